//! One controller with arms that go wherever they are told, and the scenes that they are in.

use hal::config::Source;
use hal::{ArmCommand, ArmError, ArmState, Chunk, JointVector, SafeTail, TimeNs};

use crate::config::ControlConfig;
use crate::motion::{AXES, Axes, JAW};
use crate::{Controller, OperatorEvent, TickInput, TickOutput};

/// A scene, and the texts that say what it is.
#[derive(Clone, Debug)]
pub(in crate::tests) struct Scene {
    pub(in crate::tests) control: Source,
    pub(in crate::tests) safety: Source,
    pub(in crate::tests) config: ControlConfig,
}

impl Scene {
    /// One arm among a region of each shape.
    pub(in crate::tests) fn crowded() -> Self {
        Self::new(
            ControlConfig::default_control(),
            Source::embedded("crowded.toml", include_str!("../scenes/crowded.toml")),
        )
    }

    /// The same with yaw and pitch so quick that they gain all of their speed during a stop, and
    /// with the least guard margin that is accepted for it.
    pub(in crate::tests) fn quick() -> Self {
        let control = ControlConfig::default_control().text().replace(
            "acceleration_rad_s2 = 4.0\njerk_rad_s3 = 80.0",
            "acceleration_rad_s2 = 14.0\njerk_rad_s3 = 150.0",
        );
        let safety = include_str!("../scenes/crowded.toml")
            .replace("guard_m = 0.0003", "guard_m = 0.00048")
            .replace("filter_m = 0.0015", "filter_m = 0.00168");
        let scene = Self::new(
            Source::embedded("control.toml", &control),
            Source::embedded("crowded.toml", &safety),
        );
        let quick = &scene.config.axes[..2];
        assert!(quick.iter().all(|axis| axis.acceleration > 13.0));
        assert!(scene.config.margins.guard_m < 0.0005);
        scene
    }

    /// Two arms that reach for each other.
    pub(in crate::tests) fn handover() -> Self {
        Self::new(
            ControlConfig::default_control(),
            Source::embedded("handover.toml", include_str!("../scenes/handover.toml")),
        )
    }

    /// The scene of the arms' number.
    pub(in crate::tests) fn of_arms(arms: usize) -> Self {
        if arms == 1 {
            Self::crowded()
        } else {
            Self::handover()
        }
    }

    fn new(control: Source, safety: Source) -> Self {
        let config = ControlConfig::load(&control, &safety).unwrap();
        Self {
            control,
            safety,
            config,
        }
    }

    /// With a gate that lets every finite chunk through, so that jumps reach the filter and the
    /// guard. Limits stay as they are.
    pub(in crate::tests) fn open_gate(mut self) -> Self {
        let gate = &mut self.config.gate;
        gate.step_m_max = 1e7;
        gate.step_rad_max = 10.0;
        gate.jump_m_max = 1e7;
        gate.jump_rad_max = 10.0;
        self
    }
}

/// Where every arm begins.
pub(in crate::tests) fn home() -> ArmState {
    let joints = JointVector::new(0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0);
    ArmState::at_rest(TimeNs(0), joints, 0.2)
}

/// A measured arm that is exactly where `command` said.
pub(in crate::tests) fn obedient(command: &ArmCommand, stamp: TimeNs) -> ArmState {
    ArmState {
        stamp,
        position: command.position,
        velocity: command.velocity,
        effort: JointVector::zeros(),
        jaw_position: command.jaw_position,
        jaw_velocity: command.jaw_velocity,
        jaw_effort: 0.0,
    }
}

/// A measured arm that goes a share of the way from where it was `before` to where it is `told`,
/// but for the yaw, which is off.
fn lagging(before: &ArmState, mut told: ArmState, share: f64, off_rad: f64) -> ArmState {
    told.position[0] += off_rad;
    ArmState {
        position: before.position + (told.position - before.position) * share,
        jaw_position: before.jaw_position + (told.jaw_position - before.jaw_position) * share,
        ..told
    }
}

