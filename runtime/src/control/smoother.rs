//! Jerk-limited velocities with Ruckig. Hot path: bounded, no allocation, no I/O, no lock.

use rsruckig::prelude::{
    ControlInterface, DataArrayOrVec, IgnoreErrorHandler, InputParameter, Ruckig, RuckigResult,
    Synchronization, Trajectory,
};

use super::motion::{AXES, Axes, AxisLimits, MotionState};

/// Brings each axis to its target velocity as fast as acceleration and jerk allow, one tick at a time.
///
/// It keeps no motion of its own: every step starts from the commanded state, so that an override by the guard makes no jump.
pub struct Smoother {
    ruckig: Box<Ruckig<AXES, IgnoreErrorHandler>>,
    input: Box<InputParameter<AXES>>,
    trajectory: Box<Trajectory<AXES>>,
    velocity_max: Axes,
    tick_s: f64,
}

impl Smoother {
    /// A smoother for ticks of `tick_s`; this allocates all it will ever need.
    #[must_use]
    pub fn new(limits: &[AxisLimits; AXES], tick_s: f64) -> Self {
        let mut input = Box::new(InputParameter::new(None));
        input.control_interface = ControlInterface::Velocity;
        input.synchronization = Synchronization::None;
        for (axis, limit) in limits.iter().enumerate() {
            input.max_velocity[axis] = limit.velocity;
            input.max_acceleration[axis] = limit.acceleration;
            input.max_jerk[axis] = limit.jerk;
        }
        Self {
            ruckig: Box::new(Ruckig::new(None, tick_s)),
            input,
            trajectory: Box::new(Trajectory::new(None)),
            velocity_max: limits.map(|limit| limit.velocity),
            tick_s,
        }
    }

    /// The state one tick after `state` on the way to `target_velocity`, which is brought within the limits; `None` if there
    /// is no such way or something is not finite.
    pub fn step(&mut self, state: &MotionState, target_velocity: &Axes) -> Option<MotionState> {
        // Ruckig formats a message when validation fails, which would allocate: let nothing through that could.
        if !(state.is_finite() && target_velocity.iter().all(|v| v.is_finite())) {
            return None;
        }
        for (axis, (&velocity, &limit)) in
            target_velocity.iter().zip(&self.velocity_max).enumerate()
        {
            self.input.current_position[axis] = state.position[axis];
            self.input.current_velocity[axis] = state.velocity[axis];
            self.input.current_acceleration[axis] = state.acceleration[axis];
            self.input.target_velocity[axis] = velocity.clamp(-limit, limit);
        }
        let result = self.ruckig.calculate(&self.input, &mut self.trajectory);
        if !matches!(result, Ok(RuckigResult::Working | RuckigResult::Finished)) {
            return None;
        }
        let mut position = DataArrayOrVec::Stack([0.0; AXES]);
        let mut velocity = DataArrayOrVec::Stack([0.0; AXES]);
        let mut acceleration = DataArrayOrVec::Stack([0.0; AXES]);
        self.trajectory.at_time(
            self.tick_s,
            &mut Some(&mut position),
            &mut Some(&mut velocity),
            &mut Some(&mut acceleration),
            &mut None,
            &mut None,
        );
        let next = MotionState {
            position: core::array::from_fn(|axis| position[axis]),
            velocity: core::array::from_fn(|axis| velocity[axis]),
            acceleration: core::array::from_fn(|axis| acceleration[axis]),
        };
        next.is_finite().then_some(next)
    }
}

impl core::fmt::Debug for Smoother {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Smoother")
            .field("tick_s", &self.tick_s)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::Smoother;
    use crate::control::config::ControlConfig;
    use crate::control::motion::{AXES, MotionState};
    use crate::control::random::SplitMix64;
    use crate::control::stop::Stop;

    const TICK_S: f64 = 1e-3;

    fn at_rest() -> MotionState {
        MotionState {
            position: [0.1; AXES],
            velocity: [0.0; AXES],
            acceleration: [0.0; AXES],
        }
    }

    fn config() -> ControlConfig {
        ControlConfig::load(
            &ControlConfig::default_control(),
            &ControlConfig::needle_lift_safety(),
        )
        .unwrap()
    }

    #[test]
    fn random_targets_never_break_velocity_acceleration_or_jerk() {
        let axes = config().axes;
        let mut smoother = Smoother::new(&axes, TICK_S);
        let mut random = SplitMix64::new(5);
        let mut state = at_rest();
        let mut target = [0.0; AXES];
        for tick in 0..20_000 {
            if random.happens(0.2) {
                target = core::array::from_fn(|_| random.between(-20.0, 20.0));
            }
            let next = smoother.step(&state, &target).unwrap();
            for (axis, limit) in axes.iter().enumerate() {
                assert!(
                    next.velocity[axis].abs() <= limit.velocity * (1.0 + 1e-9),
                    "tick {tick} axis {axis}"
                );
                assert!(
                    next.acceleration[axis].abs() <= limit.acceleration * (1.0 + 1e-9),
                    "tick {tick} axis {axis}"
                );
                let jerk = (next.acceleration[axis] - state.acceleration[axis]) / TICK_S;
                assert!(
                    jerk.abs() <= limit.jerk * (1.0 + 1e-6),
                    "tick {tick} axis {axis}: {jerk}"
                );
            }
            state = next;
        }
    }

    #[test]
    fn its_stop_is_the_closed_form_stop() {
        let axes = config().axes;
        let mut smoother = Smoother::new(&axes, TICK_S);
        let mut random = SplitMix64::new(6);
        let mut state = at_rest();
        for round in 0..100 {
            let target = core::array::from_fn(|_| random.between(-1.0, 1.0));
            for _ in 0..(random.next_u64() % 100) {
                state = smoother.step(&state, &target).unwrap();
            }
            let stop = Stop::new(&state, &axes);
            let mut time_s = 0.0;
            while time_s < 0.4 {
                state = smoother.step(&state, &[0.0; AXES]).unwrap();
                time_s += TICK_S;
                let expected = stop.at(time_s);
                for axis in 0..AXES {
                    let off = (state.position[axis] - expected.position[axis]).abs();
                    assert!(off < 1e-9, "round {round} axis {axis} at {time_s}: {off:e}");
                }
            }
        }
    }

    #[test]
    fn nonsense_gives_no_step() {
        let mut smoother = Smoother::new(&config().axes, TICK_S);
        assert!(smoother.step(&at_rest(), &[f64::NAN; AXES]).is_none());
        let mut broken = at_rest();
        broken.velocity[3] = f64::INFINITY;
        assert!(smoother.step(&broken, &[0.0; AXES]).is_none());
    }
}
