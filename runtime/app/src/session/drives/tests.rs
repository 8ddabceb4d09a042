//! Drives, their world and a master with the real controller in one thread and in virtual time:
//! what the processes do over real buses, without the machine's own delays.

use hal::{Arm as _, Chunk, TICK_NS, TimeNs};
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::master::{Bus, CanArm, CanConfig, Offline, Received, Space};
use trocar_canopen::{Frame, NodeId};
use trocar_drives::{Network, Terminal};
use trocar_tasks::expert::Expert;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::Outcome;

use super::bench::{Bench, Listener};
use super::inject::InjectedFault;
use super::page::DrivesPage;
use super::stops::{Stop, StopCause};
use crate::console::Console;
use crate::mailbox::mailbox;
use crate::session::source::STEP_TICKS;
use crate::session::world_report::WorldState;
use crate::session::{PolicyChoice, Setup};
use hal::PerArm;
use trocar_control::{AnyController, OperatorEvent, TickInput};

const MS_NS: u64 = 1_000_000;

/// What the bench reported.
#[derive(Debug, Default)]
struct Notes {
    stops: Vec<Stop>,
    injected: usize,
    begun: usize,
    steps: Vec<u64>,
    off: Vec<u8>,
}

impl Listener for Notes {
    fn stopped(&mut self, stop: Stop) {
        self.stops.push(stop);
    }

    fn injected(&mut self, _place: usize) {
        self.injected += 1;
    }

    fn begun(&mut self, _at: TimeNs) {
        self.begun += 1;
    }

    fn step(&mut self, sequence: u64, _world: &WorldState, _simulation: &Simulation) {
        self.steps.push(sequence);
    }

    fn bus_off(&mut self, line: u8) {
        self.off.push(line);
    }
}

/// The drives' buses with the world behind them.
struct WorldBus {
    network: Network<Terminal>,
    bench: Bench,
    notes: Notes,
}

impl WorldBus {
    fn world(&self) -> WorldState {
        self.bench.world(&self.network).unwrap()
    }
}

impl Bus for WorldBus {
    fn now(&self) -> TimeNs {
        self.network.now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        self.network.send(line, frames)
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.network.receive(line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.network.flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        let mut at = TimeNs::from_tick(self.now().tick() + 1);
        while at <= until {
            self.network.advance(at);
            self.bench
                .step(at, &mut self.network, &mut self.notes)
                .unwrap();
            at = at.plus_ns(TICK_NS);
        }
        self.network.advance(until);
    }
}

/// An enabled arm with the controller and the expert.
struct Rig {
    arm: CanArm<WorldBus>,
    controller: AnyController,
    expert: Expert,
    now: TimeNs,
    ticks: u64,
    chunks: u64,
    faulted: bool,
}

impl Rig {
    fn new(space: Space, faults: &[&str]) -> Self {
        let setup = Setup::load("needle-lift", None, &PolicyChoice::Expert).unwrap();
        let mut can = CanConfig::load(&CanConfig::shipped()).unwrap();
        can.arms[0].plan.space = space;
        if space == Space::Actuator {
            let text = CanConfig::shipped()
                .text()
                .replace("\"joint\"", "\"actuator\"");
            can = CanConfig::load(&hal::config::Source::embedded("can.toml", &text)).unwrap();
        }
        let faults: Vec<InjectedFault> = faults.iter().map(|text| text.parse().unwrap()).collect();
        let simulation = Simulation::new(&setup.task, 3, Rendering::Off).unwrap();
        let (bench, network) = Bench::new(Some(simulation), (&can, 1), &faults).unwrap();
        let bus = WorldBus {
            network,
            bench,
            notes: Notes::default(),
        };
        let mut arm = Offline::new(bus, &can.arms[0].plan)
            .and_then(Offline::scan)
            .and_then(|arm| arm.check_identity())
            .and_then(|arm| arm.map())
            .and_then(|arm| arm.home())
            .and_then(|arm| arm.enable())
            .unwrap();
        let now = TimeNs::from_tick(arm.bus_mut().now().tick());
        Self {
            arm,
            controller: setup.controller().unwrap(),
            expert: Expert::new(&setup.task, 3),
            now,
            ticks: 0,
            chunks: 0,
            faulted: false,
        }
    }

    fn bus(&mut self) -> &mut WorldBus {
        self.arm.bus_mut()
    }

    fn outcome(&mut self) -> Outcome {
        self.bus().world().outcome.unwrap()
    }

