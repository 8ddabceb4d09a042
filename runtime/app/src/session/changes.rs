//! Single values in the place of those of configuration files: `--set FILE.KEY=VALUE`, the last
//! layer over what is built in and over files that are given.
//!
//! A change is typed text until it is applied: it becomes a TOML value only in the `Source` of its
//! file, which knows what type the key has. Ranges are checked afterwards, with all changes made,
//! by whoever parses the file.

use core::fmt;
use core::str::FromStr;

use hal::config::{ConfigError, Source};

use super::SessionError;

/// A configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConfigFile {
    /// The controller's settings.
    ///
    /// `control.toml`: limits, aggregation, gate, policy time-outs, what a fault does.
    Control,
    /// The task's, or the robot's, limits.
    Safety,
    /// The task's scene.
    ///
    /// `scene.toml`, or the file of `--scene`.
    Scene,
    /// Nodes and buses.
    ///
    /// `can.toml`: interfaces, bit rate, cycle, one node an axis.
    Can,
    /// What the threads of a run in real time ask of the operating system.
    ///
    /// `realtime.toml`: priorities, CPUs, hold and overrun limits.
    Realtime,
}

impl ConfigFile {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Control,
        Self::Safety,
        Self::Scene,
        Self::Can,
        Self::Realtime,
    ];

    /// The first part of a changed key, and the file's name without its ending.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Control => "control",
            Self::Safety => "safety",
            Self::Scene => "scene",
            Self::Can => "can",
            Self::Realtime => "realtime",
        }
    }
}

/// Keys that files may leave out, and what stands for them until they are set.
///
/// `Source::with` changes only keys that a file has, which finds typing errors. These would be
/// refused though they are valid: file, the keys, and the TOML that is merged in first so that the
/// key exists.
const OPTIONAL: [(ConfigFile, &[&str], &str); 7] = [
    (
        ConfigFile::Scene,
        &["scene.patient", "scene.organ"],
        "[scene]\npatient = \"\"\norgan = \"\"\n",
    ),
    (
        ConfigFile::Scene,
        &["scene.needle"],
        "[scene]\nneedle = \"\"\n",
    ),
    (
        ConfigFile::Control,
        &["gate.resume_m_max"],
        "[gate]\nresume_m_max = 0.01\n",
    ),
    (
        ConfigFile::Control,
        &["gate.resume_rad_max"],
        "[gate]\nresume_rad_max = 0.2\n",
    ),
    (
        ConfigFile::Control,
        &["policy.frozen_s"],
        "[policy]\nfrozen_s = 0.0\n",
    ),
    (
        ConfigFile::Realtime,
        &["overruns_per_s_max"],
        "overruns_per_s_max = 0\n",
    ),
    (
        ConfigFile::Control,
        &["fault.ends_run"],
        "[fault]\nends_run = true\n",
    ),
];

/// A value for a key of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    file: ConfigFile,
    key: String,
    /// As typed, without surrounding blanks; `FILE.KEY` has no `=` in it, the value may.
    value: String,
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}={}", self.file.name(), self.key, self.value)
    }
}

impl FromStr for Change {
    type Err = String;

    /// Splits at the first `=` and the first `.`: everything behind is the key with its own dots.
    /// Whether the file has the key is not known here.
    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text
            .split_once('=')
            .and_then(|(key, value)| key.trim().split_once('.').map(|key| (key, value.trim())));
        let Some(((file, key), value)) = parts else {
            return Err(
                "expected FILE.KEY=VALUE, such as control.aggregation.decay=0.02".to_owned(),
            );
        };
        let known = ConfigFile::ALL
            .into_iter()
            .find(|known| known.name() == file);
        let file = known.ok_or_else(|| {
            let names = ConfigFile::ALL.map(ConfigFile::name).join(", ");
            format!("there is no configuration file {file:?}; there are {names}")
        })?;
        Ok(Self {
            file,
            key: key.to_owned(),
            value: value.to_owned(),
        })
    }
}

/// Values in the order in which they were given: of two for one key the last one counts.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Changes(pub Vec<Change>);

impl Changes {
    /// `source`, which is `file`, with what is to be changed in it.
    ///
    /// Changes of other files are passed over; without any the source is returned as it is.
    ///
    /// # Errors
    /// [`ConfigError::NoKey`] with the keys that there are.
    pub fn apply(&self, file: ConfigFile, source: Source) -> Result<Source, ConfigError> {
        let mut changed = source;
        for change in self.0.iter().filter(|change| change.file == file) {
            for (of, keys, stands) in OPTIONAL {
                if of == file && keys.contains(&change.key.as_str()) {
                    changed = changed.or_with(&change.key, stands);
                }
            }
            changed = changed.with(&change.key, &change.value)?;
        }
        Ok(changed)
    }

    /// Those of `files`, as they are typed.
    ///
    /// For the command line of the cameras' process, which reads these files again.
    pub fn of<'a>(&'a self, files: &'a [ConfigFile]) -> impl Iterator<Item = String> + 'a {
        let of = self.0.iter().filter(|change| files.contains(&change.file));
        of.map(ToString::to_string)
    }

