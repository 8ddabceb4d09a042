//! The axes of a grid, and where on them an evaluation lies.

use serde::{Deserialize, Serialize};

/// An axis of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// Task.
    Task,
    /// Network.
    Network,
    /// Way of recording.
    Recording,
    /// Number of demonstrations.
    Demonstrations,
    /// Needle.
    Needle,
    /// View.
    View,
    /// Execution mode.
    Execution,
}

/// All axes, in the order in which a grid is walked through.
pub const AXES: [Axis; 7] = [
    Axis::Task,
    Axis::Recording,
    Axis::Needle,
    Axis::View,
    Axis::Execution,
    Axis::Demonstrations,
    Axis::Network,
];

impl Axis {
    /// Its heading in tables.
    #[must_use]
    pub const fn heading(self) -> &'static str {
        match self {
            Self::Task => "task",
            Self::Network => "network",
            Self::Recording => "recording",
            Self::Demonstrations => "demonstrations",
            Self::Needle => "needle",
            Self::View => "view",
            Self::Execution => "execution",
        }
    }
}

/// Where an evaluation lies in a grid. Trainings that differ in their seed alone lie at the same
/// place.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Coordinates {
    /// The task by its name in the study.
    pub task: String,
    /// The network by its name in the study.
    pub network: String,
    /// The way of recording, of what is trained.
    pub recording: Option<String>,
    /// The number of demonstrations, of what is trained.
    pub demonstrations: Option<usize>,
    /// The needle, if the grid names any.
    pub needle: Option<String>,
    /// From where the cameras look.
    pub view: String,
    /// The execution mode, if the grid names any.
    pub execution: Option<String>,
}

impl Coordinates {
    /// The place on `axis`; empty where there is none.
    #[must_use]
    pub fn on(&self, axis: Axis) -> String {
        match axis {
            Axis::Task => self.task.clone(),
            Axis::Network => self.network.clone(),
            Axis::Recording => self.recording.clone().unwrap_or_default(),
            Axis::Demonstrations => self
                .demonstrations
                .map_or_else(String::new, |n| n.to_string()),
            Axis::Needle => self.needle.clone().unwrap_or_default(),
            Axis::View => self.view.clone(),
            Axis::Execution => self.execution.clone().unwrap_or_default(),
        }
    }
}