    /// One control period, with a chunk of the expert when it is time for one.
    fn tick(&mut self) {
        self.now = self.now.plus_ns(TICK_NS);
        let now = self.now;
        self.arm.bus_mut().wait(now);
        let measured = self.arm.read(now);
        let chunk: Option<Chunk> = self.ticks.is_multiple_of(STEP_TICKS).then(|| {
            self.chunks += 1;
            let scene = self.arm.bus_mut().world().scene;
            self.expert.chunk(now, &scene, self.chunks)
        });
        let input = TickInput {
            now,
            measured,
            chunk: chunk.as_ref(),
            operator: (self.ticks == 0).then_some(OperatorEvent::Enable),
        };
        let outputs = self.controller.tick(&PerArm::one(input));
        self.faulted |= outputs.first.report.fault.is_some();
        let _told = self.arm.write(&outputs.first.command, &outputs.first.tail);
        self.ticks += 1;
    }

    fn ticks(&mut self, count: u64) {
        for _ in 0..count {
            self.tick();
        }
    }

    fn run(&mut self) -> Outcome {
        for _ in 0..30_000 {
            self.tick();
            if self.faulted || !matches!(self.outcome(), Outcome::Running) {
                break;
            }
        }
        self.outcome()
    }
}

/// The needle is lifted over CAN in joint and in actuator space.
#[test]
fn needle_is_lifted_over_can_in_both_spaces() {
    for space in [Space::Joint, Space::Actuator] {
        let mut rig = Rig::new(space, &[]);
        assert_eq!(
            rig.run(),
            Outcome::Success,
            "{space:?}: {:?}",
            rig.arm.fault()
        );
        assert_eq!(rig.arm.refused(), 0, "{space:?}");
        let notes = &rig.bus().notes;
        assert_eq!((notes.begun, notes.stops.len()), (1, 0), "{space:?}");
        assert!(notes.steps.windows(2).all(|pair| pair[1] == pair[0] + 1));
    }
}

/// Whenever the master dies all axes rest within 50 ms of the last SYNC and say why.
#[test]
fn axes_rest_within_50_ms_of_a_dead_master() {
    let moments = [700, 1000, 1500, 2200, 4300];
    let moving = moments.into_iter().filter(|ticks| dies_after(*ticks));
    assert!(moving.count() >= 3, "of these most are in mid-motion");
}

/// Whether the arm was moving when its master died.
fn dies_after(ticks: u64) -> bool {
    let mut rig = Rig::new(Space::Joint, &[]);
    rig.ticks(ticks);
    let end = rig.now.plus_ns(200 * MS_NS);
    rig.bus().wait(end);
    let stops = &rig.bus().notes.stops;
    assert_eq!(stops.len(), 7);
    let moved = |stop: &Stop| stop.after_sync_ns().is_some_and(|(_, rest_ns)| rest_ns > 0);
    for stop in stops {
        let StopCause::Error(code) = stop.cause else {
            panic!("{:?}", stop.cause);
        };
        let lost = [ErrorCode::SYNC_CONTROLLER, ErrorCode::RPDO_TIMEOUT];
        assert!(lost.contains(&code), "{code:?}");
        let (stopped_ns, rest_ns) = stop.after_sync_ns().unwrap();
        assert!(stopped_ns <= 25 * MS_NS, "{ticks}: {stopped_ns}");
        assert!(rest_ns <= 50 * MS_NS, "{ticks}: {rest_ns}");
    }
    stops.iter().any(moved)
}

#[test]
fn a_pulled_node_stops_the_others_and_is_named() {
    let mut rig = Rig::new(Space::Joint, &["kind=pull,node=3,at=500ms"]);
    rig.ticks(1200);
    assert!(rig.faulted);
    let fault = rig.arm.fault().unwrap();
    assert_eq!(fault.who().unwrap().node.raw(), 3, "{fault}");
    let notes = &rig.bus().notes;
    assert_eq!((notes.injected, notes.stops.len()), (1, 7));
    for stop in &notes.stops {
        let expected = if stop.node.raw() == 3 {
            StopCause::Powerless
        } else {
            StopCause::QuickStop
        };
        assert_eq!(stop.cause, expected, "node {}", stop.node);
    }
}

/// The page names every drive's state, and the load of the bus.
#[test]
fn a_page_is_told_of_every_drive_and_bus() {
    let console = Console::open("127.0.0.1:0".parse().unwrap()).unwrap();
    let names = vec!["can0".to_owned()];
    let (_, unused) = mailbox();
    let mut page = DrivesPage::new(console, unused, [Space::Joint].into_iter(), names);
    let mut rig = Rig::new(Space::Joint, &["kind=pull,node=3,at=1500ms"]);
    let mut told = |rig: &mut Rig| {
        let WorldBus { network, bench, .. } = rig.bus();
        let seen = bench.seen(network, 1);
        page.told(&seen, &["a line"])
    };
    told(&mut rig);
    rig.ticks(1200);
    let news = told(&mut rig);
    let axes = news["arms"][0]["axes"].as_array().unwrap();
    assert_eq!(axes.len(), 7);
    for axis in axes {
        assert_eq!(axis["state"], "operation enabled", "{axis}");
        assert_eq!(axis["nmt"], "operational");
        assert_eq!(axis["mode"], "cyclic position");
        let apart = axis["position"].as_f64().unwrap() - axis["wanted"].as_f64().unwrap();
        assert!(apart.abs() < 0.1, "{axis}");
    }
    let load = news["buses"][0]["load"].as_f64().unwrap();
    assert!((0.2..1.0).contains(&load), "{load}");
    assert_eq!(news["happened"][0]["text"], "a line");
    rig.ticks(1000);
    let news = told(&mut rig);
    let axes = news["arms"][0]["axes"].as_array().unwrap();
    let of = |node: u8| axes.iter().filter(move |axis| axis["node"] == node);
    assert_eq!(of(3).count(), 0);
    let dead = axes.iter().find(|axis| axis["node"].is_null()).unwrap();
    assert_eq!(
        (&dead["state"], &dead["wanted"]),
        (&"no power".into(), &serde_json::Value::Null)
    );
    assert!(of(4).all(|axis| axis["state"] != "operation enabled"));
}

#[test]
fn every_other_injected_fault_stops_the_arm_with_its_cause() {
    for (kind, expected) in [
        (
            "emcy,code=0x4310",
            "node 3 (axis 2, bus 0): emergency 4310h",
        ),
        ("following-error", "node 3 (axis 2, bus 0): emergency 8611h"),
        ("reboot", "node 3 (axis 2, bus 0): was reset while in use"),
        ("silence", "node 3 (axis 2, bus 0): no process data for"),
        ("short", "node 3 (axis 2, bus 0): process data of"),
        ("garbage", "node 3 (axis 2, bus 0): "),
        ("no-heartbeat", "node 3 (axis 2, bus 0): no heartbeat"),
        ("foreign-master", "bus 0: another node sends 080h"),
    ] {
        let mut rig = Rig::new(Space::Joint, &[&format!("node=3,at=50ms,kind={kind}")]);
        rig.ticks(600);
        let fault = rig.arm.fault().map(|fault| fault.to_string());
        let fault = fault.unwrap_or_default();
        assert!(fault.starts_with(expected), "{kind}: {fault}");
        assert!(rig.faulted, "{kind}");
        let torque = (1..=7).any(|raw| {
            let node = NodeId::new(raw).unwrap();
            let network = &rig.bus().network;
            network.node(node).unwrap().power_state().has_torque()
        });
        // Half a second after the fault nothing has torque any more.
        rig.ticks(400);
        let later = (1..=7).any(|raw| {
            let node = NodeId::new(raw).unwrap();
            let network = &rig.bus().network;
            network.node(node).unwrap().power_state().has_torque()
        });
        assert!(!later, "{kind}: torque before {torque}, and still");
    }
}

#[test]
fn a_short_silence_is_bridged() {
    let mut rig = Rig::new(Space::Joint, &["kind=silence,node=3,at=50ms,for=4ms"]);
    rig.ticks(300);
    assert_eq!(rig.arm.fault(), None);
    assert!(!rig.faulted);
    assert!(rig.bus().notes.stops.is_empty());
}

/// Two faults begin together; the end of the shorter one leaves the other.
#[test]
fn overlapping_faults_last_until_the_last_one_ends() {
    let faults = [
        "kind=silence,node=3,at=50ms",
        "kind=silence,node=3,at=50ms,for=4ms",
    ];
    let mut rig = Rig::new(Space::Joint, &faults);
    rig.ticks(300);
    assert!(rig.faulted);
    assert_eq!(rig.bus().notes.injected, 2);
}

#[test]
fn a_bus_off_is_for_the_process_to_tell() {
    let mut rig = Rig::new(Space::Joint, &["kind=bus-off,node=3,at=20ms"]);
    rig.ticks(50);
    assert_eq!(rig.bus().notes.off, [0]);
}

/// An axis whose motor slipped stays behind and the controller notices.
#[test]
fn slipped_motor_is_noticed_by_the_controller() {
    let mut rig = Rig::new(Space::Joint, &["kind=slack,node=3,at=0ms"]);
    let outcome = rig.run();
    assert!(
        rig.faulted || matches!(outcome, Outcome::Failure(_)),
        "{outcome:?}"
    );
    assert_ne!(outcome, Outcome::Success);
}
