//! Configuration texts that allow nearly everything, to be narrowed by a test, and commands to go
//! with them.

use hal::{ArmCommand, ArmError, ArmState, JointVector, TimeNs};

use crate::Stream;
use crate::differences::AXES;

/// A limit that no command reaches.
pub(super) const LOOSE: f64 = 1e12;

/// An arm in its usual place: the instrument straight down, half inserted, the jaw a little open.
pub(super) const HOME: [f64; AXES] = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.4];

pub(super) const NAMES: [&str; AXES] = [
    "yaw",
    "pitch",
    "insertion",
    "roll",
    "wrist_pitch",
    "wrist_yaw",
    "jaw",
];

/// The limits of a test.
#[derive(Clone, Debug)]
pub(super) struct Scene {
    /// Low, high, velocity, acceleration, jerk.
    pub(super) axes: [[f64; 5]; AXES],
    pub(super) tip_speed: f64,
    pub(super) tip_angular_speed: f64,
    pub(super) arms: Vec<ArmScene>,
    pub(super) regions: String,
    /// Shaft to shaft, tip to shaft.
    pub(super) gaps_m: [f64; 2],
}

#[derive(Clone, Debug)]
pub(super) struct ArmScene {
    pub(super) place: [f64; 3],
    pub(super) rpy: [f64; 3],
    pub(super) low: [f64; 3],
    pub(super) high: [f64; 3],
}

impl Scene {
    /// Everything is allowed to this many arms.
    pub(super) fn loose(arms: usize) -> Self {
        let arm = ArmScene {
            place: [0.0; 3],
            rpy: [0.0; 3],
            low: [-10.0; 3],
            high: [10.0; 3],
        };
        Self {
            axes: [[-10.0, 10.0, LOOSE, LOOSE, LOOSE]; AXES],
            tip_speed: LOOSE,
            tip_angular_speed: LOOSE,
            arms: vec![arm; arms],
            regions: String::new(),
            gaps_m: [-1.0; 2],
        }
    }

    pub(super) fn control(&self) -> String {
        let Self {
            tip_speed,
            tip_angular_speed,
            ..
        } = self;
        let mut text = format!(
            "[limits]\ntip_speed_m_s = {tip_speed:?}\ntip_angular_speed_rad_s = {tip_angular_speed:?}\n"
        );
        for (name, [low, high, velocity, acceleration, jerk]) in NAMES.iter().zip(&self.axes) {
            let unit = if *name == "insertion" { "m" } else { "rad" };
            text += &format!(
                "[limits.{name}]\nlow_{unit} = {low:?}\nhigh_{unit} = {high:?}\nvelocity_{unit}_s = {velocity:?}\n\
                 acceleration_{unit}_s2 = {acceleration:?}\njerk_{unit}_s3 = {jerk:?}\n"
            );
        }
        text
    }

    pub(super) fn safety(&self) -> String {
        let mut text = String::from("[margins]\nguard_m = 0.0003\nrecovery_m = 0.00002\n");
        for (arm, name) in self.arms.iter().zip(["psm1", "psm2"]) {
            let ArmScene {
                place,
                rpy,
                low,
                high,
            } = arm;
            text += &format!(
                "[[arm]]\nname = \"{name}\"\nrcm_in_scene_m = {place:?}\nrcm_in_scene_rpy_rad = {rpy:?}\n\
                 workspace_min_m = {low:?}\nworkspace_max_m = {high:?}\n"
            );
        }
        if self.arms.len() == 2 {
            let [shafts, tips] = self.gaps_m;
            text += &format!(
                "[between_arms]\nshaft_to_shaft_m = {shafts:?}\ntip_to_shaft_m = {tips:?}\n"
            );
        }
        text + &self.regions
    }

    pub(super) fn stream(&self) -> Stream {
        Stream::new(&self.control(), &self.safety()).unwrap()
    }

    /// What one arm breaks that is commanded to these places, tick after tick.
    pub(super) fn broken_by(&self, places: &[[f64; AXES]]) -> Vec<String> {
        let mut stream = self.stream();
        for (place, tick) in places.iter().zip(0..) {
            let told = CommandSample::powered(tick, place);
            stream.tick(tick, &[told.pair()]);
        }
        broken(&stream)
    }
}

/// The limits of setpoints that were broken, each once, in order.
///
/// Arms of tests are measured at their commanded places, and their commands have no rates: what
/// that breaks is left to `measured` and `rates`.
pub(super) fn broken(stream: &Stream) -> Vec<String> {
    let mut names = all_broken(stream);
    names.retain(|name| !name.starts_with("measured.") && !name.ends_with("_mismatch"));
    names
}

/// All limits that were broken, each once, in order.
pub(super) fn all_broken(stream: &Stream) -> Vec<String> {
    let found = stream.worst().filter(|worst| worst.broken > 0);
    let mut names: Vec<_> = found.map(|worst| worst.limit).collect();
    let mut violations: Vec<_> = stream
        .violations()
        .iter()
        .map(|violation| violation.limit.clone())
        .collect();
    names.sort();
    violations.sort();
    violations.dedup();
    assert_eq!(names, violations);
    names
}

/// A command with what its arm had measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct CommandSample {
    pub(super) command: ArmCommand,
    pub(super) measured: Result<ArmState, ArmError>,
}

impl CommandSample {
    /// An arm with torque at its commanded place.
    pub(super) fn powered(tick: u64, place: &[f64; AXES]) -> Self {
        let [joints @ .., jaw_position] = *place;
        let (stamp, position) = (TimeNs::from_tick(tick), JointVector::from(joints));
        Self {
            command: ArmCommand {
                stamp,
                position,
                velocity: JointVector::zeros(),
                acceleration: JointVector::zeros(),
                jaw_position,
                jaw_velocity: 0.0,
                enabled: true,
            },
            measured: Ok(ArmState::at_rest(stamp, position, jaw_position)),
        }
    }

    /// An arm without torque.
    pub(super) fn limp(tick: u64, place: &[f64; AXES]) -> Self {
        let mut told = Self::powered(tick, place);
        told.command.enabled = false;
        told
    }

    pub(super) const fn pair(&self) -> (&ArmCommand, &Result<ArmState, ArmError>) {
        (&self.command, &self.measured)
    }
}

/// Numbers without a pattern.
#[derive(Clone, Debug)]
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let share = f64::from(u32::try_from(self.0 >> 32).unwrap()) / f64::from(u32::MAX);
        low + share * (high - low)
    }

    pub(super) fn vector(&mut self, size: f64) -> [f64; 3] {
        core::array::from_fn(|_| self.between(-size, size))
    }

    /// Axes somewhere within the instrument's ranges.
    pub(super) fn place(&mut self) -> [f64; AXES] {
        core::array::from_fn(|axis| match axis {
            0 | 1 => self.between(-0.6, 0.6),
            2 => self.between(0.08, 0.2),
            3 => self.between(-3.0, 3.0),
            6 => self.between(0.1, 1.3),
            _ => self.between(-1.3, 1.3),
        })
    }
}
