//! Replays of runs of the real controller, honest and tampered with.

use hal::ArmError;

use super::{ReplayError, ReplayResult, replay};
use crate::control::OperatorEvent;
use crate::log::tests::{Scratch, chunk_of_run, run_controller, write_records};
use crate::log::{Pressure, Recorder, RunLog, TickRecord};

fn tampered(name: &str, change: impl Fn(&mut Vec<TickRecord>)) -> ReplayResult {
    let (mut records, header) = run_controller(700);
    change(&mut records);
    let file = Scratch::new(name);
    write_records(&file, &records, &header);
    replay(&RunLog::open(&file.0).unwrap()).unwrap()
}

#[test]
fn a_replay_recomputes_every_command() {
    let result = tampered("replay", |_| {});
    assert_eq!(
        result,
        ReplayResult {
            identical: true,
            ticks: 700,
            first_difference: None,
            cut: None
        }
    );
}

#[test]
fn one_flipped_bit_in_an_input_shows() {
    // The measurement seeds the first command.
    let result = tampered("flip-measured", |records| {
        let state = records[0].measured.as_mut().unwrap();
        state.position[1] = f64::from_bits(state.position[1].to_bits() ^ 1);
    });
    let difference = result.first_difference.unwrap();
    assert_eq!(
        (result.identical, difference.tick, difference.what.as_str()),
        (false, 0, "position.pitch")
    );
}

#[test]
fn one_flipped_bit_in_a_command_shows() {
    let result = tampered("flip-command", |records| {
        let jaw = &mut records[300].command.jaw_velocity;
        *jaw = f64::from_bits(jaw.to_bits() ^ 1);
    });
    let difference = result.first_difference.unwrap();
    assert_eq!(
        (result.ticks, difference.tick, difference.what.as_str()),
        (300, 300, "velocity.jaw")
    );
}

#[test]
fn another_operator_or_a_lost_measurement_shows() {
    let paused = tampered("pause", |records| {
        records[200].operator = Some(OperatorEvent::Pause)
    });
    assert!(
        paused
            .first_difference
            .is_some_and(|difference| difference.tick >= 200)
    );
    let lost = tampered("lost", |records| {
        records[200].measured = Err(ArmError::MeasurementLost { age_ns: 1 })
    });
    assert!(
        lost.first_difference
            .is_some_and(|difference| difference.tick >= 200)
    );
}

#[test]
fn a_dropped_chunk_is_named() {
    let (records, header) = run_controller(200);
    let file = Scratch::new("no-chunk");
    let mut recorder = Recorder::create(&file.0, &header, Pressure::Block).unwrap();
    for record in &records {
        // As if the queue had been full: the tick says that there was a chunk, but none was handed over.
        recorder.tick(record);
    }
    recorder.finish(None).unwrap();
    let result = replay(&RunLog::open(&file.0).unwrap()).unwrap();
    let difference = result.first_difference.unwrap();
    assert!(
        difference
            .to_string()
            .contains("the chunk dropped by the logger"),
        "{difference}"
    );
}

#[test]
fn a_cut_log_replays_up_to_the_cut() {
    let (records, header) = run_controller(700);
    let file = Scratch::new("cut-replay");
    write_records(&file, &records, &header);
    let bytes = std::fs::read(&file.0).unwrap();
    let log = RunLog::from_bytes(&file.0, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let result = replay(&log).unwrap();
    assert!(
        result.identical && result.cut.is_some() && result.ticks < 700,
        "{result:?}"
    );
}

#[test]
fn a_log_of_another_configuration_or_without_one_is_refused() {
    let (records, mut header) = run_controller(5);
    let file = Scratch::new("other-config");
    header
        .texts
        .insert("control.toml".to_owned(), "nonsense = 1\n".to_owned());
    write_records(&file, &records, &header);
    let error = replay(&RunLog::open(&file.0).unwrap()).unwrap_err();
    assert!(
        matches!(&error, ReplayError::Configuration(_)) && error.to_string().contains("nonsense"),
        "{error}"
    );
    header.texts.clear();
    write_records(&file, &records, &header);
    let error = replay(&RunLog::open(&file.0).unwrap()).unwrap_err();
    assert!(
        matches!(
            error,
            ReplayError::NoConfiguration {
                file: "control.toml"
            }
        ),
        "{error}"
    );
    let (_, header) = run_controller(5);
    write_records(&file, &[], &header);
    assert!(matches!(
        replay(&RunLog::open(&file.0).unwrap()),
        Err(ReplayError::Empty)
    ));
    assert_eq!(chunk_of_run(1).sequence, 1);
}
