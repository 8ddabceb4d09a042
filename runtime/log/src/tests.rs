//! The log as a whole: what goes in comes out bit for bit, whatever happens to the file.

mod bounded;
mod damaged;
mod falsified;
mod kept;
mod live;
mod room;
mod samples;
pub(crate) mod two_arms;

use std::path::PathBuf;

use hal::{
    ArmError, ArmState, CameraFrame, Chunk, Distortion, Intrinsics, JointVector, Pose, TimeNs,
    TipTarget,
};
use nalgebra::Vector3;

use super::{
    ArmRecord, BusRecord, BusesRecord, CriterionRecord, FlapRecord, LogCounts, LogError,
    LoggedItem, LoggedReport, Loss, Pressure, Recorder, RunHeader, RunLog, SceneRecord, TaskRecord,
    TickRecord, TickTiming, Writing, read_items,
};
use hal::PerArm;
use trocar_control::OperatorEvent;

use samples::{assert_same, chunk, chunk_bits, header, outcome, record, write};

/// A file in the temporary folder, removed at the end.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        Self(std::env::temp_dir().join(format!("trocar-{}-{name}.mcap", std::process::id())))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _gone = std::fs::remove_file(&self.0);
    }
}

#[test]
fn everything_that_goes_in_comes_out_bit_for_bit() {
    let (file, _) = write("round-trip", 500);
    let log = RunLog::open(&file.0).unwrap();
    assert_eq!(log.header, header());
    assert_eq!(log.outcome, Some(outcome()));
    assert_eq!(
        log.counts,
        Some(LogCounts {
            ticks: 500,
            chunks: 13,
            ..LogCounts::default()
        })
    );
    assert_eq!((log.cut(), log.losses.as_slice()), (None, [].as_slice()));
    assert_eq!(log.tick_count(), 500);
    for ((logged, given), tick) in log.ticks().zip(0..) {
        assert_same(logged, &record(tick));
        let expected = (tick % 40 == 1).then_some(tick);
        assert_eq!(logged.arms.first.chunk_sequence, expected);
        assert_eq!(
            given.first.map(chunk_bits),
            expected.map(|tick| chunk_bits(&chunk(tick)))
        );
    }
}

#[test]
fn a_chunk_of_impossible_length_keeps_it() {
    let file = Scratch::new("impossible");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    let mut wrong = chunk(1);
    wrong.len = 4000;
    wrong.reserved = 9;
    recorder.chunk(0, &wrong);
    let mut record = record(0);
    record.arms.first.chunk_sequence = Some(1);
    recorder.tick(&record);
    recorder.finish(None).unwrap();
    let log = RunLog::open(&file.0).unwrap();
    let (_, given) = log.ticks().next().unwrap();
    let given = given.first.unwrap();
    assert_eq!(
        (given.len, given.reserved, given.valid_targets().len()),
        (4000, 9, 0)
    );
}

#[test]
fn what_was_dropped_is_counted_and_named() {
    let file = Scratch::new("drop");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Drop).unwrap();
    // Far more than the queue holds, faster than any writer.
    let ticks = 60_000;
    for tick in 0..ticks {
        let mut record = record(tick);
        record.arms.first.chunk_sequence = (tick % 10 == 0).then(|| {
            recorder.chunk(0, &chunk(tick));
            tick
        });
        recorder.tick(&record);
    }
    let counts = recorder.finish(None).unwrap();
    assert!(
        counts.ticks_dropped > 0 && counts.chunks_dropped > 0,
        "{counts:?}"
    );
    assert_eq!(counts.ticks + counts.ticks_dropped, ticks);
    let log = RunLog::open(&file.0).unwrap();
    let lost: u64 = log
        .losses
        .iter()
        .map(|loss| {
            if let Loss::Ticks { count, .. } = loss {
                *count
            } else {
                0
            }
        })
        .sum();
    assert_eq!(lost, counts.ticks_dropped);
    assert!(
        log.losses
            .iter()
            .any(|loss| matches!(loss, Loss::Chunk { .. }))
    );
    for (logged, given) in log.ticks() {
        assert_same(logged, &record(logged.tick));
        let wanted = logged.arms.first.chunk_sequence;
        assert!(
            given
                .first
                .is_none_or(|given| Some(given.sequence) == wanted)
        );
    }
}

#[test]
fn the_outcome_is_written_though_the_other_ends_are_long_gone() {
    let file = Scratch::new("late-outcome");
    let recorder = Recorder::create(&file.0, &header(), Pressure::Drop).unwrap();
    let (mut ticks, side, scenes, log_file) = recorder.split();
    ticks.tick(&record(0));
    drop((ticks, side, scenes));
    // Ten times as long as the writer thread takes to look again.
    std::thread::park_timeout(std::time::Duration::from_millis(20));
    log_file.finish(Some(&outcome())).unwrap();
    let log = RunLog::open(&file.0).unwrap();
    assert_eq!(
        (log.outcome.clone(), log.tick_count()),
        (Some(outcome()), 1)
    );
}

