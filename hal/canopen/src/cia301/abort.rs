//! Why a transfer of the object dictionary was aborted.
//!
//! CiA 301, table 22 (section 7.2.4.3.17).

use core::fmt;

use super::codes::codes;

/// An abort code. Codes that the table lacks are allowed: devices have some of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AbortCode(pub u32);

codes! {
    AbortCode;
    /// Two segments in a row with the same toggle bit.
    TOGGLE = 0x0503_0000, "toggle bit not alternated";
    /// The other side said nothing for too long.
    TIMEOUT = 0x0504_0000, "SDO protocol timed out";
    /// No such command, or not now.
    COMMAND = 0x0504_0001, "command specifier not valid or unknown";
    /// Out of memory.
    MEMORY = 0x0504_0005, "out of memory";
    /// The object knows no such access.
    ACCESS = 0x0601_0000, "unsupported access to an object";
    /// Cannot be read.
    WRITE_ONLY = 0x0601_0001, "attempt to read a write-only object";
    /// Cannot be written.
    READ_ONLY = 0x0601_0002, "attempt to write a read-only object";
    /// No such index.
    NO_OBJECT = 0x0602_0000, "object does not exist";
    /// Cannot be process data.
    NOT_MAPPABLE = 0x0604_0041, "object cannot be mapped to the PDO";
    /// More than 64 bits.
    MAPPING_LENGTH = 0x0604_0042, "mapped objects exceed the PDO's length";
    /// Does not go with another parameter.
    INCOMPATIBLE = 0x0604_0043, "general parameter incompatibility";
    /// Does not go with the device.
    INTERNAL_INCOMPATIBLE = 0x0604_0047, "general internal incompatibility";
    /// The hardware failed.
    HARDWARE = 0x0606_0000, "access failed due to a hardware error";
    /// Another length than the object's.
    LENGTH = 0x0607_0010, "data type or length does not match";
    /// Longer than the object.
    TOO_LONG = 0x0607_0012, "length too high";
    /// Shorter than the object.
    TOO_SHORT = 0x0607_0013, "length too low";
    /// No such sub-index.
    NO_SUB_INDEX = 0x0609_0011, "sub-index does not exist";
    /// Not one of the values that the object may have.
    VALUE = 0x0609_0030, "invalid value";
    /// Above the greatest value.
    TOO_HIGH = 0x0609_0031, "value too high";
    /// Below the least value.
    TOO_LOW = 0x0609_0032, "value too low";
    /// Greatest below least.
    MAX_BELOW_MIN = 0x0609_0036, "maximum below minimum";
    /// No such connection.
    RESOURCE = 0x060A_0023, "resource not available";
    /// Something.
    GENERAL = 0x0800_0000, "general error";
    /// Cannot be stored.
    CANNOT_STORE = 0x0800_0020, "data cannot be transferred or stored";
    /// The device is under local control.
    LOCAL_CONTROL = 0x0800_0021, "data cannot be stored because of local control";
    /// Not in the state that the device is in.
    DEVICE_STATE = 0x0800_0022, "data cannot be stored in the present device state";
    /// No dictionary.
    NO_DICTIONARY = 0x0800_0023, "no object dictionary";
    /// Nothing to read.
    NO_DATA = 0x0800_0024, "no data available";
}

impl fmt::Display for AbortCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.text().unwrap_or("a code of the device's own");
        write!(f, "{:#010x}, {text}", self.0)
    }
}
