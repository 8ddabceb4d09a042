use super::*;

/// The demand's positions every half millisecond from now, for `ms`, without any frame.
fn watch(bench: &mut Bench, ms: u64) -> Vec<f64> {
    (0..ms * 2)
        .map(|_| {
            let at = bench.now.plus_ns(MS / 2);
            while bench.now < at {
                bench.now = at;
                let demand = bench.node.demand(at);
                bench.node.feedback(Feedback {
                    position_counts: demand.position_counts,
                    ..Feedback::default()
                });
                bench.node.on_time(at, &mut bench.out);
                bench.collect();
            }
            bench.position()
        })
        .collect()
}

#[test]
fn it_powers_up_step_by_step_and_follows() {
    let (mut bench, target) = Bench::moving();
    // It goes to the newest target within the period that follows the SYNC.
    assert!((bench.position() - f64::from(target)).abs() < 1.0);
    bench.cycle(0x0F, target);
    let said = bench.said_by(0x185);
    let (_, newest) = said.last().unwrap();
    let [low, high, position @ ..] = newest.data() else {
        panic!("{newest}");
    };
    assert_eq!(u16::from_le_bytes([*low, *high]) & 0x6F, 0x27);
    assert_eq!(position[..4], target.to_le_bytes());
}

#[test]
fn halt_stops_and_stays_enabled() {
    let (mut bench, target) = Bench::moving();
    for _ in 0..20 {
        bench.cycle(0x10F, target + 5000);
    }
    let halted = bench.position();
    assert!(halted < f64::from(target) + 1200.0);
    bench.cycle(0x10F, target + 5000);
    assert!((bench.position() - halted).abs() < 1e-9);
    assert_eq!(bench.node.power_state(), PowerState::OperationEnabled);
    bench.cycle(0x0F, target + 5000);
    assert!(bench.position() > halted);
}

/// Silence stops the axis within 50 ms of the last SYNC and it says why.
#[test]
fn silent_master_stops_the_axis_within_50_ms() {
    let (mut bench, _) = Bench::moving();
    // The last SYNC was a millisecond ago.
    let way = watch(&mut bench, 200);
    assert!(
        way[98..].iter().all(|x| (x - way[98]).abs() < 1e-9),
        "at rest"
    );
    assert!(way.windows(2).all(|w| w[1] >= w[0] && w[1] - w[0] < 51.0));
    assert_eq!(bench.emergencies(), [0x8700]);
    // Option 2: without torque after the stop.
    assert_eq!(bench.node.power_state(), PowerState::SwitchOnDisabled);
    assert!(!bench.node.demand(bench.now).torque);
}

#[test]
fn a_stopped_axis_is_not_enabled_again_by_the_old_command() {
    for option in [2_u8, 6] {
        let mut bench = Bench::enabled();
        bench.write(index::QUICK_STOP_OPTION, &[option, 0]).unwrap();
        bench.cycle(0x0F, 50);
        bench.wait_ms(100);
        assert_eq!(bench.emergencies(), [0x8700]);
        for _ in 0..100 {
            bench.cycle(0x0F, 5000);
        }
        assert_ne!(
            bench.node.power_state(),
            PowerState::OperationEnabled,
            "{option}"
        );
        assert!(bench.position() < 500.0);
        // SYNCs are back.
        assert_eq!(bench.emergencies(), [0x8700, 0x0000]);
    }
}

#[test]
fn quick_stop_holds_or_lets_go_as_its_option_says() {
    for (option, after) in [
        (0_u8, PowerState::SwitchOnDisabled),
        (1, PowerState::SwitchOnDisabled),
        (2, PowerState::SwitchOnDisabled),
        (5, PowerState::QuickStopActive),
        (6, PowerState::QuickStopActive),
    ] {
        let (mut bench, target) = Bench::moving();
        bench.write(index::QUICK_STOP_OPTION, &[option, 0]).unwrap();
        bench.cycle(0x02, target);
        for _ in 0..30 {
            bench.cycle(0x02, target);
        }
        assert_eq!(bench.node.power_state(), after, "{option}");
        let holds = after == PowerState::QuickStopActive;
        assert_eq!(bench.node.demand(bench.now).torque, holds);
        bench.cycle(0x0F, target);
        let enabled = bench.node.power_state() == PowerState::OperationEnabled;
        assert_eq!(enabled, holds, "{option}");
    }
    let mut bench = Bench::new();
    assert_eq!(
        bench.write(index::QUICK_STOP_OPTION, &[3, 0]),
        Err(AbortCode::VALUE)
    );
}

