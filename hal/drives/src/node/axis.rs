//! What an axis is like: the numbers in which one emulated drive differs from another.

use crate::dictionary::{Dictionary, table};
use trocar_canopen::index;
use trocar_canopen::master::plan::{AxisPlan, AxisSettings};
use trocar_canopen::number::turns_a_minute;

/// What one emulated axis is like. Counts are those of its encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisConfig {
    /// Serial number, 1018h:04.
    pub serial: u32,
    /// Vendor and product that it gives itself out for, 1018h:01 and :02.
    pub identity: (u32, u32),
    /// Counts a turn of the motor, 608Fh.
    pub counts_per_turn: u32,
    /// Least and greatest position, counts.
    ///
    /// 607Bh and, as preset and widest setting, 607Dh.
    pub range: (i32, i32),
    /// Greatest speed, counts/s, 607Fh. 6080h says the same in whole turns a minute, rounded up.
    ///
    /// 0 counts as 1.
    pub speed_max: u32,
    /// Deceleration of a ramp and of a quick stop, counts/s².
    ///
    /// 6084h and 6085h.
    pub decelerations: (u32, u32),
    /// Following error window, counts.
    ///
    /// Preset and greatest setting of 6065h; FFFF FFFFh for none.
    pub following_window: u32,
    /// Whether leaving operational for pre-operational counts as a lost connection, too. CiA 402-2
    /// has 6007h act when NMT stopped is entered, and says nothing of pre-operational.
    pub stops_in_pre_operational: bool,
}

impl Default for AxisConfig {
    /// An axis with the presets of the data sheet, and of 100 turns of 10 000 counts either way.
    fn default() -> Self {
        Self {
            serial: 0,
            identity: (0, table::PRODUCT_CODE),
            counts_per_turn: 10_000,
            range: (-1_000_000, 1_000_000),
            speed_max: 1_000_000,
            decelerations: (10_000_000, 50_000_000),
            following_window: u32::MAX,
            stops_in_pre_operational: true,
        }
    }
}

impl AxisConfig {
    /// A drive for the axis `plan`: one as bring-up would set it.
    #[must_use]
    pub fn of(plan: &AxisPlan, serial: u32) -> Self {
        let AxisSettings {
            range,
            speed_max,
            decelerations,
            following_window,
        } = plan.settings();
        Self {
            serial,
            identity: plan.identity,
            counts_per_turn: plan.counts_per_turn,
            range,
            speed_max,
            decelerations,
            following_window,
            ..Self::default()
        }
    }

    /// Makes these numbers the presets and the bounds of their objects.
    pub(super) fn apply(&self, dictionary: &mut Dictionary) {
        let config = self;
        let (low, high) = (config.range.0.into(), config.range.1.into());
        dictionary.restrict(index::VENDOR, 0, 0, config.identity.0.into());
        dictionary.restrict(index::PRODUCT, 0, 0, config.identity.1.into());
        dictionary.restrict(index::SERIAL, 0, 0, config.serial.into());
        dictionary.restrict(index::RANGE_MIN, low, low, low);
        dictionary.restrict(index::RANGE_MAX, high, high, high);
        dictionary.restrict(index::LIMIT_MIN, low, high, low);
        dictionary.restrict(index::LIMIT_MAX, low, high, high);
        let speed = i64::from(config.speed_max).max(1);
        dictionary.restrict(index::SPEED_MAX, 1, speed, speed);
        let counts = i64::from(config.counts_per_turn).max(1);
        dictionary.restrict(index::ENCODER_COUNTS, counts, counts, counts);
        let turns_min = turns_a_minute(config.speed_max, config.counts_per_turn);
        dictionary.restrict(index::MOTOR_SPEED_MAX, 1, turns_min, turns_min);
        self.apply_decelerations(dictionary);
        let window = config.following_window.into();
        dictionary.restrict(index::FOLLOWING_WINDOW, 0, window, window);
    }

    /// Presets and bounds of 6084h and 6085h, counts/s²: no gentler than a tenth, or a stop would
    /// take too long.
    fn apply_decelerations(&self, dictionary: &mut Dictionary) {
        let (ramp, quick) = self.decelerations;
        for (address, value) in [
            (index::DECELERATION, i64::from(ramp).max(1)),
            (index::QUICK_STOP_DECELERATION, i64::from(quick).max(1)),
        ] {
            let (low, high) = ((value / 10).max(1), value.saturating_mul(10));
            dictionary.restrict(address, low, high, value);
        }
    }
}
