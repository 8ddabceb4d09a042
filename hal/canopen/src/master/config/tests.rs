use super::*;
use crate::master::axis::counts;
use crate::number::whole;

fn load(from: &str, to: &str) -> Result<CanConfig, ConfigError> {
    let shipped = CanConfig::shipped();
    assert!(shipped.text().contains(from), "{from}");
    let text = shipped.text().replacen(from, to, 1);
    CanConfig::load(&Source::embedded("can.toml", &text))
}

/// The shipped file has two arms of which a bus carries one at 500 Hz.
#[test]
fn shipped_bus_carries_one_arm_at_500_hz() {
    let config = CanConfig::load(&CanConfig::shipped()).unwrap();
    assert_eq!(config.arms.len(), 2);
    assert_eq!(config.check_load(1), Ok(()));
    assert!(config.check_load(2).is_err());
    let slower = load("\ncycle_us = 2000", "\ncycle_us = 4000").unwrap();
    assert_eq!(slower.check_load(2), Ok(()));
    let nodes = config.arms[1].plan.axes.map(|axis| axis.node.raw());
    assert_eq!(nodes, [11, 12, 13, 14, 15, 16, 17]);
    // Encoder counts of the insertion: 336.6 rad/m of 14 400 counts a turn.
    let insertion = &config.arms[0].plan.axes[2];
    assert!((insertion.counts_per_unit - 771_430.4).abs() < 0.1);
    assert_eq!(insertion.settings().range.1, whole_i32(0.240 * 771_430.4));
}

/// A drive's range ends at the last counts before the stops, and no set-point goes further,
/// whichever way the encoder counts.
#[test]
fn limits_and_set_points_end_before_the_stops() {
    let shipped = CanConfig::load(&CanConfig::shipped()).unwrap();
    let forwards = shipped.arms[0].plan.axes[0];
    let backwards = AxisPlan {
        counts_per_unit: -forwards.counts_per_unit,
        ..forwards
    };
    // Stops are 205 627.68 counts away: the nearest count lies beyond.
    for (axis, sign) in [(forwards, 1), (backwards, -1)] {
        assert_eq!(axis.range_counts(), (-205_627, 205_627));
        assert_eq!(axis.settings().range, axis.range_counts());
        for (units, end) in [(axis.range.0, -205_627_i32), (axis.range.1, 205_627)] {
            assert_eq!(axis.position_counts(units), sign * (end + end.signum()));
            for further in [units, 2.0 * units, 1e300_f64.copysign(units)] {
                assert_eq!(counts(&axis, further), Some(sign * end));
            }
        }
        assert_eq!(counts(&axis, f64::NAN), None);
        assert_eq!(counts(&axis, f64::INFINITY), None);
    }
}

/// The greatest speeds of the shipped motors have a value in turns a minute.
#[test]
fn motor_speed_limits_fit_turns_a_minute() {
    for space in ["joint", "actuator"] {
        let config = load("space = \"joint\"", &format!("space = {space:?}")).unwrap();
        for axis in config.arms[0].plan.axes {
            let (least, most) = axis.turns_min();
            assert!(0 < least && least < most, "{least} {most}");
            // To a turn a minute, what the axis needs and a tenth more.
            let counts_s = |turns_min: i64| {
                let turns_min = f64::from(i32::try_from(turns_min).unwrap());
                turns_min / 60.0 * f64::from(axis.counts_per_turn)
            };
            let turn = counts_s(1);
            let over = counts_s(least) - f64::from(axis.speed_counts());
            assert!((0.0..turn).contains(&over), "{space}: {over}");
            let over = counts_s(most) - f64::from(axis.settings().speed_max);
            assert!((0.0..turn).contains(&over), "{space}: {over}");
        }
    }
    // Insertion: 0.2 m/s at 336.6 rad/m.
    let config = CanConfig::load(&CanConfig::shipped()).unwrap();
    assert_eq!(config.arms[0].plan.axes[2].turns_min(), (643, 708));
}

fn whole_i32(value: f64) -> i32 {
    i32::try_from(whole(value)).unwrap()
}

#[test]
fn an_encoder_whose_turn_has_no_whole_counts_gives_no_plan() {
    let node = NodeId::new(1).unwrap();
    for counts in [
        0.0,
        -0.0,
        -4000.0,
        4000.5,
        1e-9,
        4_294_967_296.0,
        f64::NAN,
        f64::INFINITY,
    ] {
        let mut motors = ACTUATORS;
        motors[2].encoder_counts_per_turn = counts;
        let error = template(&motors, Space::Joint, (0, 0), node).unwrap_err();
        let message = format!(
            "hal/src/psm.rs:1: ACTUATORS.2.encoder_counts_per_turn = {counts} is outside whole numbers in [1, 4294967295]"
        );
        assert_eq!(error.to_string(), message);
    }
    let mut motors = ACTUATORS;
    motors[2].encoder_counts_per_turn = 4_294_967_295.0;
    let axes = template(&motors, Space::Joint, (0, 0), node).unwrap();
    assert_eq!(axes[2].counts_per_turn, u32::MAX);
}

#[test]
fn at_1_khz_an_arm_needs_three_buses() {
    let fast = load("\ncycle_us = 2000", "\ncycle_us = 1000").unwrap();
    let error = fast.check_load(1).unwrap_err().to_string();
    assert!(error.contains("181.1 % of the bus"), "{error}");
    let shipped = CanConfig::shipped();
    let text = shipped
        .text()
        .replacen("\ncycle_us = 2000", "\ncycle_us = 1000", 1)
        .replacen("[\"vcan0\"]", "[\"vcan0\", \"vcan1\", \"vcan2\"]", 1)
        .replacen("[0, 0, 0, 0, 0, 0, 0]", "[0, 0, 0, 1, 1, 2, 2]", 1);
    let spread = CanConfig::load(&Source::embedded("can.toml", &text)).unwrap();
    assert_eq!(spread.check_load(1), Ok(()));
}

