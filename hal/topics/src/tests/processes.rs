//! Topics between two processes, of which one is killed.

use std::env;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};

use super::*;
use crate::{FramePublisher, PolicyStatusTopic};

/// Names the run to a test that plays the policy process; unset in an ordinary test run.
const PEER_RUN: &str = "TROCAR_TEST_PEER_RUN";

/// Starts this test executable again, as the policy process of run `run`.
fn start_peer(run: &str) -> (Child, BufReader<std::process::ChildStdout>) {
    start_as("tests::processes::plays_the_policy_process", run)
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
        |frames: &mut FramePublisher, peer: &mut Child, out: &mut BufReader<_>, sequence| {
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
    let (mut camera, _out) = start_as(
        "tests::processes::plays_a_camera_that_stays_in_mid_sample",
        &run,
    );
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

/// A process that is killed where it would be woken does not keep others from waking.
#[test]
fn who_waits_beside_a_dead_one_is_woken() {
    let run = run_id("deaf");
    let node = TopicNode::join(&run).unwrap();
    let mut frames = CameraTopic::publisher(&node, "psm1/endoscope", 16).unwrap();
    let (mut peer, _out) = start_as("tests::processes::plays_a_process_that_waits", &run);
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
