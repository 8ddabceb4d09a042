//! The last step of bring-up: the SYNC begins, and all drives are enabled in the same cycle.

use super::super::arm::CanArm;
use super::super::cycle::{Cycle, Goal};
use super::super::link::{Bus, Received, Trouble};
use super::{BringUpError, Homed};
use crate::cia301::{Cob, NmtState};
use hal::TimeNs;

/// How long the drives may take to be enabled, ns.
const ENABLE_NS: u64 = 3_000_000_000;
/// How long the last words of bring-up may take on the bus, ns.
const SETTLE_NS: u64 = 10_000_000;

/// Starts the SYNCs of several arms and enables all their drives, so that no arm waits without a SYNC for another one.
///
/// # Errors
/// As [`Homed::enable`], with the place of the arm that failed; no drive of any arm has torque then.
pub fn enable_together<B: Bus>(
    mut homed: Vec<Homed<B>>,
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
    match turn_until_enabled(&mut arms, start) {
        Ok(()) => Ok(arms),
        Err(failed) => {
            arms.iter_mut().for_each(CanArm::shut_down);
            Err(failed)
        }
    }
}

/// Asks the nodes of all arms, and starts them if none has an objection: once started they should not wait for a SYNC. The place
/// of the arm that can't be started, if there is one.
fn start_all<B: Bus>(homed: &mut [Homed<B>]) -> Option<(usize, BringUpError)> {
    [Homed::check, Homed::start].into_iter().find_map(|step| {
        let mut arms = homed.iter_mut().enumerate();
        arms.find_map(|(place, arm)| Some((place, step(arm).err()?)))
    })
}

/// The arm as its SYNC begins at `start`. What has come since its nodes were sent NMT start is the cycle's to judge, but for
/// heartbeats from before they did; and that a controller has become error passive before.
fn begin<B: Bus>(homed: Homed<B>, start: TimeNs) -> CanArm<B> {
    let Homed {
        bus: watched, plan, ..
    } = homed;
    let mut cycle = Cycle::new(&plan, start);
    for line in (0..plan.lines).filter(|line| watched.is_passive(*line)) {
        cycle.on_received(line, start, &Received::Trouble(Trouble::ErrorPassive));
    }
    let mut bus = watched.bus;
    for line in 0..plan.lines {
        bus.receive(line, &mut |received| {
            if !is_from_before(&received) {
                cycle.on_received(line, start, &received);
            }
        });
    }
    let mut arm = CanArm::new(bus, &plan, cycle);
    arm.set_goal(start, Goal::Enabled);
    arm
}

fn is_from_before(received: &Received) -> bool {
    let Received::Frame(frame) = received else {
        return false;
    };
    let states = [NmtState::PreOperational, NmtState::Stopped];
    matches!(Cob::of(frame.id), Cob::Heartbeat(_))
        && NmtState::parse(frame.data()).is_ok_and(|state| states.contains(&state))
}

fn turn_until_enabled<B: Bus>(
    arms: &mut [CanArm<B>],
    start: TimeNs,
) -> Result<(), (usize, BringUpError)> {
    let cycle_ns = arms.iter().map(CanArm::cycle_ns).max().unwrap_or(1);
    let mut at = start;
    while let Some(slow) = arms.iter().position(|arm| !arm.is_enabled()) {
        if at.since(start) > ENABLE_NS {
            return Err((slow, BringUpError::Slow));
        }
        at = at.plus_ns(cycle_ns);
        if let Some(first) = arms.first_mut() {
            first.bus_mut().wait(at);
            // SYNCs that a late process has missed are not made up for: nobody could answer them.
            at = at.max(first.bus_mut().now());
        }
        for (place, arm) in arms.iter_mut().enumerate() {
            arm.turn(at);
            if let Some(fault) = arm.fault() {
                return Err((place, BringUpError::Fault(fault)));
            }
        }
    }
    Ok(())
}
