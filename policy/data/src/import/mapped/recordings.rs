//! What an import asks of recordings, whoever wrote them.

use image::RgbImage;

use super::super::ImportError;

/// The numbers of a feature in one episode.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Numbers {
    /// Their names; empty if they have none.
    pub(super) names: Vec<String>,
    /// How many a step has.
    pub(super) width: usize,
    /// Step after step.
    pub(super) values: Vec<f64>,
}

/// What an episode shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Label {
    /// Nothing in particular.
    Plain,
    /// How to come out of a state that went wrong.
    Recovery,
    /// A failed attempt, which no policy should learn from.
    Failure,
}

/// Recordings by episode. A `camera` is an index into those that they were opened with.
pub(super) trait Recordings {
    /// Frames a second.
    fn fps(&self) -> u32;
    /// The robot's name, if it is said.
    fn robot_type(&self) -> Option<String>;
    /// How many episodes there are.
    fn episodes(&self) -> usize;
    /// File or folder of an episode, and its number.
    fn place(&self, episode: usize) -> String;
    /// Its steps.
    fn steps(&mut self, episode: usize) -> Result<usize, ImportError>;
    /// The numbers of one of its features.
    fn numbers(&mut self, episode: usize, feature: &str) -> Result<Numbers, ImportError>;
    /// Its words: one text, or several that follow one another.
    fn words(&mut self, episode: usize) -> Result<Vec<String>, ImportError>;
    /// What it shows.
    fn label(&self, episode: usize) -> Result<Label, ImportError>;
    /// Whether a split has it.
    fn is_in_split(&self, split: &str, episode: usize) -> Result<bool, ImportError>;
    /// Width and height of a camera, pixels.
    fn camera_size(&mut self, camera: usize) -> Result<(u32, u32), ImportError>;
    /// A frame.
    fn rgb(&mut self, episode: usize, step: usize, camera: usize) -> Result<RgbImage, ImportError>;
}

/// The texts without repetitions of the one before, empty ones left out.
pub(super) fn distinct(texts: Vec<String>) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    for text in texts {
        let text = text.trim();
        if !text.is_empty() && words.last().is_none_or(|last| last != text) {
            words.push(text.to_owned());
        }
    }
    words
}
