//! The largest state that a controller can have, in the files of a log with a bound.

use std::fs;
use std::path::Path;

use hal::chunk::CHUNK_STEPS_MAX;
use hal::config::Source;
use hal::{ArmState, Chunk, JointVector, PerArm, TICK_NS, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::falsified::{Item, items};
use super::two_arms::{SCENE, start};
use super::{Pressure, Recorder, Scratch, TickRecord, TickTiming, Writing, header};
use crate::bound::earlier;
use trocar_control::snapshot::HELD_MAX;
use trocar_control::{AnyController, ControlConfig, OperatorEvent, TickInput};

/// Ticks from one chunk to the next: the targets of one are further apart, so that as many chunks
/// count as there may be.
const EVERY_TICKS: u64 = 39;

/// Bytes of both files at most: each holds little besides two states.
const BYTES_MAX: u64 = 12 << 20;

/// The longest chunk that there is, about the place of an arm, of numbers that no two targets
/// share.
fn chunk(now: TimeNs, sequence: u64, position: &JointVector) -> Chunk {
    let tip = crate::verify::tip_in_rcm(position);
    let begin = u32::try_from(sequence).unwrap();
    let targets: Vec<_> = (0..u32::try_from(CHUNK_STEPS_MAX).unwrap())
        .map(|k| {
            let phase = 0.37 * f64::from(begin) + 0.11 * f64::from(k);
            let way = 1e-3 * Vector3::new(phase.sin(), phase.cos(), (1.7 * phase).sin());
            let mut pose = Translation3::from(way) * tip;
            pose.rotation = UnitQuaternion::new(5.0 * way) * tip.rotation;
            TipTarget::new(&pose, 0.4 + 10.0 * way[0])
        })
        .collect();
    Chunk::new(now, sequence, (EVERY_TICKS + 1) * TICK_NS, &targets)
}

fn size(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |found| found.len())
}

#[test]
fn the_largest_state_fits_into_the_bound() {
    let (control, safety) = (
        ControlConfig::default_control(),
        Source::embedded("handover.toml", SCENE),
    );
    let config = ControlConfig::load(&control, &safety).unwrap();
    let mut controller = AnyController::new(&config).unwrap();
    let last = Scratch::new("room");
    let before = Scratch(earlier(&last.0));
    let writing = Writing {
        bytes_max: Some(BYTES_MAX),
        ..Writing::new(Pressure::Block)
    };
    let mut recorder = Recorder::create_with(&last.0, &header(), writing).unwrap();
    let mut places = PerArm::two((start(), 0.4), (start(), 0.4));
    let mut most = 0;
    for tick in 0..9000 {
        let now = TimeNs::from_tick(tick);
        let is_step = tick % EVERY_TICKS == 20;
        let chunks = places
            .map(|(position, _)| is_step.then(|| chunk(now, tick / EVERY_TICKS + 1, &position)));
        let inputs = places
            .zip(chunks.as_ref())
            .map(|((position, jaw), chunk)| TickInput {
                now,
                measured: Ok(ArmState::at_rest(now, position, jaw)),
                chunk: chunk.as_ref(),
                operator: (tick == 1).then_some(OperatorEvent::Enable),
            });
        let outputs = controller.tick(&inputs);
        places = outputs.map(|output| (output.command.position, output.command.jaw_position));
        for (arm, chunk) in chunks.iter().enumerate() {
            if let Some(chunk) = chunk {
                recorder.chunk(arm, chunk);
            }
        }
        recorder.tick(&TickRecord::new(
            tick,
            inputs,
            outputs,
            TickTiming::default(),
        ));
        recorder.snapshot(&controller);
        most = most.max(size(&before.0));
    }
    recorder.finish(None).unwrap();
    most = most.max(size(&before.0)).max(size(&last.0));
    assert!(most <= BYTES_MAX / 2, "{most}");
    // The state that ends a file is as large as it can be.
    let ends_with = items(&before)
        .into_iter()
        .rev()
        .find_map(|item| match item {
            Item::Message(topic, _, data) if topic == "/snapshot" => Some(data),
            Item::Message(..) | Item::Metadata(..) => None,
        });
    let state: serde_json::Value = serde_json::from_slice(&ends_with.unwrap()).unwrap();
    assert_eq!(state["chunks"].as_array().unwrap().len(), HELD_MAX);
}
