//! Topics within one process.

mod processes;

use iceoryx2::prelude::ZeroCopySend;

use super::{
    ArmReport, ArmStateTopic, CameraTopic, ChunkTopic, FrameHeader, Message, PolicyHello,
    PolicyHelloTopic, PolicyStage, PolicyStatus, RunCommand, RunControl, RunControlTopic,
    SnapshotReport, SnapshotTopic, Topic, TopicError, TopicNode,
};
use hal::{ArmState, CameraFrame, Chunk, Intrinsics, JointVector, Pose, TimeNs, TipTarget};

/// A run of its own for each test, so that they can go side by side.
fn node(test: &str) -> TopicNode {
    TopicNode::join(&run_id(test)).unwrap()
}

fn run_id(test: &str) -> String {
    format!("test-{}-{test}", std::process::id())
}

fn lens(width: u32, height: u32) -> Intrinsics {
    Intrinsics::from_vertical_fov(width, height, 0.9)
}

fn header(sequence: u64, intrinsics: Intrinsics) -> FrameHeader {
    let camera = Pose::new([0.1, -0.2, 0.3].into(), [0.4, 0.5, -0.6].into());
    FrameHeader::new(TimeNs(1_000 + sequence), sequence, intrinsics, &camera)
}

/// A frame with every bit pattern that may matter: all bytes, NaNs with payloads, infinities.
fn busy_frame(sequence: u64, intrinsics: Intrinsics) -> CameraFrame {
    let mut state = sequence.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        u32::try_from(state >> 32).unwrap()
    };
    let mut frame = CameraFrame::blank(intrinsics);
    let header = header(sequence, intrinsics);
    (frame.stamp, frame.sequence, frame.camera_in_scene) =
        (header.stamp, sequence, header.camera_in_scene());
    frame
        .colour
        .iter_mut()
        .for_each(|byte| *byte = next().to_le_bytes()[0]);
    frame
        .depth_m
        .iter_mut()
        .for_each(|depth| *depth = f32::from_bits(next()));
    frame
        .instance
        .iter_mut()
        .for_each(|byte| *byte = next().to_le_bytes()[0]);
    frame.depth_m[0] = f32::from_bits(0x7fa0_1234);
    frame
}

fn depth_bits(depth_m: &[f32]) -> Vec<u32> {
    depth_m.iter().map(|depth| depth.to_bits()).collect()
}

fn busy_chunk(sequence: u64) -> Chunk {
    let pose = Pose::new([0.01, 0.02, -0.1].into(), [0.1, 0.2, 0.3].into());
    let mut targets = [TipTarget::new(&pose, 0.3); 100];
    targets[7].position_m[1] = f64::from_bits(0x7ff4_dead_beef_0001);
    targets[8].rotation_xyzw = [
        f64::NEG_INFINITY,
        -0.0,
        f64::from_bits(0xfff8_0000_0000_0042),
        f64::MIN_POSITIVE,
    ];
    Chunk::new(
        TimeNs(sequence * 40_000_000),
        sequence,
        40_000_000,
        &targets,
    )
}

fn chunk_bits(chunk: &Chunk) -> Vec<u64> {
    let head = [
        chunk.observed_at.0,
        chunk.sequence,
        chunk.step_ns,
        u64::from(chunk.len),
    ];
    let numbers = chunk
        .targets
        .iter()
        .flat_map(|t| {
            t.position_m
                .into_iter()
                .chain(t.rotation_xyzw)
                .chain([t.jaw])
        })
        .map(f64::to_bits);
    head.into_iter().chain(numbers).collect()
}

#[test]
fn frame_arrives_bit_for_bit_with_its_header() {
    let node = node("bits");
    let intrinsics = lens(512, 512);
    let mut publisher = CameraTopic::publisher(&node, "psm1/endoscope", 512 * 512).unwrap();
    let mut subscriber = CameraTopic::subscriber(&node, "psm1/endoscope").unwrap();
    let sent = busy_frame(3, intrinsics);
    assert_eq!(publisher.publish(&sent).unwrap(), 1);
    let view = subscriber.newest().unwrap().unwrap();
    assert_eq!(*view.header(), header(3, intrinsics));
    let mut copy = CameraFrame::blank(lens(4, 4));
    view.to_frame(&mut copy);
    assert_eq!(
        (copy.stamp, copy.sequence, copy.intrinsics),
        (sent.stamp, 3, intrinsics)
    );
    assert_eq!(copy.camera_in_scene, sent.camera_in_scene);
    assert_eq!(view.as_frame().colour.as_ptr(), view.colour().as_ptr());
    assert!(copy.colour == sent.colour && copy.instance == sent.instance);
    assert!(depth_bits(&copy.depth_m) == depth_bits(&sent.depth_m));
    assert!(
        subscriber.newest().unwrap().is_none(),
        "a frame is delivered once"
    );
}

