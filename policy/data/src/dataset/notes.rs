//! What a recorder says of how a dataset came about, beyond what LeRobot's format has room for.
//!
//! ```text
//! meta/info.json, key "trocar"     how the recording differs from a plain one; LeRobot ignores the key, with a warning
//! meta/trocar_recording.json       every option of the recording, which one that resumes it must have too
//! meta/trocar_episodes.jsonl       a line an episode: episode_index, and what was particular to it
//! ```
//!
//! A dataset without such notes has none of them; LeRobot does not look at the files.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use hal::files;
use serde_json::Value;

use super::{
    DatasetError,
    layout::read_lines,
    meta,
    store::{io_error, write_json, write_lines},
};

/// What is said of a dataset.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Notes {
    /// Of the recording as a whole, where LeRobot's users see it. The key `trocar` of `info.json`;
    /// an object.
    pub recording: Option<Value>,
    /// The options of the recording, all of them. `trocar_recording.json`; an object.
    pub options: Option<Value>,
    /// Of episodes, in their order; each has its `episode_index`.
    pub episodes: Vec<Value>,
}

impl Notes {
    /// Reads what the dataset in the folder `dir` says.
    ///
    /// Lines of episodes beyond the total of `info.json` are left out, as their rows are. Missing
    /// notes are no error; a missing `info.json` is.
    ///
    /// # Errors
    /// [`DatasetError::Io`] or [`DatasetError::Json`], naming the file.
    pub fn read(dir: &Path) -> Result<Self, DatasetError> {
        let info = meta::read_info(dir)?;
        let path = path(dir);
        let mut episodes: Vec<Value> = if path.exists() {
            read_lines(&path)?
        } else {
            Vec::new()
        };
        // What is beyond the total was being written when the recording was cut off.
        let counts = |note: &Value| {
            let index = note["episode_index"].as_u64();
            index.is_some_and(|index| index < info.total_episodes as u64)
        };
        episodes.retain(counts);
        Ok(Self {
            recording: info.trocar,
            options: read_options(dir)?,
            episodes,
        })
    }

    /// Writes the options of the recording, if they are told.
    pub(super) fn write_options(&self, dir: &Path) -> Result<(), DatasetError> {
        match &self.options {
            Some(options) => write_json(&options_path(dir), options),
            None => Ok(()),
        }
    }

    /// Adds what `note`, an object, says of the episode `index`.
    pub(super) fn add(&mut self, index: usize, note: Value) {
        let mut line = serde_json::Map::new();
        line.insert("episode_index".to_owned(), index.into());
        if let Value::Object(note) = note {
            line.extend(note);
        }
        self.episodes.push(Value::Object(line));
    }

    /// Writes what is said of episodes; if nothing is, there is no file.
    pub(super) fn write_episodes(&self, dir: &Path) -> Result<(), DatasetError> {
        let path = path(dir);
        if !self.episodes.is_empty() {
            return write_lines(&path, &self.episodes);
        }
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(io_error(&path)(error)),
            Err(_) | Ok(()) => Ok(()),
        }
    }
}

/// None if the file is missing.
fn read_options(dir: &Path) -> Result<Option<Value>, DatasetError> {
    let path = options_path(dir);
    let text = match files::read(&path, "its JSON", files::JSON_SIZE_MAX) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(io_error(&path)(error)),
    };
    let options = serde_json::from_slice(&text);
    options
        .map(Some)
        .map_err(|source| DatasetError::Json { path, source })
}

fn options_path(dir: &Path) -> PathBuf {
    dir.join("meta/trocar_recording.json")
}

fn path(dir: &Path) -> PathBuf {
    dir.join("meta/trocar_episodes.jsonl")
}

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_json::json;

    use super::*;
    use crate::dataset::{ArmFrame, Dataset, DatasetSpec, DatasetWriter, FrameRecord};

    /// A folder of its own for one test, removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(test: &str) -> Self {
            let name = format!("trocar-notes-{test}-{}", std::process::id());
            let path = std::env::temp_dir().join(name);
            let _absent = fs::remove_dir_all(&path);
            Self(path)
        }

        fn writer(&self) -> DatasetWriter {
            let spec = DatasetSpec {
                fps: 25,
                robot_type: "psm".to_owned(),
                arms: 1,
                task: "Lift the needle".to_owned(),
                cameras: Vec::new(),
                intervention: false,
            };
            DatasetWriter::create(&self.0, &spec).unwrap()
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _absent = fs::remove_dir_all(&self.0);
        }
    }

    fn push(writer: &mut DatasetWriter) {
        let arms = [ArmFrame {
            state: [0.1; 7],
            tip_pose: [0.2; 7],
            action: [0.3; 8],
        }];
        let frame = FrameRecord {
            arms: &arms,
            images: &[],
            depth: &[],
        };
        writer.push_frame(&frame).unwrap();
    }

    #[test]
    fn what_was_said_is_read_again() {
        let folder = Folder::new("read");
        let mut writer = folder.writer();
        writer.describe(json!({"disturb": 0.5})).unwrap();
        writer.keep_options(json!({"seed": 3})).unwrap();
        for seed in 3..5 {
            push(&mut writer);
            writer.end_episode_with(json!({"seed": seed})).unwrap();
        }
        writer.finish().unwrap();
        let notes = Notes::read(&folder.0).unwrap();
        assert_eq!(notes.recording, Some(json!({"disturb": 0.5})));
        assert_eq!(notes.options, Some(json!({"seed": 3})));
        let expected = [3, 4].map(|seed| json!({"episode_index": seed - 3, "seed": seed}));
        assert_eq!(notes.episodes, expected);
        assert_eq!(Dataset::open(&folder.0).unwrap().len(), 2);
    }

    #[test]
    fn nothing_said_writes_nothing() {
        let folder = Folder::new("nothing");
        let mut writer = folder.writer();
        push(&mut writer);
        writer.end_episode().unwrap();
        assert_eq!(Notes::read(&folder.0).unwrap(), Notes::default());
        assert!(!path(&folder.0).exists() && !options_path(&folder.0).exists());
        let info = fs::read_to_string(folder.0.join("meta/info.json")).unwrap();
        assert!(!info.contains("trocar"), "{info}");
    }

    #[test]
    fn an_episode_that_is_not_counted_has_no_note() {
        let folder = Folder::new("uncounted");
        let mut writer = folder.writer();
        // Without a frame it is no episode.
        assert!(writer.end_episode_with(json!({"seed": 1})).is_err());
        push(&mut writer);
        writer.end_episode_with(json!({"seed": 2})).unwrap();
        // What a recording leaves that is cut off between the lines and the count.
        let text = fs::read_to_string(path(&folder.0)).unwrap();
        fs::write(
            path(&folder.0),
            format!("{text}{{\"episode_index\":1,\"seed\":3}}\n"),
        )
        .unwrap();
        let notes = Notes::read(&folder.0).unwrap();
        assert_eq!(notes.episodes, [json!({"episode_index": 0, "seed": 2})]);
        fs::write(path(&folder.0), "no JSON\n").unwrap();
        let message = Notes::read(&folder.0).unwrap_err().to_string();
        assert!(message.contains("trocar_episodes.jsonl"), "{message}");
    }
}
