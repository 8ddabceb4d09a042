//! Two arms: a run of the real controller for other tests, and the log of awkward numbers.

use std::collections::BTreeMap;

use hal::config::Source;
use hal::{ArmState, Chunk, JointVector, TimeNs, TipTarget};
use nalgebra::Translation3;

use super::samples::{self, assert_same, chunk, chunk_bits, header, outcome};
use super::{Pressure, Recorder, RunHeader, RunLog, Scratch, TickRecord, TickTiming};
use super::{chunk_of_run, run_controller};
use crate::replay::replay;
use crate::{Loss, RunOutcome};
use hal::PerArm;
use trocar_control::{AnyController, ControlConfig, OperatorEvent, TickInput};

pub(super) const SCENE: &str = include_str!("../../../control/src/tests/scenes/handover.toml");

/// Where both arms start.
pub(super) fn start() -> JointVector {
    JointVector::new(0.013, -0.021, hal::psm::HOME_INSERTION_M, 0.1, 0.05, -0.07)
}

/// The chunk that the arm `arm` is given under this sequence: both reach towards each other.
pub(crate) fn chunk_of_arm(arm: usize, sequence: u64) -> Chunk {
    let mut chunk = chunk_of_run(sequence);
    if arm == 1 {
        let home = crate::verify::tip_in_rcm(&start());
        let len = chunk.valid_targets().len();
        for (target, k) in chunk.targets[..len].iter_mut().zip(0_u32..) {
            let since = f64::from(u32::try_from(sequence - 1).unwrap());
            let reach = Translation3::new(-0.0125 * since - 0.002 * f64::from(k), 0.0, 0.0);
            *target = TipTarget::new(&(reach * home), 0.4 - 0.004 * f64::from(k));
        }
    }
    chunk
}

/// The sequence of the chunk that `arm` gets in `tick`: four a second, every second time both at
/// once.
fn sequence(arm: usize, tick: u64) -> Option<u64> {
    let delay = if arm == 1 && (tick / 250).is_multiple_of(2) {
        60
    } else {
        20
    };
    (tick % 250 == delay).then_some(tick / 250 + 1)
}

/// Runs the controller of two arms that follow perfectly for `ticks` ticks; the operator enables
/// one after the other.
pub(crate) fn run_two_arms(ticks: u64) -> (Vec<TickRecord>, RunHeader) {
    let (control, safety) = (
        ControlConfig::default_control(),
        Source::embedded("handover.toml", SCENE),
    );
    let config = ControlConfig::load(&control, &safety).unwrap();
    let mut controller = AnyController::new(&config).unwrap();
    let mut places = PerArm::two((start(), 0.4), (start(), 0.4));
    let mut records: Vec<TickRecord> = Vec::new();
    for tick in 0..ticks {
        let now = TimeNs::from_tick(tick);
        let chunks = [0, 1].map(|arm| sequence(arm, tick).map(|found| chunk_of_arm(arm, found)));
        let mut arms = (0_u64..).zip(&chunks);
        let inputs = places.map(|(position, jaw)| {
            let (arm, chunk) = arms.next().unwrap();
            TickInput {
                now,
                measured: Ok(ArmState::at_rest(now, position, jaw)),
                chunk: chunk.as_ref(),
                operator: (tick == 1 + arm).then_some(OperatorEvent::Enable),
            }
        });
        let outputs = controller.tick(&inputs);
        places = outputs.map(|output| (output.command.position, output.command.jaw_position));
        let timing = TickTiming::default();
        records.push(TickRecord::new(tick, inputs, outputs, timing));
    }
    for (position, _) in places.iter() {
        let moved = (position - start()).norm();
        assert!(ticks < 500 || moved > 0.01, "an arm hardly moved: {moved}");
    }
    let texts = [
        ("control.toml", control.text()),
        ("safety.toml", safety.text()),
    ];
    let texts = texts
        .map(|(name, text)| (name.to_owned(), text.to_owned()))
        .into();
    (records, RunHeader { texts, ..header() })
}

/// Writes `records` with the chunks that `given` answers for an arm's sequence.
pub(crate) fn write_two_arms(
    file: &Scratch,
    records: &[TickRecord],
    header: &RunHeader,
    given: impl Fn(usize, u64) -> Chunk,
    outcome: Option<&RunOutcome>,
) -> RunLog {
    let mut recorder = Recorder::create(&file.0, header, Pressure::Block).unwrap();
    for record in records {
        for (arm, told) in record.arms.iter().enumerate() {
            if let Some(sequence) = told.chunk_sequence {
                recorder.chunk(arm, &given(arm, sequence));
            }
        }
        recorder.tick(record);
    }
    recorder.finish(outcome).unwrap();
    RunLog::open(&file.0).unwrap()
}

