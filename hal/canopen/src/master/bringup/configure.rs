//! What is written to every node before it may be operational, in the order that CiA 301 wants.

use super::super::link::Bus;
use super::super::plan::ArmPlan;
use super::BringUpError;
use super::exchange::Exchange;
use super::settings::{Setting, hold, keep};
use super::writer::{INVALID, Writer};
use crate::cia301::cob::{PdoNumber, SYNC_ID};
use crate::cia301::pdo::{MappingEntry, PdoCob, SyncCount, Transmission};
use crate::cia301::{Address, Cob};
use crate::cia402::Mode;
use crate::cia402::mode::period_parameter;
use crate::index;
use hal::count::count_u8;

/// Periods of the SYNC after which a set-point is overdue.
const DEADLINE_CYCLES: u64 = 10;
/// Least deadline, ms: below that the host's own jitter would stop the arm.
const DEADLINE_MS_MIN: u64 = 10;
/// PDOs of one direction that CiA 301 gives a logical device of a node, logical devices at most,
/// and PDOs that have an identifier of their own.
const PDOS_A_DEVICE: u16 = 64;
const DEVICES_MAX: u16 = 8;
const PDOS_NAMED: u16 = 4;
/// The bits of the COB-ID of a PDO in use that are compared: valid, and the identifier of eleven
/// bits. Whether remote frames are allowed, which no node sends, is the drive's own.
const IN_USE: u32 = INVALID | 1 << 29 | 0x7FF;
/// SYNC and time stamps that the node itself sends, and time stamps that it hears (1005h, 1012h).
const PRODUCED: u32 = 1 << 30;
const CONSUMED: u32 = 1 << 31;
/// Time stamps, which our own drives do without.
const TIME_COB: Address = Address::new(0x1012, 0);

impl<B: Bus> Writer<'_, '_, B> {
    /// One PDO that is off: identifier, mapping, transmission, on.
    async fn pdo(
        &self,
        record: fn(u8, u8) -> Address,
        mapping: fn(u8, u8) -> Address,
        cob: PdoCob,
        objects: &[(Address, u8)],
        extras: &[Setting],
    ) -> Result<(), BringUpError> {
        let off = PdoCob {
            valid: false,
            ..cob
        };
        self.put(record(0, 1), &off.emit().to_le_bytes()).await?;
        self.set(mapping(0, 0), &[0]).await?;
        for (n, &(address, bits)) in (1_u8..).zip(objects) {
            let entry = MappingEntry { address, bits };
            self.set(mapping(0, n), &entry.emit().to_le_bytes()).await?;
        }
        self.set(mapping(0, 0), &[count_u8(objects.len())]).await?;
        let every = Transmission::SyncCyclic(SyncCount::EVERY);
        self.set(record(0, 2), &[every.raw()]).await?;
        for setting in extras {
            keep(self, setting).await?;
        }
        self.cob(record(0, 1), IN_USE, cob.emit()).await
    }
}

/// Writes all settings of the node of `axis`.
pub(super) async fn node<B: Bus>(
    exchange: &Exchange<'_, B>,
    plan: &ArmPlan,
    axis: usize,
) -> Result<(), BringUpError> {
    let who = plan.who(axis);
    let to = Writer {
        exchange,
        line: who.line,
        node: who.node,
    };
    sync_objects(&to, plan).await?;
    watches(&to, plan).await?;
    hold(&to, plan, axis).await?;
    silence(&to).await?;
    let command = Cob::ReceivePdo(PdoNumber::FIRST, who.node).id();
    let answer = Cob::TransmitPdo(PdoNumber::FIRST, who.node).id();
    let cob = |id, rtr| PdoCob {
        id,
        valid: true,
        rtr,
    };
    to.pdo(
        index::rpdo,
        index::rpdo_mapping,
        cob(command, true),
        &[(index::CONTROL, 16), (index::TARGET, 32)],
        &[deadline(plan)],
    )
    .await?;
    to.pdo(
        index::tpdo,
        index::tpdo_mapping,
        cob(answer, false),
        &[
            (index::STATUS, 16),
            (index::POSITION, 32),
            (index::TORQUE, 16),
        ],
        // An answer is held up by nothing, comes with no event, and with the first SYNC.
        &[
            Setting::unsigned(index::tpdo(0, 3), 2, 0),
            Setting::unsigned(index::tpdo(0, 5), 2, 0),
            Setting::unsigned(index::tpdo(0, 6), 1, 0),
        ],
    )
    .await?;
    to.set(index::MODE, &Mode::CyclicPosition.raw().to_le_bytes())
        .await
}

/// All that a drive may have stored to be said or heard beside what the plan counts: PDOs, as a
/// second way to command it or as load on the bus, and time stamps. What is used is put into use
/// afterwards.
///
/// The first four PDOs are read one by one, the others up to the first that a node lacks, and so
/// for each logical device that it may have.
async fn silence<B: Bus>(to: &Writer<'_, '_, B>) -> Result<(), BringUpError> {
    for direction in [index::rpdo(0, 1), index::tpdo(0, 1)] {
        for device in 0..DEVICES_MAX {
            let first = direction.index + device * PDOS_A_DEVICE;
            for number in 0..PDOS_A_DEVICE {
                let there = to.switch_off(Address::new(first + number, 1)).await?;
                if !there && (device > 0 || number >= PDOS_NAMED) {
                    break;
                }
            }
        }
    }
    // The SYNC of another arm may have the identifier that time stamps have by default.
    to.bits(TIME_COB, PRODUCED | CONSUMED, 0).await.map(|_| ())
}

/// SYNC and interpolation.
async fn sync_objects<B: Bus>(to: &Writer<'_, '_, B>, plan: &ArmPlan) -> Result<(), BringUpError> {
    let cycle_ns = plan.cycle_ns;
    let (value, exponent) = period_parameter(cycle_ns).ok_or(BringUpError::Period { cycle_ns })?;
    // Whoever sends the SYNC may not change its identifier meanwhile.
    to.bits(index::SYNC_COB, PRODUCED, 0).await?;
    let cob = u32::from(plan.sync_id.raw());
    if plan.sync_id == SYNC_ID {
        to.set_if_there(index::SYNC_COB, &cob.to_le_bytes()).await?;
    } else {
        to.set(index::SYNC_COB, &cob.to_le_bytes()).await?;
    }
    // The counter may change only while there is no period.
    to.set_if_there(index::SYNC_PERIOD, &[0; 4]).await?;
    to.set_if_there(index::SYNC_COUNTER, &[plan.sync_counter])
        .await?;
    to.set(index::PERIOD_VALUE, &[value]).await?;
    to.set(index::PERIOD_EXPONENT, &exponent.to_le_bytes())
        .await
}

/// Heartbeats both ways.
async fn watches<B: Bus>(to: &Writer<'_, '_, B>, plan: &ArmPlan) -> Result<(), BringUpError> {
    to.set(index::HEARTBEAT, &plan.heartbeat_ms.to_le_bytes())
        .await?;
    let [low, high] = plan.heartbeat_ms.saturating_mul(3).to_le_bytes();
    to.set_if_there(index::CONSUMER, &[low, high, plan.master.raw(), 0])
        .await
}

/// The deadline of a set-point. Some drives take it only while the PDO is off.
fn deadline(plan: &ArmPlan) -> Setting {
    let deadline_ms = (DEADLINE_CYCLES * plan.cycle_ns / 1_000_000).max(DEADLINE_MS_MIN);
    Setting::unsigned(
        index::rpdo(0, 5),
        2,
        deadline_ms.min(u16::MAX.into()).cast_signed(),
    )
}
