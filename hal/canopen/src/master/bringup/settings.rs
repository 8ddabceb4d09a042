//! What of a drive the safety of an arm depends on: the values that are written, and those that are
//! accepted.
//!
//! A drive may have stored anything. Where it refuses a value, or keeps another one, what it has
//! must be as safe; else there is no arm. Objects that CiA 402 leaves to the drive may be missing.
//! Speeds and decelerations are in counts here, as the user-defined units of CiA 402 are if nothing
//! else is defined; only 6080h is in turns of the motor a minute.

use super::super::link::Bus;
use super::super::plan::{ArmPlan, AxisPlan};
use super::BringUpError;
use super::writer::{INVALID, Writer, is_missing};
use crate::cia301::{AbortCode, Address, Cob};
use crate::index;

/// Abort connection: quick stop.
const QUICK_STOP: i64 = 3;
/// Shutdown, disabling: ramp first.
const RAMP: i64 = 1;
/// Quick stop, fault reaction: fast ramp, then no voltage. A drive whose master is dead must not
/// hold on for good.
const FAST_RAMP: i64 = 2;
/// How long the following error window may be left, ms.
const FOLLOWING_MS: i64 = 10;
/// The rated torque, per mille.
const TORQUE_MAX: i64 = 1000;
/// How much harder than planned a drive may brake.
const HARDER_MAX: i64 = 10;
/// What our own drives do without: direction, offsets of speed and torque.
const POLARITY: Address = Address::new(0x607E, 0);
const VELOCITY_OFFSET: Address = Address::new(0x60B1, 0);
const TORQUE_OFFSET: Address = Address::new(0x60B2, 0);

/// An object, the value that it is given, and what else it may be.
pub(super) struct Setting {
    address: Address,
    /// Bytes of the object, and whether it has a sign.
    bytes: usize,
    signed: bool,
    wanted: i64,
    allowed: (i64, i64),
}

impl Setting {
    const fn signed(address: Address, bytes: usize, value: i64) -> Self {
        Self {
            address,
            bytes,
            signed: true,
            wanted: value,
            allowed: (value, value),
        }
    }

    pub(super) const fn unsigned(address: Address, bytes: usize, value: i64) -> Self {
        Self {
            signed: false,
            ..Self::signed(address, bytes, value)
        }
    }

    const fn allowed(self, least: i64, most: i64) -> Self {
        Self {
            allowed: (least, most),
            ..self
        }
    }

    fn number(&self, data: &[u8]) -> Option<i64> {
        if data.len() != self.bytes {
            return None;
        }
        let negative = self.signed && data.last().is_some_and(|byte| *byte >= 0x80);
        let mut all = [if negative { 0xFF } else { 0 }; 8];
        all[..data.len()].copy_from_slice(data);
        Some(i64::from_le_bytes(all))
    }
}

/// Gives the drive of `axis` everything that is not communication.
pub(super) async fn hold<B: Bus>(
    to: &Writer<'_, '_, B>,
    plan: &ArmPlan,
    axis: usize,
) -> Result<(), BringUpError> {
    emergencies(to, plan.cycle_ns).await?;
    encoder(to, &plan.axes[axis]).await?;
    let limits = limits(&plan.axes[axis]);
    // Of two limits the lower one can't be above the upper one, whatever is written first.
    let [_, upper, ..] = &limits;
    to.try_put(upper.address, &upper.wanted.to_le_bytes()[..upper.bytes])
        .await?;
    for setting in options().iter().chain(&limits) {
        keep(to, setting).await?;
    }
    Ok(())
}

/// How it stops, and that nothing shifts or reverses its set-points.
const fn options() -> [Setting; 9] {
    [
        Setting::signed(index::ABORT_OPTION, 2, QUICK_STOP),
        Setting::signed(index::QUICK_STOP_OPTION, 2, FAST_RAMP),
        Setting::signed(index::SHUTDOWN_OPTION, 2, RAMP),
        Setting::signed(index::DISABLE_OPTION, 2, RAMP),
        Setting::signed(index::FAULT_OPTION, 2, FAST_RAMP),
        Setting::signed(index::POSITION_OFFSET, 4, 0),
        Setting::signed(VELOCITY_OFFSET, 4, 0),
        Setting::signed(TORQUE_OFFSET, 2, 0),
        Setting::unsigned(POLARITY, 1, 0),
    ]
}

