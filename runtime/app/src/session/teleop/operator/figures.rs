//! What a simulated operator is like, in figures.

use serde::Serialize;
use trocar_tasks::expert::SettleCriteria;

/// Which delays there can be, ms.
pub const DELAYS_MS: core::ops::RangeInclusive<u64> = 0..=500;

/// Which tremors there can be, mm rms.
pub const TREMORS_MM: core::ops::RangeInclusive<f64> = 0.0..=2.0;

/// What a simulated operator is like. The first two can be chosen by a user; the rest is the same
/// for all.
///
/// **Tremor.** Surgeons' hands tremble by 0.05 to 0.2 mm rms at 8 to 12 Hz (Wells, Yang,
/// MacLachlan, Handa, Gehlbach and Riviere, "Comparison of baseline tremor under various
/// microsurgical conditions", IEEE SMC 2013). The default is in the middle.
///
/// **Noise.** A hand's error grows with its speed (Harris and Wolpert, "Signal-dependent noise
/// determines motor planning", Nature 394, 1998). Here a part `noise` of the speed, along each
/// axis, with a correlation of `noise_s`: a movement over a distance D along a minimum-jerk profile
/// of T seconds ends off by `noise * D * sqrt(2.9 * noise_s / T)`, which is 4 % of a way of one
/// second.
///
/// **Submovements.** What is seen to be off by more than `near_m` or `near_rad` is corrected by
/// another minimum-jerk movement on top of the one under way (Flash and Henis, "Arm trajectory
/// modifications during reaching towards visual targets", J. Cogn. Neurosci. 3, 1991), one at a
/// time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OperatorFigures {
    /// How old what the operator sees is, ms; looked at every 8 ms.
    pub delay_ms: u64,
    /// Tremor of a hand, mm rms in all three directions together.
    pub tremor_mm: f64,
    /// Tremor's frequencies, Hz.
    pub tremor_hz: [f64; 2],
    /// Distance from where the hand turns to where its tremor is felt, m: it turns by that much
    /// less.
    pub tremor_lever_m: f64,
    /// Noise of a moving hand over its speed, along and about each axis.
    pub noise: f64,
    /// Correlation time of the noise, s.
    pub noise_s: f64,
    /// Error of a trigger that is held half pressed, over its whole way.
    pub trigger_noise: f64,
    /// Pace over the scripted expert's, drawn for each episode.
    pub tempo: [f64; 2],
    /// How much later than the hand a tip moves, as far as the operator has learned to expect it,
    /// s.
    pub arm_lag_s: f64,
    /// Error of a tip that is let be, m.
    pub near_m: f64,
    /// The same of its rotation, rad.
    pub near_rad: f64,
    /// How long a correction takes, s.
    pub correction_s: f64,
    /// From the start of a correction to that of the next, s.
    pub correct_every_s: f64,
    /// Pause at the end of each movement, s.
    pub pause_s: [f64; 2],
    /// Error of the tip with which the next movement may begin, m.
    pub arrived_m: f64,
    /// The same, rad.
    pub arrived_rad: f64,
    /// How long to wait for it at most, s.
    pub patience_s: f64,
    /// How far a hand goes in comfort before it lets the clutch go and comes back, m.
    pub range_m: f64,
    /// How far it turns, rad.
    pub range_rad: f64,
    /// How long it takes to come back, s.
    pub return_s: f64,
    /// How long it takes to slow down for that, and to get going again, s.
    pub slow_s: f64,
    /// Before the clutch is taken, s.
    pub reaction_s: [f64; 2],
}

impl Default for OperatorFigures {
    fn default() -> Self {
        Self {
            delay_ms: 80,
            tremor_mm: 0.1,
            tremor_hz: [8.0, 12.0],
            tremor_lever_m: 0.05,
            noise: 0.075,
            noise_s: 0.1,
            trigger_noise: 0.01,
            tempo: [0.7, 1.0],
            arm_lag_s: 0.06,
            near_m: 0.000_4,
            near_rad: 0.03,
            correction_s: 0.25,
            correct_every_s: 0.3,
            pause_s: [0.1, 0.4],
            arrived_m: 0.000_7,
            arrived_rad: 0.06,
            patience_s: 1.5,
            range_m: 0.1,
            range_rad: 0.7,
            return_s: 0.6,
            slow_s: 0.2,
            reaction_s: [0.2, 0.5],
        }
    }
}

impl OperatorFigures {
    /// What the script waits for.
    pub(super) const fn care(&self) -> SettleCriteria {
        SettleCriteria {
            near_m: self.arrived_m,
            near_rad: self.arrived_rad,
            pause_s: self.pause_s,
            patience_s: self.patience_s,
        }
    }
}