/// Scenes and views are there for whoever looks on, and nothing to a replay.
#[test]
fn scenes_and_views_come_back_beside_the_ticks() {
    let file = Scratch::new("scenes");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    let scene = |step: u32| SceneRecord {
        moment_ms: 40 * step,
        things: vec![Pose::translation(0.1, f64::from(step) / 3.0, 5e-324)],
        arms: vec![[Pose::rotation(Vector3::new(0.1, 0.2, 1.0 / 3.0)); 5]],
        flap: Some(FlapRecord {
            nodes_m: vec![[0.1, -1e-8, f32::MIN_POSITIVE]],
            mark_m: [0.1, 0.2],
        }),
        task: TaskRecord {
            missing: "not lifted".to_owned(),
            criteria: vec![CriterionRecord {
                name: "height".to_owned(),
                unit: "m".to_owned(),
                value: None,
                goal: 0.02,
                at_least: true,
                met: false,
            }],
        },
        ..SceneRecord::default()
    };
    let mut frame = CameraFrame::blank(Intrinsics {
        distortion: Distortion::new([-0.2, 0.05, 0.001, -0.002]),
        ..Intrinsics::from_vertical_fov(16, 8, 0.9)
    });
    frame.stamp = TimeNs::from_tick(40);
    frame.camera_in_scene = Pose::new(Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.0, 1.0, 0.5));
    // More than the queue holds, before the ticks of the same time.
    for tick in 0..40 * 60 {
        if tick % 40 == 0 {
            let step = u32::try_from(tick / 40).unwrap();
            recorder.scene(TimeNs::from_tick(tick), scene(step));
        }
        recorder.tick(&record(tick));
    }
    recorder.frame("endoscope", &frame);
    recorder.finish(Some(&outcome())).unwrap();

    let log = RunLog::open(&file.0).unwrap();
    assert_eq!((log.tick_count(), log.altered()), (40 * 60, false));
    for ((logged, _), tick) in log.ticks().zip(0..) {
        assert_same(logged, &record(tick));
    }
    let (mut scenes, mut views) = (Vec::new(), 0);
    read_items(&file.0, |item| match item {
        LoggedItem::Scene { at, message } => {
            scenes.push((at, SceneRecord::read(message.as_bytes()).unwrap()));
        }
        LoggedItem::View {
            camera,
            at,
            lens,
            camera_in_scene,
        } => {
            views += 1;
            assert_eq!((camera, at), ("endoscope", frame.stamp));
            assert_eq!(*lens, frame.intrinsics);
            let apart = camera_in_scene.inv_mul(&frame.camera_in_scene);
            assert!(apart.translation.vector.norm() < 1e-12 && apart.rotation.angle() < 1e-12);
        }
        LoggedItem::Image { .. }
        | LoggedItem::Buses { .. }
        | LoggedItem::Event { .. }
        | LoggedItem::Message { .. } => {}
    })
    .unwrap();
    let expected = (0..60).map(|step| (TimeNs::from_tick(40 * u64::from(step)), scene(step)));
    assert_eq!(scenes, expected.collect::<Vec<_>>());
    assert_eq!(views, 1);
    assert_eq!(SceneRecord::read(b"{\"moment_ms\": 1}"), None);
}

/// What the kernel counted on the buses is there for whoever looks on, and nothing to a replay.
#[test]
fn buses_come_back_beside_the_ticks() {
    let file = Scratch::new("buses");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    let busy = |errors: u64| BusesRecord {
        buses: ["can0", "can1"]
            .map(|interface| BusRecord {
                interface: interface.to_owned(),
                frames_per_s: 8123.0,
                load: 1.0 / 3.0,
                errors,
            })
            .into(),
    };
    for tick in 0..30 {
        recorder.tick(&record(tick));
        if tick % 10 == 0 {
            recorder.buses(TimeNs::from_tick(tick), busy(tick));
        }
    }
    let counts = recorder.finish(Some(&outcome())).unwrap();
    assert_eq!((counts.ticks, counts.events_dropped), (30, 0));
    let log = RunLog::open(&file.0).unwrap();
    assert_eq!((log.tick_count(), log.altered()), (30, false));
    let mut told = Vec::new();
    read_items(&file.0, |item| {
        if let LoggedItem::Buses { at, message } = item {
            told.push((at.tick(), BusesRecord::read(message.as_bytes())));
        }
    })
    .unwrap();
    assert_eq!(told, [0, 10, 20].map(|tick| (tick, Some(busy(tick)))));
    assert_eq!(BusesRecord::read(b"[]"), None);
}

