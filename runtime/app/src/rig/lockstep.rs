//! Simulated arms in lockstep: a period begins when the step before it is computed.
//!
//! Virtual time: a period is a tick of 1 ms, no clock is read and nothing sleeps, so that two runs
//! of one seed are the same bit for bit. The loop around it is `session::episode`.

use hal::{Arm as _, Measured, PerArm, Period, Rig, Setpoint, TimeNs};
use trocar_tasks::simulation::Simulation;

/// The arms of a simulation, and its clock.
pub(crate) struct LockstepRig<'a> {
    /// The episode also reads scene, cameras and verdict from it, between two exchanges.
    pub(crate) simulation: &'a mut Simulation,
    /// The newest period, once there is one.
    tick: Option<u64>,
}

impl<'a> LockstepRig<'a> {
    /// Before the first period.
    pub(crate) const fn new(simulation: &'a mut Simulation) -> Self {
        Self {
            simulation,
            tick: None,
        }
    }

    /// All arms measured at `now`; none if the simulation has no arm, or more than `hal::ARMS_MAX`.
    fn read(&mut self, now: TimeNs) -> Option<PerArm<Measured>> {
        let arms = 0..self.simulation.arm_count();
        PerArm::collect(arms.filter_map(|arm| Some(self.simulation.arm(arm)?.read(now))))
    }
}

impl Rig for LockstepRig<'_> {
    /// Set-points first, then a step of the world, then the measurement: a command acts in the
    /// period that it is for. The first call takes no step. A set-point that an arm refuses is that
    /// arm's measurement error of this period.
    ///
    /// More set-points than arms are a broken invariant (`Episode::run` compares the numbers) and
    /// end the process.
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        let mut refused = [None; hal::ARMS_MAX];
        let setpoints = setpoints.into_iter().flat_map(PerArm::iter);
        for ((index, (command, tail)), refused) in setpoints.enumerate().zip(&mut refused) {
            let arm = self.simulation.arm(index);
            assert!(arm.is_some(), "a set-point of an arm that is not there");
            *refused = arm.and_then(|mut arm| arm.write(command, tail).err());
        }
        let tick = match self.tick {
            None => 0,
            Some(before) => {
                self.simulation.step();
                before + 1
            }
        };
        self.tick = Some(tick);
        let now = TimeNs::from_tick(tick);
        let mut refused = refused.into_iter();
        let measured = self.read(now).map(|arms| {
            arms.map(|measured| match refused.next().flatten() {
                Some(error) => Err(error),
                None => measured,
            })
        });
        Period {
            now,
            late_ns: 0,
            skipped: 0,
            measured,
        }
    }
}
