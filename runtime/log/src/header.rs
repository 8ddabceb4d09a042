//! What a log says about its run as a whole: how it was set up, and how it ended.
//!
//! Four metadata records of strings: `run` (task, policy, seed, lockstep, view, and what applies of
//! needle, varied, `left_out`), `versions`, `configuration` (file name to text), and at the end
//! `outcome` (counts, `input_hash`, `contents_sha256`, `goes_on` if another file follows, and of a
//! run that was closed success, reason, `command_hash`, mark, label, teleop). Numbers are decimal,
//! hashes hexadecimal with 16 digits (FNV-1a) or 64 (SHA-256). Keys that are not known are passed
//! over.

use std::collections::BTreeMap;
use std::fmt;

use hal::Pose;
use hal::config::Source;
use serde::{Deserialize, Serialize};
use trocar_control::ControlConfig;

use super::contents::ContentHash;

/// How a run was set up; written before the first tick.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunHeader {
    /// Task name.
    pub task: String,
    /// `expert`, `noop`, `random` or the checkpoint's directory.
    pub policy: String,
    /// The seed of all random numbers.
    pub seed: u64,
    /// Whether time was the tick counter.
    pub lockstep: bool,
    /// From where the cameras looked: `train`, `view1` or `view2`; empty in a log of before there
    /// was a choice.
    pub view: String,
    /// The needle, in a task that has a choice.
    pub needle: Option<String>,
    /// What is drawn anew for each episode, by name; empty if nothing is.
    pub varied: Vec<String>,
    /// What was running: program, libraries, commit; name to version. Of a checkpoint
    /// `weights_sha256`, the SHA-256 of its weights.
    pub versions: BTreeMap<String, String>,
    /// The effective configuration; file name (`control.toml`) to text.
    pub texts: BTreeMap<String, String>,
    /// Ticks of the run before the first in this file, which a log with a bound has left behind.
    pub left_out: u64,
}

impl RunHeader {
    /// Where the arms' remote centres are in the scene, as the run's own configuration says;
    /// nothing if there is none.
    pub(super) fn rcms_in_scene(&self) -> Vec<Pose> {
        let source = |file: &'static str| Some(Source::embedded(file, self.text(file)?));
        let both = source("control.toml").zip(source("safety.toml"));
        let config = both.and_then(|(control, safety)| ControlConfig::load(&control, &safety).ok());
        let arms = config.into_iter().flat_map(|config| config.arms);
        arms.map(|arm| arm.scene_from_rcm).collect()
    }
}

/// How a run ended; written after the last tick.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunOutcome {
    /// Whether the task was done; none of a robot that has no task.
    pub success: Option<bool>,
    /// Why the run ended.
    pub reason: String,
    /// Hash over the bits of every command, as the run reported it.
    ///
    /// 16 hexadecimal digits of [`trocar_control::CommandHash`].
    pub command_hash: String,
    /// What a person said of it.
    pub said: RunNote,
    /// What an operator's hands did, a JSON object as its text; none if they drove nothing.
    pub teleop: Option<String>,
}

/// What a person says of a run that no task judges.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunNote {
    /// How it went, if they say so.
    pub mark: Option<RunMark>,
    /// What they call it; empty if they don't.
    pub label: String,
}

/// How a person says that a run went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunMark {
    /// What was to be done is done.
    Success,
    /// It is not done.
    Failure,
    /// It is neither: the run is of no use.
    Discard,
}

impl RunMark {
    /// As pages and logs have it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure => "failure",
            Self::Discard => "discard",
        }
    }

    /// The mark of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let all = [Self::Success, Self::Failure, Self::Discard];
        all.into_iter().find(|mark| mark.name() == name)
    }
}

impl fmt::Display for RunNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.mark {
            Some(mark) => write!(f, "marked {}", mark.name())?,
            None => f.write_str("not marked")?,
        }
        match self.label.as_str() {
            "" => Ok(()),
            label => write!(f, ", label {label:?}"),
        }
    }
}

impl RunNote {
    /// Whether nothing was said.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.mark.is_none() && self.label.is_empty()
    }

    /// What was said, to end a sentence with, such as `; marked success`; empty if nothing was
    /// said.
    #[must_use]
    pub fn clause(&self) -> String {
        if self.is_empty() {
            String::new()
        } else {
            format!("; {self}")
        }
    }
}

