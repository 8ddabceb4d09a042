//! What happens to an arm on CAN and to its buses, and what the log says of it.
//!
//! The control thread puts a status into a mailbox whenever it changes; the observing thread reads
//! it here and words the difference. A change that is replaced before it is read is not lost, since
//! counters only grow and a fault stays.

use super::super::signals::Signals;
use crate::mailbox::MailboxReader;
use crate::rig::can::{CanStatus, Noticed};
use hal::{PerArm, arm_names};
use trocar_log::Level;

impl CanStatus {
    /// What is new since `before`, for a person. A fault ends the motion; a controller that is
    /// error passive still works, and the arm goes on.
    ///
    /// Buses are counted from 0 within the arm. A fault is reported once: nothing clears it in a
    /// run.
    fn news(&self, before: &Self) -> Vec<(Level, String)> {
        let passive = self.passives.iter().zip(before.passives).enumerate();
        let passive = passive.filter(|(_, (now, then))| **now > *then);
        let mut news: Vec<_> = passive
            .map(|(bus, (times, _))| {
                let text = format!(
                    "bus {bus}: our controller has become error passive ({times} times so far), the next step is bus-off"
                );
                (Level::Warning, text)
            })
            .collect();
        if let Some(fault) = self.fault.filter(|_| before.fault.is_none()) {
            news.push((Level::Error, fault.to_string()));
        }
        news
    }
}

/// Changes of the arms' [`CanStatus`], for the log.
pub(in super::super) struct CanEventLog {
    noticed: MailboxReader<Noticed>,
    /// What of it is in the log.
    ///
    /// None before the first news, which are then compared with an arm that nothing has happened
    /// to.
    told: Option<PerArm<CanStatus>>,
}

impl CanEventLog {
    pub(in super::super) const fn new(noticed: MailboxReader<Noticed>) -> Self {
        Self {
            noticed,
            told: None,
        }
    }

    /// Tells what has happened to an arm and its buses.
    ///
    /// Events bear the time at which the control thread noticed them.
    pub(in super::super) fn tell(&mut self, signals: &Signals) {
        let Some((at, happened)) = self.noticed.take() else {
            return;
        };
        let told = self.told.replace(happened);
        let told = told.unwrap_or(happened.map(|_| CanStatus::default()));
        let arms = happened.iter().zip(told.iter());
        for ((now, before), name) in arms.zip(arm_names(happened.count())) {
            for (level, text) in now.news(before) {
                signals.tell(at, level, &format!("{name}: {text}"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use trocar_canopen::master::Fault;

    use super::*;

    /// Each time a controller becomes error passive is a warning and a fault is an error once.
    #[test]
    fn error_passive_is_a_warning_and_a_fault_one_error() {
        let quiet = CanStatus::default();
        assert!(quiet.news(&quiet).is_empty());
        let passive = CanStatus {
            passives: [0, 2, 0],
            ..quiet
        };
        let news = passive.news(&quiet);
        let [(level, text)] = &news[..] else {
            panic!("{news:?}");
        };
        assert_eq!(*level, Level::Warning);
        assert!(
            text.starts_with("bus 1: our controller has become error passive (2 times"),
            "{text}"
        );
        assert!(passive.news(&passive).is_empty());
        let failed = CanStatus {
            fault: Some(Fault::BusOff { line: 1 }),
            passives: [0, 3, 0],
        };
        let levels = |news: Vec<(Level, String)>| news.iter().map(|(l, _)| *l).collect::<Vec<_>>();
        assert_eq!(
            levels(failed.news(&passive)),
            [Level::Warning, Level::Error]
        );
        assert!(failed.news(&failed).is_empty());
    }
}