/// The kernel's name of the mapping that `address` lies in.
fn mapping_of(address: usize) -> String {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let hit = maps.lines().find(|line| {
        let (low, high) = line.split(' ').next().unwrap().split_once('-').unwrap();
        let bound = |text| usize::from_str_radix(text, 16).unwrap();
        (bound(low)..bound(high)).contains(&address)
    });
    hit.unwrap().to_owned()
}

/// Inode and offset in its file of what lies at `address`.
fn place_in_file(address: usize) -> (String, usize) {
    let line = mapping_of(address);
    let fields: Vec<&str> = line.split_whitespace().collect();
    let low = usize::from_str_radix(fields[0].split_once('-').unwrap().0, 16).unwrap();
    (
        fields[4].to_owned(),
        address - low + usize::from_str_radix(fields[2], 16).unwrap(),
    )
}

#[test]
fn reader_sees_the_very_memory_that_the_renderer_wrote() {
    let node = node("place");
    let mut publisher = CameraTopic::publisher(&node, "psm1/endoscope", 64 * 64).unwrap();
    let mut subscriber = CameraTopic::subscriber(&node, "psm1/endoscope").unwrap();
    let mut written_at = Vec::new();
    publisher
        .publish_with(&header(1, lens(64, 64)), |colour, depth_m, instance| {
            written_at = vec![
                colour.as_ptr().addr(),
                depth_m.as_ptr().addr(),
                instance.as_ptr().addr(),
            ];
            colour.fill(7);
            depth_m.fill(0.25);
            instance.fill(3);
        })
        .unwrap();
    let view = subscriber.newest().unwrap().unwrap();
    let read_at = [
        view.colour().as_ptr().addr(),
        view.depth_m().as_ptr().addr(),
        view.instance().as_ptr().addr(),
    ];
    for (written, read) in written_at.iter().zip(read_at) {
        assert!(
            mapping_of(read).contains("/dev/shm/"),
            "{}",
            mapping_of(read)
        );
        assert_eq!(place_in_file(*written), place_in_file(read));
    }
    assert!(view.colour().iter().all(|&c| c == 7) && view.instance().iter().all(|&i| i == 3));
    assert!(
        view.depth_m()
            .iter()
            .all(|d| d.to_bits() == 0.25_f32.to_bits())
    );
}

#[test]
fn newest_frame_wins_and_a_held_view_stays_as_it_was() {
    let node = node("latest");
    let intrinsics = lens(32, 16);
    let mut publisher = CameraTopic::publisher(&node, "psm1/endoscope", 32 * 16).unwrap();
    let mut subscriber = CameraTopic::subscriber(&node, "psm1/endoscope").unwrap();
    let publish = |publisher: &mut super::FramePublisher, n: u64| {
        let colour_byte = n.to_le_bytes()[0];
        publisher
            .publish_with(&header(n, intrinsics), |colour, _, _| {
                colour.fill(colour_byte)
            })
            .unwrap()
    };
    publish(&mut publisher, 1);
    let held = subscriber.newest().unwrap().unwrap();
    for n in 2..=50 {
        publish(&mut publisher, n);
    }
    let newest = subscriber.newest().unwrap().unwrap();
    assert_eq!(newest.header().sequence, 50);
    assert!(newest.colour().iter().all(|&byte| byte == 50));
    assert!(held.header().sequence == 1 && held.colour().iter().all(|&byte| byte == 1));
    publish(&mut publisher, 51);
    assert!(matches!(
        subscriber.newest(),
        Err(TopicError::TooManyHeld { .. })
    ));
    drop(held);
    assert_eq!(subscriber.newest().unwrap().unwrap().header().sequence, 51);
}

