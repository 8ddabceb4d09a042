//! 1000h to 1FFFh: the communication profile's objects.
//!
//! Presets as CiA 301 has them: the first PDO of each direction is in use under 180h and 200h plus
//! the node's number, the others are there with bit 31 set. No SDO client, no sync producer, no
//! LSS.

use super::super::object::Access::{Constant, ReadOnly, ReadWrite};
use super::super::object::DataType::{U8, U16, U32};
use super::super::object::{Mapping, Object, Preset, Shape};
use super::{
    CONSUMER_COUNT, DEVICE_TYPE, HISTORY_LENGTH, MAPPED_MAX, PDO_COUNT, PRODUCT_CODE, REVISION,
    alone, several, sub, text, variable,
};
use hal::count::count_u8;
use trocar_canopen::cia301::Address;
use trocar_canopen::cia301::pdo::MappingEntry;

/// Bit 31 of a COB-ID: the PDO is not in use.
const INVALID: i64 = 0x8000_0000;
/// Bit 30 of a TPDO's COB-ID: no remote frames.
const NO_RTR: i64 = 0x4000_0000;

/// All of them, by index.
pub(super) fn objects() -> Vec<Object> {
    let mut all = device();
    all.extend(network());
    all.extend((0..PDO_COUNT).map(rpdo));
    all.extend((0..PDO_COUNT).map(|number| mapping(0x1600, "RPDO", number)));
    all.extend((0..PDO_COUNT).map(tpdo));
    all.extend((0..PDO_COUNT).map(|number| mapping(0x1A00, "TPDO", number)));
    all
}

/// 1000h to 1011h: what the device is, SYNC, and stored values.
///
/// 1010h:01 and 1011h:01 read 1: the device stores and restores on command alone.
fn device() -> Vec<Object> {
    vec![
        alone(variable(0x1000, "Device type", U32, Constant, DEVICE_TYPE)),
        alone(variable(0x1001, "Error register", U8, ReadOnly, 0).mapped(Mapping::Transmit)),
        history(),
        alone(variable(
            0x1005,
            "COB-ID SYNC message",
            U32,
            ReadWrite,
            0x80,
        )),
        alone(variable(
            0x1006,
            "Communication cycle period",
            U32,
            ReadWrite,
            0,
        )),
        text(
            0x1008,
            "Manufacturer device name",
            Constant,
            "Trocar emulated drive",
        ),
        text(0x1009, "Manufacturer hardware version", Constant, "none"),
        text(0x100A, "Manufacturer software version", Constant, "1"),
        several(
            0x1010,
            "Store parameters",
            Shape::Array,
            vec![sub(0x1010, 1, "Save all parameters", U32, ReadWrite, 1)],
        ),
        several(
            0x1011,
            "Restore default parameters",
            Shape::Array,
            vec![sub(
                0x1011,
                1,
                "Restore all default parameters",
                U32,
                ReadWrite,
                1,
            )],
        ),
    ]
}

/// 1014h to 1200h: emergencies, heartbeats, identity, the dictionary's server.
///
/// Times are ms in 1016h and 1017h, 100 µs in 1015h.
fn network() -> Vec<Object> {
    vec![
        alone(
            variable(0x1014, "COB-ID emergency message", U32, ReadWrite, 0)
                .preset(Preset::PerNode(0x80)),
        ),
        alone(variable(
            0x1015,
            "Inhibit time emergency",
            U16,
            ReadWrite,
            0,
        )),
        several(
            0x1016,
            "Consumer heartbeat time",
            Shape::Array,
            (1..=CONSUMER_COUNT)
                .map(|n| {
                    let name = format!("Consumer heartbeat time {n}");
                    sub(0x1016, n, &name, U32, ReadWrite, 0).range(0, 0x007F_FFFF)
                })
                .collect(),
        ),
        alone(variable(
            0x1017,
            "Producer heartbeat time",
            U16,
            ReadWrite,
            0,
        )),
        identity(),
        alone(
            variable(
                0x1019,
                "Synchronous counter overflow value",
                U8,
                ReadWrite,
                0,
            )
            .range(0, 240),
        ),
        several(
            0x1029,
            "Error behaviour object",
            Shape::Array,
            vec![sub(0x1029, 1, "Communication error", U8, ReadWrite, 0).range(0, 2)],
        ),
        server(),
    ]
}

/// 1018h: vendor, product, revision and serial number.
fn identity() -> Object {
    several(
        0x1018,
        "Identity object",
        Shape::Record,
        vec![
            sub(0x1018, 1, "Vendor-ID", U32, Constant, 0),
            sub(
                0x1018,
                2,
                "Product code",
                U32,
                Constant,
                PRODUCT_CODE.into(),
            ),
            sub(0x1018, 3, "Revision number", U32, Constant, REVISION.into()),
            sub(0x1018, 4, "Serial number", U32, Constant, 0),
        ],
    )
}

