//! The electronic data sheet: the dictionary as a text that any CANopen tool reads.
//!
//! CiA 306-1, sections 4.5 (file and device), 4.6 (object dictionary).
//!
//! The text is deterministic: objects by index, dates fixed. A test compares it with the committed
//! file, so that table and data sheet cannot drift apart.

use std::fmt::Write as _;

use super::object::{Access, Entry, Mapping, Object, Preset, Shape};
use super::table::{PDO_COUNT, PRODUCT_CODE, REVISION};

/// The data sheet of a drive with `objects`, as it lies in `config/eds/trocar_drive.eds`.
///
/// Sections in this order: file, device, dummies, comments, the three lists of objects, then one
/// section an object and sub-index. Limits and presets are decimal, COB-IDs that depend on the node
/// are `$NODEID` plus a hexadecimal number.
#[must_use]
pub fn render(objects: &[Object]) -> String {
    let mut text = header();
    let mandatory = |object: &&Object| matches!(object.index, 0x1000 | 0x1001 | 0x1018);
    let vendor = |object: &&Object| (0x2000..0x6000).contains(&object.index);
    list(
        &mut text,
        "MandatoryObjects",
        objects.iter().filter(mandatory),
    );
    list(
        &mut text,
        "OptionalObjects",
        objects.iter().filter(|o| !mandatory(o) && !vendor(o)),
    );
    list(
        &mut text,
        "ManufacturerObjects",
        objects.iter().filter(vendor),
    );
    for object in objects {
        section(&mut text, object);
    }
    text
}

/// Bit rates that CiA 306 lists, kbit/s, and whether the drive supports them.
const BIT_RATES: [(u32, u8); 8] = [
    (10, 0),
    (20, 0),
    (50, 0),
    (125, 1),
    (250, 1),
    (500, 1),
    (800, 1),
    (1000, 1),
];

/// The sections of CiA 306 that describe file and device.
///
/// With units, dummy entries and comments; `Granularity=8` says that mappings are in whole bytes.
fn header() -> String {
    let rates: String = BIT_RATES
        .iter()
        .map(|(rate, supported)| format!("BaudRate_{rate}={supported}\n"))
        .collect();
    let dummies: String = (1..=7)
        .map(|code| format!("Dummy{code:04}={}\n", u8::from(code > 1)))
        .collect();
    format!(
        "[FileInfo]\nFileName=trocar_drive.eds\nFileVersion=1\nFileRevision=0\nEDSVersion=4.0\n\
         Description=Emulated CiA 402 drive of Trocar\nCreationTime=12:00AM\nCreationDate=01-01-2026\n\
         CreatedBy=Trocar\nModificationTime=12:00AM\nModificationDate=01-01-2026\nModifiedBy=Trocar\n\n\
         [DeviceInfo]\nVendorName=Trocar\nVendorNumber=0x00000000\nProductName=Trocar emulated drive\n\
         ProductNumber={PRODUCT_CODE:#010X}\nRevisionNumber={REVISION:#010X}\nOrderCode=none\n{rates}\
         SimpleBootUpMaster=0\nSimpleBootUpSlave=1\nGranularity=8\nDynamicChannelsSupported=0\n\
         CompactPDO=0\nGroupMessaging=0\nNrOfRXPDO={PDO_COUNT}\nNrOfTXPDO={PDO_COUNT}\nLSS_Supported=0\n\n\
         [DummyUsage]\n{dummies}\n{}",
        comments()
    )
    .replace("0X", "0x")
}

/// What a data sheet has no other place for: units.
fn comments() -> String {
    let lines = [
        "Positions are counts of the encoder: 6062h, 6064h, 6065h, 607Ah to 607Dh, 60B0h, 60F4h.",
        "Speeds are counts/s: 606Ch, 607Fh. Decelerations are counts/s^2: 6084h, 6085h.",
        "6080h is in turns of the motor a minute; 608Fh says how many counts a turn has.",
        "The greatest speed is the lower one of 607Fh and 6080h.",
        "Per axis differ: 1018sub4, 607Bh, 608Fsub1, and presets and bounds of 6065h, 607Dh, 607Fh, 6080h, 6084h, 6085h.",
        "The defaults given here for those may be beyond an axis's bounds, which then refuses them with 06090031h.",
        "Torques are per mille of the rated torque: 6072h, 6077h.",
    ];
    let numbered: String = (1..)
        .zip(lines)
        .map(|(n, line)| format!("Line{n}={line}\n"))
        .collect();
    format!("[Comments]\nLines={}\n{numbered}\n", lines.len())
}

/// A section that lists the indices of `objects`: mandatory, optional or of the manufacturer.
fn list<'a>(text: &mut String, name: &str, objects: impl Iterator<Item = &'a Object>) {
    let lines: Vec<String> = (1..)
        .zip(objects)
        .map(|(n, object)| format!("{n}={:#06x}\n", object.index))
        .collect();
    let _ = writeln!(
        text,
        "[{name}]\nSupportedObjects={}\n{}",
        lines.len(),
        lines.concat()
    );
}

/// The section of an object, and one for each of its sub-indices.
fn section(text: &mut String, object: &Object) {
    let index = object.index;
    if object.shape == Shape::Variable {
        for entry in &object.entries {
            let _ = writeln!(text, "[{index:04X}]\n{}", value(entry));
        }
        return;
    }
    let _ = writeln!(
        text,
        "[{index:04X}]\nParameterName={}\nObjectType={:#x}\nSubNumber={}\n",
        object.name,
        object.shape.code(),
        object.entries.len()
    );
    for entry in &object.entries {
        let _ = writeln!(
            text,
            "[{index:04X}sub{:X}]\n{}",
            entry.address.sub,
            value(entry)
        );
    }
}

/// The lines of an entry's bounds; none where they are those of its data type.
fn limits(entry: &Entry) -> String {
    if (entry.low, entry.high) == entry.kind.range() {
        String::new()
    } else {
        format!("LowLimit={}\nHighLimit={}\n", entry.low, entry.high)
    }
}

/// The lines of one entry (CiA 306): name, type, access, limits, default and whether it can be
/// mapped.
fn value(entry: &Entry) -> String {
    let access = match (entry.access, entry.mapping) {
        (Access::ReadOnly, _) => "ro",
        (Access::WriteOnly, _) => "wo",
        (Access::Constant, _) => "const",
        (Access::ReadWrite, Mapping::No) => "rw",
        (Access::ReadWrite, Mapping::Receive) => "rww",
        (Access::ReadWrite, Mapping::Transmit) => "rwr",
    };
    let limits = limits(entry);
    let preset = match entry.preset {
        Preset::Number(number) => number.to_string(),
        Preset::PerNode(base) => format!("$NODEID+{base:#x}"),
        Preset::Text(words) => words.to_owned(),
    };
    format!(
        "ParameterName={}\nObjectType=0x7\nDataType={:#06x}\nAccessType={access}\n{limits}\
         DefaultValue={preset}\nPDOMapping={}\n",
        entry.name,
        entry.kind.code(),
        u8::from(entry.mapping != Mapping::No),
    )
}