    /// Refuses a change of a file that is not among those that are `read`.
    ///
    /// A verb that reads no `can.toml`, say, would otherwise take `--set can.x=1` and do nothing.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`].
    pub fn only(&self, read: &[ConfigFile]) -> Result<(), SessionError> {
        match self.0.iter().find(|change| !read.contains(&change.file)) {
            None => Ok(()),
            Some(change) => {
                let names: Vec<&str> = read.iter().map(|file| file.name()).collect();
                Err(SessionError::BadArgument(format!(
                    "--set {change}: no {}.toml is read here, only {}",
                    change.file.name(),
                    names.join(", ")
                )))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_change_of_a_key_counts_and_other_files_stay() {
        let changes = ["can.cycle_us=4000", "can.cycle_us = 1000", "scene.a=1"];
        let changes = Changes(changes.map(|text| text.parse().unwrap()).into());
        let source = |text| Source::embedded("f.toml", text);
        let can = changes.apply(ConfigFile::Can, source("cycle_us = 2000\n"));
        assert_eq!(can.unwrap().text(), "cycle_us = 1000\n");
        let control = changes.apply(ConfigFile::Control, source("cycle_us = 2000\n"));
        assert_eq!(control.unwrap().text(), "cycle_us = 2000\n");
        let refused = changes.only(&[ConfigFile::Can, ConfigFile::Control]);
        assert_eq!(
            refused.unwrap_err().to_string(),
            "--set scene.a=1: no scene.toml is read here, only can, control"
        );
    }

    /// The patient of a scene, which no shipped file names, can be set; a file that names one keeps
    /// it.
    #[test]
    fn a_patient_is_set_in_a_scene_without_one() {
        let set = |text: &str, changes: &[&str]| {
            let changes = changes.iter().map(|change| change.parse().unwrap());
            let source = Source::embedded("scene.toml", text);
            let scene = Changes(changes.collect()).apply(ConfigFile::Scene, source);
            scene.map(|scene| scene.text().to_owned())
        };
        let both = ["scene.scene.patient=runs/p", "scene.scene.organ=liver"];
        let scene = "[scene]\npatient = \"runs/p\"\norgan = \"liver\"\n";
        assert_eq!(set("a = 1", &both).unwrap(), format!("a = 1\n{scene}"));
        let organ = set(scene, &["scene.scene.organ=spleen"]).unwrap();
        assert_eq!(organ, scene.replace("liver", "spleen"));
        assert!(set("a = 1", &["scene.scene.body=x"]).is_err());
        // So can the needle that lies on it, before or after them.
        let needle = "needle = \"N3\"\n";
        let with_needle = scene.replace("[scene]\n", &format!("[scene]\n{needle}"));
        let changed = set(scene, &["scene.scene.needle=N3"]).unwrap();
        assert_eq!(changed, with_needle);
        let all = ["scene.scene.needle=N3", both[0], both[1]];
        let keys = scene.replace("[scene]\n", "");
        let first = set("a = 1", &all).unwrap();
        assert_eq!(first, format!("a = 1\n[scene]\n{keys}{needle}"));
    }

    /// So can what a file has a table for, but no key; where it has one, that is changed.
    #[test]
    fn a_key_that_may_be_left_out_is_set_in_its_table() {
        let set = |text: &str| {
            let change = "control.gate.resume_m_max=0.02".parse().unwrap();
            let source = Source::embedded("control.toml", text);
            let control = Changes(vec![change]).apply(ConfigFile::Control, source);
            control.unwrap().text().to_owned()
        };
        let (before, after) = (
            "[gate] \na = 1\n[policy]\n",
            "[gate] \nresume_m_max = 0.02\na = 1\n[policy]\n",
        );
        assert_eq!(set(before), after);
        assert_eq!(set(&after.replace("0.02", "0.03")), after);
        assert_eq!(
            set("a = 1\n[gate] # of chunks"),
            "a = 1\n[gate] # of chunks\nresume_m_max = 0.02\n"
        );
        // And one of no table.
        let change = "realtime.overruns_per_s_max=5".parse().unwrap();
        let source = Source::embedded("realtime.toml", "[control]\na = 1\n");
        let real_time = Changes(vec![change]).apply(ConfigFile::Realtime, source);
        assert_eq!(
            real_time.unwrap().text(),
            "overruns_per_s_max = 5\n[control]\na = 1\n"
        );
    }

    #[test]
    fn what_is_no_change_is_refused_with_its_form() {
        for text in ["control", "control.a", "a=1", "=", ""] {
            assert!(
                text.parse::<Change>()
                    .unwrap_err()
                    .contains("FILE.KEY=VALUE"),
                "{text}"
            );
        }
        let refused = "controls.a=1".parse::<Change>().unwrap_err();
        assert!(
            refused.contains("control, safety, scene, can, realtime"),
            "{refused}"
        );
    }
}
