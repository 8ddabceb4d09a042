//! How busy the buses of arms on CAN are, for the log.

use hal::TimeNs;
use trocar_log::SideLog;

use crate::rig::can_traffic::Buses;

/// Time from one look at the buses to the next, ns: their rates are of a second.
const EVERY_NS: u64 = 500_000_000;

/// What the kernel counts on the interfaces of a run.
pub(in super::super) struct BusLog {
    buses: Buses,
    /// Of all of them, bit/s.
    bit_rate: u32,
    /// When they were last looked at.
    looked: Option<TimeNs>,
}

impl BusLog {
    /// Those of these interfaces with their bit rate, bit/s; nothing if there are none.
    pub(super) fn of((interfaces, bit_rate): &(Vec<String>, u32)) -> Option<Self> {
        let buses = || Buses::named(interfaces.iter());
        (!interfaces.is_empty()).then(|| Self::new(buses(), *bit_rate))
    }

    pub(super) const fn new(buses: Buses, bit_rate: u32) -> Self {
        Self {
            buses,
            bit_rate,
            looked: None,
        }
    }

    /// Writes into `log` how they are, if it is time: at first at once, then twice a second.
    pub(in super::super) fn tell(&mut self, now: TimeNs, log: &mut SideLog) {
        let is_due = |looked: TimeNs| now.since(looked) >= EVERY_NS;
        if self.looked.is_none_or(is_due) {
            self.looked = Some(now);
            self.buses.look();
            log.buses(now, self.buses.record(self.bit_rate));
        }
    }
}

#[cfg(test)]
mod tests {
    use trocar_log::{BusesRecord, LoggedItem, Pressure, Recorder, RunHeader, read_items};

    use super::*;
    use crate::session::scratch::Scratch;

    /// A run of ten seconds says twenty times how its buses are, however often it is asked; one
    /// without buses never.
    #[test]
    fn buses_are_logged_twice_a_second() {
        assert!(BusLog::of(&(Vec::new(), 0)).is_none());
        let folder = Scratch::folder("bus-log");
        let path = folder.0.join("run.mcap");
        let recorder = Recorder::create(&path, &RunHeader::default(), Pressure::Block).unwrap();
        let (_ticks, mut side, _scenes, file) = recorder.split();
        let names = ["no-such-can0", "no-such-can1"].map(str::to_owned);
        let mut buses = BusLog::of(&(names.into(), 1_000_000)).unwrap();
        for ms in 0..10_000 {
            buses.tell(TimeNs(ms * 1_000_000), &mut side);
        }
        file.finish(None).unwrap();
        let mut told = Vec::new();
        read_items(&path, |item| {
            if let LoggedItem::Buses { at, message } = item {
                let record = BusesRecord::read(message.as_bytes()).unwrap();
                let names = record.buses.into_iter().map(|bus| bus.interface);
                told.push((at.tick(), names.collect::<Vec<_>>()));
            }
        })
        .unwrap();
        assert_eq!(told.len(), 20);
        for ((tick, names), expected) in told.iter().zip(0..) {
            assert_eq!(*tick, 500 * expected);
            assert_eq!(*names, ["no-such-can0", "no-such-can1"]);
        }
    }
}
