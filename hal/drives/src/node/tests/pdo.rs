use super::*;

/// Bit 31 of a COB-ID: the PDO is not in use.
const INVALID: u32 = 1 << 31;

#[test]
fn mapping_changes_only_in_the_standards_order() {
    let mut bench = Bench::new();
    let u32s = |value: u32| value.to_le_bytes();
    let cob = Address::new(0x1400, 1);
    let count = Address::new(0x1600, 0);
    let first = Address::new(0x1600, 1);
    // Valid: neither mapping nor identifier.
    assert_eq!(bench.write(count, &[0]), Err(AbortCode::DEVICE_STATE));
    assert_eq!(bench.write(cob, &u32s(0x305)), Err(AbortCode::VALUE));
    bench.write(cob, &u32s(0x8000_0205)).unwrap();
    // Invalid, but with a mapping.
    assert_eq!(
        bench.write(first, &u32s(0x607A_0020)),
        Err(AbortCode::ACCESS)
    );
    bench.write(count, &[0]).unwrap();
    assert_eq!(
        bench.write(first, &u32s(0x5FFF_0020)),
        Err(AbortCode::NO_OBJECT)
    );
    assert_eq!(
        bench.write(first, &u32s(0x6041_0010)),
        Err(AbortCode::NOT_MAPPABLE)
    );
    assert_eq!(
        bench.write(first, &u32s(0x607A_0010)),
        Err(AbortCode::NOT_MAPPABLE)
    );
    for n in 1..=3 {
        bench
            .write(Address::new(0x1600, n), &u32s(0x607A_0020))
            .unwrap();
    }
    assert_eq!(bench.write(count, &[3]), Err(AbortCode::MAPPING_LENGTH));
    assert_eq!(bench.write(count, &[9]), Err(AbortCode::TOO_HIGH));
    bench.write(count, &[2]).unwrap();
    assert_eq!(
        bench.write(Address::new(0x1400, 2), &[245]),
        Err(AbortCode::VALUE)
    );
    assert_eq!(
        bench.write(cob, &u32s(0x605)),
        Err(AbortCode::VALUE),
        "identifier changed"
    );
    assert_eq!(
        bench.write(cob, &u32s(0x2000_0205)),
        Err(AbortCode::VALUE),
        "29 bits"
    );
    bench.write(cob, &u32s(0x205)).unwrap();
}

#[test]
fn a_synchronous_set_point_waits_for_the_sync() {
    let mut bench = Bench::new();
    bench.map_cyclic();
    bench.nmt(NmtCommand::Start);
    bench.command(0x06, 4711);
    assert_eq!(bench.node.dictionary().get(index::TARGET), 0);
    bench.frame(0x080, &[]);
    assert_eq!(bench.node.dictionary().get(index::TARGET), 4711);
    assert_eq!(bench.node.power_state(), PowerState::ReadyToSwitchOn);
}

#[test]
fn each_drive_picks_its_slice_of_a_shared_frame() {
    let mut bench = Bench::new();
    let u32s = |value: u32| value.to_le_bytes();
    for (index, sub, value) in [
        (0x1400, 1, 0x8000_0205_u32),
        (0x1600, 1, 0x0007_0020),
        (0x1600, 2, 0x607A_0020),
    ] {
        if index == 0x1600 && sub == 1 {
            bench.write(Address::new(0x1600, 0), &[0]).unwrap();
        }
        bench.write(Address::new(index, sub), &u32s(value)).unwrap();
    }
    bench.write(Address::new(0x1600, 0), &[2]).unwrap();
    bench
        .write(Address::new(0x1400, 1), &u32s(0x8000_0381))
        .unwrap();
    bench.write(Address::new(0x1400, 1), &u32s(0x381)).unwrap();
    bench.nmt(NmtCommand::Start);
    bench.frame(0x381, &[1, 1, 1, 1, 9, 0, 0, 0]);
    assert_eq!(bench.node.dictionary().get(index::TARGET), 9);
}

/// A short RPDO is discarded and a long one used and both are told.
#[test]
fn short_rpdo_is_discarded_and_long_one_truncated() {
    let mut bench = Bench::new();
    bench.map_cyclic();
    bench.nmt(NmtCommand::Start);
    bench.said.clear();
    bench.frame(0x205, &[6, 0, 1]);
    bench.frame(0x080, &[]);
    assert_eq!(bench.emergencies(), [0x8210]);
    assert_eq!(bench.node.power_state(), PowerState::SwitchOnDisabled);
    bench.frame(0x205, &[6, 0, 1, 0, 0, 0, 0]);
    bench.frame(0x080, &[]);
    assert_eq!(bench.emergencies(), [0x8210, 0x0000, 0x8220]);
    assert_eq!(bench.node.dictionary().get(index::TARGET), 1);
    bench.command(0x06, 0);
    assert_eq!(bench.emergencies(), [0x8210, 0x0000, 0x8220, 0x0000]);
}

