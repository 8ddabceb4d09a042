use super::*;

#[test]
fn boot_up_comes_first_and_heartbeats_follow() {
    let mut bench = Bench::new();
    assert_eq!(bench.said.len(), 1);
    assert_eq!(bench.said[0].1.to_string(), "705#00");
    bench
        .write(index::HEARTBEAT, &100_u16.to_le_bytes())
        .unwrap();
    bench.said.clear();
    bench.wait_ms(1000);
    let beats = bench.said_by(0x705);
    assert_eq!(beats.len(), 10);
    assert!(beats.iter().all(|(_, f)| f.data() == [0x7F]));
    bench.nmt(NmtCommand::Start);
    bench.wait_ms(100);
    assert_eq!(bench.said_by(0x705).last().unwrap().1.data(), [0x05]);
}

#[test]
fn nmt_commands_for_others_do_not_concern_it() {
    let mut bench = Bench::new();
    bench.frame(0x000, &[0x01, 6]);
    assert_eq!(bench.node.nmt_state(), NmtState::PreOperational);
    bench.frame(0x000, &[0x01, 5]);
    assert_eq!(bench.node.nmt_state(), NmtState::Operational);
    bench.frame(0x000, &[0x82, 0]);
    assert_eq!(bench.node.nmt_state(), NmtState::PreOperational);
    assert_eq!(bench.said_by(0x705).len(), 2);
}

#[test]
fn a_heartbeat_is_watched_from_the_first_one_on() {
    let mut bench = Bench::new();
    // 50 ms, node 1.
    bench
        .write(index::CONSUMER, &0x0001_0032_u32.to_le_bytes())
        .unwrap();
    let second = Address::new(0x1016, 2);
    let twice = bench.write(second, &0x0001_0064_u32.to_le_bytes());
    assert_eq!(twice, Err(AbortCode::INCOMPATIBLE));
    bench.nmt(NmtCommand::Start);
    bench.said.clear();
    bench.wait_ms(200);
    assert!(bench.emergencies().is_empty());
    bench.frame(0x701, &[0x05]);
    bench.wait_ms(49);
    assert!(bench.emergencies().is_empty());
    bench.wait_ms(2);
    assert_eq!(bench.emergencies(), [0x8130]);
    // 1029h: to pre-operational by default.
    assert_eq!(bench.node.nmt_state(), NmtState::PreOperational);
    assert_eq!(bench.node.dictionary().get(index::ERROR_REGISTER), 0x11);
    bench.frame(0x701, &[0x05]);
    bench.wait_ms(1);
    assert_eq!(bench.emergencies(), [0x8130, 0x0000]);
    bench.said.clear();
    assert_eq!(bench.read(Address::new(0x1003, 0)), 1);
    assert_eq!(bench.read(Address::new(0x1003, 1)), 0x8130);
    assert_eq!(bench.write(Address::new(0x1003, 0), &[0]), Ok(()));
    assert_eq!(bench.read(Address::new(0x1003, 0)), 0);
    assert_eq!(
        bench.try_read(Address::new(0x1003, 1)),
        Err(AbortCode::NO_DATA)
    );
}

#[test]
fn another_node_with_its_number_is_told() {
    let mut bench = Bench::new();
    bench.frame(0x705, &[0x05]);
    assert_eq!(bench.emergencies(), [0x8150]);
}

#[test]
fn emergencies_keep_their_inhibit_time_and_none_is_lost() {
    let mut bench = Bench::new();
    bench.map_cyclic();
    bench
        .write(index::EMERGENCY_INHIBIT, &100_u16.to_le_bytes())
        .unwrap();
    bench.nmt(NmtCommand::Start);
    bench.said.clear();
    bench.frame(0x205, &[6]);
    bench.command(6, 0);
    assert_eq!(bench.emergencies(), [0x8210]);
    bench.wait_ms(11);
    assert_eq!(bench.emergencies(), [0x8210, 0x0000]);
}

#[test]
fn the_sync_counter_may_change_only_without_a_period() {
    let mut bench = Bench::new();
    bench
        .write(index::SYNC_PERIOD, &1000_u32.to_le_bytes())
        .unwrap();
    assert_eq!(
        bench.write(index::SYNC_COUNTER, &[10]),
        Err(AbortCode::DEVICE_STATE)
    );
    bench
        .write(index::SYNC_PERIOD, &0_u32.to_le_bytes())
        .unwrap();
    assert_eq!(
        bench.write(index::SYNC_COUNTER, &[1]),
        Err(AbortCode::VALUE)
    );
    assert_eq!(bench.write(index::SYNC_COUNTER, &[10]), Ok(()));
    let producer = 0x4000_0080_u32.to_le_bytes();
    assert_eq!(
        bench.write(index::SYNC_COB, &producer),
        Err(AbortCode::VALUE)
    );
}
