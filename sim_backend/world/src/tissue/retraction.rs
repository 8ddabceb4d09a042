//! Decides whether the flap was grasped at its mark and lifted, and catches what would only look
//! like it.
//!
//! In words: the flap counts as retracted when one jaw holds it within `mark_distance_m` of the
//! mark (measured in the material, to the middle of the area held) while the mark is at least
//! `lift_height_m` above where it lay, for `hold_s` without a break. The episode is lost when the
//! tissue is pulled or pushed harder than `force_n_max` or slips out of the jaw, when one finger
//! squeezes it harder than `squeeze_n_max`, when it is stretched by more than `stretch_max` or
//! torn, when a jaw holds it beside the mark for longer than `stray_s`, when an instrument sinks
//! into it, when it is pressed into what it lies on, when it is flung about, and when its
//! simulation breaks; the task's clock is not kept here. Forces, stretch, depths and speed count
//! once they last for 20 ms: one step alone may be a solver's hiccup.
//!
//! Rigid things may not gain energy without external work. A flap has no such check, since its
//! attached edge, the organ and the jaws all do work on it. A broken simulation of it shows
//! otherwise: energy gain as speed (flung) and stretch (torn), at the worst as nodes that must be
//! slowed down since they would cross half a cell in a sub-step (16 m/s as the task ships; no hand
//! is that fast, so one is enough) or as numbers out of their range; a contact that gives way as
//! depth, of the instrument in the tissue or of the tissue in the organ.

use core::fmt;

use hal::TICK_S;
use hal::config::{ConfigError, Source};
use serde::Deserialize;

use super::report::TissueReport;

/// What counts as a retracted flap, and what ends the episode at once.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetractionConfig {
    /// How far the mark must be above where it lay at rest, m.
    pub lift_height_m: f64,
    /// How long it must be held up without a break, s.
    pub hold_s: f64,
    /// Distance of the middle of the held area from the mark within which the grasp is right, m.
    pub mark_distance_m: f64,
    /// How long a jaw may hold the tissue elsewhere before the episode is lost, s.
    pub stray_s: f64,
    /// Force between an instrument as a whole and the tissue, after a low pass at 50 Hz, N; a pinch
    /// is not in it. The task's 0.8 N are half of what surgeons grip a liver with (1.75 N in the
    /// mean, 3.4 N at most, doi 10.1080/13645706.2020.1755313), since the flap is 1.5 mm thick.
    pub force_n_max: f64,
    /// Normal force of one finger on the tissue, held or not, after the same low pass, N.
    pub squeeze_n_max: f64,
    /// Largest stretch (0.3 is three tenths longer than at rest).
    pub stretch_max: f64,
    /// Overlap of an instrument with the tissue's thickness, m; deeper is a fault of the
    /// simulation, and makes a trial invalid.
    pub depth_m_max: f64,
    /// How deep the tissue may be pressed into what it lies on, m: a pressure, by the stiffness of
    /// `[tissue.ground]`. The task's 0.5 mm are 5 kPa, a little more than closes a capillary (4.3
    /// kPa, Landis 1930).
    pub ground_depth_m_max: f64,
    /// Speed of the fastest point of the tissue, m/s.
    pub speed_m_s_max: f64,
}

/// How an episode of the retraction stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Retraction {
    /// Not decided yet.
    Running,
    /// The flap was grasped at the mark, lifted and held.
    Success,
    /// The episode is lost.
    Failure(RetractionFailure),
}

/// Why an episode of the retraction was lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RetractionFailure {
    /// The tissue was held at the wrong place.
    BesideMark {
        /// How far from the mark, m.
        distance_m: f64,
    },
    /// The tissue was pulled or pressed too hard.
    TooHard {
        /// How hard, N.
        force_n: f64,
    },
    /// The tissue was squeezed too hard.
    Squeezed {
        /// How hard one finger pressed, N.
        force_n: f64,
    },
    /// The tissue slipped out of the jaw because it was pulled too hard.
    SlippedOut,
    /// The tissue was stretched too far.
    Overstretched {
        /// By how much of its length at rest.
        stretch: f64,
    },
    /// The tissue tore.
    Torn,
    /// The instrument sank into the tissue.
    Sunk {
        /// How deep, m.
        depth_m: f64,
    },
    /// The tissue was pressed into what it lies on.
    PressedIn {
        /// How deep, m.
        depth_m: f64,
    },
    /// The tissue moved faster than a careful hand moves it.
    Flung {
        /// How fast, m/s.
        speed_m_s: f64,
    },
    /// Parts of the tissue would have crossed half a cell in a sub-step and were slowed down.
    Slowed {
        /// How often.
        times: u64,
    },
    /// The tissue's numbers left their range.
    OutOfRange,
}