#[test]
fn tpdos_come_at_every_nth_sync_from_the_start_value_on() {
    let mut bench = Bench::new();
    bench.map_cyclic();
    let u32s = |value: u32| value.to_le_bytes();
    bench.write(index::SYNC_COUNTER, &[20]).unwrap();
    bench
        .write(Address::new(0x1800, 1), &u32s(0xC000_0185))
        .unwrap();
    bench.write(Address::new(0x1800, 2), &[3]).unwrap();
    bench.write(Address::new(0x1800, 6), &[4]).unwrap();
    bench
        .write(Address::new(0x1800, 1), &u32s(0x4000_0185))
        .unwrap();
    assert_eq!(
        bench.write(Address::new(0x1800, 6), &[5]),
        Err(AbortCode::DEVICE_STATE)
    );
    bench.nmt(NmtCommand::Start);
    let mut at = Vec::new();
    for counter in 1..=12 {
        bench.said.clear();
        bench.frame(0x080, &[counter]);
        if !bench.said_by(0x185).is_empty() {
            at.push(counter);
        }
    }
    assert_eq!(at, [4, 7, 10]);
    // A SYNC without its counter is none.
    bench.said.clear();
    bench.frame(0x080, &[]);
    assert_eq!(bench.emergencies(), [0x8240]);
}

#[test]
fn event_tpdos_keep_inhibit_and_event_time() {
    let mut bench = Bench::new();
    let u32s = |value: u32| value.to_le_bytes();
    bench
        .write(Address::new(0x1800, 1), &u32s(0xC000_0185))
        .unwrap();
    bench
        .write(Address::new(0x1800, 3), &100_u16.to_le_bytes())
        .unwrap();
    bench
        .write(Address::new(0x1800, 5), &50_u16.to_le_bytes())
        .unwrap();
    bench
        .write(Address::new(0x1800, 1), &u32s(0x4000_0185))
        .unwrap();
    bench.nmt(NmtCommand::Start);
    bench.said.clear();
    bench.wait_ms(1);
    assert_eq!(bench.said_by(0x185).len(), 1, "at once");
    for control in [6_u8, 7, 6, 7] {
        bench.frame(0x205, &[control, 0]);
        bench.wait_ms(1);
    }
    assert_eq!(bench.said_by(0x185).len(), 1, "inhibited");
    bench.wait_ms(8);
    assert_eq!(bench.said_by(0x185).len(), 2);
    bench.wait_ms(200);
    assert_eq!(bench.said_by(0x185).len(), 6, "every 50 ms");
}

/// Bit 30 of a TPDO's COB-ID (no remote frames) may be clear, as Lely's dcfgen writes it, or set,
/// as our master does, and may change while the PDO is valid; CiA 301 fixes bits 0 to 29 meanwhile.
/// The drive sends the same frames either way.
#[test]
fn tpdo_cob_id_is_taken_with_bit_30_clear_and_set() {
    const NO_RTR: u32 = 1 << 30;
    let cob = index::tpdo(0, 1);
    for bit_30 in [0, NO_RTR] {
        let mut bench = Bench::new();
        let write = |bench: &mut Bench, raw: u32| bench.write(cob, &raw.to_le_bytes());
        assert_eq!(bench.read(cob), 0x4000_0185, "as delivered");
        // In dcfgen's order: off, transmission, mapping, on.
        assert_eq!(write(&mut bench, INVALID | bit_30 | 0x185), Ok(()));
        assert_eq!(bench.read(cob), i64::from(INVALID | bit_30 | 0x185));
        bench.write(index::tpdo(0, 2), &[1]).unwrap();
        bench.write(index::tpdo_mapping(0, 0), &[0]).unwrap();
        let entry = 0x6041_0010_u32.to_le_bytes();
        bench.write(index::tpdo_mapping(0, 1), &entry).unwrap();
        bench.write(index::tpdo_mapping(0, 0), &[1]).unwrap();
        assert_eq!(write(&mut bench, bit_30 | 0x185), Ok(()));
        bench.nmt(NmtCommand::Start);
        for bit_30 in [bit_30, bit_30 ^ NO_RTR, bit_30] {
            assert_eq!(write(&mut bench, bit_30 | 0x185), Ok(()));
            assert_eq!(bench.read(cob), i64::from(bit_30 | 0x185));
            for changed in [0x186, INVALID | 0x186, NO_RTR | 0x186, 1 << 29 | 0x185] {
                assert_eq!(write(&mut bench, changed), Err(AbortCode::VALUE));
            }
            assert_eq!(bench.read(cob), i64::from(bit_30 | 0x185));
            bench.said.clear();
            bench.frame(0x080, &[]);
            let sent = bench.said_by(0x185);
            assert_eq!(sent.len(), 1, "a SYNC, a TPDO");
            let status = bench.node.dictionary().encode(index::STATUS);
            assert_eq!(sent[0].1.data(), status.as_slice());
        }
        // Off, with either bit 30, it is sent no more.
        assert_eq!(write(&mut bench, INVALID | bit_30 | 0x185), Ok(()));
        bench.said.clear();
        bench.frame(0x080, &[]);
        assert!(bench.said_by(0x185).is_empty());
    }
}
