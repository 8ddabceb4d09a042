//! Homing: control words as set-points with a SYNC, status words from the dictionary.
//!
//! An axis with an absolute encoder is homed where it stands (method 37): all these at the same
//! time. One that has to move does so alone, by the drive's own homing sequence (CiA 402-2, clause
//! 10), one axis after the other in the order of the plan.

use super::super::link::Bus;
use super::super::plan::{ArmPlan, AxisNode, HomingPlan};
use super::exchange::Exchange;
use super::watched::MonitoredBuses;
use super::writer::{Writer, is_missing};
use super::{BringUpError, Step};
use crate::cia301::cob::PdoNumber;
use crate::cia301::emcy::ErrorCode;
use crate::cia301::{AbortCode, Address, Cob, NmtCommand, NmtTarget};
use crate::cia402::{Command, Control, Mode, PowerState, Status};
use crate::index;
use crate::number::seconds;
use crate::{Frame, Payload};
use hal::tail::TAIL_AXES;

/// How long one step may take, ns.
const STEP_NS: u64 = 1_000_000_000;
/// Method 37: the present position is the reference.
const PRESENT_POSITION: i8 = 37;

/// The home offset that each drive was given, counts; none if it has no such object.
pub(super) type Homes = [Option<u32>; TAIL_AXES];

/// Homes all axes.
pub(super) fn home_all<B: Bus>(
    bus: &mut MonitoredBuses<B>,
    plan: &ArmPlan,
) -> Result<Homes, BringUpError> {
    let mut homes = [None; TAIL_AXES];
    let moves = |axis: &usize| moving(plan, *axis).is_some();
    let standing: Vec<usize> = (0..TAIL_AXES).filter(|axis| !moves(axis)).collect();
    bus.enter(Step::Homing)?;
    home(bus, plan, &standing, &mut homes)?;
    for sequence in plan.homing.iter().flatten() {
        let axis = usize::from(sequence.axis);
        bus.enter(Step::Moving(axis))?;
        home(bus, plan, &[axis], &mut homes)?;
    }
    Ok(homes)
}

/// The homing sequence of `axis`, if it has one.
fn moving(plan: &ArmPlan, axis: usize) -> Option<&HomingPlan> {
    let mut sequences = plan.homing.iter().flatten();
    sequences.find(|sequence| usize::from(sequence.axis) == axis)
}

/// Homes `axes` side by side. Whatever it comes to, their drives are let go.
fn home<B: Bus>(
    bus: &mut MonitoredBuses<B>,
    plan: &ArmPlan,
    axes: &[usize],
    homes: &mut Homes,
) -> Result<(), BringUpError> {
    let prepared = bus.side_by_side(plan, axes, async |exchange, axis| {
        Axis::new(exchange, plan, axis, 0).prepare().await
    })?;
    let mut positions = [0; TAIL_AXES];
    for (&axis, (position, home)) in axes.iter().zip(prepared) {
        positions[axis] = position;
        homes[axis] = home;
    }
    let homed = bus.side_by_side(plan, axes, async |exchange, axis| {
        let axis = Axis::new(exchange, plan, axis, positions[axis]);
        axis.reference().await
    });
    let let_go = let_all_go(bus, plan, axes, &positions, homed.is_ok());
    homed?;
    bus.judge(let_go)?;
    set_cyclic_position(bus, plan, axes, &positions)
}

/// Lets go the drives of `axes`, which are at `positions` (counts) and whose homing is `complete`
/// or was ended.
fn let_all_go<B: Bus>(
    bus: &mut MonitoredBuses<B>,
    plan: &ArmPlan,
    axes: &[usize],
    positions: &[u32; TAIL_AXES],
    complete: bool,
) -> Result<Vec<()>, BringUpError> {
    let let_go = bus.each_to_its_end(plan, axes, async |exchange, axis| {
        let axis = Axis::new(exchange, plan, axis, positions[axis]);
        axis.let_go(complete).await
    });
    let_go.into_iter().collect()
}

/// Puts the drives of `axes`, which are at `positions` (counts), into the mode of the control loop.
fn set_cyclic_position<B: Bus>(
    bus: &mut MonitoredBuses<B>,
    plan: &ArmPlan,
    axes: &[usize],
    positions: &[u32; TAIL_AXES],
) -> Result<(), BringUpError> {
    let modes = bus.side_by_side(plan, axes, async |exchange, axis| {
        let axis = Axis::new(exchange, plan, axis, positions[axis]);
        axis.write(index::MODE, &Mode::CyclicPosition.raw().to_le_bytes())
            .await
    });
    modes.map(|_| ())
}

