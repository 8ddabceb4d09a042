//! A LeRobot dataset as recordings.

use image::RgbImage;

use super::super::ImportError;
use super::ImportRequest;
use super::mapping::CameraMapping;
use super::recordings::{Label, Numbers, Recordings, distinct};
use crate::dataset::DatasetError;
use crate::dataset::foreign::Foreign;
use crate::dataset::schema::TIMESTAMP;

/// By how much the mean spacing of an episode's timestamps may differ from what the dataset's rate
/// says.
const SPACING_TOLERANCE: f64 = 0.2;
/// Times above this are of a clock, not of an episode, and as `f32` they say nothing, s.
const CLOCK_S: f64 = 1e6;

/// Numbers, texts and frames come from [`Foreign`]; this adds what an import checks of them.
pub(super) struct LerobotRecordings {
    dataset: Foreign,
    /// The text feature with each frame's words, if the mapping names one and the dataset has it.
    instruction: Option<String>,
}

impl LerobotRecordings {
    /// Opens the dataset, and says which cameras of the mapping it has.
    pub(super) fn open(request: &ImportRequest) -> Result<(Self, Vec<CameraMapping>), ImportError> {
        let known = Foreign::features(&request.source)?;
        let cameras = &request.mapping.cameras;
        // One that has to be there is opened in any case, which says that it is not.
        let wanted = |camera: &&CameraMapping| !camera.optional || known.contains(&camera.feature);
        let chosen: Vec<CameraMapping> = cameras.iter().filter(wanted).cloned().collect();
        let features: Vec<String> = chosen.iter().map(|it| it.feature.clone()).collect();
        let dataset = Foreign::open(&request.source, &features)?;
        if chosen.is_empty() && !cameras.is_empty() {
            let names: Vec<&str> = cameras.iter().map(|it| it.feature.as_str()).collect();
            return Err(ImportError::Missing {
                place: dataset.info_path().display().to_string(),
                name: format!("each camera of the mapping ({})", names.join(", ")),
            });
        }
        let instruction = request.mapping.instruction.clone();
        // Not every dataset has words a frame; the episode's task is there in any case.
        let instruction = instruction.filter(|feature| dataset.has(feature));
        let recordings = Self {
            dataset,
            instruction,
        };
        Ok((recordings, chosen))
    }

    /// The times in the rows must be those of the rate that `info.json` says, where they are an
    /// episode's at all.
    fn check_rate(&mut self, episode: usize) -> Result<(), ImportError> {
        if !self.dataset.has(TIMESTAMP) {
            return Ok(());
        }
        let (_, times) = self.dataset.numbers(episode, TIMESTAMP)?;
        let (Some(&first), Some(&last)) = (times.first(), times.last()) else {
            return Ok(());
        };
        if times.len() < 2 || first.abs() > CLOCK_S {
            return Ok(());
        }
        if let Some(step) = times.windows(2).position(|pair| pair[1] <= pair[0]) {
            return Err(ImportError::Mismatch {
                place: self.place(episode),
                name: TIMESTAMP.to_owned(),
                found: format!("does not go on after step {step}"),
                expected: "times that increase".to_owned(),
            });
        }
        #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
        let spacing_s = (last - first) / (times.len() - 1) as f64;
        let expected_s = 1.0 / f64::from(self.dataset.fps());
        if (spacing_s / expected_s - 1.0).abs() <= SPACING_TOLERANCE {
            return Ok(());
        }
        Err(ImportError::Mismatch {
            place: self.place(episode),
            name: TIMESTAMP.to_owned(),
            found: format!("is {spacing_s:.4} s apart in the mean"),
            expected: format!("{expected_s:.4}, by the fps of meta/info.json"),
        })
    }
}

impl Recordings for LerobotRecordings {
    fn fps(&self) -> u32 {
        self.dataset.fps()
    }

    fn robot_type(&self) -> Option<String> {
        self.dataset.robot_type().map(str::to_owned)
    }

    fn episodes(&self) -> usize {
        self.dataset.episodes()
    }

    fn place(&self, episode: usize) -> String {
        let path = self.dataset.data_path(episode).display();
        format!("{path}, episode {episode}")
    }

    fn steps(&mut self, episode: usize) -> Result<usize, ImportError> {
        self.check_rate(episode)?;
        Ok(self.dataset.episode_len(episode))
    }

    fn numbers(&mut self, episode: usize, feature: &str) -> Result<Numbers, ImportError> {
        let names = self.dataset.element_names(feature)?;
        let (width, values) = self.dataset.numbers(episode, feature)?;
        Ok(Numbers {
            names,
            width,
            values,
        })
    }

    fn words(&mut self, episode: usize) -> Result<Vec<String>, ImportError> {
        let texts = match self.instruction.clone() {
            Some(feature) => self.dataset.texts(episode, &feature)?,
            None => self.dataset.tasks(episode)?,
        };
        Ok(distinct(texts))
    }

    fn label(&self, episode: usize) -> Result<Label, ImportError> {
        for (split, label) in [("failure", Label::Failure), ("recovery", Label::Recovery)] {
            if self.dataset.is_in_split(split, episode)? {
                return Ok(label);
            }
        }
        Ok(Label::Plain)
    }

    fn is_in_split(&self, split: &str, episode: usize) -> Result<bool, ImportError> {
        if self.dataset.split(split).is_none() {
            let known = self.dataset.split_names().join(", ");
            let path = self.dataset.info_path().display();
            let text = format!("--split {split}: {path} has splits {known}");
            return Err(ImportError::Options(text));
        }
        Ok(self.dataset.is_in_split(split, episode)?)
    }

    fn camera_size(&mut self, camera: usize) -> Result<(u32, u32), ImportError> {
        Ok(self.dataset.camera_size(camera))
    }

    fn rgb(&mut self, episode: usize, step: usize, camera: usize) -> Result<RgbImage, ImportError> {
        let image: Result<RgbImage, DatasetError> = self.dataset.rgb(episode, step, camera);
        Ok(image?)
    }
}
