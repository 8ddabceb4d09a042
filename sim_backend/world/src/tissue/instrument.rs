//! One instrument in the tissue: its parts, its hold, and what it felt of both.
//!
//! A millisecond of it: `begin` takes the new poses and looks for what is near, sub-steps press and
//! rub with the parts and pull with the hold, `end` sums up what was felt and lets the hold decide
//! whether the next millisecond grasps, keeps or tears loose.

use hal::{Pose, TICK_S};
use nalgebra::Vector3;

use super::config::TissueConfig;
use super::contact::{Felt, Part};
use super::grasp::Hold;
use super::jaw::{JawInput, Motion, PAD_MIDDLE_M, Solid, Wrench, frame_along};
use super::report::{Grasp, JawReport};
use super::samples::Samples;
use super::sheet::Sheet;

/// One instrument.
#[derive(Clone, Debug)]
pub(super) struct Jaw {
    /// Where it is at the end of this millisecond.
    pub(super) input: JawInput,
    /// Of the middle between the fingers, over this millisecond.
    pub(super) motion: Motion,
    /// First finger, second finger, wrist.
    pub(super) parts: [Part; 3],
    /// What tissue is between the pads.
    pub(super) hold: Hold,
    /// Of the last millisecond that has ended.
    pub(super) report: JawReport,
}

/// Gap of an empty jaw's ends, over the tissue's thickness, below which nothing fits between them.
const SHUT: f64 = 0.5;

impl Jaw {
    pub(super) fn new(
        config: &TissueConfig,
        input: &JawInput,
        sheet: &Sheet,
        samples: &Samples,
    ) -> Self {
        let [first, second] = input.fingers;
        let (wrist, wrist_m) = frame_along(&input.wrist[0], &input.wrist[1]);
        let part = |solid, pose: &Pose| Part::new(solid, &config.instrument, pose, sheet, samples);
        Self {
            input: *input,
            motion: Motion::new(&input.middle(), &input.middle(), TICK_S),
            parts: [
                part(Solid::finger(1.0), &first),
                part(Solid::finger(-1.0), &second),
                part(Solid::wrist(wrist_m), &wrist),
            ],
            hold: Hold::new(&config.grasp, sheet, samples),
            report: JawReport::untouched(),
        }
    }

    /// An empty jaw that is shut counts as one solid: both fingers reach through to each other's
    /// outer face, so that tissue is not drawn into a gap that it would not fit.
    pub(super) fn begin(&mut self, input: &JawInput, sheet: &Sheet, samples: &Samples) {
        self.motion = Motion::new(&self.input.middle(), &input.middle(), TICK_S);
        self.input = *input;
        let (wrist, _) = frame_along(&input.wrist[0], &input.wrist[1]);
        let poses = [input.fingers[0], input.fingers[1], wrist];
        self.hold.begin();
        let shut = !self.hold.holds() && input.gap_m() < SHUT * sheet.material.thickness_m;
        for (part, side) in self.parts.iter_mut().zip([1.0, -1.0]) {
            part.reshape(if shut {
                Solid::shut_finger()
            } else {
                Solid::finger(side)
            });
        }
        for (part, pose) in self.parts.iter_mut().zip(poses) {
            part.begin(&pose, TICK_S, sheet, samples, self.hold.held());
        }
    }

    /// Forces are means over the `substeps`. Each pad gets half of the patch's pull; the squeeze
    /// goes to both with opposite signs.
    pub(super) fn end(&mut self, sheet: &Sheet, samples: &Samples, substeps: f64) {
        let felt: [Felt; 3] = [0, 1, 2].map(|index| self.parts[index].felt(substeps));
        let pull = self.hold.felt(substeps);
        let grasp = self.hold.holds().then(|| self.grasp(sheet, &pull));
        let mut wrenches = felt.map(|felt| felt.wrench);
        // Both pads share what the patch pulls.
        wrenches[0].add(&pull.scaled(0.5));
        wrenches[1].add(&pull.scaled(0.5));
        let squeeze_n = self.hold.squeeze_n(&self.input, sheet);
        let squeezed = squeeze(&self.input.middle(), squeeze_n);
        wrenches[0].add(&squeezed);
        wrenches[1].add(&squeezed.scaled(-1.0));
        self.report = JawReport {
            fingers: [wrenches[0], wrenches[1]],
            wrist: wrenches[2],
            pressed_n: felt.map(|felt| felt.load_n),
            squeezed_n: squeeze_n,
            depth_m: felt.iter().map(|felt| felt.depth_m).fold(0.0, f64::max),
            grasp,
        };
        let pressed_n = [felt[0].load_n, felt[1].load_n];
        self.hold
            .decide(&self.input, sheet, samples, pressed_n, pull.force.norm());
    }

    /// `beside_mark_m` is filled in by the flap, which knows the mark.
    fn grasp(&self, sheet: &Sheet, pull: &Wrench) -> Grasp {
        Grasp {
            area_m2: self.hold.area_m2(),
            force_n: pull.force.norm(),
            middle_m: self.hold.middle_m(sheet),
            beside_mark_m: f64::INFINITY,
        }
    }
}

/// What squeezed tissue does to the first finger of a jaw around `middle`: a force along y at the
/// pads' middle. The second finger feels the opposite, so that nothing is left of it on the whole.
fn squeeze(middle: &Pose, force_n: f64) -> Wrench {
    let mut wrench = Wrench::zero();
    let lever = middle.rotation * Vector3::new(0.0, 0.0, PAD_MIDDLE_M);
    wrench.push(&lever, &(middle.rotation * Vector3::new(0.0, force_n, 0.0)));
    wrench
}
