use std::collections::BTreeMap;

use super::object::{Access, Mapping};
use super::*;
use trocar_canopen::arbitrary::Random;
use trocar_canopen::index;

const SHEET: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../config/eds/trocar_drive.eds"
);

fn dictionary() -> Dictionary {
    Dictionary::new(&table::objects(), NodeId::new(5).unwrap())
}

#[test]
fn objects_are_in_order_and_once() {
    let objects = table::objects();
    assert!(objects.is_sorted_by(|a, b| a.index < b.index));
    for object in &objects {
        assert!(object.entries.is_sorted_by(|a, b| a.address < b.address));
        assert!(
            object
                .entries
                .iter()
                .all(|e| e.address.index == object.index)
        );
    }
    let dictionary = dictionary();
    for address in index::ALL {
        assert!(dictionary.read(*address).is_ok(), "{address}");
    }
}

#[test]
fn reading_and_writing_refuse_with_the_standards_codes() {
    let mut dictionary = dictionary();
    let read = |address| {
        dictionary
            .read(address)
            .map(|bytes| bytes.as_slice().to_vec())
    };
    assert_eq!(read(index::DEVICE_TYPE), Ok(vec![0x92, 0x01, 0x02, 0x00]));
    assert_eq!(read(index::EMERGENCY_COB), Ok(vec![0x85, 0, 0, 0]));
    assert_eq!(
        read(Address::new(0x1008, 0)),
        Ok(b"Trocar emulated drive".to_vec())
    );
    assert_eq!(read(Address::new(0x5FFF, 0)), Err(AbortCode::NO_OBJECT));
    assert_eq!(read(Address::new(0x1018, 9)), Err(AbortCode::NO_SUB_INDEX));
    let mut write = |address, data: &[u8]| dictionary.write(address, data);
    assert_eq!(write(index::STATUS, &[0, 0]), Err(AbortCode::READ_ONLY));
    assert_eq!(write(index::CONTROL, &[0]), Err(AbortCode::TOO_SHORT));
    assert_eq!(write(index::CONTROL, &[0; 4]), Err(AbortCode::TOO_LONG));
    assert_eq!(write(index::SYNC_LOSS, &[101]), Err(AbortCode::TOO_HIGH));
    assert_eq!(write(index::SYNC_LOSS, &[1]), Err(AbortCode::TOO_LOW));
    assert_eq!(write(index::LABEL, &[b'a'; 65]), Err(AbortCode::TOO_LONG));
    assert_eq!(write(index::TARGET, &(-5_i32).to_le_bytes()), Ok(()));
    assert_eq!(dictionary.get(index::TARGET), -5);
}

#[test]
fn a_written_number_is_read_back() {
    let mut dictionary = dictionary();
    let mut random = Random::new(3);
    let mut written = 0;
    for address in dictionary.addresses().collect::<Vec<_>>() {
        for _ in 0..200 {
            let payload = random.payload();
            let data = payload.as_slice();
            if dictionary.write(address, data).is_ok() {
                written += 1;
                assert_eq!(
                    dictionary.read(address).unwrap().as_slice(),
                    data,
                    "{address}"
                );
            }
        }
    }
    assert!(written > 1000, "{written}");
}

#[test]
fn reset_and_store_concern_what_they_say() {
    let mut dictionary = dictionary();
    dictionary.set(index::HEARTBEAT, 100);
    dictionary.set(index::TARGET, 7);
    dictionary.reset(Area::Communication);
    assert_eq!(
        (
            dictionary.get(index::HEARTBEAT),
            dictionary.get(index::TARGET)
        ),
        (0, 7)
    );
    dictionary.set(index::HEARTBEAT, 100);
    dictionary.store();
    dictionary.set(index::HEARTBEAT, 50);
    dictionary.reset(Area::All);
    assert_eq!(dictionary.get(index::HEARTBEAT), 100);
}

#[test]
fn the_data_sheet_is_the_dictionary() {
    let text = std::fs::read_to_string(SHEET).unwrap();
    assert!(
        text == eds::render(&table::objects()),
        "config/eds/trocar_drive.eds is older than the dictionary; run the ignored test write_the_data_sheet"
    );
}

/// The committed file read as what it is, an INI file, by other code than what wrote it.
#[test]
fn data_sheet_matches_the_dictionary() {
    let text = std::fs::read_to_string(SHEET).unwrap();
    let mut sections: BTreeMap<&str, BTreeMap<&str, &str>> = BTreeMap::new();
    let mut name = "";
    for line in text.lines().filter(|line| !line.is_empty()) {
        if let Some(header) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            name = header;
            assert!(
                sections.insert(name, BTreeMap::new()).is_none(),
                "{name} twice"
            );
        } else {
            let (key, value) = line.split_once('=').unwrap();
            sections.get_mut(name).unwrap().insert(key, value);
        }
    }
    let node = NodeId::new(5).unwrap();
    let dictionary = Dictionary::new(&table::objects(), node);
    let mut values = 0;
    for cell in &dictionary.cells {
        let Address { index, sub } = cell.address;
        let plain = format!("{index:04X}");
        let section = match &sections[plain.as_str()] {
            object if object["ObjectType"] == "0x7" => object,
            _ => &sections[format!("{index:04X}sub{sub:X}").as_str()],
        };
        values += 1;
        assert_eq!(section["DataType"], format!("{:#06x}", cell.kind.code()));
        let writable = matches!(section["AccessType"], "rw" | "rww" | "rwr" | "wo");
        assert_eq!(
            writable,
            cell.access == Access::ReadWrite,
            "{}",
            cell.address
        );
        assert_eq!(section["PDOMapping"] == "1", cell.mapping != Mapping::No);
        let preset = section["DefaultValue"];
        match cell.value {
            Value::Text(text) => assert_eq!(text.as_slice(), preset.as_bytes()),
            Value::Number(number) => {
                let expected = preset.strip_prefix("$NODEID+0x").map_or_else(
                    || preset.parse().unwrap(),
                    |base| i64::from_str_radix(base, 16).unwrap() + i64::from(node.raw()),
                );
                assert_eq!(number, expected, "{}", cell.address);
            }
        }
    }
    let described = sections
        .values()
        .filter(|s| s.contains_key("DataType"))
        .count();
    assert_eq!(described, values);
    for list in ["MandatoryObjects", "OptionalObjects", "ManufacturerObjects"] {
        let section = &sections[list];
        assert_eq!(section["SupportedObjects"], (section.len() - 1).to_string());
    }
}

#[test]
#[ignore = "writes config/eds/trocar_drive.eds from the dictionary"]
fn write_the_data_sheet() {
    std::fs::write(SHEET, eds::render(&table::objects())).unwrap();
}
