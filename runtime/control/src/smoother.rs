//! Jerk-limited velocities with Ruckig. Hot path: bounded, no allocation, no I/O, no lock.
//!
//! A target velocity of zero is coming to rest, any other is tracking. Both are reached from any
//! state within the limits as fast as acceleration and jerk allow, without overshoot, with zero
//! acceleration, and are then held; an axis at rest that is commanded to rest stays where it is,
//! bit for bit.

mod lowered;

use rsruckig::prelude::{
    ControlInterface, DataArrayOrVec, IgnoreErrorHandler, InputParameter, Ruckig, RuckigResult,
    Synchronization, Trajectory,
};

use super::motion::{AXES, Axes, AxisLimits, MotionState};
use super::snapshot::{Reader, Snapshot, SnapshotError, Stateful, layout};
use lowered::AxisLowering;

/// Brings each axis to its target velocity as fast as acceleration and jerk allow, one tick at a
/// time.
///
/// It keeps no motion of its own: every step starts from the commanded state, so that an override
/// by the guard makes no jump. Its limits may be lowered while the arm moves, see
/// [`Smoother::set_limits`].
pub struct Smoother {
    ruckig: Box<Ruckig<AXES, IgnoreErrorHandler>>,
    input: Box<InputParameter<AXES>>,
    trajectory: Box<Trajectory<AXES>>,
    axes: [AxisLowering; AXES],
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
            axes: limits.map(|limit| AxisLowering::new(&limit)),
            tick_s,
        }
    }

    /// Lowers velocity, acceleration and jerk, or brings them back, at any moment and in any
    /// motion.
    ///
    /// No limit goes above what the smoother was built with, nor acceleration and jerk below a
    /// thousandth of it; a limit that is not a number counts as the lowest. The position range
    /// stays. What was built in remains the measure of a stop:
    ///
    /// - A speed above its new limit falls to it and does not pass it. An acceleration above its
    ///   new limit comes under it as fast as the full jerk allows. The jerk keeps its new limit
    ///   once the motion fits it; until then it is as much higher as is needed to pass neither the
    ///   target nor the speed limit, at most the full one.
    /// - While acceleration or jerk are lowered, an axis whose stop at full limits would leave the
    ///   range after the next step makes that stop instead: the range comes before the lowered
    ///   limits.
    pub fn set_limits(&mut self, limits: &[AxisLimits; AXES]) {
        for (axis, limit) in self.axes.iter_mut().zip(limits) {
            axis.set(limit);
        }
    }

    /// The limits that hold now, as far as [`Smoother::set_limits`] took them.
    #[must_use]
    pub fn limits(&self) -> [AxisLimits; AXES] {
        core::array::from_fn(|axis| *self.axes[axis].limits())
    }

    /// The state one tick after `state` on the way to `target_velocity`, which is brought within
    /// the limits; `None` if there is no such way or something is not finite.
    pub fn step(&mut self, state: &MotionState, target_velocity: &Axes) -> Option<MotionState> {
        // Ruckig formats a message when validation fails, which would allocate: let nothing through
        // that could.
        if !(state.is_finite() && target_velocity.iter().all(|v| v.is_finite())) {
            return None;
        }
        self.load(state, target_velocity);
        let result = self.ruckig.calculate(&self.input, &mut self.trajectory);
        if !matches!(result, Ok(RuckigResult::Working | RuckigResult::Finished)) {
            return None;
        }
        let mut next = self.sample();
        for (axis, lowering) in self.axes.iter().enumerate() {
            lowering.keep_range(axis, state, &mut next, self.tick_s);
        }
        next.is_finite().then_some(next)
    }

    /// Makes `state` and `target_velocity`, brought within the limits, Ruckig's input.
    fn load(&mut self, state: &MotionState, target_velocity: &Axes) {
        for (axis, (lowering, &wanted)) in self.axes.iter_mut().zip(target_velocity).enumerate() {
            let (velocity, acceleration) = (state.velocity[axis], state.acceleration[axis]);
            let limit = lowering.limits().velocity;
            let target = wanted.clamp(-limit, limit);
            self.input.current_position[axis] = state.position[axis];
            self.input.current_velocity[axis] = velocity;
            self.input.current_acceleration[axis] = acceleration;
            self.input.target_velocity[axis] = target;
            self.input.max_acceleration[axis] = lowering.limits().acceleration;
            self.input.max_jerk[axis] = lowering.jerk(velocity, acceleration, target);
        }
    }

    /// One tick into the trajectory.
    fn sample(&self) -> MotionState {
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
        MotionState {
            position: core::array::from_fn(|axis| position[axis]),
            velocity: core::array::from_fn(|axis| velocity[axis]),
            acceleration: core::array::from_fn(|axis| acceleration[axis]),
        }
    }
}

// Ruckig computes each trajectory anew, from an input that `load` fills.
impl Stateful for Smoother {
    const LAYOUT: u64 = layout("Smoother axes", &[<AxisLowering as Stateful>::LAYOUT]);
    const WORDS_MAX: usize = AXES * <AxisLowering as Stateful>::WORDS_MAX;

    fn save(&self, to: &mut Snapshot) {
        let Self {
            ruckig: _,
            input: _,
            trajectory: _,
            axes,
            tick_s: _,
        } = self;
        for axis in axes {
            axis.save(to);
        }
    }

    fn restore(&mut self, from: &mut Reader<'_>) -> Result<(), SnapshotError> {
        let Self {
            ruckig: _,
            input: _,
            trajectory: _,
            axes,
            tick_s: _,
        } = self;
        for axis in axes {
            axis.restore(from)?;
        }
        Ok(())
    }
}

impl core::fmt::Debug for Smoother {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Smoother")
            .field("axes", &self.axes)
            .field("tick_s", &self.tick_s)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod differential;
#[cfg(test)]
mod tests;
