//! Chunks made to do harm: no command may break a limit, whatever arrives.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::psm::{FINGER_M, SHAFT_RADIUS_M};
use hal::{ArmCommand, Chunk, JOINT_COUNT, TICK_NS, TimeNs, TipTarget};
use nalgebra::{UnitQuaternion, Vector3};

use super::{Bench, STEP_NS, config};
use crate::control::config::ControlConfig;
use crate::control::motion::{AXES, JAW};
use crate::control::random::SplitMix64;
use crate::control::{QpOutcome, TickOutput};
use crate::kinematics::forward;

const TICKS: u64 = 100_000;

/// What an independent check finds in a stream of commands; every figure is a share of its limit, or metres.
#[derive(Debug, Default)]
struct Findings {
    position_over: f64,
    velocity: f64,
    acceleration: f64,
    jerk: f64,
    tip_speed: f64,
    clearance_m: f64,
    solved: u32,
    failed: u32,
    intervened: u32,
    refused: u64,
}

/// Positions and stamps alone, differentiated: the check takes no derivative on trust.
struct Checker<'a> {
    config: &'a ControlConfig,
    previous: Option<ArmCommand>,
    findings: Findings,
}

impl<'a> Checker<'a> {
    fn new(config: &'a ControlConfig) -> Self {
        Self {
            config,
            previous: None,
            findings: Findings {
                clearance_m: f64::INFINITY,
                ..Findings::default()
            },
        }
    }

    fn look(&mut self, output: &TickOutput) {
        let command = &output.command;
        let found = &mut self.findings;
        for axis in 0..AXES {
            let limits = &self.config.axes[axis];
            let (p, v) = if axis == JAW {
                (command.jaw_position, command.jaw_velocity)
            } else {
                (command.position[axis], command.velocity[axis])
            };
            assert!(p.is_finite() && v.is_finite());
            found.position_over = found.position_over.max(limits.low - p).max(p - limits.high);
            found.velocity = found.velocity.max(v.abs() / limits.velocity);
        }
        for joint in 0..JOINT_COUNT {
            let limits = &self.config.axes[joint];
            found.acceleration = found
                .acceleration
                .max(command.acceleration[joint].abs() / limits.acceleration);
            if let Some(previous) = &self.previous {
                let tick_s = 1e-3;
                let speed = (command.position[joint] - previous.position[joint]) / tick_s;
                let acceleration = (command.velocity[joint] - previous.velocity[joint]) / tick_s;
                let jerk = (command.acceleration[joint] - previous.acceleration[joint]) / tick_s;
                found.velocity = found.velocity.max(speed.abs() / limits.velocity);
                found.acceleration = found
                    .acceleration
                    .max(acceleration.abs() / limits.acceleration);
                found.jerk = found.jerk.max(jerk.abs() / limits.jerk);
            }
        }
        let tip = forward(&command.position);
        if let Some(previous) = &self.previous {
            let way_m =
                (tip.translation.vector - forward(&previous.position).translation.vector).norm();
            found.tip_speed = found
                .tip_speed
                .max(way_m / 1e-3 / self.config.tip_speed_m_s);
        }
        let finger_m = tip.translation.vector + tip.rotation * Vector3::z() * FINGER_M;
        for point in [tip.translation.vector, finger_m] {
            for axis in 0..3 {
                let low = point[axis] - (self.config.arms[0].workspace.center_m - self.config.arms[0].workspace.half_m)[axis];
                let high = (self.config.arms[0].workspace.center_m + self.config.arms[0].workspace.half_m)[axis] - point[axis];
                found.clearance_m = found.clearance_m.min(low).min(high);
            }
            for sphere in &self.config.geometry.forbidden {
                let h = (point - sphere.center_m).norm() - sphere.radius_m - SHAFT_RADIUS_M;
                found.clearance_m = found.clearance_m.min(h);
            }
        }
        match output.report.qp {
            QpOutcome::NotNeeded => {}
            QpOutcome::Solved { .. } => found.solved += 1,
            QpOutcome::Failed => found.failed += 1,
        }
        found.intervened += u32::from(output.report.guard_intervened);
        self.previous = Some(*command);
    }
}

fn wild_target(random: &mut SplitMix64, reach_m: f64) -> TipTarget {
    let mut unit = || random.between(-1.0, 1.0);
    let position = Vector3::new(unit(), unit(), unit()) * reach_m + Vector3::new(0.0, 0.0, -0.11);
    let rotation = UnitQuaternion::new(Vector3::new(unit(), unit(), unit()) * 2.0);
    let mut target = TipTarget::new(
        &hal::Pose::from_parts(position.into(), rotation),
        3.0 * unit(),
    );
    target.position_m = position.into();
    target
}

