//! Records full of awkward numbers, and their comparison to the bit.

use hal::{ArmCommand, ArmError, ArmState, Chunk, JointVector, TimeNs, TipTarget};

use super::Scratch;
use crate::{
    ArmRecord, Level, LoggedTick, Pressure, Recorder, RunHeader, RunMark, RunNote, RunOutcome,
    TickRecord, TickTiming,
};
use hal::PerArm;
use trocar_control::{Fault, Mode, OperatingState, OperatorEvent, QpOutcome, TickReport};

pub(super) fn report() -> TickReport {
    TickReport {
        mode: Mode {
            state: OperatingState::Enabled,
            homed: true,
            busy: true,
        },
        gate: None,
        qp: QpOutcome::Solved { iterations: 7 },
        rows_active: 2,
        correction: f64::NAN,
        guard_intervened: false,
        target: Some(TipTarget {
            position_m: [0.1, -0.0, 5e-324],
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
            jaw: 0.3,
        }),
        fault: Some(Fault::TrackingError {
            tip_m: 0.25,
            turn_rad: f64::INFINITY,
        }),
    }
}

/// Numbers that are easy to lose on the way.
pub(super) fn awkward(index: u64) -> f64 {
    let values = [
        5e-324,
        -0.0,
        0.1,
        1e308,
        -f64::MAX,
        f64::MIN_POSITIVE,
        f64::NAN,
        f64::INFINITY,
        1.0 / 3.0,
    ];
    values[usize::try_from(index).unwrap() % values.len()]
}

pub(super) fn record(tick: u64) -> TickRecord {
    TickRecord {
        tick,
        now: TimeNs::from_tick(tick),
        arms: PerArm::one(arm(tick)),
        timing: TickTiming {
            wake_ns: tick,
            compute_ns: 2 * tick,
        },
    }
}

/// One arm in a tick, full of awkward numbers.
pub(super) fn arm(tick: u64) -> ArmRecord {
    let now = TimeNs::from_tick(tick);
    let vector = |offset| {
        JointVector::from_fn(|axis, _| awkward(tick + offset + u64::try_from(axis).unwrap()))
    };
    let state = ArmState {
        stamp: TimeNs(now.0.saturating_sub(3)),
        position: vector(0),
        velocity: vector(1),
        effort: vector(2),
        jaw_position: awkward(tick + 5),
        jaw_velocity: -0.0,
        jaw_effort: awkward(tick + 6),
    };
    let measured = match tick % 7 {
        3 => Err(ArmError::MeasurementLost { age_ns: u64::MAX }),
        4 => Err(ArmError::DriveFault {
            axis: 6,
            code: 0xff02,
        }),
        5 => Err(ArmError::EndOfRecording),
        _ => Ok(state),
    };
    let operators = [
        OperatorEvent::Enable,
        OperatorEvent::Disable,
        OperatorEvent::Pause,
        OperatorEvent::Resume,
        OperatorEvent::Clear,
        OperatorEvent::Speed { percent: 37 },
        OperatorEvent::TakeOver,
        OperatorEvent::HandBack,
        OperatorEvent::GoOn,
    ];
    ArmRecord {
        measured,
        operator: operators.get(usize::try_from(tick % 11).unwrap()).copied(),
        chunk_sequence: None,
        command: ArmCommand {
            stamp: now.plus_ns(hal::TICK_NS),
            position: vector(3),
            velocity: vector(4),
            acceleration: vector(5),
            jaw_position: awkward(tick),
            jaw_velocity: awkward(tick + 1),
            enabled: tick.is_multiple_of(2),
        },
        report: report(),
    }
}

pub(super) fn chunk(sequence: u64) -> Chunk {
    let targets: Vec<_> = (0..100)
        .map(|k| TipTarget {
            position_m: [awkward(k), awkward(k + 1), awkward(k + 2)],
            rotation_xyzw: [
                awkward(k + 3),
                awkward(k + 4),
                f64::from_bits(0x7ff8_0000_0000_1234),
                -0.0,
            ],
            jaw: awkward(k + 5),
        })
        .collect();
    Chunk::new(TimeNs(sequence * 77), sequence, 40_000_000, &targets)
}

