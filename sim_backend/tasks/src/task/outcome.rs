//! How an episode stands or has ended, and why, in words.

use core::fmt;

use trocar_world::tissue::RetractionFailure;

/// How an episode stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// Not decided yet.
    Running,
    /// The task is done.
    Success,
    /// The episode is lost.
    Failure(Reason),
    /// The simulation, not the policy, is at fault: the trial says nothing.
    Invalid(Reason),
}

/// Why an episode was lost. `thing` is what the task is about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// Time ran out.
    TimeLimit {
        /// What has not happened.
        missing: &'static str,
        /// The limit, s.
        limit_s: f64,
    },
    /// The fingers sank into the thing.
    Penetration {
        /// What.
        thing: &'static str,
        /// How deep, m.
        depth_m: f64,
    },
    /// The fingers squeezed the thing harder than it stands.
    Squeezed {
        /// What.
        thing: &'static str,
        /// How hard one finger pressed, N.
        force_n: f64,
    },
    /// The thing gained energy without external work.
    Gained {
        /// What.
        thing: &'static str,
        /// How much, J.
        energy_j: f64,
    },
    /// The thing sank into what it lies on.
    Sunk {
        /// What.
        thing: &'static str,
        /// How deep, m.
        depth_m: f64,
    },
    /// The thing moved faster than careful hands move it.
    Thrown {
        /// What.
        thing: &'static str,
        /// How fast, m/s.
        speed_m_s: f64,
    },
    /// The thing fell off what it belongs on.
    Fallen {
        /// What.
        thing: &'static str,
        /// Off what.
        ground: &'static str,
    },
    /// The ground was pressed too hard for too long.
    Pressed {
        /// What was pressed.
        ground: &'static str,
        /// How hard in the end, N.
        force_n: f64,
        /// For how long, s.
        seconds: f64,
    },
    /// The flap was not retracted as it should be.
    Tissue(RetractionFailure),
    /// The thing's pose is not finite any more.
    NotFinite {
        /// What.
        thing: &'static str,
    },
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Running => f.write_str("running"),
            Self::Success => f.write_str("success"),
            Self::Failure(reason) => reason.fmt(f),
            Self::Invalid(reason) => write!(f, "invalid: {reason}"),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TimeLimit { missing, limit_s } => write!(f, "{missing} within {limit_s} s"),
            Self::Penetration { thing, depth_m } => {
                write!(f, "fingers sank {:.2} mm into the {thing}", depth_m * 1e3)
            }
            Self::Squeezed { thing, force_n } => {
                write!(f, "{thing} squeezed with {force_n:.1} N")
            }
            Self::Gained { thing, energy_j } => {
                let energy_uj = energy_j * 1e6;
                write!(
                    f,
                    "{thing} gained {energy_uj:.0} uJ without work done on it"
                )
            }
            Self::Sunk { thing, depth_m } => {
                let depth_mm = depth_m * 1e3;
                write!(f, "{thing} sank {depth_mm:.2} mm into what it lies on")
            }
            Self::Thrown { thing, speed_m_s } => write!(f, "{thing} thrown at {speed_m_s:.2} m/s"),
            Self::Fallen { thing, ground } => write!(f, "{thing} fell off the {ground}"),
            Self::Pressed {
                ground,
                force_n,
                seconds,
            } => {
                write!(
                    f,
                    "pressed on the {ground} with {force_n:.1} N, too hard for {seconds:.1} s"
                )
            }
            Self::Tissue(failure) => failure.fmt(f),
            Self::NotFinite { thing } => write!(f, "{thing} pose is not finite"),
        }
    }
}