/// What is read of a report without a replay is what was reported; other texts are none.
#[test]
fn a_report_is_read_back() {
    let (file, _) = write("reports", 30);
    let log = RunLog::open(&file.0).unwrap();
    let expected = samples::report();
    for step in log.steps() {
        let read = LoggedReport::read(step.reports.first.unwrap()).unwrap();
        assert_eq!(
            (read.state, read.target),
            (expected.mode.state, expected.target)
        );
    }
    for text in ["", "{}", "{\"mode\": \"ASLEEP\"}"] {
        assert_eq!(LoggedReport::read(text.as_bytes()), None, "{text}");
    }
    let read = LoggedReport::read(b"{\"mode\": \"PAUSED\"}").unwrap();
    assert_eq!(read.target, None);
}

#[test]
fn frames_become_png_images_with_their_lens() {
    use prost::Message;

    let file = Scratch::new("frames");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    let mut frame = CameraFrame::blank(Intrinsics::from_vertical_fov(16, 8, 0.9));
    for (pixel, value) in frame.colour.iter_mut().zip((0..=255).cycle()) {
        *pixel = value;
    }
    frame.camera_in_scene = hal::Pose::translation(0.1, -0.2, 0.3);
    frame.intrinsics.distortion = hal::Distortion::new([-0.3, 0.1, 0.001, -0.002]);
    recorder.frame("endoscope", &frame);
    recorder.tick(&record(0));
    assert_eq!(recorder.finish(None).unwrap().frames, 1);
    let bytes = std::fs::read(&file.0).unwrap();
    let mut seen = 0;
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        if message.channel.topic == "/camera/endoscope" {
            let shown = super::messages::CompressedImage::decode(&message.data[..]).unwrap();
            let decoded = image::load_from_memory(&shown.data).unwrap().into_rgb8();
            assert_eq!(decoded.as_raw(), &frame.colour);
            seen += 1;
        }
        if message.channel.topic == "/camera/endoscope/calibration" {
            let lens = super::messages::CameraCalibration::decode(&message.data[..]).unwrap();
            assert_eq!(
                (lens.width, lens.height, lens.K.len(), lens.P.len()),
                (16, 8, 9, 12)
            );
            assert_eq!(lens.distortion_model, "plumb_bob");
            assert_eq!(lens.D, [-0.3, 0.1, 0.001, -0.002, 0.0]);
            seen += 1;
        }
        if message.channel.topic == "/camera/endoscope/pose" {
            let told = super::messages::PoseInFrame::decode(&message.data[..]).unwrap();
            assert_eq!(told.frame_id, "scene");
            assert_eq!(told.pose, Some((&frame.camera_in_scene).into()));
            seen += 1;
        }
    }
    assert_eq!(seen, 3);
}

#[test]
fn a_frame_without_pixels_fails_the_log_and_not_the_run() {
    let file = Scratch::new("bad-frame");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    let mut frame = CameraFrame::blank(Intrinsics::from_vertical_fov(16, 8, 0.9));
    frame.colour.pop();
    recorder.frame("endoscope", &frame);
    recorder.tick(&record(0));
    let error = recorder.finish(None).unwrap_err();
    assert!(error.to_string().contains("383 bytes"), "{error}");
}

/// The chunk that [`run_controller`] hands over under this sequence, four times a second.
pub(crate) fn chunk_of_run(sequence: u64) -> Chunk {
    let mut joints = JointVector::zeros();
    joints[2] = hal::psm::HOME_INSERTION_M;
    let home = crate::verify::tip_in_rcm(&joints);
    let targets: Vec<_> = (0..50_u32)
        .map(|k| {
            let reach =
                0.0004 * f64::from(k) + 0.004 * f64::from(u32::try_from(sequence % 3).unwrap());
            let tip = nalgebra::Translation3::new(reach, -0.5 * reach, 0.2 * reach) * home;
            TipTarget::new(&tip, 0.3 + 0.005 * f64::from(k))
        })
        .collect();
    Chunk::new(
        TimeNs(sequence * 250_000_000 - 230_000_000),
        sequence,
        40_000_000,
        &targets,
    )
}

/// Runs the real controller on an arm that follows perfectly, for `ticks` ticks.
pub(crate) fn run_controller(ticks: u64) -> (Vec<TickRecord>, RunHeader) {
    run_with_operator(ticks, |tick| (tick == 1).then_some(OperatorEvent::Enable))
}