#[test]
fn disabling_ramps_or_lets_go_as_its_option_says() {
    for (control, address, option, ramps) in [
        (0x07, index::DISABLE_OPTION, 0_u8, false),
        (0x07, index::DISABLE_OPTION, 1, true),
        (0x06, index::SHUTDOWN_OPTION, 0, false),
        (0x06, index::SHUTDOWN_OPTION, 1, true),
        (0x00, index::SHUTDOWN_OPTION, 1, false),
    ] {
        let (mut bench, target) = Bench::moving();
        bench.write(address, &[option, 0]).unwrap();
        bench.cycle(control, target);
        assert_eq!(
            bench.node.demand(bench.now).torque,
            ramps,
            "{control:x} {option}"
        );
        for _ in 0..30 {
            bench.cycle(control, target);
        }
        assert!(!bench.node.demand(bench.now).torque);
    }
}

#[test]
fn an_overdue_rpdo_and_a_lost_master_stop_the_axis() {
    let (mut bench, target) = Bench::moving();
    bench
        .write(Address::new(0x1400, 5), &5_u16.to_le_bytes())
        .unwrap();
    bench.cycle(0x0F, target);
    for _ in 0..30 {
        bench.frame(0x080, &[]);
        bench.wait_ms(1);
    }
    assert_eq!(bench.emergencies(), [0x8250]);
    assert_eq!(bench.node.power_state(), PowerState::SwitchOnDisabled);

    let (mut bench, mut target) = Bench::moving();
    bench
        .write(index::CONSUMER, &0x0001_000A_u32.to_le_bytes())
        .unwrap();
    bench.frame(0x701, &[5]);
    for _ in 0..30 {
        target += 100;
        bench.cycle(0x0F, target);
    }
    assert_eq!(bench.emergencies(), [0x8130]);
    assert!(!bench.node.demand(bench.now).torque);
    assert_eq!(bench.node.nmt_state(), NmtState::PreOperational);
}

#[test]
fn leaving_operational_stops_the_axis() {
    for command in [
        NmtCommand::Stop,
        NmtCommand::EnterPreOperational,
        NmtCommand::ResetCommunication,
    ] {
        let (mut bench, _) = Bench::moving();
        bench.nmt(command);
        let way = watch(&mut bench, 50);
        assert!(way.windows(2).all(|w| w[1] - w[0] < 51.0), "{command:?}");
        assert!((way[40] - way[99]).abs() < 1e-9);
        assert!(!bench.node.demand(bench.now).torque);
    }
    // One that pre-operational does not stop is stopped by what comes after it.
    let (mut bench, _) = Bench::moving();
    bench.node.config.stops_in_pre_operational = false;
    bench.nmt(NmtCommand::EnterPreOperational);
    let _ = watch(&mut bench, 50);
    assert!(bench.node.demand(bench.now).torque);
    bench.nmt(NmtCommand::Stop);
    let _ = watch(&mut bench, 50);
    assert!(!bench.node.demand(bench.now).torque);
    let (mut bench, _) = Bench::moving();
    bench.nmt(NmtCommand::ResetNode);
    assert!(!bench.node.demand(bench.now).torque);
    assert_eq!(bench.said_by(0x705).last().unwrap().1.data(), [0]);
}

#[test]
fn the_abort_option_decides_about_a_lost_master() {
    for (option, after) in [
        (0_u8, PowerState::OperationEnabled),
        (1, PowerState::Fault),
        (2, PowerState::SwitchOnDisabled),
        (3, PowerState::SwitchOnDisabled),
    ] {
        let (mut bench, _) = Bench::moving();
        bench.write(index::ABORT_OPTION, &[option, 0]).unwrap();
        bench.wait_ms(100);
        assert_eq!(bench.node.power_state(), after, "{option}");
        // Even without a reaction it does not run away.
        assert!(bench.position() < 7000.0);
    }
}