#[test]
fn actuator_space_covers_what_the_joints_can_do() {
    let config = load("space = \"joint\"", "space = \"actuator\"").unwrap();
    let axes = &config.arms[0].plan.axes;
    let space = Space::Actuator;
    let [low, high] = [POSITION_MIN, POSITION_MAX];
    let reach = space.from_joints(&[low[0], high[1], 0.1, low[3], high[4], low[5], JAW_MAX]);
    for (axis, at) in axes.iter().zip(reach) {
        assert!(axis.range.0 - 1e-9 <= at && at <= axis.range.1 + 1e-9);
    }
}

#[test]
fn what_cannot_be_is_named_with_its_place() {
    for (from, to, message) in [
        (
            "\ncycle_us = 2000",
            "\ncycle_us = 400",
            "can.toml:7: cycle_us = 400 is outside [500, 20000]",
        ),
        (
            "\ncycle_us = 2000",
            "\ncycle_us = 1050",
            "can.toml:7: cycle_us = 1050 is outside whole hundreds",
        ),
        (
            "\"joint\"\n",
            "\"disc\"\n",
            "can.toml:10: space = disc is outside {\"joint\", \"actuator\"}",
        ),
        (
            "[1, 2, 3",
            "[1, 1, 3",
            "arm.0.nodes.1 = 1 is outside numbers that no other node has",
        ),
        (
            "[1, 2, 3",
            "[0, 2, 3",
            "arm.0.nodes.0 = 0 is outside [1, 127]",
        ),
        (
            "[0, 0, 0, 0, 0, 0, 0]",
            "[0, 0, 0, 1, 0, 0, 0]",
            "arm.0.lines.3 = 1 is outside [0, 0]",
        ),
        (
            "sync_id = 0x080",
            "sync_id = 0x081",
            "arm.0.sync_id = 0x081 is outside {0x080, 0x100}",
        ),
        (
            "[\"vcan0\"]",
            "[]",
            "arm.0.interfaces = 0 interfaces is outside 1 to 3 interfaces",
        ),
        (
            "[\"vcan0\"]",
            &format!("[{}]", vec!["\"vcan0\""; 300].join(", ")),
            "arm.0.interfaces = 300 interfaces is outside 1 to 3 interfaces",
        ),
        (
            "[\"vcan0\"]",
            "[\"vcan0\", \"vcan0\"]",
            "arm.0.interfaces = vcan0 is outside interfaces named once",
        ),
        (
            "[11, 12, 13",
            "[11, 2, 13",
            "arm.1.nodes.1 = 2 is outside one that the first arm, on the same interface, has not",
        ),
        (
            "sync_id = 0x100",
            "sync_id = 0x080",
            "arm.1.sync_id = 0x080 is outside one that the first arm",
        ),
        (
            "master_node = 126",
            "master_node = 127",
            "arm.1.master_node = 127 is outside one that the first arm",
        ),
    ] {
        let error = load(from, to).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}

/// An arm's homing sequence with one line changed.
fn homing(from: &str, to: &str) -> Result<CanConfig, ConfigError> {
    let sequence = "
[[arm.homing]]
axis = 2
method = 17
home_position = 0.0
switch_speed = 0.02
zero_speed = 0.002
acceleration = 0.2
time_out_s = 30.0
";
    assert!(sequence.contains(from), "{from}");
    let text = CanConfig::shipped().text().to_owned() + &sequence.replacen(from, to, 1);
    CanConfig::load(&Source::embedded("can.toml", &text))
}

/// Axes that the file names home by their method, the others where they stand.
#[test]
fn axes_home_in_place_unless_the_file_names_a_method() {
    let config = CanConfig::load(&CanConfig::shipped()).unwrap();
    assert_eq!(config.arms[0].plan.homing, [None; TAIL_AXES]);
    // The table belongs to the last arm.
    let config = homing("axis = 2", "axis = 2").unwrap();
    let [first, rest @ ..] = config.arms[1].plan.homing;
    assert_eq!(rest, [None; TAIL_AXES - 1]);
    let first = first.unwrap();
    assert_eq!((first.axis, first.method), (2, 17));
    assert_eq!(first.time_out_ns, 30_000_000_000);
    let insertion = &config.arms[1].plan.axes[2];
    assert_eq!(insertion.rate_counts(first.switch_speed), 15_429);
}

#[test]
fn homing_sequences_that_cannot_be_are_refused() {
    for (from, to, message) in [
        (
            "axis = 2",
            "axis = 7",
            "arm.1.homing.0.axis = 7 is outside 0 to 6",
        ),
        (
            "method = 17",
            "method = 37",
            "arm.1.homing.0.method = 37 is outside [-128, -1], [1, 14]",
        ),
        (
            "home_position = 0.0",
            "home_position = 0.5",
            "arm.1.homing.0.home_position = 0.5 is outside [0, 0.24]",
        ),
        (
            "switch_speed = 0.02",
            "switch_speed = 0.3",
            "switch_speed = 0.3 is outside",
        ),
        (
            "zero_speed = 0.002",
            "zero_speed = 0.03",
            "zero_speed = 0.03 is outside",
        ),
        (
            "acceleration = 0.2",
            "acceleration = 0.0",
            "acceleration = 0 is outside",
        ),
        (
            "time_out_s = 30.0",
            "time_out_s = 0.5",
            "time_out_s = 0.5 is outside [1, 600]",
        ),
        ("axis = 2", "axis = 2\nspeed = 1", "unknown field `speed`"),
    ] {
        let error = homing(from, to).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}
