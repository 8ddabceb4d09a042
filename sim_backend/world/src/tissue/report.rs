//! What the tissue says about itself after every millisecond.

use super::jaw::Wrench;

/// What a jaw holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grasp {
    /// Area held, m².
    pub area_m2: f64,
    /// Force between the jaw and the held patch, N; compare [`super::GraspConfig::break_force_n`].
    pub force_n: f64,
    /// Middle of the patch in the material, m.
    pub middle_m: [f64; 2],
    /// Distance of that middle from the mark, measured in the material, m.
    pub beside_mark_m: f64,
}

/// What one jaw felt of the tissue in a millisecond. Wrenches are on the instrument, in the scene's
/// axes, about the hinge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JawReport {
    /// On each finger.
    pub fingers: [Wrench; 2],
    /// On the wrist.
    pub wrist: Wrench,
    /// Sums of the normal forces with which the fingers and the wrist press on tissue that they do
    /// not hold, N.
    pub pressed_n: [f64; 3],
    /// Force with which the tissue between the pads that it does hold pushes each of them back, N.
    pub squeezed_n: f64,
    /// Deepest overlap of the instrument with the tissue's thickness, m.
    pub depth_m: f64,
    /// What it holds.
    pub grasp: Option<Grasp>,
}

impl JawReport {
    /// Nothing felt.
    #[must_use]
    pub const fn untouched() -> Self {
        Self {
            fingers: [Wrench::zero(); 2],
            wrist: Wrench::zero(),
            pressed_n: [0.0; 3],
            squeezed_n: 0.0,
            depth_m: 0.0,
            grasp: None,
        }
    }

    /// The wrench on the whole instrument.
    #[must_use]
    pub fn total(&self) -> Wrench {
        let mut total = self.wrist;
        total.add(&self.fingers[0]);
        total.add(&self.fingers[1]);
        total
    }

    /// Normal force of each finger on the tissue, held or not, N.
    #[must_use]
    pub fn finger_n(&self) -> [f64; 2] {
        [0, 1].map(|finger| self.pressed_n[finger] + self.squeezed_n)
    }
}

/// What the whole flap felt in a millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissueReport {
    /// The grasp, of the first jaw that has one.
    pub grasp: Option<Grasp>,
    /// Largest force between one instrument as a whole and the tissue, N: what moves it. A pinch is
    /// not in it, since its two sides cancel.
    pub force_n: f64,
    /// The same after a low pass at 50 Hz, N.
    pub smooth_force_n: f64,
    /// Largest normal force of one finger on the tissue, held or not, N: what crushes it.
    pub squeeze_n: f64,
    /// The same after a low pass at 50 Hz, N.
    pub smooth_squeeze_n: f64,
    /// Largest stretch of the tissue (0.1 is a tenth longer than at rest).
    pub stretch: f64,
    /// Whether the stretch ever exceeded the tearing strain. The mesh does not open; the tissue
    /// there only yields.
    pub torn: bool,
    /// How often the tissue has slipped out of a jaw because it pulled too hard.
    pub lost: u32,
    /// How far the mark is above where it lay at rest, m.
    pub mark_rise_m: f64,
    /// Speed of the fastest point, m/s.
    pub speed_m_s: f64,
    /// Deepest overlap of an instrument with the tissue's thickness, m.
    pub instrument_depth_m: f64,
    /// Deepest that the tissue sank into the organ, m.
    pub ground_depth_m: f64,
    /// How often a node was slowed down because it would have crossed half a cell in a sub-step,
    /// since the start.
    pub slowed: u64,
    /// Whether numbers left their range; the flap then stays where it was.
    pub fault: bool,
}

impl TissueReport {
    /// A flap at rest that nothing touches.
    #[must_use]
    pub const fn at_rest() -> Self {
        Self {
            grasp: None,
            force_n: 0.0,
            smooth_force_n: 0.0,
            squeeze_n: 0.0,
            smooth_squeeze_n: 0.0,
            stretch: 0.0,
            torn: false,
            lost: 0,
            mark_rise_m: 0.0,
            speed_m_s: 0.0,
            instrument_depth_m: 0.0,
            ground_depth_m: 0.0,
            slowed: 0,
            fault: false,
        }
    }

    /// Takes in what the jaws feel after a millisecond.
    pub(super) fn feel(&mut self, jaws: impl Iterator<Item = JawReport> + Clone) {
        let most = |of: fn(&JawReport) -> f64| jaws.clone().map(|jaw| of(&jaw)).fold(0.0, f64::max);
        self.force_n = most(|jaw| jaw.total().force.norm());
        self.squeeze_n = most(|jaw| jaw.finger_n().into_iter().fold(0.0, f64::max));
        self.instrument_depth_m = most(|jaw| jaw.depth_m);
        low_pass(&mut self.smooth_force_n, self.force_n);
        low_pass(&mut self.smooth_squeeze_n, self.squeeze_n);
    }
}

/// Cut-off of the forces that the report gives beside the plain ones, as a share per millisecond:
/// 50 Hz.
const FORCE_SHARE: f64 = 0.239;
/// What is left of a fading force below this is none, N.
const FORCE_N_MIN: f64 = 1e-12;

fn low_pass(smooth_n: &mut f64, force_n: f64) {
    *smooth_n += FORCE_SHARE * (force_n - *smooth_n);
    if *smooth_n < FORCE_N_MIN {
        *smooth_n = 0.0;
    }
}

/// What a flap went through in an episode: the largest values so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TissueExtremes {
    /// Force between an instrument as a whole and the tissue after a low pass at 50 Hz, N.
    pub force_n: f64,
    /// Normal force of one finger on the tissue after the same low pass, N.
    pub squeeze_n: f64,
    /// Stretch (0.1 is a tenth longer than at rest).
    pub stretch: f64,
    /// How far the mark was above where it lay at rest, m.
    pub mark_rise_m: f64,
}

impl TissueExtremes {
    /// Takes in what the flap says after a millisecond.
    pub fn observe(&mut self, report: &TissueReport) {
        self.force_n = self.force_n.max(report.smooth_force_n);
        self.squeeze_n = self.squeeze_n.max(report.smooth_squeeze_n);
        self.stretch = self.stretch.max(report.stretch);
        self.mark_rise_m = self.mark_rise_m.max(report.mark_rise_m);
    }
}