impl fmt::Display for Retraction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Running => f.write_str("running"),
            Self::Success => f.write_str("flap grasped at the mark, lifted and held"),
            Self::Failure(failure) => failure.fmt(f),
        }
    }
}

impl RetractionFailure {
    /// Whether the simulation is at fault, not who leads the instrument.
    #[must_use]
    pub const fn is_of_the_simulation(self) -> bool {
        match self {
            Self::Sunk { .. } | Self::Slowed { .. } | Self::OutOfRange => true,
            Self::BesideMark { .. }
            | Self::TooHard { .. }
            | Self::Squeezed { .. }
            | Self::SlippedOut
            | Self::Overstretched { .. }
            | Self::Torn
            | Self::PressedIn { .. }
            | Self::Flung { .. } => false,
        }
    }
}

impl fmt::Display for RetractionFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BesideMark { distance_m } => {
                write!(f, "flap held {:.1} mm beside the mark", distance_m * 1e3)
            }
            Self::TooHard { force_n } => write!(f, "tissue handled with {force_n:.2} N"),
            Self::Squeezed { force_n } => write!(f, "tissue squeezed with {force_n:.2} N"),
            Self::SlippedOut => f.write_str("tissue slipped out of the jaw"),
            Self::Overstretched { stretch } => {
                write!(f, "tissue stretched by {:.0} %", stretch * 100.0)
            }
            Self::Torn => f.write_str("tissue torn"),
            Self::Sunk { depth_m } => {
                write!(f, "instrument sank {:.2} mm into the tissue", depth_m * 1e3)
            }
            Self::PressedIn { depth_m } => {
                let depth_mm = depth_m * 1e3;
                write!(f, "tissue pressed {depth_mm:.2} mm into what it lies on")
            }
            Self::Flung { speed_m_s } => write!(f, "tissue flung at {speed_m_s:.2} m/s"),
            Self::Slowed { times } => {
                write!(
                    f,
                    "tissue too fast for its simulation, slowed down {times} times"
                )
            }
            Self::OutOfRange => f.write_str("tissue's numbers left their range"),
        }
    }
}

impl RetractionConfig {
    /// Checks the ranges read from `source` at the dotted `key`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        let check = |name: &str, value, low, high| {
            source.check_range(&format!("{key}.{name}"), value, low, high)
        };
        check("lift_height_m", self.lift_height_m, 0.001, 0.1)?;
        check("hold_s", self.hold_s, 0.0, 10.0)?;
        check("mark_distance_m", self.mark_distance_m, 0.000_5, 0.05)?;
        check("stray_s", self.stray_s, 0.0, 10.0)?;
        check("force_n_max", self.force_n_max, 0.01, 50.0)?;
        check("squeeze_n_max", self.squeeze_n_max, 0.05, 50.0)?;
        check("stretch_max", self.stretch_max, 0.01, 2.0)?;
        check("depth_m_max", self.depth_m_max, 0.000_1, 0.01)?;
        check("ground_depth_m_max", self.ground_depth_m_max, 0.000_1, 0.01)?;
        check("speed_m_s_max", self.speed_m_s_max, 0.05, 10.0)
    }
}

/// Time for which forces, stretch, depths and speed must last to count, s.
const JUDGED_S: f64 = 0.020;

/// For how long several things have lasted without a break, s.
#[derive(Clone, Copy, Debug, Default)]
struct Lasting {
    held_s: f64,
    stray_s: f64,
    hard_s: f64,
    squeezed_s: f64,
    stretched_s: f64,
    deep_s: f64,
    pressed_in_s: f64,
    fast_s: f64,
}

/// Watches the flap, 1000 times a second.
#[derive(Clone, Debug)]
pub struct RetractionMonitor {
    config: RetractionConfig,
    lasting: Lasting,
    state: Retraction,
}