pub(super) fn header() -> RunHeader {
    RunHeader {
        task: "needle-lift".to_owned(),
        policy: "expert".to_owned(),
        seed: u64::MAX,
        lockstep: true,
        view: "view2".to_owned(),
        needle: Some("N3".to_owned()),
        varied: vec!["needles".to_owned(), "lens".to_owned()],
        versions: [("trocar".to_owned(), "0.1.0".to_owned())].into(),
        texts: [("safety.toml".to_owned(), "# µ\n[a]\nb = 1\n".to_owned())].into(),
        left_out: 0,
    }
}

pub(super) fn outcome() -> RunOutcome {
    RunOutcome {
        success: Some(true),
        reason: "success".to_owned(),
        command_hash: "0123456789abcdef".to_owned(),
        said: RunNote {
            mark: Some(RunMark::Discard),
            label: "Nadel, \"schräg\"".to_owned(),
        },
        teleop: Some("{\"messages\":2}".to_owned()),
    }
}

/// Writes `ticks` ticks, a chunk every 40, and gives the file's bytes.
pub(super) fn write(name: &str, ticks: u64) -> (Scratch, Vec<u8>) {
    let file = Scratch::new(name);
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    for tick in 0..ticks {
        let mut record = record(tick);
        if tick % 40 == 1 {
            recorder.chunk(0, &chunk(tick));
            record.arms.first.chunk_sequence = Some(tick);
        }
        recorder.tick(&record);
    }
    recorder.event(TimeNs(5), Level::Warning, "something happened");
    let counts = recorder.finish(Some(&outcome())).unwrap();
    assert_eq!(counts.ticks, ticks);
    let bytes = std::fs::read(&file.0).unwrap();
    (file, bytes)
}

/// All numbers of a tick as bits, so that NaN equals itself.
pub(super) fn bits(
    measured: &Result<ArmState, ArmError>,
    command: &ArmCommand,
) -> (Result<Vec<u64>, ArmError>, Vec<u64>, TimeNs, bool) {
    let measured = measured.map(|state| {
        let vectors = state
            .position
            .iter()
            .chain(state.velocity.iter())
            .chain(state.effort.iter());
        let jaw = [&state.jaw_position, &state.jaw_velocity, &state.jaw_effort];
        vectors
            .chain(jaw)
            .map(|value| value.to_bits())
            .chain([state.stamp.0])
            .collect()
    });
    let vectors = command
        .position
        .iter()
        .chain(command.velocity.iter())
        .chain(command.acceleration.iter());
    let jaw = [&command.jaw_position, &command.jaw_velocity];
    let sent = vectors.chain(jaw).map(|value| value.to_bits()).collect();
    (measured, sent, command.stamp, command.enabled)
}

pub(super) fn assert_same(logged: &LoggedTick, written: &TickRecord) {
    assert_eq!((logged.tick, logged.now), (written.tick, written.now));
    assert_eq!(logged.timing, written.timing);
    assert_eq!(logged.arms.count(), written.arms.count());
    for (logged, written) in logged.arms.iter().zip(written.arms.iter()) {
        assert_eq!(logged.operator, written.operator);
        assert_eq!(
            bits(&logged.measured, &logged.command),
            bits(&written.measured, &written.command)
        );
    }
}

pub(super) fn chunk_bits(chunk: &Chunk) -> (TimeNs, u64, u64, u32, Vec<u64>) {
    let numbers = |target: &TipTarget| {
        let mut all = target.position_m.to_vec();
        all.extend(target.rotation_xyzw);
        all.push(target.jaw);
        all.into_iter().map(f64::to_bits).collect::<Vec<_>>()
    };
    let targets = chunk.valid_targets().iter().flat_map(numbers).collect();
    (
        chunk.observed_at,
        chunk.sequence,
        chunk.step_ns,
        chunk.len,
        targets,
    )
}