/// A chunk of one of several kinds of malice.
fn hostile(random: &mut SplitMix64, now: TimeNs, sequence: u64) -> Chunk {
    let reach_m = random.between(0.01, 0.3);
    let goal = wild_target(random, reach_m);
    let mut chunk = Chunk::new(now, sequence, STEP_NS, &[goal; CHUNK_STEPS_MAX]);
    match random.next_u64() % 8 {
        // One far target.
        0 | 1 => {}
        // Another one every step.
        2 => chunk
            .targets
            .iter_mut()
            .for_each(|target| *target = wild_target(random, reach_m)),
        // Back and forth as fast as a chunk can say it.
        3 => {
            let other = wild_target(random, reach_m);
            chunk.step_ns = TICK_NS * (1 + random.next_u64() % 100);
            chunk
                .targets
                .iter_mut()
                .step_by(2)
                .for_each(|target| *target = other);
        }
        4 => chunk.targets[(random.next_u64() % 128) as usize].position_m[1] = f64::NAN,
        5 => {
            chunk.targets[(random.next_u64() % 128) as usize].rotation_xyzw =
                [1e308, f64::INFINITY, 0.0, 5e-324]
        }
        6 => {
            chunk.observed_at = TimeNs(random.next_u64());
            chunk.step_ns = random.next_u64();
            chunk.len = (random.next_u64() >> 32) as u32;
        }
        _ => chunk.sequence = random.next_u64(),
    }
    chunk
}

/// A gate that lets every finite chunk through, so that jumps reach the filter and the guard.
fn open_gate() -> ControlConfig {
    let mut config = config();
    config.gate.step_m_max = 10.0;
    config.gate.step_rad_max = 10.0;
    config.gate.jump_m_max = 10.0;
    config.gate.jump_rad_max = 10.0;
    config
}

fn attack(config: &ControlConfig, seed: u64, ticks: u64, guard_removed: bool) -> Findings {
    let mut random = SplitMix64::new(seed);
    let mut bench = Bench::enabled(config);
    bench.controller.sabotage.guard_removed = guard_removed;
    let mut checker = Checker::new(config);
    let mut chunk = hostile(&mut random, bench.now(), 1);
    let mut patience = 0;
    for tick in 0..ticks {
        if patience == 0 {
            chunk = hostile(&mut random, bench.now(), tick + 2);
            patience = 1 + random.next_u64() % if random.happens(0.5) { 40 } else { 600 };
            // A wild sequence would block all that follow; a restarted policy is enabled anew.
            if random.happens(0.05) {
                bench.controller.arms[0].gate.forget();
            }
        }
        patience -= 1;
        checker.look(&bench.step(Some(&chunk), None));
    }
    checker.findings.refused = bench.controller.chunk_counts().1;
    checker.findings
}

#[test]
fn no_chunk_breaks_a_limit() {
    let config = open_gate();
    let found = attack(&config, 31, TICKS, false);
    println!("{found:?}");
    assert!(found.position_over <= 1e-6, "{found:?}");
    assert!(
        found.velocity <= 1.0 + 1e-6 && found.acceleration <= 1.0 + 1e-6,
        "{found:?}"
    );
    assert!(found.jerk <= 1.0 + 1e-6, "{found:?}");
    assert!(found.tip_speed <= 1.0 + 1e-6, "{found:?}");
    assert!(found.clearance_m >= 0.0, "{found:?}");
    assert!(
        found.solved > 1000 && found.refused > 50,
        "the attack was real: {found:?}"
    );
}

#[test]
fn without_the_guard_the_same_attack_breaks_limits() {
    let config = open_gate();
    let found = attack(&config, 31, TICKS / 5, true);
    println!("{found:?}");
    assert!(
        found.tip_speed > 1.001 || found.clearance_m < 0.0 || found.position_over > 1e-6,
        "{found:?}"
    );
}

#[test]
fn the_committed_gate_refuses_most_of_the_attack() {
    let found = attack(&config(), 32, TICKS / 10, false);
    println!("{found:?}");
    assert!(
        found.refused > 20 && found.tip_speed <= 1.0 && found.clearance_m > 0.0,
        "{found:?}"
    );
}
