//! The drive behind the communication: power states, set-points, stops, homing, and its own watch
//! over the motor.
//!
//! CiA 402-2, clauses 8 (power), 12 (cyclic synchronous position), 10 (homing), and the option
//! codes 6007h and 605Ah to 605Eh.
//!
//! All numbers are in the units of the object dictionary: counts of the encoder, counts/s,
//! counts/s², per mille of the rated torque. Positions of the motion (`motion`) count from home,
//! those of [`Feedback`] and [`Demand`] from the encoder's own zero; `offset` is between them.

mod control;
mod follow;
mod homing;
mod report;

use super::motion::Motion;
use crate::dictionary::Dictionary;
use hal::TimeNs;
use trocar_canopen::cia402::mode::period_ns;
use trocar_canopen::cia402::{Command, ControlView, Event, Mode, PowerState};
use trocar_canopen::index;
use trocar_canopen::number::real;

/// Interpolation periods that the drive can do, ns.
const PERIOD_NS: (u64, u64) = (250_000, 20_000_000);

/// Where the motor is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Feedback {
    /// Position as the encoder counts.
    pub position_counts: f64,
    /// Velocity, counts/s.
    ///
    /// Reported in 606Ch. A stop ends once it is below a hundredth of the greatest speed, or 100 ms
    /// after the ramp.
    pub velocity_counts_s: f64,
    /// Torque, per mille of the rated one.
    ///
    /// Reported in 6077h.
    pub torque_per_mille: f64,
}

/// Where the motor should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Whether it has torque at all.
    ///
    /// Without it the position is where the motor is.
    pub torque: bool,
    /// Position as the encoder counts.
    ///
    /// Always within 607Bh, the encoder's range.
    pub position_counts: f64,
    /// Velocity, counts/s.
    pub velocity_counts_s: f64,
    /// Greatest torque, per mille of the rated one.
    ///
    /// 6072h.
    pub torque_per_mille_max: f64,
}

/// A motor slower than this part of its greatest speed rests.
const REST_PART: f64 = 100.0;

/// How long a motor may lag behind the end of its stop before it loses its torque all the same, ns.
const REST_NS_MAX: u64 = 100_000_000;

/// What happens at the end of a stop.
///
/// `Send` holds the event that the power state machine gets once the axis stands; with it the drive
/// loses its torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AtRest {
    Stay,
    Send(Event),
}

/// The power stage and the set-point generator of a drive (CiA 402). Positions are counts.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    state: PowerState,
    /// 6061h: what 6060h was last set to, if the drive has it.
    mode: Mode,
    motion: Motion,
    at_rest: AtRest,
    /// Since when the stop is over and the motor lags behind it.
    lags_since: Option<TimeNs>,
    feedback: Feedback,
    /// Added to the encoder's counts.
    offset: f64,
    /// Lost at power-on and at the start of a homing that moves.
    homed: bool,
    /// Present while a homing that moves is under way.
    search: Option<homing::Search>,
    /// 6040h as it was written last, against which edges are found. A lost connection clears bits 0
    /// to 3.
    control: u16,
    /// Whether something else than "enable operation" was said since the quick stop began.
    rearmed: bool,
    /// Bit 8 of the control word.
    halted: bool,
    /// The newest target was cut by 607Dh or the greatest speed: bit 11 of the status word.
    limited: bool,
    /// Since when the following error is beyond 6065h; 6066h counts from here.
    deviates_since: Option<TimeNs>,
    /// Kept until the fault is reset.
    register: u8,
}

impl Default for Drive {
    fn default() -> Self {
        Self {
            state: PowerState::NotReady,
            mode: Mode::None,
            motion: Motion::Rest { position: 0.0 },
            at_rest: AtRest::Stay,
            lags_since: None,
            feedback: Feedback::default(),
            offset: 0.0,
            homed: false,
            search: None,
            control: 0,
            rearmed: false,
            halted: false,
            limited: false,
            deviates_since: None,
            register: 0,
        }
    }
}

/// The interpolation period, 60C2h, as near as the drive can do it, ns.
///
/// `value * 10^exponent` s, sub-indices 1 and 2, within 0.25 to 20 ms.
pub(super) fn interpolation_ns(dictionary: &Dictionary) -> u64 {
    let value = dictionary.get_as(index::PERIOD_VALUE);
    let exponent = dictionary.get_as(index::PERIOD_EXPONENT);
    period_ns(value, exponent)
        .unwrap_or(PERIOD_NS.1)
        .clamp(PERIOD_NS.0, PERIOD_NS.1)
}