#[test]
fn chunk_keeps_every_bit_even_of_nans() {
    let node = node("chunk");
    let publisher = ChunkTopic::publisher(&node, "psm1").unwrap();
    let subscriber = ChunkTopic::subscriber(&node, "psm1").unwrap();
    let other_arm = ChunkTopic::subscriber(&node, "psm2").unwrap();
    assert!(subscriber.newest().unwrap().is_none());
    for sequence in 1..=3 {
        assert_eq!(publisher.publish(&busy_chunk(sequence)).unwrap(), 1);
    }
    let received = subscriber.newest().unwrap().unwrap();
    assert_eq!(chunk_bits(&received), chunk_bits(&busy_chunk(3)));
    assert!(subscriber.newest().unwrap().is_none());
    assert!(other_arm.newest().unwrap().is_none());
}

#[test]
fn late_reader_gets_the_newest_value_once() {
    let node = node("late");
    let publisher = RunControlTopic::publisher(&node, "psm1").unwrap();
    publisher
        .publish(&RunControl::new(TimeNs(1), 1, RunCommand::Wait))
        .unwrap();
    let wish = RunControl::new(TimeNs(2), 4, RunCommand::Run { seed: u64::MAX });
    publisher.publish(&wish).unwrap();
    let late = RunControlTopic::subscriber(&node, "psm1").unwrap();
    publisher.keep_alive().unwrap();
    let received = late.newest().unwrap().unwrap();
    assert_eq!(
        (received, received.command()),
        (wish, Some(RunCommand::Run { seed: u64::MAX }))
    );
    assert!(late.newest().unwrap().is_none());
}

#[test]
fn arm_report_gives_back_state_and_tip_bit_for_bit() {
    let node = node("arm");
    let publisher = ArmStateTopic::publisher(&node, "psm1").unwrap();
    let subscriber = ArmStateTopic::subscriber(&node, "psm1").unwrap();
    let mut state = ArmState::at_rest(
        TimeNs(77),
        JointVector::new(0.1, -0.2, 0.12, 3.0, -1.0, 1.0 / 3.0),
        0.4,
    );
    state.velocity[2] = -0.0;
    state.effort[5] = 1e-300;
    let tip = Pose::new([0.1, 0.2, 0.3].into(), [0.3, -0.7, 2.9].into());
    publisher.publish(&ArmReport::new(9, &state, &tip)).unwrap();
    let report = subscriber.newest().unwrap().unwrap();
    assert_eq!(
        (report.state(), report.tip_in_rcm(), report.sequence),
        (state, tip, 9)
    );
    assert!(report.state().velocity[2].is_sign_negative());
}

/// A reader that was busy finds the arm of the instant of a frame that took time; of a chunk it
/// finds only the newest.
#[test]
fn the_newest_reports_of_an_arm_are_kept_for_a_busy_reader() {
    let node = node("kept");
    let publisher = ArmStateTopic::publisher(&node, "psm1").unwrap();
    let subscriber = ArmStateTopic::subscriber(&node, "psm1").unwrap();
    let kept = ArmReport::UNREAD as u64;
    for step in 0..kept + 3 {
        let state = ArmState::at_rest(TimeNs(step), JointVector::zeros(), 0.0);
        let report = ArmReport::new(step, &state, &Pose::identity());
        publisher.publish(&report).unwrap();
    }
    let mut steps = Vec::new();
    while let Some(report) = subscriber.next_unread().unwrap() {
        steps.push(report.sequence);
    }
    assert_eq!(steps, (3..kept + 3).collect::<Vec<_>>());
    assert_eq!(<Chunk as Message>::UNREAD, 1);
}

#[test]
fn status_and_control_decode_what_was_said() {
    for stage in [
        PolicyStage::Loading,
        PolicyStage::Ready,
        PolicyStage::Failed,
    ] {
        assert_eq!(PolicyStatus::new(1, 2, stage, 3, 4).stage(), stage);
    }
    for command in [
        RunCommand::Wait,
        RunCommand::Run { seed: 5 },
        RunCommand::Stop,
    ] {
        assert_eq!(
            RunControl::new(TimeNs(0), 1, command).command(),
            Some(command)
        );
    }
}