/// A tick of two arms with different awkward numbers; chunks for one, the other or both, under one
/// number.
fn awkward(tick: u64) -> TickRecord {
    let mut record = samples::record(tick);
    let mut second = samples::arm(tick + 4);
    record.arms.first.chunk_sequence = (tick % 6 == 1).then_some(tick);
    second.chunk_sequence = (tick % 10 == 1).then_some(tick);
    record.arms.second = Some(second);
    record
}

#[test]
fn both_arms_come_out_bit_for_bit_with_their_own_chunks() {
    let file = Scratch::new("two-round-trip");
    let records: Vec<_> = (0..300).map(awkward).collect();
    let given = |arm: usize, sequence| chunk(sequence + 1000 * u64::try_from(arm).unwrap());
    let log = write_two_arms(&file, &records, &header(), given, Some(&outcome()));
    assert_eq!((log.cut(), log.losses.as_slice()), (None, [].as_slice()));
    assert_eq!(log.tick_count(), 300);
    for ((logged, chunks), written) in log.ticks().zip(&records) {
        assert_same(logged, written);
        for (index, (arm, chunk)) in written.arms.iter().zip(chunks.iter()).enumerate() {
            assert_eq!(
                chunk.map(chunk_bits),
                arm.chunk_sequence
                    .map(|sequence| chunk_bits(&given(index, sequence)))
            );
        }
    }
}

fn topics(log: &Scratch) -> BTreeMap<String, usize> {
    let bytes = std::fs::read(&log.0).unwrap();
    let mut topics = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let topic = message.unwrap().channel.topic.clone();
        *topics.entry(topic).or_default() += 1;
    }
    topics
}

/// A log of one arm lacks them.
#[test]
fn only_a_second_arm_has_the_second_arm_s_topics() {
    let (one, _) = samples::write("topics-one", 100);
    let (file, ticks) = (Scratch::new("topics-two"), 100);
    let records: Vec<_> = (0..ticks).map(awkward).collect();
    write_two_arms(&file, &records, &header(), |_, tick| chunk(tick), None);
    let (one, two) = (topics(&one), topics(&file));
    let first = [
        "/psm1/measured_js",
        "/psm1/setpoint_js",
        "/psm1/jaw",
        "/psm1/tick",
        "/policy/chunk",
        "/safety",
        "/timing",
    ];
    // Of the awkward numbers, no measurement is finite, so that there is no tip.
    let mut known = first.to_vec();
    known.push("/events");
    known.sort_unstable();
    assert_eq!(one.keys().collect::<Vec<_>>(), known);
    let count = |topic: &str| two.get(topic).copied().unwrap_or(0);
    for topic in first {
        let beside = match topic {
            "/timing" => continue,
            "/safety" => "/safety/psm2".to_owned(),
            "/policy/chunk" => "/policy/chunk/psm2".to_owned(),
            _ => topic.replace("psm1", "psm2"),
        };
        assert!(count(topic) > 0 && count(&beside) > 0, "{two:?}");
    }
    assert_eq!((count("/psm1/tick"), count("/psm2/tick")), (100, 100));
    assert_eq!((count("/timing"), two.len()), (100, 14));
}

#[test]
fn a_lost_chunk_of_the_second_arm_is_named() {
    let file = Scratch::new("two-lost");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    for tick in 0..40 {
        let record = awkward(tick);
        if record.arms.first.chunk_sequence.is_some() {
            recorder.chunk(0, &chunk(tick));
        }
        recorder.tick(&record);
    }
    recorder.finish(None).unwrap();
    let log = RunLog::open(&file.0).unwrap();
    let lost = [1, 11, 21, 31].map(|tick| Loss::Chunk { tick });
    assert_eq!(log.losses, lost);
}

/// A log with ticks of other arms than its configuration has differs in their number, whichever has
/// more.
#[test]
fn log_of_other_arms_than_its_configuration_differs() {
    let (one, of_one) = run_controller(5);
    let (two, of_two) = run_two_arms(5);
    for (records, header, logged, computed) in
        [(&one, &of_two, "1", "2"), (&two, &of_one, "2", "1")]
    {
        let file = Scratch::new("other-arms");
        let log = write_two_arms(&file, records, header, chunk_of_arm, None);
        let result = replay(&log).unwrap();
        assert!(!result.identical && result.ticks == 0);
        let found = result.first_difference.unwrap();
        assert_eq!((found.tick, found.what.as_str()), (0, "arms"));
        assert_eq!(
            (found.logged.as_str(), found.computed.as_str()),
            (logged, computed)
        );
    }
}