/// The greatest speed, counts/s: the lower one of 607Fh and 6080h.
///
/// 6080h is in turns a minute: a sixtieth of it, times the counts a turn of 608Fh.
pub(super) fn speed_max(dictionary: &Dictionary) -> f64 {
    let get = |address| real(dictionary.get(address));
    let turn = get(index::ENCODER_COUNTS) / get(index::ENCODER_TURNS);
    let motor = get(index::MOTOR_SPEED_MAX) / 60.0 * turn;
    get(index::SPEED_MAX).min(motor)
}

impl Drive {
    /// The state of the power state machine.
    pub(super) const fn state(&self) -> PowerState {
        self.state
    }

    /// The bits that its faults set in the error register (1001h).
    pub(super) const fn fault_register(&self) -> u8 {
        self.register
    }

    /// Whether its motion is synchronised: cyclic modes.
    pub(super) fn follows_sync(&self) -> bool {
        self.state == PowerState::OperationEnabled && self.mode == Mode::CyclicPosition
    }

    /// As after power-on: not homed, no torque, no mode.
    pub(super) fn power_on(&mut self) {
        let feedback = self.feedback;
        *self = Self::default();
        self.feedback = feedback;
        self.settle();
        self.event(Event::Started);
    }

    /// Takes what the motor's encoder measures; a position that is not finite is ignored.
    pub(super) fn feedback(&mut self, feedback: Feedback) {
        if feedback.position_counts.is_finite() {
            self.feedback = feedback;
        }
    }

    /// Actual position, counts, home offset included (6064h).
    fn actual(&self) -> f64 {
        self.feedback.position_counts + self.offset
    }

    /// Without torque the demand is wherever the motor is.
    fn settle(&mut self) {
        self.motion = Motion::Rest {
            position: self.actual(),
        };
    }

    /// What the motor is to do at `now`: position, counts of the encoder; velocity, counts/s;
    /// torque limit, per mille.
    pub(super) fn demand(&self, now: TimeNs, dictionary: &Dictionary) -> Demand {
        let torque = self.state.has_torque();
        let (position, velocity) = self.motion.at(now);
        // The range is the encoder's, whatever a ramp would do or the home offset says.
        let low = real(dictionary.get(index::RANGE_MIN));
        let high = real(dictionary.get(index::RANGE_MAX));
        Demand {
            torque,
            position_counts: (position - self.offset).max(low).min(high),
            velocity_counts_s: velocity,
            torque_per_mille_max: real(dictionary.get(index::TORQUE_MAX)),
        }
    }

    /// Lets time pass: ends stops, goes on with homing.
    pub(super) fn step(&mut self, now: TimeNs, dictionary: &Dictionary) {
        if !self.state.has_torque() {
            self.settle();
        }
        if let AtRest::Send(event) = self.at_rest
            && self.motion.rests(now)
            && self.motor_rests(now, dictionary)
        {
            self.at_rest = AtRest::Stay;
            let position = self.motion.at(now).0;
            self.motion = Motion::Rest { position };
            self.event(event);
        }
        // Passing through switched-on to enabled takes a second look at the control word.
        if self.state == PowerState::SwitchedOn
            && self.at_rest == AtRest::Stay
            && ControlView(self.control).command() == Command::EnableOperation
            && !ControlView(self.control).fault_reset()
        {
            self.command(now, Command::EnableOperation, dictionary);
        }
        self.search(now, dictionary);
    }

    /// Whether the motor, too, has come to rest, or has had its time for it: without torque it
    /// would only coast.
    fn motor_rests(&mut self, now: TimeNs, dictionary: &Dictionary) -> bool {
        let since = *self.lags_since.get_or_insert(now);
        let speed = self.feedback.velocity_counts_s.abs();
        let rests = speed * REST_PART <= speed_max(dictionary) || now.since(since) >= REST_NS_MAX;
        if rests {
            self.lags_since = None;
        }
        rests
    }

    /// Passes `event` to the power state machine; without torque the demand follows the motor.
    fn event(&mut self, event: Event) {
        let had_torque = self.state.has_torque();
        self.state = self.state.next(event);
        if !self.state.has_torque() || !had_torque {
            self.settle();
            self.at_rest = AtRest::Stay;
        }
        if self.state != PowerState::OperationEnabled {
            self.halted = false;
        }
        self.deviates_since = None;
    }

    /// Brakes with `deceleration`; what `after` says comes at rest, or at once without braking.
    fn brake(&mut self, now: TimeNs, deceleration: Option<i64>, after: AtRest) {
        self.lags_since = None;
        match deceleration {
            Some(deceleration) => {
                self.motion = self.motion.stopped(now, real(deceleration));
                self.at_rest = after;
            }
            None => {
                if let AtRest::Send(event) = after {
                    self.event(event);
                }
            }
        }
    }
}
