//! The objects of the emulated drive.
//!
//! CiA 301, table 47 ff. (1000h to 1FFFh) and CiA 402-2, table 6 ff. (6000h to 67FFh). What has no
//! effect in this drive is not in the table.

mod communication;
mod drive;

use super::object::Access::Constant;
use super::object::DataType::{Text, U8};
use super::object::{Access, DataType, Entry, Object, Preset, Shape};
use trocar_canopen::cia301::Address;

/// PDOs in each direction.
pub const PDO_COUNT: u8 = 4;
/// Objects that fit into a PDO: bytes.
pub const MAPPED_MAX: u8 = 8;
/// Errors that the history keeps.
pub const HISTORY_LENGTH: u8 = 8;
/// Heartbeats that a node can watch.
pub const CONSUMER_COUNT: u8 = 4;
/// Homing methods: the present position is the reference; the negative limit switch, the positive
/// one.
pub const HOMING_METHODS: [i64; 4] = [37, 35, 17, 18];
/// Product code of the emulated drive: "TROC".
pub const PRODUCT_CODE: u32 = 0x5452_4F43;
/// Its revision.
pub const REVISION: u32 = 0x0001_0000;

/// A servo drive of the device profile 402.
///
/// Low word 0192h, the profile 402; high word 0002h, a servo drive.
const DEVICE_TYPE: i64 = 0x0002_0192;

/// All objects, by index.
#[must_use]
pub fn objects() -> Vec<Object> {
    let mut all = communication::objects();
    all.extend(drive::objects());
    all
}

/// Sub-index 0 of an object that has only that one.
fn variable(index: u16, name: &str, kind: DataType, access: Access, preset: i64) -> Entry {
    Entry::new(Address::new(index, 0), name, kind, access, preset)
}

/// The object of a single entry.
fn alone(entry: Entry) -> Object {
    Object {
        index: entry.address.index,
        name: entry.name.clone(),
        shape: Shape::Variable,
        entries: vec![entry],
    }
}

/// An object with sub-indices; sub-index 0 says which is the last.
fn several(index: u16, name: &str, shape: Shape, subs: Vec<Entry>) -> Object {
    let last = subs.last().map_or(0, |entry| i64::from(entry.address.sub));
    let mut entries = vec![variable(
        index,
        "Highest sub-index supported",
        U8,
        Constant,
        last,
    )];
    entries.extend(subs);
    Object {
        index,
        name: name.to_owned(),
        shape,
        entries,
    }
}

/// A sub-index of an array or a record.
fn sub(index: u16, sub: u8, name: &str, kind: DataType, access: Access, preset: i64) -> Entry {
    Entry::new(Address::new(index, sub), name, kind, access, preset)
}

/// A visible string.
fn text(index: u16, name: &str, access: Access, text: &'static str) -> Object {
    alone(variable(index, name, Text, access, 0).preset(Preset::Text(text)))
}