/// What the logger wrote and what it had to leave out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogCounts {
    /// Ticks written.
    pub ticks: u64,
    /// Chunks written.
    pub chunks: u64,
    /// Camera frames written.
    pub frames: u64,
    /// Ticks that found the queue full.
    pub ticks_dropped: u64,
    /// Chunks that found the queue full.
    pub chunks_dropped: u64,
    /// Frames that found the queue full.
    pub frames_dropped: u64,
    /// Events, scenes of policy steps, and states of buses, that found their queue full.
    pub events_dropped: u64,
}

/// Names of the metadata records.
pub(super) const RUN: &str = "run";
pub(super) const VERSIONS: &str = "versions";
pub(super) const CONFIGURATION: &str = "configuration";
pub(super) const OUTCOME: &str = "outcome";

type Map = BTreeMap<String, String>;

/// The whole number at `key`; none if it is missing or no number.
fn number(map: &Map, key: &str) -> Option<u64> {
    map.get(key)?.parse().ok()
}

impl RunHeader {
    /// Text of the configuration file `name`, as the run used it.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.texts.get(name).map(String::as_str)
    }

    /// The metadata records that hold this header: name and entries.
    pub(super) fn to_metadata(&self) -> [(&'static str, Map); 3] {
        let run = [
            ("task", self.task.clone()),
            ("policy", self.policy.clone()),
            ("seed", self.seed.to_string()),
            ("lockstep", self.lockstep.to_string()),
            ("view", self.view.clone()),
        ];
        let needle = self.needle.clone().map(|needle| ("needle", needle));
        let varied = Some(("varied", self.varied.join(",")));
        let varied = varied.filter(|_| !self.varied.is_empty());
        let left_out = Some(("left_out", self.left_out.to_string()));
        let left_out = left_out.filter(|_| self.left_out > 0);
        let run = run
            .into_iter()
            .chain(needle)
            .chain(varied)
            .chain(left_out)
            .map(|(key, value)| (key.to_owned(), value))
            .collect();
        [
            (RUN, run),
            (VERSIONS, self.versions.clone()),
            (CONFIGURATION, self.texts.clone()),
        ]
    }

    /// Takes over one metadata record; `false` if it lacks something.
    pub(super) fn absorb(&mut self, name: &str, map: Map) -> bool {
        match name {
            RUN => {
                let (Some(task), Some(policy)) = (map.get("task"), map.get("policy")) else {
                    return false;
                };
                let Some(seed) = number(&map, "seed") else {
                    return false;
                };
                self.task.clone_from(task);
                self.policy.clone_from(policy);
                self.seed = seed;
                self.lockstep = map.get("lockstep").is_some_and(|text| text == "true");
                self.view = map.get("view").cloned().unwrap_or_default();
                self.needle = map.get("needle").cloned();
                let varied = map.get("varied").into_iter();
                self.varied = varied
                    .flat_map(|names| names.split(','))
                    .map(str::to_owned)
                    .collect();
                self.left_out = number(&map, "left_out").unwrap_or(0);
            }
            VERSIONS => self.versions = map,
            CONFIGURATION => self.texts = map,
            _ => {}
        }
        true
    }
}

/// Keys of [`LogCounts`] in the closing record, in the order of its values.
const COUNT_KEYS: [&str; 7] = [
    "ticks",
    "chunks",
    "frames",
    "ticks_dropped",
    "chunks_dropped",
    "frames_dropped",
    "events_dropped",
];

impl LogCounts {
    fn values(&self) -> [u64; 7] {
        [
            self.ticks,
            self.chunks,
            self.frames,
            self.ticks_dropped,
            self.chunks_dropped,
            self.frames_dropped,
            self.events_dropped,
        ]
    }

    /// Whether ticks or chunks are missing, without which a replay cannot be exact.
    #[must_use]
    pub const fn lost_inputs(&self) -> bool {
        self.ticks_dropped > 0 || self.chunks_dropped > 0
    }
}