#[test]
fn second_publisher_and_oversized_frame_are_refused() {
    let node = node("refuse");
    let first = CameraTopic::publisher(&node, "psm1/endoscope", 16).unwrap();
    let second = CameraTopic::publisher(&node, "psm1/endoscope", 16).unwrap_err();
    assert!(
        matches!(second, TopicError::AlreadyPublished { .. }),
        "{second}"
    );
    let too_large = first.loan(&header(1, lens(5, 4))).unwrap_err();
    assert!(
        matches!(
            too_large,
            TopicError::FrameTooLarge {
                capacity: 16,
                pixels: 20,
                ..
            }
        ),
        "{too_large}"
    );
    let huge = CameraTopic::publisher(&node, "psm1/huge", 1 << 36).unwrap_err();
    assert!(
        matches!(huge, TopicError::SharedMemoryTooSmall { .. }),
        "{huge}"
    );
    assert!(matches!(
        TopicNode::join("a b"),
        Err(TopicError::BadName { .. })
    ));
}

/// Cameras draw what the run has shown, those that come late the newest, and pages ask for theirs
/// on a topic of their own.
#[test]
fn a_snapshot_arrives_whole() {
    let node = node("snapshot");
    let publisher = SnapshotTopic::publisher(&node, "psm1").unwrap();
    let pages = SnapshotTopic::publisher(&node, "console").unwrap();
    let mut sent = SnapshotReport {
        stamp: TimeNs(7),
        sequence: 3,
        seed: u64::MAX,
        wanted: 0b101,
        arm_count: 2,
        has_flap: 1,
        ..SnapshotReport::default()
    };
    sent.arms[1].tip.position_m = [0.1, f64::NEG_INFINITY, -0.0];
    sent.flap.nodes_m[207] = [1.0, f32::MIN_POSITIVE, -2.0];
    publisher.publish(&sent).unwrap();
    let late = SnapshotTopic::subscriber(&node, "psm1").unwrap();
    let other = SnapshotTopic::subscriber(&node, "console").unwrap();
    publisher.keep_alive().unwrap();
    pages.keep_alive().unwrap();
    assert_eq!(late.newest().unwrap(), Some(sent));
    assert_eq!(other.newest().unwrap(), None);
}

#[test]
fn runs_do_not_meet() {
    let (one, two) = (node("meet-one"), node("meet-two"));
    let publisher = ChunkTopic::publisher(&one, "psm1").unwrap();
    let stranger = ChunkTopic::subscriber(&two, "psm1").unwrap();
    assert_eq!(publisher.publish(&busy_chunk(1)).unwrap(), 0);
    assert!(stranger.newest().unwrap().is_none());
}

/// Longer than any test may take, ns.
const NEVER_NS: u64 = 600_000_000_000;

#[test]
fn who_waits_is_woken_by_messages_and_frames() {
    let (node, other) = (node("events"), node("events"));
    let (events, idle) = (node.events().unwrap(), node.events().unwrap());
    let chunks = ChunkTopic::publisher(&other, "psm1").unwrap();
    let mut frames = CameraTopic::publisher(&other, "scope", 16).unwrap();
    // What came before is not lost.
    chunks.publish(&busy_chunk(1)).unwrap();
    events.wait(NEVER_NS);
    std::thread::scope(|scope| {
        scope.spawn(|| events.wait(NEVER_NS));
        frames.publish(&busy_frame(1, lens(4, 4))).unwrap();
    });
    // One that never wakes is told once and holds nobody up.
    for sequence in 0..5_000 {
        chunks.publish(&busy_chunk(sequence)).unwrap();
    }
    idle.wait(NEVER_NS);
    let nothing_more = std::time::Duration::from_millis(20);
    idle.wait(nothing_more.as_nanos().try_into().unwrap());
}

/// A hello of a later version.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/policy_hello/2")]
struct LaterHello(PolicyHello);

impl Message for LaterHello {
    const TOPIC: &'static str = PolicyHello::TOPIC;
}

#[test]
fn a_message_of_another_version_is_refused_by_its_topic() {
    let node = node("versions");
    let _later = Topic::<LaterHello>::publisher(&node, "psm1").unwrap();
    let error = PolicyHelloTopic::subscriber(&node, "psm1").unwrap_err();
    assert!(matches!(error, TopicError::OtherType { .. }), "{error}");
    let named = format!("trocar/{}/psm1/policy_hello", run_id("versions"));
    assert!(error.to_string().contains(&named), "{error}");
}
