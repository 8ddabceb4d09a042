//! The last step of bring-up: the SYNC begins, and all drives are enabled in the same cycle, once
//! they may have torque.

use super::super::arm::CanArm;
use super::super::cycle::{Cycle, Goal};
use super::super::link::{Bus, ControllerEvent, Received};
use super::{BringUpError, Homed};
use crate::cia301::{Cob, NmtState};
use crate::cia402::PowerState;
use hal::{TICK_NS, TimeNs};

/// How long the drives may take to be enabled, ns.
const ENABLE_NS: u64 = 3_000_000_000;
/// How long the last words of bring-up may take on the bus, ns.
const SETTLE_NS: u64 = 10_000_000;

/// Whether drives may have torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Permission {
    /// They may.
    Granted,
    /// Not yet: the SYNC goes on, and they wait for it without torque.
    Pending,
    /// They never may.
    Denied,
}

/// Starts the SYNCs of several arms and enables all their drives, so that no arm waits without a
/// SYNC for another one. No drive has torque before `allowed`, which is called once a cycle, grants
/// it.
///
/// # Errors
/// As [`Homed::enable`], with the place of the arm that failed, or [`BringUpError::Denied`]; the
/// drives of all arms are taken down then, through the states of CiA 402.
pub fn enable_together<B: Bus>(
    mut homed: Vec<Homed<B>>,
    allowed: &mut dyn FnMut() -> Permission,
) -> Result<Vec<CanArm<B>>, (usize, BringUpError)> {
    if let Some(failed) = start_all(&mut homed) {
        homed.iter_mut().for_each(|arm| arm.bus.stop());
        return Err(failed);
    }
    let Some(first) = homed.first_mut() else {
        return Ok(Vec::new());
    };
    let start = first.bus.now().plus_ns(SETTLE_NS);
    first.bus.wait(start);
    let mut arms: Vec<CanArm<B>> = homed.into_iter().map(|homed| begin(homed, start)).collect();
    let mut turns = Turns::new(&arms, start);
    match turns.until_enabled(&mut arms, allowed) {
        Ok(()) => Ok(arms),
        Err((place, cause)) => Err((place, turns.take_down_after(cause, &mut arms))),
    }
}

impl<B: Bus> CanArm<B> {
    /// Gives the buses back, for a new bring-up, after the operator has cleared the fault. The
    /// drives are taken down and the nodes stopped first, which may take [`Self::take_down_ns`].
    #[must_use]
    pub fn release(mut self) -> B {
        take_down(core::slice::from_mut(&mut self));
        self.into_bus()
    }
}

/// Takes the drives of all arms down and stops their nodes, from now on.
fn take_down<B: Bus>(arms: &mut [CanArm<B>]) {
    let now = arms.first_mut().map(|first| first.bus_mut().now());
    if let Some(now) = now {
        let _confirmed = Turns::new(arms, now).take_down(arms);
    }
}

/// Asks the nodes of all arms, and starts them if none has an objection: once started they should
/// not wait for a SYNC. The place of the arm that can't be started, if there is one.
fn start_all<B: Bus>(homed: &mut [Homed<B>]) -> Option<(usize, BringUpError)> {
    [Homed::check, Homed::start].into_iter().find_map(|step| {
        let mut arms = homed.iter_mut().enumerate();
        arms.find_map(|(place, arm)| Some((place, step(arm).err()?)))
    })
}

/// The arm as its SYNC begins at `start`. What has come since its nodes were sent NMT start is the
/// cycle's to judge, but for heartbeats from before they did; and that a controller has become
/// error passive before.
fn begin<B: Bus>(homed: Homed<B>, start: TimeNs) -> CanArm<B> {
    let Homed {
        bus: watched, plan, ..
    } = homed;
    let mut cycle = Cycle::new(&plan, start);
    for line in (0..plan.lines).filter(|line| watched.is_passive(*line)) {
        cycle.on_received(
            line,
            start,
            &Received::ControllerEvent(ControllerEvent::ErrorPassive),
        );
    }
    let mut bus = watched.bus;
    for line in 0..plan.lines {
        bus.receive(line, &mut |received| {
            if !is_from_before(&received) {
                cycle.on_received(line, start, &received);
            }
        });
    }
    CanArm::new(bus, &plan, cycle)
}

