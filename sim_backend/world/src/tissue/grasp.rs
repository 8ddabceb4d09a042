//! Grasping by area: which material lies between the pads, what holds it there, and when it lets
//! go.
//!
//! Both fingers must press on the tissue while the drive closes them; then the samples between the
//! pads are tied to the frame between the fingers, each by a spring as stiff as its share of the
//! area. The sum of those springs is what the jaw feels. Above the break force they all let go, and
//! the jaw must open before it can grasp again.

use hal::Pose;
use hal::config::{ConfigError, Source};
use hal::psm::FINGER_M;
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

use super::jaw::{FINGER_HALF_WIDTH_M, JawInput, Motion, PAD_FROM_M, Wrench};
use super::samples::{MaterialPoint, Samples};
use super::sheet::{Sheet, count};

/// When a jaw takes hold of the tissue, how firmly, and what it cannot hold.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspConfig {
    /// Least grip of the drive, N; half of it is enough to go on holding.
    pub grip_n_min: f64,
    /// Least force of each finger on the tissue at the moment of grasping, N.
    pub press_n_min: f64,
    /// Least area between the pads, m².
    pub area_m2_min: f64,
    /// Widest gap between the pads at which they bite, m: two layers of tissue, since a fold may
    /// lie between them.
    pub gap_m_max: f64,
    /// How deep the teeth at the ends of the fingers draw in tissue, beyond the end, m.
    pub bite_m: f64,
    /// Stiffness with which a square metre is held, N/m³.
    pub stiffness_n_m3: f64,
    /// Damping of the hold as a time, s.
    pub relaxation_s: f64,
    /// Force on the whole patch above which it slips out, N.
    pub break_force_n: f64,
    /// How much wider than at the grasp the jaw opens before it lets go, m.
    pub release_m: f64,
}

impl GraspConfig {
    /// Checks the ranges of a grasp read from `source` at the dotted `key`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        let check = |name: &str, value, low, high| {
            source.check_range(&format!("{key}.{name}"), value, low, high)
        };
        check("grip_n_min", self.grip_n_min, 0.01, 20.0)?;
        check("press_n_min", self.press_n_min, 0.0001, 5.0)?;
        check("area_m2_min", self.area_m2_min, 1e-6, 1e-4)?;
        check("gap_m_max", self.gap_m_max, 0.0005, 0.01)?;
        check("bite_m", self.bite_m, 0.0, 0.003)?;
        check("stiffness_n_m3", self.stiffness_n_m3, 1e6, 1e10)?;
        check("relaxation_s", self.relaxation_s, 0.0, 0.01)?;
        check("break_force_n", self.break_force_n, 0.05, 20.0)?;
        check("release_m", self.release_m, 0.0001, 0.01)
    }
}

/// One held sample.
#[derive(Clone, Copy, Debug)]
struct Tie {
    index: usize,
    point: MaterialPoint,
    /// Where it is held, in the frame between the fingers.
    anchor: Point3<f64>,
}

/// The hold of one jaw.
#[derive(Clone, Debug)]
pub(super) struct Hold {
    config: GraspConfig,
    spring_n_m: f64,
    area_m2: f64,
    ties: Vec<Tie>,
    held: Vec<bool>,
    nodes: Vec<usize>,
    stiffness_n_m: Vec<f64>,
    pulls: Vec<Vector3<f64>>,
    gap_m: f64,
    armed: bool,
    lost: u32,
    felt: Wrench,
}

/// The ends' gap at which a jaw is open enough to grasp anew, over [`GraspConfig::gap_m_max`].
const OPEN: f64 = 1.2;
/// The ends' gap at which a jaw has closed on nothing, over [`GraspConfig::gap_m_max`].
const SHUT: f64 = 0.1;
/// Compression of held tissue beyond which it pushes back no harder.
const COMPRESSION_MAX: f64 = 0.95;
/// Tissue may stand this far inside a pad and still count as between the pads, m.
const INSIDE_M: f64 = 0.000_3;

