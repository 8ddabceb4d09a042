//! The checker on runs of the real controller, honest and doctored.

mod torque;
mod two_arms;

use hal::{TICK_NS, TimeNs};

use super::{VerifyError, VerifyResult, verify};
use crate::tests::{Scratch, run_controller, write_records};
use crate::{Pressure, Recorder, RunHeader, RunLog, RunOutcome, TickRecord};
use trocar_control::CommandHash;

fn verify_records(name: &str, records: &[TickRecord], header: &RunHeader) -> VerifyResult {
    let file = Scratch::new(name);
    write_records(&file, records, header);
    verify(&RunLog::open(&file.0).unwrap()).unwrap()
}

/// An honest run with one change made to its records.
fn doctored(name: &str, change: impl Fn(&mut Vec<TickRecord>)) -> VerifyResult {
    let (mut records, header) = run_controller(900);
    change(&mut records);
    verify_records(name, &records, &header)
}

fn limits(result: &VerifyResult) -> Vec<&str> {
    result
        .violations
        .iter()
        .map(|violation| violation.limit.as_str())
        .collect()
}

#[test]
fn an_honest_run_breaks_no_limit() {
    let result = doctored("honest", |_| {});
    assert!(result.ok, "{:?}", result.violations.first());
    assert_eq!((result.ticks, result.skipped_periods), (900, 0));
}

#[test]
fn a_position_jump_is_caught() {
    let result = doctored("jump", |records| {
        records[600].arms.first.command.position[0] += 0.002
    });
    let found = limits(&result);
    assert!(
        !result.ok && found.contains(&"yaw.velocity") && found.contains(&"yaw.jerk"),
        "{found:?}"
    );
    assert_eq!(result.violations[0].tick, 600);
}

#[test]
fn a_jump_too_small_for_speed_is_caught_by_jerk() {
    let result = doctored("small-jump", |records| {
        records[600].arms.first.command.position[4] += 1e-5
    });
    let found = limits(&result);
    assert!(
        found.contains(&"wrist_pitch.jerk") && !found.contains(&"wrist_pitch.velocity"),
        "{found:?}"
    );
}

#[test]
fn a_run_shifted_out_of_its_box_is_caught() {
    let result = doctored("shift", |records| {
        // Even and slow, so that only the place is wrong: 40 mm deeper over 600 ticks.
        for (record, k) in records[200..].iter_mut().zip(0_u32..) {
            record.arms.first.command.position[2] += 0.04 * (f64::from(k) / 600.0).min(1.0).powi(3);
        }
    });
    let found = limits(&result);
    assert!(
        found.contains(&"workspace.left_finger_tip.z_min"),
        "{found:?}"
    );
}

#[test]
fn nan_is_caught() {
    let result = doctored("nan", |records| {
        records[500].arms.first.command.position[3] = f64::NAN
    });
    let found = limits(&result);
    assert!(
        found.contains(&"roll.low") && found.contains(&"roll.velocity"),
        "{found:?}"
    );
}

#[test]
fn a_velocity_beyond_the_drives_is_caught() {
    let result = doctored("said", |records| {
        records[500].arms.first.command.velocity[0] = 7.0
    });
    let found = limits(&result);
    assert_eq!(found[0], "yaw.commanded_velocity");
    let others = found[1..].iter();
    assert!(
        others.clone().all(|limit| limit.ends_with("_mismatch")),
        "{found:?}"
    );
}

#[test]
fn stamps_must_rise_by_whole_periods() {
    let early = doctored("stamp", |records| {
        records[500].arms.first.command.stamp = TimeNs(499 * TICK_NS)
    });
    assert!(limits(&early).contains(&"stamp"), "{early:?}");
    let crooked = doctored("crooked", |records| {
        records[500].arms.first.command.stamp = TimeNs(500 * TICK_NS + 7)
    });
    assert_eq!(limits(&crooked), ["stamp", "clock_ns", "stamp"]);
}