/// As [`run_controller`], with another operator.
pub(crate) fn run_with_operator(
    ticks: u64,
    operator: impl Fn(u64) -> Option<OperatorEvent>,
) -> (Vec<TickRecord>, RunHeader) {
    run_disturbed(ticks, operator, |_, state| Ok(state))
}

/// As [`run_with_operator`], with something between the arm and its measurement.
pub(crate) fn run_disturbed(
    ticks: u64,
    operator: impl Fn(u64) -> Option<OperatorEvent>,
    measure: impl Fn(u64, ArmState) -> Result<ArmState, ArmError>,
) -> (Vec<TickRecord>, RunHeader) {
    use trocar_control::{ControlConfig, Controller, TickInput};

    let (control, safety) = (
        ControlConfig::default_control(),
        ControlConfig::needle_lift_safety(),
    );
    let config = ControlConfig::load(&control, &safety).unwrap();
    let mut controller = Controller::new(&config).unwrap();
    let mut position =
        JointVector::new(0.013, -0.021, hal::psm::HOME_INSERTION_M, 0.1, 0.05, -0.07);
    let mut jaw = 0.4;
    let mut records = Vec::new();
    for tick in 0..ticks {
        let now = TimeNs::from_tick(tick);
        let measured = measure(tick, ArmState::at_rest(now, position, jaw));
        let operator = operator(tick);
        let chunk = (tick % 250 == 20).then(|| chunk_of_run(tick / 250 + 1));
        let output = controller.tick(&TickInput {
            now,
            measured,
            chunk: chunk.as_ref(),
            operator,
        });
        position = output.command.position;
        jaw = output.command.jaw_position;
        records.push(TickRecord {
            tick,
            now,
            arms: PerArm::one(ArmRecord {
                measured,
                operator,
                chunk_sequence: chunk.map(|chunk| chunk.sequence),
                command: output.command,
                report: output.report,
            }),
            timing: TickTiming::default(),
        });
    }
    let moved = (position - records[0].arms.first.command.position).norm();
    assert!(ticks < 500 || moved > 0.01, "the arm hardly moved: {moved}");
    let texts = [
        ("control.toml", control.text()),
        ("safety.toml", safety.text()),
    ];
    let texts = texts
        .map(|(name, text)| (name.to_owned(), text.to_owned()))
        .into();
    (records, RunHeader { texts, ..header() })
}

/// Writes the records of [`run_controller`] with their chunks.
pub(crate) fn write_records(file: &Scratch, records: &[TickRecord], header: &RunHeader) {
    let mut recorder = Recorder::create(&file.0, header, Pressure::Block).unwrap();
    for record in records {
        if let Some(sequence) = record.arms.first.chunk_sequence {
            recorder.chunk(0, &chunk_of_run(sequence));
        }
        recorder.tick(record);
    }
    recorder.finish(None).unwrap();
}

#[test]
fn faults_modes_and_the_end_are_told_in_words() {
    let (records, header) = run_disturbed(
        900,
        |tick| (tick == 1).then_some(OperatorEvent::Enable),
        |tick, state| match tick {
            400.. => Err(ArmError::DriveFault { axis: 2, code: 1 }),
            _ => Ok(state),
        },
    );
    let file = Scratch::new("told");
    let mut recorder = Recorder::create(&file.0, &header, Pressure::Block).unwrap();
    records.iter().for_each(|record| recorder.tick(record));
    recorder.finish(Some(&outcome())).unwrap();
    let (reason, said) = (outcome().reason, outcome().said);
    assert_eq!(
        RunLog::open(&file.0).unwrap().events,
        [
            "psm1: operator: enable".to_owned(),
            "psm1: DISABLED to ENABLED".to_owned(),
            "psm1: ENABLED to FAULT".to_owned(),
            "psm1: fault: drive of axis 2 reports fault 0x0001".to_owned(),
            format!("the run ended: {reason}; {said}"),
        ]
    );
}

#[test]
fn what_cannot_be_written_is_told_at_once() {
    let (sender, told) = std::sync::mpsc::channel();
    let on_failure = Box::new(move |error: &LogError| {
        sender.send(error.to_string()).unwrap();
    });
    let path = PathBuf::from("/dev/full");
    let writing = Writing {
        on_failure,
        ..Writing::new(Pressure::Block)
    };
    let created = Recorder::create_with(&path, &header(), writing);
    // The header fits into a buffer, or is refused at once.
    let Ok(mut recorder) = created else { return };
    for tick in 0..2000 {
        recorder.tick(&record(tick));
    }
    let told = told.recv().unwrap();
    assert!(
        told.contains("/dev/full: the log could not be written"),
        "{told}"
    );
    assert!(recorder.finish(None).is_err());
}
