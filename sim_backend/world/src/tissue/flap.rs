//! Hot path: bounded, no allocation after construction, no I/O, no lock.
//! The flap with everything that touches it, a millisecond at a time.

use hal::{Pose, TICK_S};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::bed::Bed;
use super::config::TissueConfig;
use super::contact::Part;
use super::ground::Ground;
use super::instrument::Jaw;
use super::jaw::JawInput;
use super::lay::lay;
use super::report::{JawReport, TissueReport};
use super::samples::{MaterialPoint, Samples};
use super::sheet::Sheet;

/// A flap of tissue over an organ, with the jaws that may touch it.
///
/// Equal inputs give equal bits. Numbers cannot leave their range: a node faster than half a cell a
/// sub-step is slowed to that (counted in the report), and if an input or the state is ever not
/// finite or further than a metre away, the flap stays for good where it last was, feels nothing,
/// and says so ([`TissueReport::fault`]).
#[derive(Clone, Debug)]
pub struct Tissue {
    pub(super) sheet: Sheet,
    samples: Samples,
    bed: Bed,
    jaws: Vec<Jaw>,
    mark: MaterialPoint,
    mark_m: [f64; 2],
    mark_rest: Vector3<f64>,
    substeps: u32,
    speed_max_m_s: f64,
    kept: Vec<Vector3<f64>>,
    report: TissueReport,
}

/// Milliseconds for which a new flap settles on its organ before the episode begins, heavily
/// damped.
const SETTLE_STEPS: usize = 1000;
/// Damping while it settles, 1/s.
const SETTLE_DRAG_PER_S: f64 = 25.0;
/// A coordinate beyond this is out of range, m.
const RANGE_M: f64 = 1.0;

impl Tissue {
    /// A flap that lies at rest on `ground`, with a mark drawn by `seed`, and one jaw for each of
    /// `jaws`, which must not touch it yet.
    #[must_use]
    pub fn new(config: &TissueConfig, ground: Ground, seed: u64, jaws: &[JawInput]) -> Self {
        let mut sheet = config.sheet(&config.scene_from_material());
        let bed = Bed::new(ground, &config.ground, &sheet);
        lay(&mut sheet, &bed);
        let samples = Samples::new(&sheet);
        let mark_m = config.mark.draw(seed, config);
        let mark = MaterialPoint::at(&sheet, mark_m);
        let speed_max_m_s =
            0.5 * sheet.spacing_m[0].min(sheet.spacing_m[1]) * f64::from(config.substeps) / TICK_S;
        let jaws = jaws.iter();
        let jaws = jaws.map(|input| Jaw::new(config, input, &sheet, &samples));
        let jaws = jaws.collect();
        let mut tissue = Self {
            kept: sheet.positions.clone(),
            sheet,
            samples,
            bed,
            jaws,
            mark,
            mark_m,
            mark_rest: Vector3::zeros(),
            substeps: config.substeps,
            speed_max_m_s,
            report: TissueReport::at_rest(),
        };
        tissue.settle();
        tissue
    }

    /// Lets the flap come to rest where it lies, and takes that as the rest of the mark.
    fn settle(&mut self) {
        let drag = core::mem::replace(&mut self.sheet.material.drag_per_s, SETTLE_DRAG_PER_S);
        let jaws = core::mem::take(&mut self.jaws);
        for _ in 0..SETTLE_STEPS {
            self.step(&[]);
        }
        self.jaws = jaws;
        self.sheet.material.drag_per_s = drag;
        self.sheet.velocities.fill(Vector3::zeros());
        self.mark_rest = self.mark.of(&self.sheet.positions);
        self.report = TissueReport {
            fault: self.report.fault,
            ..TissueReport::at_rest()
        };
    }

    /// Advances one millisecond, in which every jaw moves to where `inputs` says; a jaw without an
    /// input stays.
    ///
    /// A jaw may grasp or let go at the end of the millisecond.
    pub fn step(&mut self, inputs: &[JawInput]) {
        if self.report.fault {
            return;
        }
        self.kept.copy_from_slice(&self.sheet.positions);
        if !inputs.iter().all(JawInput::is_finite) {
            self.freeze();
            return;
        }
        self.begin(inputs);
        let substeps = f64::from(self.substeps);
        let dt_s = TICK_S / substeps;
        for substep in 1..=self.substeps {
            self.substep(f64::from(substep) / substeps, dt_s);
        }
        if self.in_range() {
            for jaw in &mut self.jaws {
                jaw.end(&self.sheet, &self.samples, substeps);
            }
            self.look();
        } else {
            self.freeze();
        }
    }

    /// Begins a millisecond: ground and jaws find what is near them.
    fn begin(&mut self, inputs: &[JawInput]) {
        self.bed.begin(&self.sheet);
        for (index, jaw) in self.jaws.iter_mut().enumerate() {
            let input = inputs.get(index).copied().unwrap_or(jaw.input);
            jaw.begin(&input, &self.sheet, &self.samples);
        }
    }