fn is_from_before(received: &Received) -> bool {
    let Received::Frame(frame) = received else {
        return false;
    };
    let states = [NmtState::PreOperational, NmtState::Stopped];
    matches!(Cob::of(frame.id), Cob::Heartbeat(_))
        && NmtState::parse(frame.data()).is_ok_and(|state| states.contains(&state))
}

/// Cycles of several arms that are not controlled, one after the other.
struct Turns {
    at: TimeNs,
    cycle_ns: u64,
    /// Whether a drive has been switched on, after which it may have got torque.
    switched_on: bool,
}

impl Turns {
    fn new<B: Bus>(arms: &[CanArm<B>], start: TimeNs) -> Self {
        let longest = arms.iter().map(CanArm::cycle_ns).max();
        Self {
            at: start,
            cycle_ns: longest.unwrap_or(TICK_NS),
            switched_on: false,
        }
    }

    /// Waits for the next cycle. SYNCs that a late process has missed are not made up for: no drive
    /// could answer them.
    fn next<B: Bus>(&mut self, arms: &mut [CanArm<B>]) {
        self.at = self.at.plus_ns(self.cycle_ns);
        if let Some(first) = arms.first_mut() {
            first.bus_mut().wait(self.at);
            self.at = self.at.max(first.bus_mut().now());
        }
    }

    /// Enables all drives, from the cycle on in which it is `allowed`.
    fn until_enabled<B: Bus>(
        &mut self,
        arms: &mut [CanArm<B>],
        allowed: &mut dyn FnMut() -> Permission,
    ) -> Result<(), (usize, BringUpError)> {
        let mut since = None;
        while let Some(slow) = arms.iter().position(|arm| !arm.is_enabled()) {
            match (since, allowed()) {
                (_, Permission::Denied) => return Err((slow, BringUpError::Denied)),
                (None, Permission::Granted) => {
                    since = Some(self.at);
                    let goal = |arm: &mut CanArm<B>| arm.set_goal(self.at, Goal::Enabled);
                    arms.iter_mut().for_each(goal);
                }
                _ => {}
            }
            if since.is_some_and(|since| self.at.since(since) > ENABLE_NS) {
                return Err((slow, BringUpError::Slow));
            }
            self.next(arms);
            for (place, arm) in arms.iter_mut().enumerate() {
                self.turn(arm).map_err(|cause| (place, cause))?;
            }
        }
        Ok(())
    }

    /// A cycle of `arm`; notes whether a drive of it is switched on.
    fn turn<B: Bus>(&mut self, arm: &mut CanArm<B>) -> Result<(), BringUpError> {
        arm.turn(self.at);
        let mut states = arm.cycle().states().into_iter().flatten();
        self.switched_on |=
            states.any(|state| state == PowerState::SwitchedOn || state.has_torque());
        arm.fault()
            .map_or(Ok(()), |fault| Err(BringUpError::Fault(fault)))
    }

    /// Takes the drives of `arms` down because of `cause`, and says so where one that was switched
    /// on does not confirm it.
    fn take_down_after<B: Bus>(
        &mut self,
        cause: BringUpError,
        arms: &mut [CanArm<B>],
    ) -> BringUpError {
        let confirmed = self.take_down(arms);
        if self.switched_on && !confirmed {
            BringUpError::NotDown(Box::new(cause))
        } else {
            cause
        }
    }

    /// Takes the drives of all arms down and stops their nodes; whether all have confirmed that
    /// they have no torque.
    fn take_down<B: Bus>(&mut self, arms: &mut [CanArm<B>]) -> bool {
        let start = self.at;
        loop {
            self.next(arms);
            // Each arm has its turn, whether the ones before it are down or not.
            let down = arms.iter_mut().map(|arm| arm.take_down(self.at));
            let down = down.fold(true, |all, down| all & down);
            let longest_ns = arms.iter().map(CanArm::take_down_ns).max();
            if down || self.at.since(start) >= longest_ns.unwrap_or(0) {
                break;
            }
        }
        let mut all = arms.iter();
        let confirmed = all.all(|arm| arm.cycle().is_confirmed_without_torque());
        arms.iter_mut().for_each(CanArm::shut_down);
        confirmed
    }
}
