//! Topics within one process and between two.

use std::env;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};

use iceoryx2::prelude::ZeroCopySend;

use super::{
    ArmReport, ArmStateTopic, CameraTopic, ChunkTopic, FrameHeader, Message, PolicyHello,
    PolicyHelloTopic, PolicyStage, PolicyStatus, PolicyStatusTopic, RunCommand, RunControl,
    RunControlTopic, SnapshotReport, SnapshotTopic, Topic, TopicError, TopicNode,
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

/// Names the run to a test that plays the policy process; unset in an ordinary test run.
const PEER_RUN: &str = "TROCAR_TEST_PEER_RUN";

/// Starts this test executable again, as the policy process of run `run`.
fn start_peer(run: &str) -> (Child, BufReader<std::process::ChildStdout>) {
    start_as("tests::plays_the_policy_process", run)
}

/// Starts this test executable again for the test `role`, which plays a process of run `run`.
fn start_as(role: &str, run: &str) -> (Child, BufReader<std::process::ChildStdout>) {
    let mut child = Command::new(env::current_exe().unwrap())
        .args(["--exact", role, "--nocapture", "--test-threads=1"])
        .env(PEER_RUN, run)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut out = BufReader::new(child.stdout.take().unwrap());
    wait_for(&mut out, "peer ready");
    (child, out)
}

fn wait_for(out: &mut BufReader<std::process::ChildStdout>, text: &str) -> String {
    let mut line = String::new();
    while !line.contains(text) {
        line.clear();
        assert!(
            out.read_line(&mut line).unwrap() > 0,
            "the peer ended before it said '{text}'"
        );
    }
    line
}

/// For each line on standard input: reads the newest frame, and answers with a chunk that carries a
/// sum of it.
#[test]
fn plays_the_policy_process() {
    let Ok(run) = env::var(PEER_RUN) else {
        return;
    };
    let node = TopicNode::join(&run).unwrap();
    let mut frames = CameraTopic::subscriber(&node, "psm1/endoscope").unwrap();
    let chunks = ChunkTopic::publisher(&node, "psm1").unwrap();
    let status = PolicyStatusTopic::publisher(&node, "psm1").unwrap();
    status
        .publish(&PolicyStatus::new(1, 1, PolicyStage::Ready, 0, 0))
        .unwrap();
    let mut out = std::io::stdout();
    writeln!(out, "\npeer ready").unwrap();
    for line in std::io::stdin().lock().lines() {
        line.unwrap();
        let view = frames.newest().unwrap().unwrap();
        let mut chunk = busy_chunk(view.header().sequence);
        chunk.step_ns = digest(view.colour(), view.depth_m(), view.instance());
        chunks.publish(&chunk).unwrap();
        writeln!(out, "answered").unwrap();
    }
}

fn digest(colour: &[u8], depth_m: &[f32], instance: &[u8]) -> u64 {
    let words = colour.iter().chain(instance).map(|&byte| u64::from(byte));
    let words = words.chain(depth_m.iter().map(|depth| u64::from(depth.to_bits())));
    words.fold(0xcbf2_9ce4_8422_2325, |hash, word| {
        (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[test]
fn processes_exchange_frames_and_a_killed_one_is_replaced() {
    let run = run_id("two");
    let node = TopicNode::join(&run).unwrap();
    let intrinsics = lens(512, 512);
    let mut frames = CameraTopic::publisher(&node, "psm1/endoscope", 512 * 512).unwrap();
    let chunks = ChunkTopic::subscriber(&node, "psm1").unwrap();
    let (mut peer, mut out) = start_peer(&run);
    let exchange =
        |frames: &mut super::FramePublisher, peer: &mut Child, out: &mut BufReader<_>, sequence| {
            let frame = busy_frame(sequence, intrinsics);
            assert_eq!(frames.publish(&frame).unwrap(), 1);
            writeln!(peer.stdin.as_mut().unwrap()).unwrap();
            wait_for(out, "answered");
            let chunk = chunks.newest().unwrap().unwrap();
            assert_eq!(chunk.sequence, sequence);
            assert_eq!(
                chunk.step_ns,
                digest(&frame.colour, &frame.depth_m, &frame.instance)
            );
            let mut expected = busy_chunk(sequence);
            expected.step_ns = chunk.step_ns;
            assert_eq!(chunk_bits(&chunk), chunk_bits(&expected));
        };
    exchange(&mut frames, &mut peer, &mut out, 1);
    exchange(&mut frames, &mut peer, &mut out, 2);
    let status = PolicyStatusTopic::subscriber(&node, "psm1").unwrap();
    let taken = ChunkTopic::publisher(&node, "psm1").unwrap_err();
    assert!(
        matches!(taken, TopicError::AlreadyPublished { .. }),
        "{taken}"
    );

    // One that lives is waited for and then left alone; one that is killed is waited for until it
    // has let go.
    let moment = core::time::Duration::from_millis(20);
    assert!(!node.remove_dying(peer.id(), moment));
    peer.kill().unwrap();
    assert!(node.remove_dying(peer.id(), 1000 * moment));
    peer.wait().unwrap();
    let (mut successor, mut out) = start_peer(&run);
    exchange(&mut frames, &mut successor, &mut out, 3);
    assert_eq!(
        status.newest().unwrap().map(|message| message.stage()),
        Some(PolicyStage::Ready)
    );
    drop(successor.stdin.take());
    assert!(successor.wait().unwrap().success());
}

/// Shows a frame, and then holds another that it has written half of.
#[test]
fn plays_a_camera_that_stays_in_mid_sample() {
    let Ok(run) = env::var(PEER_RUN) else {
        return;
    };
    let node = TopicNode::join(&run).unwrap();
    let mut frames = CameraTopic::publisher(&node, "scope", 64 * 64).unwrap();
    frames.publish(&busy_frame(1, lens(64, 64))).unwrap();
    let mut loan = frames.loan(&header(2, lens(64, 64))).unwrap();
    loan.planes().1[..2048].fill(0.5);
    let mut out = std::io::stdout();
    writeln!(out, "\npeer ready").unwrap();
    let _until_killed = std::io::stdin().lock().lines().next();
}

/// A camera's process that is killed while it writes, and readers that hold what it wrote before.
#[test]
fn a_writer_killed_in_mid_sample_is_replaced() {
    let run = run_id("half");
    let node = TopicNode::join(&run).unwrap();
    let mut reader = CameraTopic::subscriber(&node, "scope").unwrap();
    let (mut camera, _out) = start_as("tests::plays_a_camera_that_stays_in_mid_sample", &run);
    let before = busy_frame(1, lens(64, 64));
    let mut view = None;
    while view.is_none() {
        view = reader.newest().unwrap();
    }
    camera.kill().unwrap();
    camera.wait().unwrap();
    let mut successor = CameraTopic::publisher(&node, "scope", 64 * 64).unwrap();
    assert!(reader.newest().unwrap().is_none(), "half a frame");
    let view = view.unwrap();
    assert_eq!(view.colour(), before.colour);
    assert_eq!(depth_bits(view.depth_m()), depth_bits(&before.depth_m));
    successor.publish(&busy_frame(3, lens(64, 64))).unwrap();
    assert_eq!(reader.newest().unwrap().unwrap().header().sequence, 3);
    assert!(node.remove_dying(camera.id(), core::time::Duration::from_secs(5)));
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

/// A process that is killed where it would be woken does not keep others from waking.
#[test]
fn who_waits_beside_a_dead_one_is_woken() {
    let run = run_id("deaf");
    let node = TopicNode::join(&run).unwrap();
    let mut frames = CameraTopic::publisher(&node, "psm1/endoscope", 16).unwrap();
    let (mut peer, _out) = start_as("tests::plays_a_process_that_waits", &run);
    peer.kill().unwrap();
    peer.wait().unwrap();
    let events = node.events().unwrap();
    frames.publish(&busy_frame(1, lens(4, 4))).unwrap();
    events.wait(NEVER_NS);
    assert!(node.remove_dying(peer.id(), core::time::Duration::from_secs(5)));
    frames.publish(&busy_frame(2, lens(4, 4))).unwrap();
    events.wait(NEVER_NS);
}

#[test]
fn plays_a_process_that_waits() {
    let Ok(run) = env::var(PEER_RUN) else {
        return;
    };
    let node = TopicNode::join(&run).unwrap();
    let events = node.events().unwrap();
    let mut out = std::io::stdout();
    writeln!(out, "\npeer ready").unwrap();
    loop {
        events.wait(NEVER_NS);
    }
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
