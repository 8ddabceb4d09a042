//! 2000h to 67FFh: the vendor's objects and those of the device profile.
//!
//! Presets are those of a small axis; `AxisConfig::apply` narrows them to the axis at hand. All
//! option codes are within what the drive can do, so a master that asks for another stop is told by
//! an abort.

use super::super::object::Access::{Constant, ReadOnly, ReadWrite};
use super::super::object::DataType::{I8, I16, I32, U8, U16, U32};
use super::super::object::{Access, DataType, Mapping, Object, Shape};
use super::{DEVICE_TYPE, HOMING_METHODS, alone, several, sub, text, variable};
use trocar_canopen::cia402::Mode;

/// All of them, by index.
pub(super) fn objects() -> Vec<Object> {
    let mut all = vendor();
    all.extend(options());
    all.extend(motion());
    all.extend(homing());
    all.extend(profile());
    all
}

/// 2000h: how many interpolation periods (60C2h) may pass without a SYNC before the axis stops.
/// 2001h: a label that a master writes, for people.
fn vendor() -> Vec<Object> {
    vec![
        alone(variable(0x2000, "SYNC loss limit", U8, ReadWrite, 10).range(2, 100)),
        text(0x2001, "Axis label", ReadWrite, "axis"),
    ]
}

/// 605Ah to 605Eh and 6007h: how the drive stops, by cause.
///
/// 603Fh, 6040h, 6041h, 6060h and 6061h are among them by index. Presets: quick stop on a lost
/// master, a ramp on disable operation, the quick ramp on a quick stop and a fault, coasting on
/// shutdown.
fn options() -> Vec<Object> {
    vec![
        alone(variable(0x6007, "Abort connection option code", I16, ReadWrite, 3).range(0, 3)),
        alone(variable(0x603F, "Error code", U16, ReadOnly, 0).mapped(Mapping::Transmit)),
        alone(variable(0x6040, "Controlword", U16, ReadWrite, 0).mapped(Mapping::Receive)),
        alone(variable(0x6041, "Statusword", U16, ReadOnly, 0).mapped(Mapping::Transmit)),
        alone(variable(0x605A, "Quick stop option code", I16, ReadWrite, 2).range(0, 6)),
        alone(variable(0x605B, "Shutdown option code", I16, ReadWrite, 0).range(0, 1)),
        alone(variable(0x605C, "Disable operation option code", I16, ReadWrite, 1).range(0, 1)),
        alone(variable(0x605D, "Halt option code", I16, ReadWrite, 1).range(1, 2)),
        alone(variable(0x605E, "Fault reaction option code", I16, ReadWrite, 2).range(0, 2)),
        alone(variable(0x6060, "Modes of operation", I8, ReadWrite, 0).mapped(Mapping::Receive)),
        alone(
            variable(0x6061, "Modes of operation display", I8, ReadOnly, 0)
                .mapped(Mapping::Transmit),
        ),
    ]
}

/// A value that the drive reports, and that a TPDO may carry.
fn sent(index: u16, name: &str, kind: DataType) -> Object {
    alone(variable(index, name, kind, ReadOnly, 0).mapped(Mapping::Transmit))
}

/// A value that the master writes.
fn set(index: u16, name: &str, kind: DataType, preset: i64) -> Object {
    alone(variable(index, name, kind, ReadWrite, preset))
}

/// A lower and an upper limit.
fn pair(index: u16, name: &str, access: Access) -> Object {
    let subs = vec![
        sub(index, 1, "Minimum", I32, access, -0x8000_0000),
        sub(index, 2, "Maximum", I32, access, 0x7FFF_FFFF),
    ];
    several(index, name, Shape::Array, subs)
}

