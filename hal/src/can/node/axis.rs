//! What an axis is like: the numbers in which one emulated drive differs from another.

use crate::can::od::{Dictionary, index, table};

/// What one emulated axis is like. Counts are those of its encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisConfig {
    /// Serial number, 1018h:04.
    pub serial: u32,
    /// Vendor and product that it gives itself out for, 1018h:01 and :02.
    pub identity: (u32, u32),
    /// Least and greatest position, counts.
    pub range: (i32, i32),
    /// Greatest speed, counts/s.
    pub speed_max: u32,
    /// Deceleration of a ramp and of a quick stop, counts/s².
    pub decelerations: (u32, u32),
    /// Following error window, counts.
    pub following_window: u32,
}

impl Default for AxisConfig {
    /// An axis with the presets of the data sheet, and of 100 turns of 10 000 counts either way.
    fn default() -> Self {
        Self {
            serial: 0,
            identity: (0, table::PRODUCT_CODE),
            range: (-1_000_000, 1_000_000),
            speed_max: 1_000_000,
            decelerations: (10_000_000, 50_000_000),
            following_window: u32::MAX,
        }
    }
}

impl AxisConfig {
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
        let (ramp, quick) = config.decelerations;
        for (address, value) in [
            (index::DECELERATION, i64::from(ramp).max(1)),
            (index::QUICK_STOP_DECELERATION, i64::from(quick).max(1)),
        ] {
            // No gentler than a tenth, or a stop would take too long.
            dictionary.restrict(
                address,
                (value / 10).max(1),
                value.saturating_mul(10),
                value,
            );
        }
        let window = config.following_window.into();
        dictionary.restrict(index::FOLLOWING_WINDOW, 0, window, window);
    }
}
