//! The master and the emulated drives on a real bus: the kernel's sockets between two threads.
//!
//! `make test-can` runs these where the interfaces are, which is why a plain `cargo test` leaves
//! them out.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "can_bus/direct.rs"]
mod direct;
#[path = "can_bus/two_arms.rs"]
mod two_arms;

use std::cell::Cell;
use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use hal::{Arm, ArmCommand, JointVector, SafeTail, TimeNs};
use trocar_canopen::master::{
    ArmPlan, AxisPlan, Bus, CanArm, ControllerEvent, Fault, Offline, Received, Space,
};
use trocar_canopen::socket::{Clock, SocketBus};
use trocar_canopen::{CanId, Frame, NodeId, Payload};
use trocar_drives::dictionary::table::PRODUCT_CODE;
use trocar_drives::node::{AxisConfig, Node};
use trocar_drives::{Demand, Feedback, Motor, Network, Station};

const MS: u64 = 1_000_000;
const COUNTS: f64 = 1e5;

/// What the drives may ask of their motors, counts/s.
const SPEED_MAX: u32 = 400_000;

/// A bus carries everybody's frames: one test at a time.
///
/// # Panics
/// Without a CAN interface: where there is no bus no test of it may pass.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    let interfaces = fs::read_to_string("/proc/self/net/dev").unwrap();
    for name in ["vcan0", "vcan1", "vcan2"] {
        assert!(
            interfaces.contains(&format!("{name}:")),
            "there is no CAN interface {name} here: run `make test-can`, or this under .ci/with-vcan, which makes one"
        );
    }
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file of the repository.
fn file(path: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "..", "..", path]
        .iter()
        .collect()
}

/// Real time since the test began.
#[derive(Clone, Copy, Debug)]
struct Real(Instant);

impl Real {
    #[expect(clippy::disallowed_methods, reason = "a real bus has a real clock")]
    fn start() -> Self {
        Self(Instant::now())
    }
}

impl Clock for Real {
    fn now(&self) -> TimeNs {
        TimeNs(u64::try_from(self.0.elapsed().as_nanos()).unwrap())
    }

    #[expect(clippy::disallowed_methods, reason = "a real bus has a real clock")]
    fn wait(&mut self, until: TimeNs) {
        thread::sleep(Duration::from_nanos(until.since(self.now())));
    }
}

fn socket(name: &str) -> SocketBus<Real> {
    SocketBus::open(&[name.to_owned()], Real::start()).unwrap()
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(CanId::new(id).unwrap(), Payload::new(data).unwrap())
}