/// Joints, then jaw.
pub(in crate::tests) fn axes_of(arm: &ArmState) -> Axes {
    core::array::from_fn(|axis| {
        if axis == JAW {
            arm.jaw_position
        } else {
            arm.position[axis]
        }
    })
}

/// An arm at rest at these axes.
pub(in crate::tests) fn resting(stamp: TimeNs, axes: &[f64; AXES]) -> ArmState {
    let joints = JointVector::from_fn(|joint, _| axes[joint]);
    ArmState::at_rest(stamp, joints, axes[JAW])
}

/// A controller, its arms and the chunks that they see.
pub(in crate::tests) struct Rig<const ARMS: usize> {
    pub(in crate::tests) controller: Controller<ARMS>,
    pub(in crate::tests) arms: [ArmState; ARMS],
    /// The newest chunk of each arm, seen again at every tick.
    pub(in crate::tests) chunks: [Option<Box<Chunk>>; ARMS],
    pub(in crate::tests) tick: u64,
    /// Whether each arm was commanded to hold torque.
    pub(in crate::tests) powered: [bool; ARMS],
    tails: [Option<SafeTail>; ARMS],
    /// The share of the way to its setpoint that an arm goes in a tick.
    pub(in crate::tests) follows: f64,
    /// How far each arm's yaw is off when it has come there, rad.
    pub(in crate::tests) off_rad: f64,
}

impl<const ARMS: usize> Rig<ARMS> {
    /// A disabled arm at home.
    pub(in crate::tests) fn new(config: &ControlConfig) -> Self {
        Self {
            controller: Controller::for_arms(config).unwrap(),
            arms: [home(); ARMS],
            chunks: core::array::from_fn(|_| None),
            tick: 0,
            powered: [false; ARMS],
            tails: [None; ARMS],
            follows: 1.0,
            off_rad: 0.0,
        }
    }

    /// Misses `periods`: the controller is late, and each backend plays the tail that it has.
    pub(in crate::tests) fn miss(&mut self, periods: u64) {
        self.tick += periods;
        let now = self.now();
        for (arm, tail) in self.arms.iter_mut().zip(&self.tails) {
            if let Some(tail) = tail {
                *arm = obedient(&tail.command_at(TimeNs::from_tick(self.tick - 1)), now);
            }
        }
    }

    /// An enabled one.
    pub(in crate::tests) fn enabled(config: &ControlConfig) -> Self {
        let mut rig = Self::new(config);
        rig.step(rig.arms.map(Ok), [Some(OperatorEvent::Enable); ARMS]);
        rig
    }

    /// The next control period.
    pub(in crate::tests) fn now(&self) -> TimeNs {
        TimeNs::from_tick(self.tick)
    }

    /// Where each arm is.
    pub(in crate::tests) fn positions(&self) -> [Axes; ARMS] {
        self.arms.map(|arm| axes_of(&arm))
    }

    /// One tick in which nothing is asked and all is measured well.
    pub(in crate::tests) fn quiet_step(&mut self) -> [TickOutput; ARMS] {
        self.step(self.arms.map(Ok), [None; ARMS])
    }

    /// One tick.
    pub(in crate::tests) fn step(
        &mut self,
        measured: [Result<ArmState, ArmError>; ARMS],
        operator: [Option<OperatorEvent>; ARMS],
    ) -> [TickOutput; ARMS] {
        let now = self.now();
        let inputs: [TickInput<'_>; ARMS] = core::array::from_fn(|arm| TickInput {
            now,
            measured: measured[arm],
            chunk: self.chunks[arm].as_deref(),
            operator: operator[arm],
        });
        let outputs = self.controller.tick_arms(&inputs);
        self.tick += 1;
        let stamp = self.now();
        self.arms = core::array::from_fn(|arm| {
            let told = obedient(&outputs[arm].command, stamp);
            if outputs[arm].command.enabled && self.follows < 1.0 {
                lagging(&self.arms[arm], told, self.follows, self.off_rad)
            } else {
                told
            }
        });
        self.powered = core::array::from_fn(|arm| outputs[arm].command.enabled);
        self.tails = core::array::from_fn(|arm| Some(outputs[arm].tail));
        outputs
    }
}
