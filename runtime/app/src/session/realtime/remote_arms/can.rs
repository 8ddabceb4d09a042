//! Arms whose drives are on CAN. The bring-up ends in the control thread, which must not let the SYNC stop from then on. A fault of any drive or bus
//! stops all drives of its arm.

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
    type Opened = Vec<SocketBus<CanClock>>;
    type Ready = Vec<ReadyArm>;
    type Rig = CanRig;

    fn topics(&self) -> &str {
        &self.topics
    }

    fn host(&self) -> &'static str {
        "trocar drives"
    }

    fn open(&self, robot: &Robot, clock: MonotonicClock) -> Result<Self::Opened, SessionError> {
        check(&robot.name, robot.arms(), &self.config)?;
        let arms = self.config.arms.iter().take(robot.arms());
        let buses = arms.map(|arm| can_interfaces::open(&arm.interfaces, clock));
        buses.collect()
    }

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
        buses: Self::Opened,
        _clock: MonotonicClock,
        say: PrintLine<'_>,
    ) -> Result<Self::Ready, SessionError> {
        bring_up(self, buses, say)
    }

    fn await_world(
        &self,
        scene: &Subscriber<SceneReport>,
        clock: MonotonicClock,
        say: PrintLine<'_>,
    ) -> Result<(), SessionError> {
        awaited::stopped(scene, clock, &self.topics, say)
    }

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

    fn take_down(rig: &mut CanRig, clock: MonotonicClock) {
        rig.take_down(clock);
    }

    fn fault(rig: &CanRig) -> Option<String> {
        let faults = rig.fault_texts();
        (!faults.is_empty()).then(|| format!("fault: {}", faults.join("; ")))
    }

    fn summary(&self, rig: &CanRig) -> Option<CanSummary> {
        Some(summary(rig, self))
    }
}
