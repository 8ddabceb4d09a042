//! The table of names: which numbers of a foreign dataset are an arm's poses, jaw and commands, and
//! in which units.
//!
//! TOML; unknown keys are refused, so a misspelt one is not taken for an optional part left out.

use hal::config::{ConfigError, Source};
use hal::psm::DEGREE;
use serde::Deserialize;

use hal::{ARM_NAMES, JOINT_COUNT};

/// The mappings that are built in: name, path in the repository, text.
const BUILT_IN: [(&str, &str, &str); 2] = [
    (
        "open-h-dvrk",
        "config/mappings/open-h-dvrk.toml",
        include_str!("../../../../../config/mappings/open-h-dvrk.toml"),
    ),
    (
        "dvrk-raw",
        "config/mappings/dvrk-raw.toml",
        include_str!("../../../../../config/mappings/dvrk-raw.toml"),
    ),
];

/// What the folder holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// A LeRobot dataset of v2.0, v2.1 or v3.0.
    Lerobot,
    /// Folders of a dVRK's recordings: images and a table of numbers an episode.
    DvrkRaw,
}

/// Unit of positions and of the insertion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LengthUnit {
    /// Metres.
    M,
    /// Millimetres.
    Mm,
}

impl LengthUnit {
    pub(super) const fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Mm => 1e-3,
        }
    }
}

/// Unit of the jaw and the joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AngleUnit {
    /// Radians.
    Rad,
    /// Degrees.
    Deg,
}

impl AngleUnit {
    pub(super) const fn radians(self) -> f64 {
        match self {
            Self::Rad => 1.0,
            Self::Deg => DEGREE,
        }
    }
}

/// The order of a quaternion's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum QuaternionOrder {
    /// x, y, z, w.
    Xyzw,
    /// w, x, y, z.
    Wxyz,
}

/// Some numbers of a feature: by their names there, by their indices from 0, or all of them.
/// Columns with neither names nor indices mean every number of the feature.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Columns {
    /// The feature.
    pub feature: String,
    /// Names of its numbers, in the order that is meant.
    #[serde(default)]
    pub names: Vec<String>,
    /// Or their indices.
    #[serde(default)]
    pub indices: Vec<usize>,
}

/// Where the RCM frame of an arm is in the frame that its poses are given in.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frame {
    /// Position, m.
    pub position_m: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation_xyzw: [f64; 4],
}

/// One arm: its poses or its joints, its jaw, and what was commanded.
///
/// Measured: `tip_position` with `tip_orientation`, `joints`, or both. Commanded: `action_position`
/// with `action_orientation`, or `action_joints`, not both.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmMapping {
    /// Left out where the dataset names none of its numbers.
    #[serde(default)]
    pub optional: bool,
    /// Measured position of the tip: three numbers.
    pub tip_position: Option<Columns>,
    /// Measured orientation of the tip: a quaternion.
    pub tip_orientation: Option<Columns>,
    /// Measured positions of the six joints; computed from the pose if not given.
    pub joints: Option<Columns>,
    /// Measured jaw angle.
    pub jaw: Columns,
    /// Commanded position of the tip, absolute.
    pub action_position: Option<Columns>,
    /// Commanded orientation of the tip, absolute.
    pub action_orientation: Option<Columns>,
    /// Commanded joints instead, absolute.
    pub action_joints: Option<Columns>,
    /// Commanded jaw angle.
    pub action_jaw: Columns,
    /// Where the poses' frame is not the arm's RCM frame: where that is in it.
    pub rcm_in_source: Option<Frame>,
}

/// One camera.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraMapping {
    /// Its name in the new dataset.
    pub name: String,
    /// Its name there if the robot has one arm.
    pub name_of_one_arm: Option<String>,
    /// Its feature, or its folder.
    pub feature: String,
    /// Left out where the dataset has none.
    #[serde(default)]
    pub optional: bool,
}

/// A table of names, read and checked.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// What the folder holds.
    pub format: Format,
    /// Unit of positions and of the insertion.
    pub length_unit: LengthUnit,
    /// Unit of the jaw and the joints.
    pub angle_unit: AngleUnit,
    /// Order of quaternions.
    pub quaternion: QuaternionOrder,
    /// From the wrist-yaw axis to the tip that the poses are of, along the tip frame's z, m. 0
    /// where poses are of the wrist-yaw axis, the dVRK's control point; within ±0.1.
    pub tip_beyond_wrist_m: f64,
    /// The feature with each frame's words; the episode's task if not given.
    pub instruction: Option<String>,
    /// The arms, psm1 first.
    pub arms: Vec<ArmMapping>,
    /// The cameras, in the new dataset's order.
    #[serde(default)]
    pub cameras: Vec<CameraMapping>,
}

impl Mapping {
    /// Reads the mapping of this name if one is built in, else the file of this path.
    ///
    /// # Errors
    /// [`ConfigError`] with file, line, key and what is allowed.
    pub fn read(name: &str) -> Result<Self, ConfigError> {
        let built_in = BUILT_IN.iter().find(|(known, _, _)| *known == name);
        let source = match built_in {
            Some((_, path, text)) => Source::embedded(path, text),
            None => Source::read(name)?,
        };
        Self::parse(&source)
    }

