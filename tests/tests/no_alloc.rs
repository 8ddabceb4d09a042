//! The tick takes no memory from the system allocator, but for what Clarabel takes in a solve.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::error::Error;

use hal::{ArmError, ArmState, Chunk, JointVector, Pose, TimeNs, TipTarget};
use nalgebra::Translation3;
use runtime::control::{
    ControlConfig, Controller, OperatorEvent, QpOutcome, TickInput, TickOutput,
};
use runtime::kinematics::forward;

/// The system allocator, counting what the current thread asks of it.
struct Counting;

thread_local! {
    static REQUESTS: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    REQUESTS.with(|requests| requests.set(requests.get() + 1));
}

#[expect(unsafe_code, reason = "an allocator can't be had without")]
// SAFETY: every call goes on to the system allocator unchanged; counting touches a thread-local cell without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A controller, an arm that is wherever it was told to be, and what the ticks asked of the allocator.
struct Rig {
    controller: Controller,
    arm: ArmState,
    tick: u64,
    sequence: u64,
}

const HOME: [f64; 6] = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0];

impl Rig {
    fn new() -> Result<Self, Box<dyn Error>> {
        let config = ControlConfig::load(
            &ControlConfig::default_control(),
            &ControlConfig::needle_lift_safety(),
        )?;
        let home = JointVector::from(HOME);
        let mut rig = Self {
            controller: Controller::new(&config)?,
            arm: ArmState::at_rest(TimeNs(0), home, 0.2),
            tick: 0,
            sequence: 0,
        };
        rig.tick(None, Some(OperatorEvent::Enable), None);
        Ok(rig)
    }

    /// One tick, and how often it asked for memory.
    fn tick(
        &mut self,
        chunk: Option<&Chunk>,
        operator: Option<OperatorEvent>,
        error: Option<ArmError>,
    ) -> (TickOutput, u64) {
        let now = TimeNs::from_tick(self.tick);
        self.arm.stamp = now;
        let measured = error.map_or(Ok(self.arm), Err);
        let before = REQUESTS.get();
        let output = self.controller.tick(&TickInput {
            now,
            measured,
            chunk,
            operator,
        });
        let requests = REQUESTS.get() - before;
        self.tick += 1;
        self.arm.position = output.command.position;
        self.arm.velocity = output.command.velocity;
        self.arm.jaw_position = output.command.jaw_position;
        (output, requests)
    }

    /// A chunk that wants the tip at `offset_m` from home, observed now.
    fn chunk(&mut self, offset_m: [f64; 3]) -> Chunk {
        self.sequence += 1;
        let home: Pose = forward(&JointVector::from(HOME));
        let target = TipTarget::new(&(Translation3::from(offset_m) * home), 0.3);
        Chunk::new(
            TimeNs::from_tick(self.tick),
            self.sequence,
            40_000_000,
            &[target; 50],
        )
    }
}

#[test]
fn a_tick_without_a_solve_takes_no_memory() {
    let mut rig = Rig::new().unwrap();
    for round in 0..200_u64 {
        let offset = if round.is_multiple_of(2) { 0.01 } else { -0.01 };
        let chunk = rig.chunk([offset, 0.0, 0.0]);
        for tick in 0..40 {
            let (output, requests) = rig.tick((tick == 0).then_some(&chunk), None, None);
            assert_eq!(output.report.qp, QpOutcome::NotNeeded);
            assert_eq!(requests, 0, "round {round}, tick {tick}");
        }
    }
    assert!(
        (rig.arm.position - JointVector::from(HOME)).norm() > 1e-4,
        "the arm has not moved"
    );
}

#[test]
fn clarabel_takes_memory_twice_a_solve_at_most() {
    let mut rig = Rig::new().unwrap();
    let (mut solves, mut most) = (0, 0);
    for _ in 0..200 {
        // Far below the floor of the workspace.
        let chunk = rig.chunk([0.0, 0.0, -0.058]);
        for tick in 0..40 {
            let (output, requests) = rig.tick((tick == 0).then_some(&chunk), None, None);
            match output.report.qp {
                QpOutcome::Solved { .. } => {
                    solves += 1;
                    most = most.max(requests);
                }
                QpOutcome::NotNeeded => assert_eq!(requests, 0),
                QpOutcome::Failed => panic!("the QP failed at tick {}", rig.tick),
            }
        }
    }
    assert!(solves > 100, "only {solves} ticks needed the QP");
    assert!(most <= 2, "a solve took memory {most} times");
}

#[test]
fn error_paths_take_no_memory() {
    let mut rig = Rig::new().unwrap();
    let mut nonsense = rig.chunk([0.005, 0.0, 0.0]);
    nonsense.targets[3].position_m[1] = f64::NAN;
    let (output, requests) = rig.tick(Some(&nonsense), None, None);
    assert!(
        output
            .report
            .gate
            .is_some_and(|verdict| !verdict.is_accepted())
    );
    assert_eq!(requests, 0, "a refused chunk");

    let (_, requests) = rig.tick(None, Some(OperatorEvent::Pause), None);
    assert_eq!(requests, 0, "a pause");
    let (output, requests) = rig.tick(None, None, Some(ArmError::MeasurementLost { age_ns: 1 }));
    assert!(output.report.fault.is_some());
    assert_eq!(requests, 0, "a lost measurement");
}