/// 1200h: the COB-IDs of the SDO server.
fn server() -> Object {
    several(
        0x1200,
        "SDO server parameter",
        Shape::Record,
        vec![
            sub(0x1200, 1, "COB-ID client to server", U32, ReadOnly, 0)
                .preset(Preset::PerNode(0x600)),
            sub(0x1200, 2, "COB-ID server to client", U32, ReadOnly, 0)
                .preset(Preset::PerNode(0x580)),
        ],
    )
}

/// 1003h: the newest error first.
fn history() -> Object {
    let mut object = several(
        0x1003,
        "Pre-defined error field",
        Shape::Array,
        (1..=HISTORY_LENGTH)
            .map(|n| {
                sub(
                    0x1003,
                    n,
                    &format!("Standard error field {n}"),
                    U32,
                    ReadOnly,
                    0,
                )
            })
            .collect(),
    );
    // Writing 0 clears the history; the node counts.
    object.entries[0] = variable(0x1003, "Number of errors", U8, ReadWrite, 0);
    object
}

/// 1400h and after: communication parameters of an RPDO.
///
/// Preset to type 255, event-driven by the profile. Sub-index 5 is the deadline, ms.
fn rpdo(number: u8) -> Object {
    let index = 0x1400 + u16::from(number);
    let valid = if number == 0 { 0 } else { INVALID };
    let base = 0x200 + 0x100 * i64::from(number) + valid;
    several(
        index,
        &format!("RPDO{} communication parameter", number + 1),
        Shape::Record,
        vec![
            sub(index, 1, "COB-ID", U32, ReadWrite, 0).preset(Preset::PerNode(base)),
            sub(index, 2, "Transmission type", U8, ReadWrite, 255),
            sub(index, 5, "Event timer", U16, ReadWrite, 0),
        ],
    )
}

/// 1800h and after: communication parameters of a TPDO.
fn tpdo(number: u8) -> Object {
    let index = 0x1800 + u16::from(number);
    let valid = if number == 0 { 0 } else { INVALID };
    let base = 0x180 + 0x100 * i64::from(number) + valid + NO_RTR;
    several(
        index,
        &format!("TPDO{} communication parameter", number + 1),
        Shape::Record,
        vec![
            sub(index, 1, "COB-ID", U32, ReadWrite, 0).preset(Preset::PerNode(base)),
            sub(index, 2, "Transmission type", U8, ReadWrite, 255),
            sub(index, 3, "Inhibit time", U16, ReadWrite, 0),
            sub(index, 5, "Event timer", U16, ReadWrite, 0),
            sub(index, 6, "SYNC start value", U8, ReadWrite, 0).range(0, 240),
        ],
    )
}

/// What the PDOs hold after power-on, as the device profile has it.
fn mapped_by_default(direction: &str, number: u8) -> &'static [(u16, u8)] {
    match (direction, number) {
        ("RPDO", 0) => &[(0x6040, 16)],
        ("RPDO", 1) => &[(0x6040, 16), (0x6060, 8)],
        ("RPDO", 2) => &[(0x6040, 16), (0x607A, 32)],
        ("TPDO", 0) => &[(0x6041, 16)],
        ("TPDO", 1) => &[(0x6041, 16), (0x6061, 8)],
        ("TPDO", 2) => &[(0x6041, 16), (0x6064, 32)],
        ("TPDO", 3) => &[(0x6041, 16), (0x606C, 32)],
        _ => &[],
    }
}

/// 1600h or 1A00h and after: what a PDO carries, 64 bits at most.
fn mapping(base: u16, direction: &str, number: u8) -> Object {
    let index = base + u16::from(number);
    let preset = mapped_by_default(direction, number);
    let entries = (1..=MAPPED_MAX).map(|n| {
        let raw = preset.get(usize::from(n - 1)).map_or(0, |&(mapped, bits)| {
            let address = Address::new(mapped, 0);
            MappingEntry { address, bits }.emit()
        });
        let name = format!("Application object {n}");
        sub(index, n, &name, U32, ReadWrite, raw.into())
    });
    let mut object = several(
        index,
        &format!("{direction}{} mapping parameter", number + 1),
        Shape::Record,
        entries.collect(),
    );
    let count = count_u8(preset.len()).into();
    object.entries[0] = variable(index, "Number of mapped objects", U8, ReadWrite, count)
        .range(0, MAPPED_MAX.into());
    object
}