/// Waits for `count` things on the bus.
fn receive(bus: &mut SocketBus<Real>, count: usize) -> Vec<Received> {
    let mut all = Vec::new();
    while all.len() < count {
        bus.receive(0, &mut |received| all.push(received));
        let later = bus.now().plus_ns(MS);
        bus.wait(later);
    }
    all
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn frames_cross_in_batches_and_in_order() {
    let _turn = alone();
    let (mut a, mut b) = (socket("vcan1"), socket("vcan1"));
    let frames: Vec<Frame> = (0..50).map(|n| frame(0x100 + n, &[1, 2, 3])).collect();
    assert_eq!(a.send(0, &frames), 50);
    let received = receive(&mut b, 50);
    let expected: Vec<Received> = frames.into_iter().map(Received::Frame).collect();
    assert_eq!(received, expected);
    // A socket does not hear itself.
    let mut own = 0;
    a.receive(0, &mut |_| own += 1);
    assert_eq!(own, 0);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn a_slow_reader_is_told_how_many_frames_it_missed() {
    let _turn = alone();
    let (mut a, mut b) = (socket("vcan1"), socket("vcan1"));
    for n in 0..4000 {
        a.send(0, &[frame(0x123, &u16::to_le_bytes(n))]);
    }
    let (frames, lost) = (Cell::new(0), Cell::new(0));
    let mut count = |received: Received| match received {
        Received::Frame(_) => frames.set(frames.get() + 1),
        Received::ControllerEvent(ControllerEvent::Lost(n)) => lost.set(lost.get() + n),
        Received::ControllerEvent(_) => {}
    };
    b.receive(0, &mut count);
    // The count comes with the first frame that is queued after the loss.
    a.send(0, &[frame(0x123, &[])]);
    for _ in 0..10_000 {
        b.receive(0, &mut count);
        if frames.get() + lost.get() == 4001 {
            break;
        }
        let later = b.now().plus_ns(1_000_000);
        b.wait(later);
    }
    let (frames, lost) = (frames.get(), lost.get());
    assert!(lost > 0 && frames + lost == 4001, "{frames} {lost}");
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn error_frames_of_the_kernel_are_heard_as_trouble() {
    let _turn = alone();
    let mut bus = socket("vcan1");
    let sent = Command::new("cansend")
        .args(["vcan1", "20000040#0000000000000000"])
        .status()
        .unwrap();
    assert!(sent.success());
    assert_eq!(
        receive(&mut bus, 1),
        [Received::ControllerEvent(ControllerEvent::BusOff)]
    );
}

fn node(axis: u8) -> NodeId {
    NodeId::new(axis + 1).unwrap()
}

/// Seven axes of drives that say they are `identity`, on a slow SYNC: python, and every system call
/// inside user-mode Linux, take their time. Our own drives interpolate for 20 ms at most.
fn plan(identity: (u32, u32), cycle_ms: u64) -> ArmPlan {
    ArmPlan {
        lines: 1,
        bit_rate: 1_000_000,
        cycle_ns: cycle_ms * MS,
        sync_id: CanId::new(0x80).unwrap(),
        sync_counter: 0,
        master: NodeId::new(127).unwrap(),
        heartbeat_ms: 1000,
        brake_ns: 0,
        homing: [None; 7],
        space: Space::Joint,
        axes: core::array::from_fn(|axis| AxisPlan {
            node: node(u8::try_from(axis).unwrap()),
            line: 0,
            identity,
            counts_per_unit: COUNTS,
            counts_per_turn: 10_000,
            range: (-5.0, 5.0),
            speed_max: 2.0,
            following_max: 0.1,
            torque_rated: 1.0,
        }),
    }
}

/// Emulated drives, seven for each arm, on the first bus in a thread of their own.
struct Drives {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<[f64; 7]>>,
}

impl Drives {
    fn start() -> Self {
        Self::of_arms(&[0])
    }

    /// Drives of arms whose nodes begin behind the given numbers.
    fn of_arms(arms: &'static [u8]) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stop);
        // The socket is there before anybody is told that the drives are.
        let bus = socket("vcan0");
        let thread = Some(thread::spawn(move || emulate(bus, arms, &told)));
        Self { stop, thread }
    }

    /// Ends them, and tells where their motors are.
    fn finish(mut self) -> [f64; 7] {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Drives {
    /// Of a test that fails nobody is left on the bus.
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _failed = thread.join();
        }
    }
}

/// Follows its demand at no more than three quarters of the speed that the drives may ask for.
#[derive(Clone, Copy, Default)]
struct SlowMotor {
    position_counts: f64,
}

impl Motor for SlowMotor {
    fn step(&mut self, step_ns: u64, demand: &Demand) -> Feedback {
        let step_s = TimeNs(step_ns).seconds();
        let before = self.position_counts;
        if demand.torque {
            let reach = 0.75 * f64::from(SPEED_MAX) * step_s;
            self.position_counts += (demand.position_counts - before).clamp(-reach, reach);
        }
        Feedback {
            position_counts: self.position_counts,
            velocity_counts_s: (self.position_counts - before) / step_s,
            torque_per_mille: 0.0,
        }
    }
}

fn emulate(bus: SocketBus<Real>, arms: &[u8], stop: &AtomicBool) -> [f64; 7] {
    let mut net: Network<SlowMotor> = Network::new(1, 1_000_000, 1000);
    for axis in arms
        .iter()
        .flat_map(|arm| (0..7).map(move |axis| arm + axis))
    {
        let config = AxisConfig {
            range: (-500_000, 500_000),
            speed_max: SPEED_MAX,
            following_window: 5_000,
            ..AxisConfig::default()
        };
        net.add(0, Node::new(node(axis), &config), SlowMotor::default());
    }
    let mut station = Station::new(net, bus, 1);
    while !stop.load(Ordering::Relaxed) {
        let later = station.turn().plus_ns(MS / 2);
        station.bus_mut().wait(later);
    }
    assert_eq!(station.lost(), 0);
    core::array::from_fn(|axis| {
        let id = node(u8::try_from(axis).unwrap());
        station.network_mut().motor(id).unwrap().position_counts / COUNTS
    })
}

/// Brings the drives up and moves all axes from 0 to 0.12; gives the arm, the time, and where axis
/// 3 is measured.
fn lead(identity: (u32, u32), cycle_ms: u64) -> (CanArm<SocketBus<Real>>, TimeNs, f64) {
    let plan = plan(identity, cycle_ms);
    let scanned = Offline::new(socket("vcan0"), &plan)
        .unwrap()
        .scan()
        .unwrap();
    let mapped = scanned.check_identity().unwrap().map().unwrap();
    let mut arm = mapped.home().unwrap().enable().unwrap();
    let mut at = arm.bus_mut().now();
    let (mut wanted, mut measured) = (0.0, 0.0);
    for _ in 0..60 {
        at = at.plus_ns(plan.cycle_ns);
        arm.bus_mut().wait(at);
        measured = arm.read(at).unwrap().position[3];
        wanted += 0.002;
        let command = ArmCommand {
            stamp: at,
            position: JointVector::repeat(wanted),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: wanted,
            jaw_velocity: 0.0,
            enabled: true,
        };
        arm.write(&command, &SafeTail::hold(&command)).unwrap();
        arm.send_before(at.plus_ns(plan.cycle_ns));
    }
    (arm, at, measured)
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn our_master_leads_our_drives_and_stops_them_at_bus_off() {
    let _turn = alone();
    let drives = Drives::start();
    let (mut arm, mut at, measured) = lead((0, PRODUCT_CODE), 20);
    assert!((0.11..0.12).contains(&measured), "{measured}");
    let error = |class: &str| {
        let frame = format!("{class}#0000000000000000");
        let sent = Command::new("cansend").args(["vcan0", &frame]).status();
        assert!(sent.unwrap().success());
    };
    error("20000040");
    for _ in 0..4 {
        at = at.plus_ns(50 * MS);
        arm.bus_mut().wait(at);
        let _ = arm.read(at);
    }
    assert_eq!(arm.fault(), Some(Fault::BusOff { line: 0 }));
    arm.bus_mut().wait(at.plus_ns(1000 * MS));
    // That it is back waits in our socket, and a new bring-up knows it for over.
    error("20000100");
    let again = Offline::new(arm.release(), &plan((0, PRODUCT_CODE), 20));
    assert!(again.unwrap().scan().is_ok());
    let motors = drives.finish();
    assert!(
        motors.iter().all(|m| (0.11..0.13).contains(m)),
        "{motors:?}"
    );
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn our_master_leads_drives_written_in_python() {
    let _turn = alone();
    let mut peer = Command::new("python3")
        .arg(file("tests/can/peer_drive.py"))
        .arg("--eds")
        .arg(file("tests/can/peer_drive.eds"))
        .args(["--nodes", "1,2,3,4,5,6,7"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let output = peer.stdout.as_mut().unwrap();
    BufReader::new(output).read_line(&mut line).unwrap();
    assert_eq!(line, "ready\n");
    let (arm, _, measured) = lead((0, 0x402), 50);
    let _bus = arm.release();
    peer.kill().unwrap();
    peer.wait().unwrap();
    assert!((0.11..0.12).contains(&measured), "{measured}");
}

/// A master written in Python leads our drives by their data sheet and Wireshark agrees.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn python_master_commands_our_drives_by_their_eds() {
    let _turn = alone();
    let capture = std::env::temp_dir().join(format!("trocar-{}.log", std::process::id()));
    let log = std::fs::File::create(&capture).unwrap();
    let mut dump = Command::new("candump")
        .args(["-L", "vcan0"])
        .stdout(log)
        .spawn()
        .unwrap();
    let drives = Drives::start();
    let master = Command::new("python3")
        .arg(file("tests/can/master.py"))
        .arg("--eds")
        .arg(file("config/eds/trocar_drive.eds"))
        .args(["--nodes", "1,2,7", "--period", "0.02"])
        // A set-point takes effect at the next SYNC and is reached a period later, so the drive is
        // between two of the last.
        .args(["--tolerance", "300"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&master.stdout).into_owned()
        + &String::from_utf8_lossy(&master.stderr);
    assert!(master.status.success(), "{said}");
    drives.finish();
    dump.kill().unwrap();
    dump.wait().unwrap();
    let filter = "_ws.malformed || _ws.expert";
    let dissected = Command::new("tshark")
        .args(["-d", "can.subdissector,canopen", "-Y", filter, "-r"])
        .arg(&capture)
        .output()
        .unwrap();
    let frames = std::fs::read_to_string(&capture).unwrap().lines().count();
    std::fs::remove_file(&capture).unwrap();
    assert!(
        dissected.status.success() && frames > 1000,
        "{frames} frames"
    );
    assert_eq!(String::from_utf8_lossy(&dissected.stdout), "");
}
