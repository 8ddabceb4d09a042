//! Arms whose drives are on CAN. The bring-up ends in the control thread, which must not let the
//! SYNC stop from then on. A fault of any drive or bus stops all drives of its arm.
//!
//! Configuration, bus load and interfaces are checked first, without any frame; `bring_up` then
//! leads the drives to where they may be enabled, and `enable` gives them torque once the observing
//! thread allows it.

use hal::{PerArm, TICK_NS};
use trocar_canopen::master::{BringUpError, Permission, enable_together};
use trocar_canopen::socket::SocketBus;
use trocar_topics::{SceneReport, Subscriber};

use super::super::signals::Signals;
use super::ArmLink;
use super::awaited::{self, PrintLine};
use super::bring_up::{ReadyArm, bring_up, check, failed};
use super::options::CanOptions;
use super::summary::summary;
use crate::mailbox::MailboxWriter;
use crate::rig::can::{CanRig, Noticed};
use crate::rig::can_clock::CanClock;
use crate::rt::{self, MonotonicClock, Periodic};
use crate::session::summary::CanSummary;
use crate::session::{Robot, SessionError, can_interfaces};

impl ArmLink for CanOptions {
    /// One an arm: an arm's buses are a set of sockets of its own, even where two arms share an
    /// interface.
    type Opened = Vec<SocketBus<CanClock>>;
    /// Homed, mapped and without torque.
    type Ready = Vec<ReadyArm>;
    type Rig = CanRig;

    fn topics(&self) -> &str {
        &self.topics
    }

    /// Named in errors: what to start if there is no world.
    fn host(&self) -> &'static str {
        "trocar drives"
    }

    /// Opens sockets alone: nothing is sent.
    fn open(&self, robot: &Robot, clock: MonotonicClock) -> Result<Self::Opened, SessionError> {
        check(&robot.name, robot.arms(), &self.config)?;
        let arms = self.config.arms.iter().take(robot.arms());
        let buses = arms.map(|arm| can_interfaces::open(&arm.interfaces, clock));
        buses.collect()
    }

    /// What the margins do not hold of the arms' lag at the cycle of their buses.
    ///
    /// The longest cycle of all arms counts.
    fn warnings(&self, robot: &Robot) -> Vec<String> {
        let arms = self.config.arms.iter().take(robot.arms());
        let cycle_ns = arms.map(|arm| arm.plan.cycle_ns).max();
        let lines = cycle_ns.map(|cycle_ns| robot.control.lag_beyond_margins(cycle_ns));
        lines.unwrap_or_default()
    }

    /// Each interface once, by name, and the greatest bit rate of all arms; 0 without an arm.
    fn buses(&self, arms: usize) -> (Vec<String>, u32) {
        let arms = self.config.arms.iter().take(arms);
        let rate = arms.clone().map(|arm| arm.plan.bit_rate).max();
        let mut interfaces: Vec<String> = arms.flat_map(|arm| arm.interfaces.clone()).collect();
        interfaces.sort_unstable();
        interfaces.dedup();
        (interfaces, rate.unwrap_or(0))
    }

    fn bring_up(
        &self,
        opened: Self::Opened,
        _clock: MonotonicClock,
        say: PrintLine<'_>,
    ) -> Result<Self::Ready, SessionError> {
        bring_up(self, opened, say)
    }

    /// The world's drives must be those that were just brought up, and have not been started yet.
    fn await_world(
        &self,
        scene: &Subscriber<SceneReport>,
        clock: MonotonicClock,
        say: PrintLine<'_>,
    ) -> Result<(), SessionError> {
        awaited::stopped(scene, clock, &self.topics, say)
    }

    /// Runs on the control thread, which goes on with the SYNC in its loop. Torque waits for the
    /// permission of the observing thread. [`SessionError::Interrupted`] if the run ended or a
    /// signal came meanwhile.
    fn enable(
        &self,
        ready: Self::Ready,
        noticed: MailboxWriter<Noticed>,
        signals: &Signals,
        clock: MonotonicClock,
    ) -> Result<CanRig, SessionError> {
        let arms = enable_together(ready, &mut || {
            if signals.done() || rt::interrupted() {
                Permission::Denied
            } else if signals.torque_allowed() {
                Permission::Granted
            } else {
                Permission::Pending
            }
        });
        let arms = arms.map_err(|(arm, error)| {
            if error == BringUpError::Denied {
                return SessionError::Interrupted;
            }
            failed(self, arm, &error)
        })?;
        let Some(arms) = PerArm::collect(arms) else {
            return Err(SessionError::BadArgument("there is no arm".to_owned()));
        };
        // The SYNC goes on at once.
        let periodic = Periodic::new(clock, clock.now().plus_ns(TICK_NS), TICK_NS);
        Ok(CanRig::new(arms, noticed, periodic))
    }

    /// Blocks until the drives are down or their time is up.
    fn take_down(rig: &mut CanRig, clock: MonotonicClock) {
        rig.take_down(clock);
    }

    /// Of all arms, in one line.
    fn fault(rig: &CanRig) -> Option<String> {
        let faults = rig.fault_texts();
        (!faults.is_empty()).then(|| format!("fault: {}", faults.join("; ")))
    }

    fn summary(&self, rig: &CanRig) -> Option<CanSummary> {
        Some(summary(rig, self))
    }
}

#[cfg(test)]
mod tests {
    use hal::config::Source;
    use trocar_canopen::master::CanConfig;

    use super::{ArmLink, CanOptions};
    use crate::session::{PolicyChoice, Setup};

    /// Two arms on one bus have a cycle whose lag the margins don't hold, until they are what the
    /// warnings ask for; one arm at the shipped cycle has none to tell of.
    #[test]
    fn a_cycle_whose_lag_margins_do_not_hold_is_named() {
        let warnings = |task: &str, cycle: &str, margins: Option<(f64, f64)>| {
            let mut setup = Setup::load(task, None, &PolicyChoice::Expert).unwrap();
            if let Some((guard_m, filter_m)) = margins {
                let of_robot = &mut setup.robot.control.margins;
                (of_robot.guard_m, of_robot.filter_m) = (guard_m, filter_m);
            }
            let text = CanConfig::shipped()
                .text()
                .replace("cycle_us = 2000", cycle);
            let source = Source::embedded("can.toml", &text);
            let (can, _) = CanOptions::load(&source, "lab").unwrap();
            can.warnings(&setup.robot)
        };
        let none = Vec::<String>::new();
        assert_eq!(warnings("needle-lift", "cycle_us = 2000", None), none);
        let two = warnings("needle-handover", "cycle_us = 4000", None);
        let [guard, filter] = two.as_slice() else {
            panic!("{two:?}");
        };
        assert!(
            guard.contains("up to 0.313 mm during a stop")
                && guard.ends_with("margins.guard_m >= 0.00039 hold it"),
            "{guard}"
        );
        assert!(
            filter.contains("13.0 ms behind their commands, 1.836 mm at full speed")
                && filter.ends_with("margins.filter_m >= 0.00223 hold it"),
            "{filter}"
        );
        let followed = Some((0.00039, 0.00223));
        let left = warnings("needle-handover", "cycle_us = 4000", followed);
        assert_eq!(left, none);
    }
}