/// A motor that does not follow is a fault that only an edge resets.
#[test]
fn following_error_is_reset_by_an_edge_only() {
    let (mut bench, mut target) = Bench::moving();
    bench
        .write(index::FOLLOWING_WINDOW, &500_u32.to_le_bytes())
        .unwrap();
    bench.stuck = Some(bench.position());
    let mut cycles = 0;
    while bench.node.power_state() == PowerState::OperationEnabled {
        target += 100;
        bench.cycle(0x0F, target);
        cycles += 1;
        assert!(cycles < 40);
    }
    assert!((14..=18).contains(&cycles), "{cycles}");
    for _ in 0..30 {
        bench.cycle(0x0F, target);
    }
    assert_eq!(bench.emergencies(), [0x8611]);
    assert_eq!(bench.node.power_state(), PowerState::Fault);
    assert_eq!(bench.node.dictionary().get(index::ERROR_CODE), 0x8611);
    assert_eq!(bench.node.dictionary().get(index::ERROR_REGISTER), 0x21);
    bench.cycle(0x80, target);
    assert_eq!(bench.node.power_state(), PowerState::SwitchOnDisabled);
    assert_eq!(bench.emergencies(), [0x8611, 0x0000]);
    // Held high it is no edge.
    bench
        .node
        .fail(bench.now, ErrorCode::OVER_CURRENT, 2, &mut bench.out);
    bench.wait_ms(20);
    bench.cycle(0x80, target);
    assert_eq!(bench.node.power_state(), PowerState::Fault);
    bench.cycle(0x00, target);
    bench.cycle(0x80, target);
    assert_eq!(bench.node.power_state(), PowerState::SwitchOnDisabled);
}

#[test]
fn homing_makes_the_present_position_the_home_offset() {
    let mut bench = Bench::enabled();
    bench
        .write(index::HOME_OFFSET, &(-777_i32).to_le_bytes())
        .unwrap();
    assert_eq!(
        bench.write(index::HOMING_METHOD, &[19]),
        Err(AbortCode::VALUE)
    );
    bench.write(index::HOMING_METHOD, &[37]).unwrap();
    bench.write(index::MODE, &[6]).unwrap();
    bench.cycle(0x0F, 0);
    assert_eq!(bench.node.dictionary().get(index::STATUS) & 0x3000, 0);
    bench.cycle(0x1F, 0);
    assert_eq!(bench.node.dictionary().get(index::STATUS) & 0x3400, 0x1400);
    assert_eq!(bench.node.dictionary().get(index::POSITION), -777);
    // The motor did not move.
    assert!(bench.position().abs() < 1e-6);
}

/// Methods 17 and 18, with the bits that CiA 402-2 gives the status word: neither attained nor
/// reached on the way, both at the end.
#[test]
fn homing_finds_the_end_of_a_limit_switch() {
    for (method, end) in [(17, -1_000_000.0), (18, 1_000_000.0)] {
        let mut bench = Bench::enabled();
        for (address, value) in [
            (index::HOME_OFFSET, 5_000),
            (index::HOMING_SWITCH_SPEED, 500_000),
            (index::HOMING_ZERO_SPEED, 10_000),
            (index::HOMING_ACCELERATION, 5_000_000),
        ] {
            let value: i32 = value;
            bench.write(address, &value.to_le_bytes()).unwrap();
        }
        bench.write(index::HOMING_METHOD, &[method]).unwrap();
        bench.write(index::MODE, &[6]).unwrap();
        bench.cycle(0x0F, 0);
        let status = |bench: &Bench| bench.node.dictionary().get(index::STATUS) & 0x3400;
        for _ in 0..1000 {
            bench.cycle(0x1F, 0);
            assert_eq!(status(&bench) & 0x1000, 0);
        }
        let mut cycles = 1000;
        while status(&bench) != 0x1400 {
            bench.cycle(0x1F, 0);
            cycles += 1;
            assert!(cycles < 4000, "{}", bench.position());
        }
        // 2 s of a million counts at 500 000 a second, and back from the switch.
        assert!(cycles > 2000, "{cycles}");
        assert!(
            (bench.position() - end).abs() < 100.0,
            "{}",
            bench.position()
        );
        let position = bench.node.dictionary().get(index::POSITION);
        assert!((position - 5_000).abs() < 100, "{position}");
        let at_rest = bench.position();
        bench.cycle(0x1F, 0);
        assert!((bench.position() - at_rest).abs() < 1e-9);
    }
}

#[test]
fn homing_is_interrupted_by_its_bit() {
    let mut bench = Bench::enabled();
    bench.write(index::HOMING_METHOD, &[17]).unwrap();
    bench.write(index::MODE, &[6]).unwrap();
    for _ in 0..200 {
        bench.cycle(0x1F, 0);
    }
    assert!(bench.position() < -100.0);
    for _ in 0..20 {
        bench.cycle(0x0F, 0);
    }
    let at_rest = bench.position();
    bench.cycle(0x0F, 0);
    assert!((bench.position() - at_rest).abs() < 1e-9);
    assert_eq!(bench.node.dictionary().get(index::STATUS) & 0x1000, 0);
    assert_eq!(bench.node.power_state(), PowerState::OperationEnabled);
}