/// One axis that is homed.
struct Axis<'a, 'b, B> {
    exchange: &'a Exchange<'b, B>,
    plan: &'a ArmPlan,
    axis: usize,
    who: AxisNode,
    /// Where it stood before, counts: the target position of its set-points, which no drive follows
    /// in this mode.
    position: u32,
}

impl<'a, 'b, B: Bus> Axis<'a, 'b, B> {
    fn new(exchange: &'a Exchange<'b, B>, plan: &'a ArmPlan, axis: usize, position: u32) -> Self {
        Self {
            exchange,
            plan,
            axis,
            who: plan.who(axis),
            position,
        }
    }

    async fn read_number(&self, address: Address) -> Result<u32, BringUpError> {
        self.exchange
            .read_number(self.who.line, self.who.node, address)
            .await
    }

    async fn write(&self, address: Address, data: &[u8]) -> Result<(), BringUpError> {
        self.exchange
            .write(self.who.line, self.who.node, address, data)
            .await
    }

    async fn nmt(&self, command: NmtCommand) -> Result<(), BringUpError> {
        let frame = command.emit(NmtTarget::Node(self.who.node));
        self.exchange.send(self.who.line, frame).await
    }

    /// Writes the objects of the homing mode. Gives the position of the axis, and its home offset,
    /// none if it has no such object.
    async fn prepare(&self) -> Result<(u32, Option<u32>), BringUpError> {
        let position = self.read_number(index::POSITION).await?;
        let home = match moving(self.plan, self.axis) {
            Some(sequence) => Some(self.prepare_sequence(sequence).await?),
            None => self.prepare_standing(position).await?,
        };
        self.write(index::MODE, &Mode::Homing.raw().to_le_bytes())
            .await?;
        Ok((position, home))
    }

    /// The reference is what the absolute encoder says.
    async fn prepare_standing(&self, position: u32) -> Result<Option<u32>, BringUpError> {
        let offset = position.to_le_bytes();
        let home = match self.write(index::HOME_OFFSET, &offset).await {
            // A drive without a home offset calls its reference zero, which is right if it stands
            // there.
            Err(BringUpError::Refused { code, .. })
                if code == AbortCode::NO_OBJECT && position == 0 =>
            {
                None
            }
            other => other.map(|()| Some(position))?,
        };
        self.write(index::HOMING_METHOD, &PRESENT_POSITION.to_le_bytes())
            .await?;
        Ok(home)
    }

    /// Method, speeds and acceleration, written and read back.
    async fn prepare_sequence(&self, sequence: &HomingPlan) -> Result<u32, BringUpError> {
        let (who, method) = (self.who, sequence.method);
        if !self.offers(method).await? {
            return Err(BringUpError::HomingMethod { who, method });
        }
        let axis = &self.plan.axes[self.axis];
        let home = axis.position_counts(sequence.home_position).to_le_bytes();
        let to = Writer {
            exchange: self.exchange,
            line: who.line,
            node: who.node,
        };
        let rate = |units| axis.rate_counts(units).to_le_bytes();
        to.set(index::HOME_OFFSET, &home).await?;
        to.set(index::HOMING_METHOD, &method.to_le_bytes()).await?;
        to.set(index::HOMING_SWITCH_SPEED, &rate(sequence.switch_speed))
            .await?;
        to.set(index::HOMING_ZERO_SPEED, &rate(sequence.zero_speed))
            .await?;
        to.set(index::HOMING_ACCELERATION, &rate(sequence.acceleration))
            .await?;
        Ok(u32::from_le_bytes(home))
    }

