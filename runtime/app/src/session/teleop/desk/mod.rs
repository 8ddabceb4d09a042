//! Devices at the robot's computer as the operator's hands: keyboards, gamepads and SpaceMice under
//! `/dev/input`, with or without a page.
//!
//! ```text
//!  /dev/input/eventN ── a thread each: events ──> thread of the desk: hands, 50 a second ──> `Hands`, as from a page
//! ```
//!
//! `events` reads a device, `device` is what its controls ask for (the page's own), `hand` what a
//! hand makes of it. A keyboard moves the arms whichever window has the focus. A device that goes
//! lets go, and so does one that has lost events: its keys have to be pressed anew.

mod device;
mod events;
mod hand;

#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::Duration;

use hal::{ARMS_MAX, TimeNs};

use super::message::HandsMessage;
use super::{Hands, ReleaseCause};
use crate::rt::MonotonicClock;
use crate::session::SessionError;
use device::{ButtonAction, Device};
use events::{Event, Source};
use hand::{DeviceAxes, VirtualHand};

/// Its seat; those of pages are counted from 1.
const SEAT: u64 = 0;

/// Time from one message of hands to the next, ns, and for how long an event is waited for.
const EVERY_NS: u64 = 20_000_000;
const WAIT: Duration = Duration::from_millis(5);

/// An event of the device of that index; none when it has gone.
type DeviceEvent = (usize, Option<Event>);

/// From now on the devices at `paths` are the `hands`; `warn` hears of those that go.
///
/// # Errors
/// [`SessionError::BadArgument`] if one can't be read or is no input device.
pub(crate) fn attend(
    paths: &[PathBuf],
    hands: Arc<Hands>,
    warn: fn(&str),
) -> Result<(), SessionError> {
    let sources = paths.iter().map(|path| Source::open(path));
    let sources: Vec<Source> = sources.collect::<Result<_, _>>()?;
    let failed = |error: std::io::Error| {
        SessionError::BadArgument(format!("--hands: no thread can be started for it: {error}"))
    };
    hands.take_desk();
    let mut desk = InputDevices::new(hands);
    let (to, events) = mpsc::channel();
    for (index, source) in sources.into_iter().enumerate() {
        desk.devices
            .push(Some(Device::new(source.is_cap, source.ranges.clone())));
        let to: Sender<DeviceEvent> = to.clone();
        let read = move || {
            source.read(|event| to.send((index, Some(event))).is_ok());
            let _over = to.send((index, None));
        };
        spawn("desk-device", read).map_err(failed)?;
    }
    let paths = paths.to_vec();
    let gone = move |index: usize| {
        let path = paths.get(index).map(|path| path.display().to_string());
        warn(&format!(
            "--hands {}: the device is disconnected; its arm holds",
            path.unwrap_or_default()
        ));
    };
    spawn("desk", move || desk.run(&events, gone)).map_err(failed)
}

fn spawn(name: &str, body: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    // They end with the process: whoever waits for a person's key can't be asked to.
    thread::Builder::new()
        .name(name.to_owned())
        .spawn(body)
        .map(drop)
}

/// The hands of its devices.
struct InputDevices {
    hands: Arc<Hands>,
    /// None has gone.
    devices: Vec<Option<Device>>,
    /// The arm that is moved, where devices have none of their own.
    chosen: usize,
    arms: [VirtualHand; ARMS_MAX],
    clock: MonotonicClock,
    before: TimeNs,
}

impl InputDevices {
    fn new(hands: Arc<Hands>) -> Self {
        let clock = MonotonicClock::new();
        Self {
            hands,
            devices: Vec::new(),
            chosen: 0,
            arms: [VirtualHand::default(); ARMS_MAX],
            before: clock.now(),
            clock,
        }
    }

    fn run(mut self, events: &Receiver<DeviceEvent>, gone: impl Fn(usize)) {
        loop {
            match events.recv_timeout(WAIT) {
                Ok((index, Some(event))) => self.take(index, event),
                Ok((index, None)) => {
                    self.go(index);
                    gone(index);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    self.hands.release(SEAT, ReleaseCause::NoDevice);
                    return;
                }
            }
            if self.clock.now().since(self.before) >= EVERY_NS {
                self.tell();
            }
        }
    }

    fn go(&mut self, index: usize) {
        if let Some(device) = self.devices.get_mut(index) {
            *device = None;
        }
    }

    fn take(&mut self, index: usize, event: Event) {
        let now = self.clock.now();
        let device = self.devices.get_mut(index).and_then(Option::as_mut);
        let chosen = match device.and_then(|device| device.take(event, now)) {
            Some(ButtonAction::Arm(arm)) => arm,
            Some(ButtonAction::OtherArm) => 1 - self.chosen.min(1),
            Some(ButtonAction::EpisodeCommand(wish)) => {
                // One that does not apply now is none.
                let _none = self.hands.wish(wish);
                return;
            }
            Some(ButtonAction::HandBack) => {
                let _none = self.hands.hand_back();
                return;
            }
            None => return,
        };
        // A clutch that is held is that of the arm before.
        if chosen != self.chosen {
            self.chosen = chosen;
            self.devices.iter_mut().flatten().for_each(Device::clear);
        }
    }

    /// Which arm a device moves, of so many: with two of both each has its own.
    fn arm_of(&self, device: usize, arms: usize) -> usize {
        if arms > 1 && self.devices.len() > 1 {
            device.min(arms - 1)
        } else {
            self.chosen.min(arms.saturating_sub(1))
        }
    }

    /// Says where the hands are, if the run is moved by hand.
    fn tell(&mut self) {
        let now = self.clock.now();
        let seconds = TimeNs(now.since(self.before)).seconds().min(0.05);
        self.before = now;
        let Some(status) = self.hands.status() else {
            return;
        };
        let count = status.arms.len();
        let mut arms = Vec::new();
        for (arm, told) in status.arms.iter().enumerate().take(ARMS_MAX) {
            let jaw = self.arms[arm].jaw;
            let mine: Vec<usize> = (0..self.devices.len())
                .filter(|&device| self.arm_of(device, count) == arm)
                .collect();
            let mut asked = DeviceAxes::default();
            let mut is_moved = mine.is_empty();
            for device in mine {
                if let Some(device) = &mut self.devices[device] {
                    is_moved = true;
                    asked = asked.and(device.asked(now, jaw));
                }
            }
            self.arms[arm].go(&asked, seconds, told.jaw);
            arms.push(is_moved.then(|| self.arms[arm].told()));
        }
        let t = now.seconds() * 1e3;
        // Whatever does not fit the run moves nothing.
        let _refused = self.hands.hear(SEAT, &HandsMessage { t, arms });
    }
}