/// The closing metadata record: the outcome, if the run had one, what was written, and what the
/// controller was given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Closing {
    /// How the run ended; none if it was not closed with an outcome.
    pub(super) outcome: Option<RunOutcome>,
    /// Whether the run goes on in another file: counts and hash are those of a moment, of which
    /// this one may lack the last ticks.
    pub(super) goes_on: bool,
    /// What was written and dropped.
    pub(super) counts: LogCounts,
    /// Hash over all inputs of the controller.
    ///
    /// [`trocar_control::InputHash`]; 16 hexadecimal digits in the record.
    pub(super) input_hash: u64,
    /// Hash over everything that the log holds, this record too but for the hash itself; none in a
    /// log of before there was one, which nothing vouches for.
    pub(super) contents: Option<String>,
}

/// The hash of a log that holds `before` and then the closing record `map`.
pub(super) fn contents_after(before: &ContentHash, map: &Map) -> String {
    let mut map = map.clone();
    map.remove(CONTENTS);
    let mut contents = before.clone();
    contents.metadata(OUTCOME, &map);
    contents.value()
}

/// The mark in the closing record `map`, if there is one that is no [`RunMark`].
pub(super) fn unknown_mark(map: &Map) -> Option<String> {
    let unknown = |name: &&String| RunMark::named(name).is_none();
    map.get(MARK).filter(unknown).cloned()
}

/// Further keys of the closing record.
const INPUT_HASH: &str = "input_hash";
const GOES_ON: &str = "goes_on";
const MARK: &str = "mark";
const LABEL: &str = "label";
const TELEOP: &str = "teleop";
/// Left out of the map while the hash over it is computed.
const CONTENTS: &str = "contents_sha256";

impl Closing {
    pub(super) fn to_metadata(&self) -> Map {
        let mut map: Map = COUNT_KEYS
            .iter()
            .zip(self.counts.values())
            .map(|(key, value)| ((*key).to_owned(), value.to_string()))
            .collect();
        map.insert(INPUT_HASH.to_owned(), format!("{:016x}", self.input_hash));
        if self.goes_on {
            map.insert(GOES_ON.to_owned(), "true".to_owned());
        }
        if let Some(contents) = &self.contents {
            map.insert(CONTENTS.to_owned(), contents.clone());
        }
        if let Some(outcome) = &self.outcome {
            if let Some(success) = outcome.success {
                map.insert("success".to_owned(), success.to_string());
            }
            map.insert("reason".to_owned(), outcome.reason.clone());
            map.insert("command_hash".to_owned(), outcome.command_hash.clone());
            if let Some(mark) = outcome.said.mark {
                map.insert(MARK.to_owned(), mark.name().to_owned());
            }
            if !outcome.said.label.is_empty() {
                map.insert(LABEL.to_owned(), outcome.said.label.clone());
            }
            if let Some(teleop) = &outcome.teleop {
                map.insert(TELEOP.to_owned(), teleop.clone());
            }
        }
        map
    }

    /// Reads what [`Self::to_metadata`] wrote; `None` if a count or the hash is missing.
    pub(super) fn parse(map: &Map) -> Option<Self> {
        let mut values = [0; COUNT_KEYS.len()];
        for (value, key) in values.iter_mut().zip(COUNT_KEYS) {
            *value = number(map, key)?;
        }
        let [
            ticks,
            chunks,
            frames,
            ticks_dropped,
            chunks_dropped,
            frames_dropped,
            events_dropped,
        ] = values;
        let counts = LogCounts {
            ticks,
            chunks,
            frames,
            ticks_dropped,
            chunks_dropped,
            frames_dropped,
            events_dropped,
        };
        let outcome = match map.get("reason") {
            None => None,
            Some(reason) => Some(RunOutcome {
                success: map.get("success").map(|success| success == "true"),
                reason: reason.clone(),
                command_hash: map.get("command_hash")?.clone(),
                said: RunNote {
                    mark: map.get(MARK).and_then(|name| RunMark::named(name)),
                    label: map.get(LABEL).cloned().unwrap_or_default(),
                },
                teleop: map.get(TELEOP).cloned(),
            }),
        };
        let input_hash = u64::from_str_radix(map.get(INPUT_HASH)?, 16).ok()?;
        Some(Self {
            outcome,
            goes_on: map.contains_key(GOES_ON),
            counts,
            input_hash,
            contents: map.get(CONTENTS).cloned(),
        })
    }
}