    /// Whether the drive offers `method`, by its list (60E3h); one without a list may, and refuses
    /// it when it is written.
    async fn offers(&self, method: i8) -> Result<bool, BringUpError> {
        let list = index::HOMING_METHOD_COUNT;
        let count = match self.read_number(list).await {
            Err(BringUpError::Refused { code, .. }) if is_missing(code) => return Ok(true),
            other => other?,
        };
        for sub in 1..=u8::try_from(count).unwrap_or(u8::MAX) {
            let offered = self.read_number(Address::new(list.index, sub)).await?;
            // 8 bits in older editions of CiA 402-2, 16 in newer ones.
            let [low, ..] = offered.to_le_bytes();
            if low == method.cast_unsigned() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Enables the drive and starts its homing: it is over when the drive has attained it and
    /// rests.
    async fn reference(&self) -> Result<(), BringUpError> {
        self.nmt(NmtCommand::Start).await?;
        for (command, state) in [
            (Command::Shutdown, PowerState::ReadyToSwitchOn),
            (Command::SwitchOn, PowerState::SwitchedOn),
            (Command::EnableOperation, PowerState::OperationEnabled),
        ] {
            self.command(Control::new(command), |status| status.state == state)
                .await?;
        }
        let start = Control {
            start: true,
            ..Control::new(Command::EnableOperation)
        };
        let attained =
            |status: &Status| status.follows && status.target_reached && !status.deviation;
        let Some(sequence) = moving(self.plan, self.axis) else {
            return self.command(start, attained).await;
        };
        let who = self.who;
        let ended = self.step(start, sequence.time_out_ns, |status| {
            attained(status) || status.deviation || self.exchange.is_cancelled()
        });
        match ended.await? {
            End::Reached(status, parsed) if parsed.deviation => {
                Err(BringUpError::HomingError { who, status })
            }
            End::Reached(_, parsed) if !attained(&parsed) => Err(BringUpError::Cancelled { who }),
            End::Reached(..) => Ok(()),
            End::Late(status) => {
                let limit_s = seconds(sequence.time_out_ns);
                Err(BringUpError::HomingTimeOut {
                    who,
                    limit_s,
                    status,
                })
            }
        }
    }

    /// Takes the drive's torque and its process data; one that still moves is stopped first.
    async fn let_go(&self, complete: bool) -> Result<(), BringUpError> {
        let down = |status: &Status| status.state == PowerState::SwitchOnDisabled;
        if !complete && moving(self.plan, self.axis).is_some() {
            // By 605Ah, which bring-up has set: a fast ramp, then no voltage.
            let stop = Control::new(Command::QuickStop);
            let _ = self.step(stop, STEP_NS, down).await;
        }
        let control = Control::new(Command::DisableVoltage);
        let let_go = self.command(control, down).await;
        self.exchange.set_point(self.axis, None);
        // One that does not go is stopped: pre-operational removes no torque, see CiA 402-2.
        let leave = match let_go {
            Ok(()) => NmtCommand::EnterPreOperational,
            Err(_) => NmtCommand::Stop,
        };
        self.nmt(leave).await?;
        let_go
    }

    /// As [`Self::step`]; that it takes too long is an error.
    async fn command(
        &self,
        control: Control,
        reached: impl Fn(&Status) -> bool,
    ) -> Result<(), BringUpError> {
        let who = self.who;
        match self.step(control, STEP_NS, reached).await? {
            End::Reached(..) => Ok(()),
            End::Late(status) => Err(BringUpError::Homing { who, status }),
        }
    }

    /// Gives the control word until the status word is as it should be.
    async fn step(
        &self,
        control: Control,
        limit_ns: u64,
        reached: impl Fn(&Status) -> bool,
    ) -> Result<End, BringUpError> {
        let AxisNode { line, node, .. } = self.who;
        let [a, b] = control.emit().to_le_bytes();
        let [c, d, e, f] = self.position.to_le_bytes();
        let id = Cob::ReceivePdo(PdoNumber::FIRST, node).id();
        let set_point = Frame::new(id, Payload::truncated(&[a, b, c, d, e, f]));
        self.exchange.set_point(self.axis, Some((line, set_point)));
        let end = self.exchange.now().plus_ns(limit_ns);
        loop {
            self.exchange.next_sync(line).await?;
            let status = self.read_number(index::STATUS).await?;
            let parsed = u16::try_from(status).ok();
            let parsed = parsed.and_then(|raw| Status::parse(raw).ok());
            match parsed {
                Some(parsed) if reached(&parsed) => return Ok(End::Reached(status, parsed)),
                Some(parsed) if parsed.state == PowerState::Fault => {
                    let unnamed = BringUpError::Homing {
                        who: self.who,
                        status,
                    };
                    return Err(self.fault().await.unwrap_or(unnamed));
                }
                Some(_) | None => {}
            }
            if self.exchange.now() >= end {
                return Ok(End::Late(status));
            }
        }
    }

    /// Why the drive is in fault, if it says so.
    async fn fault(&self) -> Option<BringUpError> {
        let code = self.read_number(index::ERROR_CODE).await.ok()?;
        let code = ErrorCode(u16::try_from(code).ok()?);
        let who = self.who;
        (code != ErrorCode::RESET).then_some(BringUpError::Faulty { who, code })
    }
}

/// How a step ended, with the newest status word.
enum End {
    Reached(u32, Status),
    Late(u32),
}
