//! Replays of runs of the real controller, honest and tampered with.

mod two_arms;

use hal::{ArmError, Chunk};

use super::{ReplayError, ReplayResult, replay};
use crate::tests::{Scratch, chunk_of_run, run_controller, write_records};
use crate::{Pressure, Recorder, RunLog, TickRecord};
use trocar_control::OperatorEvent;

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
    let second_opinion = result.second_opinion;
    assert_eq!(
        result,
        ReplayResult {
            identical: true,
            ticks: 700,
            inputs_checked: true,
            first_difference: None,
            second_opinion,
            kept_from: None,
            edge_checked: false,
            cut: None,
            bounded: false,
        }
    );
    assert_eq!(second_opinion.unsolved, 0);
    assert!(second_opinion.largest_difference < 1e-5);
}

/// Writes an honest run and its inputs' hash, then reads it back with `change` made to what the log
/// says.
///
/// The file is as if a bit had flipped and the checksums had been computed again.
fn changed_in_the_file(
    name: &str,
    change: impl Fn(&mut Vec<TickRecord>, &mut Vec<Chunk>),
) -> ReplayResult {
    let (mut records, header) = run_controller(700);
    let mut chunks: Vec<_> = records
        .iter()
        .filter_map(|record| record.arms.first.chunk_sequence.map(chunk_of_run))
        .collect();
    let file = Scratch::new(name);
    let write = |records: &[TickRecord], chunks: &[Chunk]| {
        let mut recorder = Recorder::create(&file.0, &header, Pressure::Block).unwrap();
        let mut chunks = chunks.iter();
        for record in records {
            if record.arms.first.chunk_sequence.is_some() {
                recorder.chunk(0, chunks.next().unwrap());
            }
            recorder.tick(record);
        }
        recorder.finish(None).unwrap();
        RunLog::open(&file.0).unwrap()
    };
    let honest = write(&records, &chunks);
    change(&mut records, &mut chunks);
    let mut log = write(&records, &chunks);
    log.input_hash = honest.input_hash;
    replay(&log).unwrap()
}

fn flip(value: &mut f64) {
    *value = f64::from_bits(value.to_bits() ^ 1);
}

#[test]
fn one_flipped_bit_in_an_input_shows() {
    // The measurement seeds the first command.
    let result = changed_in_the_file("flip-first", |records, _| {
        flip(&mut records[0].arms.first.measured.as_mut().unwrap().position[1]);
    });
    let difference = result.first_difference.unwrap();
    assert_eq!(
        (result.identical, difference.tick, difference.what.as_str()),
        (false, 0, "position.pitch")
    );
    // Later ones change no command.
    for (name, index) in [("flip-later", 300), ("flip-last", 699)] {
        let result = changed_in_the_file(name, |records, _| {
            flip(
                &mut records[index]
                    .arms
                    .first
                    .measured
                    .as_mut()
                    .unwrap()
                    .position[1],
            );
        });
        let difference = result.first_difference.unwrap();
        assert_eq!(
            (result.identical, result.ticks, difference.what.as_str()),
            (false, 700, "inputs")
        );
    }
}

#[test]
fn one_flipped_bit_in_a_chunk_shows() {
    let used = changed_in_the_file("flip-chunk", |_, chunks| {
        flip(&mut chunks[1].targets[20].position_m[0]);
    });
    assert!(!used.identical, "{used:?}");
    // Due long after the run has ended.
    let unused = changed_in_the_file("flip-chunk-end", |_, chunks| {
        flip(&mut chunks[2].targets[49].jaw);
    });
    let difference = unused.first_difference.unwrap();
    assert_eq!(
        (unused.identical, difference.what.as_str()),
        (false, "inputs")
    );
}

#[test]
fn a_flipped_bit_that_the_controller_ignores_shows() {
    let result = changed_in_the_file("flip-effort", |records, _| {
        flip(
            &mut records[650]
                .arms
                .first
                .measured
                .as_mut()
                .unwrap()
                .jaw_effort,
        );
    });
    assert_eq!(result.first_difference.unwrap().what, "inputs");
}

#[test]
fn one_flipped_bit_in_a_command_shows() {
    let result = tampered("flip-command", |records| {
        let jaw = &mut records[300].arms.first.command.jaw_velocity;
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
        records[200].arms.first.operator = Some(OperatorEvent::Pause)
    });
    assert!(
        paused
            .first_difference
            .is_some_and(|difference| difference.tick >= 200)
    );
    let lost = tampered("lost", |records| {
        records[200].arms.first.measured = Err(ArmError::MeasurementLost { age_ns: 1 })
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
        // As if the queue had been full: the tick says that there was a chunk, but none was handed
        // over.
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
    assert!(difference.is_gap());
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
        result.identical && result.cut.is_some() && result.ticks < 700 && !result.inputs_checked,
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