impl RetractionMonitor {
    /// A monitor at the start of an episode.
    #[must_use]
    pub fn new(config: &RetractionConfig) -> Self {
        Self {
            config: config.clone(),
            lasting: Lasting::default(),
            state: Retraction::Running,
        }
    }

    /// How the episode stands; once decided it stays.
    #[must_use]
    pub const fn state(&self) -> Retraction {
        self.state
    }

    /// For how long the mark has been held up where it is to be, s.
    #[must_use]
    pub const fn held_s(&self) -> f64 {
        self.lasting.held_s
    }

    /// Takes in what the tissue reports after one millisecond.
    pub fn observe(&mut self, report: &TissueReport) {
        if self.state != Retraction::Running {
            return;
        }
        self.count(report);
        self.state = match self.failure(report) {
            Some(failure) => Retraction::Failure(failure),
            None if self.lasting.held_s > 0.0
                && reached(self.lasting.held_s, self.config.hold_s) =>
            {
                Retraction::Success
            }
            None => Retraction::Running,
        };
    }

    fn count(&mut self, report: &TissueReport) {
        let config = &self.config;
        let beside_m = report.grasp.map(|grasp| grasp.beside_mark_m);
        let right = beside_m.is_some_and(|beside_m| beside_m <= config.mark_distance_m);
        let lifted = report.mark_rise_m >= config.lift_height_m;
        let lasting = &mut self.lasting;
        for (seconds, lasts) in [
            (&mut lasting.held_s, right && lifted),
            (&mut lasting.stray_s, beside_m.is_some() && !right),
            (
                &mut lasting.hard_s,
                report.smooth_force_n > config.force_n_max,
            ),
            (
                &mut lasting.squeezed_s,
                report.smooth_squeeze_n > config.squeeze_n_max,
            ),
            (
                &mut lasting.stretched_s,
                report.stretch > config.stretch_max,
            ),
            (
                &mut lasting.deep_s,
                report.instrument_depth_m > config.depth_m_max,
            ),
            (
                &mut lasting.pressed_in_s,
                report.ground_depth_m > config.ground_depth_m_max,
            ),
            (&mut lasting.fast_s, report.speed_m_s > config.speed_m_s_max),
        ] {
            *seconds = if lasts { *seconds + TICK_S } else { 0.0 };
        }
    }

    fn failure(&self, report: &TissueReport) -> Option<RetractionFailure> {
        let lasting = &self.lasting;
        let judged = |seconds: f64| reached(seconds, JUDGED_S);
        if report.fault {
            Some(RetractionFailure::OutOfRange)
        } else if report.slowed > 0 {
            Some(RetractionFailure::Slowed {
                times: report.slowed,
            })
        } else if report.torn {
            Some(RetractionFailure::Torn)
        } else if report.lost > 0 {
            Some(RetractionFailure::SlippedOut)
        } else if judged(lasting.hard_s) {
            Some(RetractionFailure::TooHard {
                force_n: report.smooth_force_n,
            })
        } else if judged(lasting.squeezed_s) {
            Some(RetractionFailure::Squeezed {
                force_n: report.smooth_squeeze_n,
            })
        } else if judged(lasting.stretched_s) {
            Some(RetractionFailure::Overstretched {
                stretch: report.stretch,
            })
        } else if judged(lasting.deep_s) {
            Some(RetractionFailure::Sunk {
                depth_m: report.instrument_depth_m,
            })
        } else if judged(lasting.pressed_in_s) {
            Some(RetractionFailure::PressedIn {
                depth_m: report.ground_depth_m,
            })
        } else if judged(lasting.fast_s) {
            Some(RetractionFailure::Flung {
                speed_m_s: report.speed_m_s,
            })
        } else if lasting.stray_s > 0.0 && reached(lasting.stray_s, self.config.stray_s) {
            let distance_m = report
                .grasp
                .map_or(f64::INFINITY, |grasp| grasp.beside_mark_m);
            Some(RetractionFailure::BesideMark { distance_m })
        } else {
            None
        }
    }
}

/// Whether `seconds`, a sum of steps, amounts to `limit_s`; sums of milliseconds are exact to far
/// less than half of one.
fn reached(seconds: f64, limit_s: f64) -> bool {
    seconds > limit_s - 0.5 * TICK_S
}