    fn substep(&mut self, share: f64, dt_s: f64) {
        let Self {
            sheet,
            samples,
            bed,
            jaws,
            ..
        } = self;
        sheet.load();
        bed.press(sheet);
        for jaw in jaws.iter_mut() {
            let centre = jaw.input.fingers[0].translation.vector;
            for part in &mut jaw.parts {
                part.press(sheet, samples, share, &centre);
            }
            jaw.hold.pull(sheet, &jaw.motion, share);
        }
        sheet.accelerate(dt_s);
        bed.rub_as_before(sheet);
        for part in jaws.iter_mut().flat_map(|jaw| &mut jaw.parts) {
            part.rub_as_before(sheet);
        }
        for jaw in jaws.iter_mut() {
            let centre = jaw.input.fingers[0].translation.vector;
            jaw.hold.act(sheet, dt_s, &centre);
            for part in &mut jaw.parts {
                part.rub(sheet, share, dt_s, &centre);
            }
        }
        bed.rub(sheet, dt_s);
        self.report.slowed += slow_down(&mut sheet.velocities, self.speed_max_m_s);
        sheet.drift(dt_s);
    }

    /// Whether every node is within [`RANGE_M`] and every velocity finite.
    fn in_range(&self) -> bool {
        let near = |v: &Vector3<f64>| v.iter().all(|x| x.abs() <= RANGE_M);
        self.sheet.positions.iter().all(near)
            && self
                .sheet
                .velocities
                .iter()
                .all(|v| v.iter().all(|x| x.is_finite()))
    }

    /// Stops for good where the flap last was.
    fn freeze(&mut self) {
        self.sheet.positions.copy_from_slice(&self.kept);
        self.sheet.velocities.fill(Vector3::zeros());
        for jaw in &mut self.jaws {
            jaw.hold.let_go();
            jaw.report = JawReport::untouched();
        }
        let torn = self.report.torn;
        self.report = TissueReport {
            fault: true,
            torn,
            ..TissueReport::at_rest()
        };
    }

    /// Reads off what the report says.
    fn look(&mut self) {
        let stretch = self.sheet.stretch_max();
        let report = &mut self.report;
        report.stretch = stretch;
        report.torn |= stretch > self.sheet.material.tear_strain;
        report.ground_depth_m = self.bed.depth_m();
        report.feel(self.jaws.iter().map(|jaw| jaw.report));
        report.speed_m_s = self
            .sheet
            .velocities
            .iter()
            .map(Vector3::norm)
            .fold(0.0, f64::max);
        report.lost = self.jaws.iter().map(|jaw| jaw.hold.lost()).sum();
        report.mark_rise_m = (self.mark.of(&self.sheet.positions) - self.mark_rest).z;
        self.measure_from_mark();
        self.report.grasp = self.jaws.iter().find_map(|jaw| jaw.report.grasp);
    }

    /// Reads off how far beside the mark each jaw holds the tissue, m along it.
    fn measure_from_mark(&mut self) {
        let mark_m = self.mark_m;
        for jaw in &mut self.jaws {
            if let Some(grasp) = &mut jaw.report.grasp {
                let [u, v] = [grasp.middle_m[0] - mark_m[0], grasp.middle_m[1] - mark_m[1]];
                grasp.beside_mark_m = (u * u + v * v).sqrt();
            }
        }
    }

    /// Forces and deformation of the whole flap in the newest step.
    #[must_use]
    pub const fn report(&self) -> &TissueReport {
        &self.report
    }

    /// Contact of one jaw in the newest step; none for a jaw that does not exist.
    #[must_use]
    pub fn jaw(&self, index: usize) -> JawReport {
        self.jaws
            .get(index)
            .map_or(JawReport::untouched(), |jaw| jaw.report)
    }

    /// The elastic sheet, for drawing and tests.
    #[must_use]
    pub const fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    /// Material coordinates of the mark, m.
    #[must_use]
    pub const fn mark_m(&self) -> [f64; 2] {
        self.mark_m
    }

    /// The mark in the scene: on the upper face, x along the material's u axis (the free edge), z
    /// out of the tissue.
    #[must_use]
    pub fn mark_in_scene(&self) -> Pose {
        let [u, v] = self.mark.tangents(&self.sheet.positions);
        let out = u.cross(&v);
        let (along, out) = match (u.try_normalize(0.0), out.try_normalize(0.0)) {
            (Some(along), Some(out)) => (along, out),
            _ => (Vector3::x(), Vector3::z()),
        };
        let axes = Matrix3::from_columns(&[along, out.cross(&along), out]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let at =
            self.mark.of(&self.sheet.positions) + out * (0.5 * self.sheet.material.thickness_m);
        Pose::from_parts(at.into(), rotation)
    }

    /// The complete state, for a hash.
    pub fn state(&self) -> impl Iterator<Item = f64> + '_ {
        let vectors = self.sheet.positions.iter().chain(&self.sheet.velocities);
        let holds = self.jaws.iter().flat_map(|jaw| jaw.hold.state());
        let parts = self
            .jaws
            .iter()
            .flat_map(|jaw| &jaw.parts)
            .flat_map(Part::state);
        let vectors = vectors.flat_map(|v| [v.x, v.y, v.z]);
        vectors.chain(holds).chain(parts).chain(self.bed.state())
    }
}

/// Slows everything faster than `most_m_s` down to it; returns how many.
fn slow_down(velocities: &mut [Vector3<f64>], most_m_s: f64) -> u64 {
    let mut slowed = 0;
    for velocity in velocities {
        let speed = velocity.norm();
        if speed > most_m_s {
            *velocity *= most_m_s / speed;
            slowed += 1;
        }
    }
    slowed
}
