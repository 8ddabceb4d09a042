//! Addresses of the objects that a node or its master uses, under the names of the standards.

use crate::cia301::Address;

/// Addresses with their names.
macro_rules! addresses {
    ($($(#[$doc:meta])* $name:ident = $index:literal, $sub:literal;)*) => {
        $($(#[$doc])* pub const $name: Address = Address::new($index, $sub);)*

        /// All of the above.
        pub const ALL: &[Address] = &[$($name),*];
    };
}

addresses! {
    /// Device type.
    DEVICE_TYPE = 0x1000, 0;
    /// Error register.
    ERROR_REGISTER = 0x1001, 0;
    /// Number of errors in the history.
    ERROR_COUNT = 0x1003, 0;
    /// COB-ID of the SYNC.
    SYNC_COB = 0x1005, 0;
    /// Period of the SYNC, us.
    SYNC_PERIOD = 0x1006, 0;
    /// "save" stores what was written.
    STORE = 0x1010, 1;
    /// "load" brings back what was shipped.
    RESTORE = 0x1011, 1;
    /// COB-ID of emergencies.
    EMERGENCY_COB = 0x1014, 0;
    /// Least time between emergencies, 100 us.
    EMERGENCY_INHIBIT = 0x1015, 0;
    /// First heartbeat to watch: node and time, ms.
    CONSUMER = 0x1016, 1;
    /// Period of the own heartbeat, ms.
    HEARTBEAT = 0x1017, 0;
    /// Vendor.
    VENDOR = 0x1018, 1;
    /// Product.
    PRODUCT = 0x1018, 2;
    /// Revision.
    REVISION = 0x1018, 3;
    /// Serial number.
    SERIAL = 0x1018, 4;
    /// Greatest value of the SYNC's counter.
    SYNC_COUNTER = 0x1019, 0;
    /// NMT state to take after a communication error.
    ERROR_BEHAVIOUR = 0x1029, 1;
    /// SYNC periods without a SYNC after which the drive stops. Vendor's own.
    SYNC_LOSS = 0x2000, 0;
    /// What the axis is called. Vendor's own.
    LABEL = 0x2001, 0;
    /// What the drive does when it loses its master.
    ABORT_OPTION = 0x6007, 0;
    /// Code of the newest fault.
    ERROR_CODE = 0x603F, 0;
    /// Control word.
    CONTROL = 0x6040, 0;
    /// Status word.
    STATUS = 0x6041, 0;
    /// How to stop quickly, and what then.
    QUICK_STOP_OPTION = 0x605A, 0;
    /// How to get from enabled to ready.
    SHUTDOWN_OPTION = 0x605B, 0;
    /// How to get from enabled to switched on.
    DISABLE_OPTION = 0x605C, 0;
    /// How to halt.
    HALT_OPTION = 0x605D, 0;
    /// How to stop at a fault.
    FAULT_OPTION = 0x605E, 0;
    /// Commanded mode of operation.
    MODE = 0x6060, 0;
    /// Mode of operation taken.
    MODE_DISPLAY = 0x6061, 0;
    /// Position demand, counts.
    POSITION_DEMAND = 0x6062, 0;
    /// Actual position, counts.
    POSITION = 0x6064, 0;
    /// Following error window, counts.
    FOLLOWING_WINDOW = 0x6065, 0;
    /// How long it may be left, ms.
    FOLLOWING_TIME = 0x6066, 0;
    /// Actual velocity, counts/s.
    VELOCITY = 0x606C, 0;
    /// Greatest torque, per mille of the rated one.
    TORQUE_MAX = 0x6072, 0;
    /// Actual torque, per mille of the rated one.
    TORQUE = 0x6077, 0;
    /// Target position, counts.
    TARGET = 0x607A, 0;
    /// Least position that the axis can have, counts.
    RANGE_MIN = 0x607B, 1;
    /// Greatest position that the axis can have, counts.
    RANGE_MAX = 0x607B, 2;
    /// Position that the reference has, counts.
    HOME_OFFSET = 0x607C, 0;
    /// Least position to go to, counts.
    LIMIT_MIN = 0x607D, 1;
    /// Greatest position to go to, counts.
    LIMIT_MAX = 0x607D, 2;
    /// Greatest speed, counts/s.
    SPEED_MAX = 0x607F, 0;
    /// Greatest speed of the motor, turns a minute.
    MOTOR_SPEED_MAX = 0x6080, 0;
    /// Deceleration of a ramp, counts/s^2.
    DECELERATION = 0x6084, 0;
    /// Deceleration of a quick stop, counts/s^2.
    QUICK_STOP_DECELERATION = 0x6085, 0;
    /// Counts of the encoder in so many turns of the motor.
    ENCODER_COUNTS = 0x608F, 1;
    /// How many turns these are.
    ENCODER_TURNS = 0x608F, 2;
    /// How to find the reference.
    HOMING_METHOD = 0x6098, 0;
    /// Homing speed towards the switch, counts/s.
    HOMING_SWITCH_SPEED = 0x6099, 1;
    /// Homing speed at which the home point is found, counts/s.
    HOMING_ZERO_SPEED = 0x6099, 2;
    /// Homing acceleration, counts/s^2.
    HOMING_ACCELERATION = 0x609A, 0;
    /// Added to the target position, counts.
    POSITION_OFFSET = 0x60B0, 0;
    /// Interpolation period: value.
    PERIOD_VALUE = 0x60C2, 1;
    /// Interpolation period: power of ten, s.
    PERIOD_EXPONENT = 0x60C2, 2;
    /// How many homing methods the drive offers; sub-index 1 is the first one.
    HOMING_METHOD_COUNT = 0x60E3, 0;
    /// Following error, counts.
    FOLLOWING_ERROR = 0x60F4, 0;
    /// Limit switches.
    INPUTS = 0x60FD, 0;
    /// Modes of operation that there are.
    SUPPORTED_MODES = 0x6502, 0;
}

/// Communication record of the RPDO `number` from 0.
#[must_use]
pub const fn rpdo(number: u8, sub: u8) -> Address {
    Address::new(0x1400 + number as u16, sub)
}

/// Mapping record of the RPDO `number` from 0.
#[must_use]
pub const fn rpdo_mapping(number: u8, sub: u8) -> Address {
    Address::new(0x1600 + number as u16, sub)
}

/// Communication record of the TPDO `number` from 0.
#[must_use]
pub const fn tpdo(number: u8, sub: u8) -> Address {
    Address::new(0x1800 + number as u16, sub)
}

/// Mapping record of the TPDO `number` from 0.
#[must_use]
pub const fn tpdo_mapping(number: u8, sub: u8) -> Address {
    Address::new(0x1A00 + number as u16, sub)
}