impl Hold {
    pub(super) fn new(config: &GraspConfig, sheet: &Sheet, samples: &Samples) -> Self {
        let nodes = sheet.positions.len();
        Self {
            config: *config,
            spring_n_m: config.stiffness_n_m3 * samples.area_m2,
            area_m2: samples.area_m2,
            ties: Vec::with_capacity(samples.len()),
            held: vec![false; samples.len()],
            nodes: Vec::with_capacity(nodes),
            stiffness_n_m: vec![0.0; nodes],
            pulls: vec![Vector3::zeros(); nodes],
            gap_m: 0.0,
            armed: false,
            lost: 0,
            felt: Wrench::zero(),
        }
    }

    /// Whether it holds something.
    pub(super) fn holds(&self) -> bool {
        !self.ties.is_empty()
    }

    /// Which samples it holds.
    pub(super) fn held(&self) -> &[bool] {
        &self.held
    }

    /// Area held, m².
    pub(super) fn area_m2(&self) -> f64 {
        self.area_m2 * count(self.ties.len())
    }

    /// How often the tissue has slipped out so far.
    pub(super) const fn lost(&self) -> u32 {
        self.lost
    }

    /// Middle of the held area in the material, m.
    pub(super) fn middle_m(&self, sheet: &Sheet) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for tie in &self.ties {
            let at = tie.point.material_m(sheet);
            sum = [sum[0] + at[0], sum[1] + at[1]];
        }
        sum.map(|sum| sum / count(self.ties.len().max(1)))
    }

    /// Numbers that decide the future, for hashing.
    pub(super) fn state(&self) -> impl Iterator<Item = f64> + '_ {
        let anchors = self
            .ties
            .iter()
            .flat_map(|tie| [count(tie.index), tie.anchor.x, tie.anchor.y, tie.anchor.z]);
        anchors.chain([
            self.gap_m,
            f64::from(u8::from(self.armed)),
            f64::from(self.lost),
        ])
    }

    pub(super) fn begin(&mut self) {
        self.felt = Wrench::zero();
    }

    /// Computes the pull of the ties while the jaw is at the share `share` of its `motion`.
    pub(super) fn pull(&mut self, sheet: &Sheet, motion: &Motion, share: f64) {
        if self.ties.is_empty() {
            return;
        }
        let pose = motion.at(share);
        for tie in &self.ties {
            let anchor = (pose * tie.anchor).coords;
            let moving = motion.velocity(&pose, &anchor) * self.config.relaxation_s;
            let force = (anchor - tie.point.of(&sheet.positions) + moving) * self.spring_n_m;
            for (node, weight) in tie.point.shares() {
                self.pulls[node] += force * weight;
            }
        }
    }

    /// Lets the pull act on the velocities for `dt_s`, implicitly and so without a bound on its
    /// stiffness: every held node answers as if its neighbours moved with it, which for a patch
    /// that moves as one is exact.
    pub(super) fn act(&mut self, sheet: &mut Sheet, dt_s: f64, centre: &Vector3<f64>) {
        for &node in &self.nodes {
            let mass = sheet.masses[node];
            let stiff = self.stiffness_n_m[node] * dt_s * (dt_s + self.config.relaxation_s);
            let free = sheet.velocities[node];
            let force = if sheet.inverse_masses[node] > 0.0 {
                let bound = (free * mass + self.pulls[node] * dt_s) / (mass + stiff);
                sheet.velocities[node] = bound;
                (bound - free) * (mass / dt_s)
            } else {
                self.pulls[node]
            };
            self.felt.push(&(sheet.positions[node] - centre), &-force);
            self.pulls[node] = Vector3::zeros();
        }
    }

    /// What the jaw felt of the held patch since [`Self::begin`], over `substeps` sub-steps.
    pub(super) fn felt(&self, substeps: f64) -> Wrench {
        self.felt.scaled(substeps.recip())
    }

    /// Decides at the end of a millisecond: grasp, go on holding, or let go; `pressed_n` is what
    /// the fingers press on the tissue, `pulled_n` what the patch pulls.
    pub(super) fn decide(
        &mut self,
        jaw: &JawInput,
        sheet: &Sheet,
        samples: &Samples,
        pressed_n: [f64; 2],
        pulled_n: f64,
    ) {
        let gap_m = jaw.gap_m();
        if self.holds() {
            self.let_go_if(pulled_n, gap_m, jaw.grip_n);
            return;
        }
        if gap_m > OPEN * self.config.gap_m_max {
            self.armed = true;
        } else if gap_m < SHUT * self.config.gap_m_max {
            self.armed = false;
        }
        let least_n = self.config.press_n_min;
        let pressed = pressed_n.iter().all(|load| *load >= least_n);
        if self.armed && pressed && jaw.grip_n >= self.config.grip_n_min {
            self.take(jaw, sheet, samples);
            self.gap_m = gap_m;
        }
    }

    /// Lets go where the patch is torn out of the jaw, the jaw has opened or hardly grips.
    fn let_go_if(&mut self, pulled_n: f64, gap_m: f64, grip_n: f64) {
        let torn_out = pulled_n > self.config.break_force_n;
        let opened = gap_m > self.gap_m + self.config.release_m;
        if torn_out || opened || grip_n < 0.5 * self.config.grip_n_min {
            self.lost += u32::from(torn_out);
            self.let_go();
        }
    }

    fn take(&mut self, jaw: &JawInput, sheet: &Sheet, samples: &Samples) {
        let middle = jaw.middle();
        let pads = (middle * Point3::new(0.0, 0.0, 0.5 * FINGER_M)).coords;
        let Self { config, ties, .. } = self;
        samples.around(sheet, &pads, FINGER_M, |index, point| {
            let at = Point3::from(point.of(&sheet.positions));
            if between_pads(config, jaw, &at) {
                let anchor = middle.inverse_transform_point(&at);
                ties.push(Tie {
                    index,
                    point: *point,
                    anchor,
                });
            }
        });
        if self.area_m2() < self.config.area_m2_min {
            self.ties.clear();
            return;
        }
        self.armed = false;
        self.stiffen();
    }

    /// Gives the nodes of all ties their springs.
    fn stiffen(&mut self) {
        for tie in &self.ties {
            self.held[tie.index] = true;
            for (node, weight) in tie.point.shares() {
                if self.stiffness_n_m[node] <= 0.0 {
                    self.nodes.push(node);
                }
                self.stiffness_n_m[node] += weight * self.spring_n_m;
            }
        }
    }

    /// Lets the tissue go.
    pub(super) fn let_go(&mut self) {
        for tie in &self.ties {
            self.held[tie.index] = false;
        }
        for &node in &self.nodes {
            self.stiffness_n_m[node] = 0.0;
        }
        self.nodes.clear();
        self.ties.clear();
        self.armed = false;
    }

    /// Force with which the held tissue pushes each pad back, N. The thinner the pads leave it the
    /// stiffer it gets: Young's modulus times `s / (1 - s)` at the compression `s`.
    pub(super) fn squeeze_n(&self, jaw: &JawInput, sheet: &Sheet) -> f64 {
        let material = &sheet.material;
        let sum: f64 = self
            .ties
            .iter()
            .map(|tie| {
                let at = Point3::from(tie.point.of(&sheet.positions));
                let [first, second] = pad_distances(jaw, &at);
                let compression = 1.0 - (first + second) / material.thickness_m;
                let compression = compression.clamp(0.0, COMPRESSION_MAX);
                compression / (1.0 - compression)
            })
            .sum();
        material.young_pa * self.area_m2 * sum
    }
}

/// Distances of a point from the inner faces of the two fingers, positive between them, m.
fn pad_distances(jaw: &JawInput, at: &Point3<f64>) -> [f64; 2] {
    let first = jaw.fingers[0].inverse_transform_point(at).y;
    let second = jaw.fingers[1].inverse_transform_point(at).y;
    [-first, second]
}

fn between_pads(config: &GraspConfig, jaw: &JawInput, at: &Point3<f64>) -> bool {
    let over = jaw.fingers.iter().all(|finger: &Pose| {
        let local = finger.inverse_transform_point(at);
        local.x.abs() <= FINGER_HALF_WIDTH_M
            && (PAD_FROM_M..=FINGER_M + config.bite_m).contains(&local.z)
    });
    let [first, second] = pad_distances(jaw, at);
    over && first >= -INSIDE_M && second >= -INSIDE_M && first + second <= config.gap_m_max
}