    /// Names of the mappings that are built in.
    pub fn built_in() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _, _)| *name)
    }

    fn parse(source: &Source) -> Result<Self, ConfigError> {
        let mapping: Self = source.parse()?;
        let offset_m = mapping.tip_beyond_wrist_m;
        source.check_range("tip_beyond_wrist_m", offset_m, -0.1, 0.1)?;
        let arms = mapping.arms.len();
        if !(1..=ARM_NAMES.len()).contains(&arms) {
            let allowed = format!("1 to {} tables", ARM_NAMES.len());
            return Err(source.out_of_range("arms", &format!("{arms} tables"), &allowed));
        }
        for (index, arm) in mapping.arms.iter().enumerate() {
            arm.check(source, index)?;
        }
        for (index, camera) in mapping.cameras.iter().enumerate() {
            let names = [Some(&camera.name), camera.name_of_one_arm.as_ref()];
            for name in names.into_iter().flatten() {
                if name.is_empty() || name.contains(['/', '\\']) {
                    let key = format!("cameras.{index}.name");
                    return Err(source.out_of_range(&key, name, "names without '/'"));
                }
            }
        }
        Ok(mapping)
    }
}

impl ArmMapping {
    /// Every part that the arm needs must be given once, with as many numbers as it has.
    fn check(&self, source: &Source, index: usize) -> Result<(), ConfigError> {
        let tip = (&self.tip_position, &self.tip_orientation);
        let action = (&self.action_position, &self.action_orientation);
        let refuse = |key: &str, value: &str, allowed: &str| {
            Err(source.out_of_range(&format!("arms.{index}.{key}"), value, allowed))
        };
        match (tip, &self.joints) {
            ((Some(_), Some(_)), _) | ((None, None), Some(_)) => {}
            _ => {
                let allowed = "tip_position with tip_orientation, joints, or all of them";
                return refuse("tip_position", "what is there", allowed);
            }
        }
        match (action, &self.action_joints) {
            ((Some(_), Some(_)), None) | ((None, None), Some(_)) => {}
            _ => {
                let allowed = "action_position with action_orientation, or action_joints";
                return refuse("action_position", "what is there", allowed);
            }
        }
        for (key, columns, width) in self.parts() {
            let count = columns.names.len().max(columns.indices.len());
            if !columns.names.is_empty() && !columns.indices.is_empty() {
                return refuse(key, "names and indices", "one of them");
            }
            if count != 0 && count != width {
                return refuse(key, &format!("{count} numbers"), &width.to_string());
            }
        }
        match &self.rcm_in_source {
            Some(frame) => frame.check(source, &format!("arms.{index}.rcm_in_source")),
            None => Ok(()),
        }
    }

    /// What is given: key, columns and how many numbers they must be.
    pub(super) fn parts(&self) -> impl Iterator<Item = (&'static str, &Columns, usize)> {
        let all = [
            ("tip_position", self.tip_position.as_ref(), 3),
            ("tip_orientation", self.tip_orientation.as_ref(), 4),
            ("joints", self.joints.as_ref(), JOINT_COUNT),
            ("jaw", Some(&self.jaw), 1),
            ("action_position", self.action_position.as_ref(), 3),
            ("action_orientation", self.action_orientation.as_ref(), 4),
            ("action_joints", self.action_joints.as_ref(), JOINT_COUNT),
            ("action_jaw", Some(&self.action_jaw), 1),
        ];
        let given = all.into_iter();
        given.filter_map(|(key, columns, width)| columns.map(|columns| (key, columns, width)))
    }
}

impl Frame {
    fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        for value in self.position_m {
            source.check_range(&format!("{key}.position_m"), value, -10.0, 10.0)?;
        }
        let squares = self.orientation_xyzw.iter().map(|part| part * part);
        let length = squares.sum::<f64>().sqrt();
        let key = format!("{key}.orientation_xyzw");
        match (length - 1.0).abs() <= 1e-3 {
            true => Ok(()),
            false => Err(source.out_of_range(&key, &format!("length {length}"), "length 1")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl Fn(&str) -> String, expected: &[&str]) {
        let (_, path, text) = BUILT_IN[0];
        let changed = change(text);
        assert_ne!(changed, text);
        let error = Mapping::parse(&Source::embedded(path, &changed)).unwrap_err();
        let told = error.to_string();
        for part in expected {
            assert!(told.contains(part), "no {part:?} in: {told}");
        }
    }

    #[test]
    fn built_in_mappings_are_whole() {
        for name in Mapping::built_in() {
            let mapping = Mapping::read(name).unwrap();
            assert_eq!(
                (mapping.arms.len(), mapping.quaternion),
                (2, QuaternionOrder::Xyzw)
            );
            let parts = mapping.arms[1].parts().map(|(_, columns, width)| {
                assert_eq!(columns.names.len(), width);
                width
            });
            assert_eq!(parts.sum::<usize>(), 16);
        }
    }

    #[test]
    fn mistakes_name_file_line_and_key() {
        refused(
            |text| text.replace("\"rad\"", "\"degrees\""),
            &[
                "open-h-dvrk.toml:6: angle_unit",
                "degrees",
                "`rad` or `deg`",
            ],
        );
        refused(
            |text| text.replacen(", \"psm1_pose.position.z\"", "", 1),
            &["arms.0.tip_position = 2 numbers is outside 3"],
        );
        refused(
            |text| text.replace("tip_beyond_wrist_m = 0.0", "tip_beyond_wrist_m = 10.2"),
            &["tip_beyond_wrist_m = 10.2 is outside [-0.1, 0.1]"],
        );
        refused(
            |text| text.replacen("action_orientation", "action_angle", 1),
            &["unknown field `action_angle`"],
        );
        refused(
            |text| text.replace("\"side\"", "\"../side\""),
            &["cameras.2.name = ../side is outside names without '/'"],
        );
        refused(
            |text| {
                let lines = text
                    .lines()
                    .filter(|line| !line.starts_with("action_position"));
                lines.collect::<Vec<_>>().join("\n")
            },
            &[
                "arms.0.action_position",
                "action_position with action_orientation, or",
            ],
        );
    }
}
