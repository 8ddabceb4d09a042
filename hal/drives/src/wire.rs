//! One bus on which frames take their time and the lowest identifier goes first.
//!
//! A frame takes its exact length on the wire, stuff bits included (`bus_load::bits`), at the bit
//! rate. Arbitration takes place when the bus is free: the lowest identifier among the frames that
//! the controllers offer wins, and a frame that has begun is not interrupted. No bit errors, no
//! error frames.

use std::collections::VecDeque;

use hal::TimeNs;
use trocar_canopen::Frame;
use trocar_canopen::bus_load::bits::{duration_ns, exact};

/// How a controller picks what it offers to the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Oldest first, as a Linux interface does.
    Fifo,
    /// Lowest identifier first, as a drive with a mailbox for each service does.
    Priority,
}

/// A node's controller: its transmit queue, each frame with the time at which it was queued.
#[derive(Clone, Debug)]
struct Port {
    order: Order,
    /// Frames, the one on the wire not among them.
    capacity: usize,
    /// Off the bus nothing of its queue is sent; a change of this empties the queue.
    attached: bool,
    queue: VecDeque<(TimeNs, Frame)>,
}

impl Port {
    /// Place in the queue of what it offers at `now`.
    fn offer(&self, now: TimeNs) -> Option<usize> {
        let mut ready = self
            .queue
            .iter()
            .enumerate()
            .filter(|(_, (queued, _))| *queued <= now);
        match self.order {
            Order::Fifo => ready.next().map(|(place, _)| place),
            Order::Priority => ready
                .min_by_key(|(place, (_, frame))| (frame.id, *place))
                .map(|(place, _)| place),
        }
    }
}

/// The frame that is on the wire, and when its last bit is.
#[derive(Clone, Copy, Debug)]
struct Sending {
    port: usize,
    frame: Frame,
    end: TimeNs,
}

/// A frame that has arrived everywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// When its last bit was sent.
    pub at: TimeNs,
    /// Who sent it.
    pub port: usize,
    /// The frame.
    pub frame: Frame,
}

/// No room in a controller's queue: ENOBUFS on Linux.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueFull;

/// A bus with its controllers.
#[derive(Clone, Debug)]
pub struct Wire {
    bit_rate: u32,
    ports: Vec<Port>,
    sending: Option<Sending>,
    /// When the newest frame's last bit was sent; the next may begin then.
    idle_since: TimeNs,
    /// Since the beginning, frames under way in full.
    busy_ns: u64,
    frames: u64,
    collisions: u64,
}

impl Wire {
    /// A bus without anybody, `bit_rate` in bits a second.
    #[must_use]
    pub const fn new(bit_rate: u32) -> Self {
        Self {
            bit_rate,
            ports: Vec::new(),
            sending: None,
            idle_since: TimeNs(0),
            busy_ns: 0,
            frames: 0,
            collisions: 0,
        }
    }

    /// Attaches a controller whose queue holds `capacity` frames; gives its port.
    pub fn attach(&mut self, order: Order, capacity: usize) -> usize {
        self.ports.push(Port {
            order,
            capacity,
            attached: true,
            queue: VecDeque::with_capacity(capacity),
        });
        self.ports.len() - 1
    }

    /// Takes a controller off the bus, or puts it back. What it had queued goes with it.
    pub fn set_attached(&mut self, port: usize, attached: bool) {
        if let Some(port) = self.ports.get_mut(port) {
            port.attached = attached;
            port.queue.clear();
        }
    }

    /// Forgets what waits at `port`.
    pub fn discard(&mut self, port: usize) {
        if let Some(port) = self.ports.get_mut(port) {
            port.queue.clear();
        }
    }

    /// Queues a frame.
    ///
    /// # Errors
    /// [`QueueFull`]. A controller off the bus keeps what it is given until its queue is full.
    pub fn send(&mut self, now: TimeNs, port: usize, frame: Frame) -> Result<(), QueueFull> {
        let port = self.ports.get_mut(port).ok_or(QueueFull)?;
        if port.queue.len() >= port.capacity {
            return Err(QueueFull);
        }
        port.queue.push_back((now, frame));
        Ok(())
    }

    /// The next frame that arrives by `until`. Frames sent because of a delivery must be queued
    /// before the next call.
    ///
    /// Linear in ports and queued frames.
    pub fn next(&mut self, until: TimeNs) -> Option<Delivery> {
        let sending = match self.sending {
            Some(sending) => sending,
            None => self.arbitrate(until)?,
        };
        if sending.end > until {
            self.sending = Some(sending);
            return None;
        }
        self.sending = None;
        self.idle_since = sending.end;
        Some(Delivery {
            at: sending.end,
            port: sending.port,
            frame: sending.frame,
        })
    }

    /// Whoever has the lowest identifier when the bus is free begins to send.
    ///
    /// Of equal identifiers the lowest port wins, and the collision is counted if their frames
    /// differ; a real bus would have an error frame. None if nobody has anything to begin by
    /// `until`.
    fn arbitrate(&mut self, until: TimeNs) -> Option<Sending> {
        let attached = || self.ports.iter().filter(|port| port.attached);
        let first = attached()
            .filter_map(|port| port.queue.iter().map(|(queued, _)| *queued).min())
            .min()?;
        let start = first.max(self.idle_since);
        if start > until {
            return None;
        }
        let offers = self.ports.iter().enumerate().filter_map(|(n, port)| {
            let place = port.offer(start).filter(|_| port.attached)?;
            Some((port.queue.get(place)?.1, n, place))
        });
        let (frame, port, place) = offers.clone().min_by_key(|(frame, n, _)| (frame.id, *n))?;
        // Two with the same identifier destroy each other's frames unless they say the same.
        let mut others = offers.filter(|(_, n, _)| *n != port);
        let collides = others.any(|(other, ..)| other.id == frame.id && other != frame);
        self.collisions += u64::from(collides);
        self.ports[port].queue.remove(place);
        let duration_ns = duration_ns(exact(&frame), self.bit_rate);
        self.busy_ns += duration_ns;
        self.frames += 1;
        Some(Sending {
            port,
            frame,
            end: start.plus_ns(duration_ns),
        })
    }

    /// When the last frame that now waits at any port but `except` will have been sent, if no other
    /// comes; none if there is none.
    #[must_use]
    pub fn silent_at(&self, except: usize) -> Option<TimeNs> {
        let others = self.ports.iter().enumerate();
        let others = others.filter(|(port, place)| *port != except && place.attached);
        let waiting_ns: u64 = others
            .flat_map(|(_, port)| &port.queue)
            .map(|(_, frame)| duration_ns(exact(frame), self.bit_rate))
            .sum();
        match &self.sending {
            Some(sending) if waiting_ns > 0 || sending.port != except => {
                Some(sending.end.plus_ns(waiting_ns))
            }
            None if waiting_ns > 0 => Some(self.idle_since.plus_ns(waiting_ns)),
            Some(_) | None => None,
        }
    }

    /// Frames that wait at `port`.
    #[must_use]
    pub fn waiting(&self, port: usize) -> usize {
        self.ports.get(port).map_or(0, |port| port.queue.len())
    }

    /// How long the bus was busy, ns, and with how many frames.
    #[must_use]
    pub const fn busy(&self) -> (u64, u64) {
        (self.busy_ns, self.frames)
    }

    /// How often two controllers sent different frames under one identifier at the same time.
    #[must_use]
    pub const fn collisions(&self) -> u64 {
        self.collisions
    }
}