/// 6062h to 608Fh: positions, limits and decelerations. Positions are counts of the encoder; speeds
/// are counts/s and decelerations counts/s², but for 6080h, which is in turns of the motor a
/// minute.
fn motion() -> Vec<Object> {
    vec![
        sent(0x6062, "Position demand value", I32),
        sent(0x6064, "Position actual value", I32),
        set(0x6065, "Following error window", U32, 0xFFFF_FFFF),
        set(0x6066, "Following error time out", U16, 10),
        sent(0x606C, "Velocity actual value", I32),
        alone(variable(0x6072, "Max torque", U16, ReadWrite, 1000).range(0, 3000)),
        sent(0x6077, "Torque actual value", I16),
        alone(variable(0x607A, "Target position", I32, ReadWrite, 0).mapped(Mapping::Receive)),
        pair(0x607B, "Position range limit", ReadOnly),
        set(0x607C, "Home offset", I32, 0),
        pair(0x607D, "Software position limit", ReadWrite),
        alone(
            variable(0x607F, "Max profile velocity", U32, ReadWrite, 1_000_000)
                .range(1, 0xFFFF_FFFF),
        ),
        alone(variable(0x6080, "Max motor speed", U32, ReadWrite, 6000).range(1, 0xFFFF_FFFF)),
        alone(
            variable(0x6084, "Profile deceleration", U32, ReadWrite, 10_000_000)
                .range(1, 0xFFFF_FFFF),
        ),
        alone(
            variable(
                0x6085,
                "Quick stop deceleration",
                U32,
                ReadWrite,
                50_000_000,
            )
            .range(1, 0xFFFF_FFFF),
        ),
        several(
            0x608F,
            "Position encoder resolution",
            Shape::Array,
            vec![
                sub(0x608F, 1, "Encoder increments", U32, ReadOnly, 10_000),
                sub(0x608F, 2, "Motor revolutions", U32, Constant, 1),
            ],
        ),
    ]
}

/// 6098h to 609Ah: homing.
///
/// 6098h is preset to 37, which takes the present position for home; speeds are counts/s, the
/// acceleration counts/s².
fn homing() -> Vec<Object> {
    vec![
        set(0x6098, "Homing method", I8, 37),
        several(
            0x6099,
            "Homing speeds",
            Shape::Array,
            vec![
                sub(
                    0x6099,
                    1,
                    "Speed during search for switch",
                    U32,
                    ReadWrite,
                    10_000,
                )
                .range(1, 0xFFFF_FFFF),
                sub(
                    0x6099,
                    2,
                    "Speed during search for zero",
                    U32,
                    ReadWrite,
                    1_000,
                )
                .range(1, 0xFFFF_FFFF),
            ],
        ),
        alone(
            variable(0x609A, "Homing acceleration", U32, ReadWrite, 1_000_000)
                .range(1, 0xFFFF_FFFF),
        ),
    ]
}

/// 60B0h to 67FFh: cyclic positions and what the drive can do.
///
/// 60C2h is preset to `1 * 10^-3` s.
fn profile() -> Vec<Object> {
    let methods = (1_u8..).zip(HOMING_METHODS).map(|(n, method)| {
        sub(
            0x60E3,
            n,
            &format!("Supported homing method {n}"),
            I8,
            Constant,
            method,
        )
    });
    let modes = Mode::Homing.supported_bit() | Mode::CyclicPosition.supported_bit();
    vec![
        alone(variable(0x60B0, "Position offset", I32, ReadWrite, 0).mapped(Mapping::Receive)),
        several(
            0x60C2,
            "Interpolation time period",
            Shape::Record,
            vec![
                sub(
                    0x60C2,
                    1,
                    "Interpolation time period value",
                    U8,
                    ReadWrite,
                    1,
                )
                .range(1, 255),
                sub(0x60C2, 2, "Interpolation time index", I8, ReadWrite, -3).range(-6, -2),
            ],
        ),
        several(
            0x60E3,
            "Supported homing methods",
            Shape::Array,
            methods.collect(),
        ),
        sent(0x60F4, "Following error actual value", I32),
        sent(0x60FD, "Digital inputs", U32),
        alone(variable(
            0x6502,
            "Supported drive modes",
            U32,
            Constant,
            modes.into(),
        )),
        alone(variable(
            0x67FF,
            "Single device type",
            U32,
            Constant,
            DEVICE_TYPE,
        )),
    ]
}
