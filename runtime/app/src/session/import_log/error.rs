//! Why run logs can't become a dataset.

use std::path::PathBuf;

use trocar_log::{LogError, RunMark};

/// What is wrong with which log, and what helps.
#[derive(Debug, thiserror::Error)]
pub enum LogImportError {
    /// The file is no log, or damaged.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log does not hold its run up to the end.
    #[error(
        "{log}: the log is cut off ({reason}), so it is no whole episode; leave it out, and repeat the run up to its end"
    )]
    Cut {
        /// The log.
        log: PathBuf,
        /// Where and how.
        reason: String,
    },
    /// The log had a bound and holds a part of its run.
    #[error(
        "{log}: the log holds a part of its run ({reason}), so it is no whole episode; leave it out, and record without --log-max-mb"
    )]
    Bounded {
        /// The log.
        log: PathBuf,
        /// Which part is missing.
        reason: String,
    },
    /// The log is not what the run wrote.
    #[error(
        "{log}: something was changed, put in or taken away since the run wrote it; import the log as it was"
    )]
    Altered {
        /// The log.
        log: PathBuf,
    },
    /// What its operator said of the run is not known here.
    #[error(
        "{log}: its mark is {mark:?}, which is none of {}, {} and {}; import it with the version that recorded it",
        RunMark::Success.name(),
        RunMark::Failure.name(),
        RunMark::Discard.name()
    )]
    Mark {
        /// The log.
        log: PathBuf,
        /// The mark.
        mark: String,
    },
    /// What an operator's hands did in the run can't be read.
    #[error(
        "{log}: its `teleop` is {text:?}, which is no JSON object; import it with the version that recorded it"
    )]
    Teleop {
        /// The log.
        log: PathBuf,
        /// What it says.
        text: String,
    },
    /// No arm was asked for anything.
    #[error(
        "{log}: its arms were never ENABLED with a target at once, so there is nothing to learn from; leave it out"
    )]
    NeverAsked {
        /// The log.
        log: PathBuf,
    },
    /// A camera is not in the log.
    #[error(
        "{log}: has no frames of {camera}, only of {found}; give --cameras those that all logs have, and `run --cameras` those to be kept"
    )]
    NoCamera {
        /// The log.
        log: PathBuf,
        /// The camera.
        camera: String,
        /// The cameras that there are.
        found: String,
    },
    /// No camera is in the log.
    #[error("{log}: has no camera frames; `trocar run --cameras NAMES --log FILE` keeps them")]
    NoFrames {
        /// The log.
        log: PathBuf,
    },
    /// A camera shows too little for the rate.
    #[error(
        "{log}: too few frames of {camera} for --fps {fps}: it has {rate_hz:.1} a second, and none for {gap_ms:.0} ms from {from_s:.2} s on (at most {needed_ms:.0} ms, and one step of 20 without its own); {remedy}"
    )]
    TooFew {
        /// The log.
        log: PathBuf,
        /// The camera.
        camera: String,
        /// The rate that was asked for, Hz.
        fps: u32,
        /// The measured one, Hz.
        rate_hz: f64,
        /// The longest time without a frame, ms.
        gap_ms: f64,
        /// When it begins by the run's clock, s.
        from_s: f64,
        /// What would always do, ms.
        needed_ms: f64,
        /// What helps.
        remedy: String,
    },
    /// The images of a camera change their size.
    #[error(
        "{log}: the images of {camera} are {} x {} at first and {} x {} at {at_s:.2} s; --resize WIDTHxHEIGHT makes them alike", first.0, first.1, other.0, other.1
    )]
    Sizes {
        /// The log.
        log: PathBuf,
        /// The camera.
        camera: String,
        /// Width and height at first, pixels.
        first: (u32, u32),
        /// Others.
        other: (u32, u32),
        /// When they come, s.
        at_s: f64,
    },
    /// An image can't be decoded.
    #[error("{log}: the image of {camera} at {at_s:.2} s cannot be decoded; leave the log out")]
    Image {
        /// The log.
        log: PathBuf,
        /// The camera.
        camera: String,
        /// When it was taken, s.
        at_s: f64,
        /// The codec's reason.
        #[source]
        source: image::ImageError,
    },
    /// Ticks are missing, or what belongs to them.
    #[error("{log}: lacks {what} at {at_s:.3} s; leave the log out")]
    Missing {
        /// The log.
        log: PathBuf,
        /// What is missing.
        what: String,
        /// When, s.
        at_s: f64,
    },
    /// NaN or infinity.
    #[error("{log}: {what} of {arm} is non-finite at {at_s:.3} s; leave the log out")]
    NotFinite {
        /// The log.
        log: PathBuf,
        /// What is.
        what: &'static str,
        /// The arm.
        arm: &'static str,
        /// When, s.
        at_s: f64,
    },
    /// A log of another robot.
    #[error(
        "{log}: has {found}, the first log {expected}; import logs of one robot, choose --cameras that all have, and bring images to one size by --resize"
    )]
    Differs {
        /// The log.
        log: PathBuf,
        /// Its arms and cameras.
        found: String,
        /// Those of the first one.
        expected: String,
    },
    /// There is no run whose task was done.
    #[error("none of the {count} runs has done its task; --failures takes them")]
    Failures {
        /// How many there are.
        count: usize,
    },
    /// There is no run that was not discarded.
    #[error("the operator has discarded all of the {count} runs: nothing is left to import")]
    Discarded {
        /// How many there are.
        count: usize,
    },
}

impl LogImportError {
    /// Whether the logs are at fault, rather than the reading of them.
    #[must_use]
    pub const fn is_bad_input(&self) -> bool {
        match self {
            Self::Log(error) => error.is_bad_input(),
            Self::Cut { .. }
            | Self::Bounded { .. }
            | Self::Altered { .. }
            | Self::Mark { .. }
            | Self::Teleop { .. }
            | Self::NeverAsked { .. }
            | Self::NoCamera { .. }
            | Self::NoFrames { .. }
            | Self::TooFew { .. }
            | Self::Sizes { .. }
            | Self::Image { .. }
            | Self::Missing { .. }
            | Self::NotFinite { .. }
            | Self::Differs { .. }
            | Self::Failures { .. }
            | Self::Discarded { .. } => true,
        }
    }
}