/// One that stood still meanwhile is a violation, one that played its tail is none.
#[test]
fn an_arm_must_go_on_during_skipped_periods() {
    let fast = |record: &TickRecord| record.arms.first.command.velocity.amax();
    let (records, _) = run_controller(900);
    let moving = records
        .iter()
        .position(|record| fast(record) > 0.02)
        .unwrap();
    let gone_on = doctored("gone-on", |records| {
        records.drain(moving..moving + 3);
        for (tick, record) in (0..).zip(records) {
            record.tick = tick;
        }
    });
    assert!(
        gone_on.ok && gone_on.skipped_periods == 3,
        "{:?}",
        gone_on.violations
    );
    let stood_still = doctored("stood-still", |records| {
        for record in &mut records[moving..] {
            record.arms.first.command.stamp = record.arms.first.command.stamp.plus_ns(3 * TICK_NS);
        }
    });
    let found = limits(&stood_still);
    assert!(
        found.iter().any(|limit| limit.ends_with(".jerk")),
        "{found:?}"
    );
}

#[test]
fn a_removed_tick_shows() {
    let result = doctored("removed", |records| {
        records.remove(600);
    });
    assert!(!result.ok || result.skipped_periods == 1, "{result:?}");
}

#[test]
fn commands_that_the_run_did_not_report_are_caught() {
    let (mut records, header) = run_controller(100);
    let mut hash = CommandHash::new();
    for record in &records {
        hash.add(&record.arms.first.command);
    }
    let outcome = RunOutcome {
        command_hash: format!("{:016x}", hash.value()),
        ..RunOutcome::default()
    };
    let verify_all = |name: &str, records: &[TickRecord]| {
        let file = Scratch::new(name);
        let mut recorder = Recorder::create(&file.0, &header, Pressure::Block).unwrap();
        for record in records {
            let mut record = *record;
            record.arms.first.chunk_sequence = None;
            recorder.tick(&record);
        }
        recorder.finish(Some(&outcome)).unwrap();
        verify(&RunLog::open(&file.0).unwrap()).unwrap()
    };
    assert!(verify_all("hash", &records).ok);
    let jaw = &mut records[50].arms.first.command.jaw_velocity;
    *jaw = f64::from_bits(jaw.to_bits() ^ 1);
    let found = verify_all("hash-other", &records);
    assert_eq!(limits(&found), ["command_hash_mismatches"]);
}

#[test]
fn a_cut_log_is_verified_up_to_the_cut_and_never_ok() {
    let (records, header) = run_controller(700);
    let file = Scratch::new("cut-verify");
    write_records(&file, &records, &header);
    let bytes = std::fs::read(&file.0).unwrap();
    let log = RunLog::from_bytes(&file.0, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let result = verify(&log).unwrap();
    assert!(
        result.cut.is_some() && (1..700).contains(&result.ticks),
        "{result:?}"
    );
    assert_eq!((result.ok, result.violation_count), (false, 0));
}

#[test]
fn a_log_without_limits_is_refused() {
    let (records, mut header) = run_controller(10);
    let file = Scratch::new("no-limits");
    let control = header
        .texts
        .insert("control.toml".to_owned(), "[limits]\n".to_owned());
    write_records(&file, &records, &header);
    let error = verify(&RunLog::open(&file.0).unwrap()).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("control.toml in the log: `limits.yaw.low_rad`"),
        "{error}"
    );
    header
        .texts
        .insert("control.toml".to_owned(), control.unwrap());
    header.texts.remove("safety.toml");
    write_records(&file, &records, &header);
    let error = verify(&RunLog::open(&file.0).unwrap()).unwrap_err();
    assert!(
        matches!(
            error,
            VerifyError::NoConfiguration {
                file: "safety.toml"
            }
        ),
        "{error}"
    );
}

#[test]
fn the_checkers_kinematics_agree_with_the_controllers() {
    let mut state = 3_u64;
    for _ in 0..1000 {
        let joints = hal::JointVector::from_fn(|axis, _| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let share = f64::from(u32::try_from(state >> 32).unwrap()) / f64::from(u32::MAX);
            let (low, high) = (hal::psm::POSITION_MIN[axis], hal::psm::POSITION_MAX[axis]);
            low + share * (high - low)
        });
        let (ours, theirs) = (
            super::tip_in_rcm(&joints),
            trocar_control::kinematics::forward(&joints),
        );
        assert!(
            (ours.translation.vector - theirs.translation.vector).norm() < 1e-12,
            "{joints:?}"
        );
        assert!(
            ours.rotation.angle_to(&theirs.rotation) < 1e-7,
            "{joints:?}"
        );
    }
}