/// How far, how fast, how strongly, and how hard it brakes.
fn limits(plan: &AxisPlan) -> [Setting; 9] {
    let (turns_min, turns_max) = plan.turns_min();
    let drive = plan.settings();
    let (low, high) = drive.range;
    let (low, high) = (i64::from(low), i64::from(high));
    let speed = i64::from(drive.speed_max);
    let slowest = i64::from(plan.speed_counts());
    let (ramp, quick) = drive.decelerations;
    let (ramp, quick) = (i64::from(ramp), i64::from(quick));
    let window = i64::from(drive.following_window);
    [
        Setting::signed(index::LIMIT_MIN, 4, low),
        Setting::signed(index::LIMIT_MAX, 4, high),
        Setting::unsigned(index::SPEED_MAX, 4, speed).allowed(slowest, speed),
        Setting::unsigned(index::MOTOR_SPEED_MAX, 4, turns_max).allowed(turns_min, turns_max),
        Setting::unsigned(index::DECELERATION, 4, ramp).allowed(ramp, HARDER_MAX * ramp),
        Setting::unsigned(index::QUICK_STOP_DECELERATION, 4, quick)
            .allowed(quick, HARDER_MAX * quick),
        Setting::unsigned(index::TORQUE_MAX, 2, TORQUE_MAX).allowed(1, TORQUE_MAX),
        Setting::unsigned(index::FOLLOWING_WINDOW, 4, window).allowed(0, window),
        Setting::unsigned(index::FOLLOWING_TIME, 2, FOLLOWING_MS).allowed(0, FOLLOWING_MS),
    ]
}

/// Compares the counts of a motor turn, if the drive says so many: by them turns become counts, and
/// a drive that counts otherwise would go to another place.
async fn encoder<B: Bus>(to: &Writer<'_, '_, B>, plan: &AxisPlan) -> Result<(), BringUpError> {
    let node = to.node;
    let ask = async |address| match to.read_number(address).await {
        Ok(number) => Ok(Some(i64::from(number))),
        Err(BringUpError::Refused { code, .. }) if is_missing(code) => Ok(None),
        Err(error) => Err(error),
    };
    let Some(found) = ask(index::ENCODER_COUNTS).await? else {
        return Ok(());
    };
    let turns = ask(index::ENCODER_TURNS).await?.unwrap_or(1);
    let outside = |address, found, least, most| BringUpError::Setting {
        node,
        address,
        found,
        least,
        most,
    };
    // Of more turns than that the counts would not fit into their object.
    let counts = i64::from(plan.counts_per_turn);
    let turns_max = i64::from(u32::MAX).checked_div(counts).unwrap_or(0);
    let wanted = turns
        .checked_mul(counts)
        .filter(|_| (1..=turns_max).contains(&turns))
        .ok_or_else(|| outside(index::ENCODER_TURNS, turns, 1, turns_max))?;
    if found == wanted {
        Ok(())
    } else {
        Err(outside(index::ENCODER_COUNTS, found, wanted, wanted))
    }
}

/// Writes the wanted value or, if the drive refuses it, the other end of the allowed range, and
/// reads it back.
pub(super) async fn keep<B: Bus>(
    to: &Writer<'_, '_, B>,
    setting: &Setting,
) -> Result<(), BringUpError> {
    let Setting {
        address,
        bytes,
        allowed: (least, most),
        ..
    } = *setting;
    let node = to.node;
    let other = if setting.wanted == least { most } else { least };
    let mut found = setting.wanted;
    for value in [setting.wanted, other] {
        if !to.try_put(address, &value.to_le_bytes()[..bytes]).await? {
            return Ok(());
        }
        let data = to.read(address).await?;
        found = setting
            .number(data.as_slice())
            .ok_or(BringUpError::Confused { node, address })?;
        if (least..=most).contains(&found) {
            return Ok(());
        }
    }
    Err(BringUpError::Setting {
        node,
        address,
        found,
        least,
        most,
    })
}

/// Emergencies come under the identifier that CiA 301 gives them, or the master would not receive
/// them, and at once: no later than a cycle after the one before.
async fn emergencies<B: Bus>(to: &Writer<'_, '_, B>, cycle_ns: u64) -> Result<(), BringUpError> {
    let address = index::EMERGENCY_COB;
    let wanted = i64::from(Cob::Emergency(to.node).id().raw());
    let setting = Setting::unsigned(address, 4, wanted);
    match to.read(address).await {
        Ok(found) if setting.number(found.as_slice()) == Some(wanted) => {}
        // It may change only while it is not in use.
        Ok(found) => {
            let old = found.as_slice().try_into().map_or(0, u32::from_le_bytes);
            to.try_put(address, &(old | INVALID).to_le_bytes()).await?;
            keep(to, &setting).await?;
        }
        // Where it cannot be set, it is as CiA 301 has it. No other refusal says so.
        Err(BringUpError::Refused { code, .. })
            if code == AbortCode::NO_OBJECT || code == AbortCode::NO_DATA => {}
        Err(error) => return Err(error),
    }
    let cycle_100_us = (cycle_ns / 100_000).cast_signed();
    keep(
        to,
        &Setting::unsigned(index::EMERGENCY_INHIBIT, 2, 0).allowed(0, cycle_100_us),
    )
    .await
}
