//! The console's end of the control thread, with a server behind it.

use std::error::Error;

use hal::{ArmState, Chunk, JointVector, PerArm, TimeNs, TipTarget};
use nalgebra::Translation3;
use trocar::console::{Console, ControlTap, Facts};
use trocar_control::kinematics::forward;
use trocar_control::{AnyController, OperatorEvent, TickInput};
use trocar_log::{TickRecord, TickTiming};

use super::{HOME, one_arm};
use trocar::rt::thread_allocations;

/// A chunk that wants the tip below the floor of the workspace, observed at `now`; every third is
/// nonsense.
fn chunk(now: TimeNs, sequence: u64) -> Chunk {
    let side = if sequence.is_multiple_of(2) {
        0.01
    } else {
        -0.01
    };
    let home = forward(&JointVector::from(HOME));
    let mut target = TipTarget::new(&(Translation3::new(side, 0.0, -0.058) * home), 0.3);
    if sequence.is_multiple_of(3) {
        target.jaw = f64::NAN;
    }
    Chunk::new(now, sequence, 40_000_000, &[target; 50])
}

/// Hands a tick to `tap`; how often that allocated.
fn tapped(
    tap: &mut ControlTap,
    (chunk, record): (&Chunk, &TickRecord),
    controller: &AnyController,
) -> u64 {
    let before = thread_allocations();
    tap.chunk(&PerArm::one(*chunk), record.now.0);
    tap.tick(record, controller, record.tick / 100);
    thread_allocations() - before
}

#[test]
fn console_tap_allocates_nothing() -> Result<(), Box<dyn Error>> {
    let config = one_arm()?;
    let console = Console::open("127.0.0.1:0".parse()?)?;
    let facts = Facts::new("needle-lift", "random", 7, &config, Vec::new());
    let mut tap = console.show_run(facts, None).control;
    let mut controller = AnyController::new(&config)?;
    let mut state = ArmState::at_rest(TimeNs(0), JointVector::from(HOME), 0.2);
    let (mut corrected, mut refused) = (0, 0);
    for tick in 0..8000 {
        let now = TimeNs::from_tick(tick);
        state.stamp = now;
        let newest = tick.is_multiple_of(40).then(|| chunk(now, tick / 40 + 1));
        let operator = match tick % 2000 {
            0 => Some(OperatorEvent::Enable),
            1500 => Some(OperatorEvent::Pause),
            1700 => Some(OperatorEvent::Resume),
            1800 => Some(OperatorEvent::Speed { percent: 60 }),
            _ => None,
        };
        let inputs = PerArm::one(TickInput {
            now,
            measured: Ok(state),
            chunk: newest.as_ref(),
            operator,
        });
        let outputs = controller.tick(&inputs);
        let timing = TickTiming {
            wake_ns: tick,
            compute_ns: 10 * tick,
        };
        let record = TickRecord::new(tick, inputs, outputs, timing);
        let given = (&chunk(now, tick), &record);
        assert_eq!(tapped(&mut tap, given, &controller), 0, "tick {tick}");
        let report = &record.arms.first.report;
        corrected += u32::from(report.correction > 0.0);
        refused += u32::from(report.gate.is_some_and(|gate| !gate.is_accepted()));
        let command = outputs.first.command;
        state.position = command.position;
        state.velocity = command.velocity;
        state.jaw_position = command.jaw_position;
    }
    assert!(corrected > 500 && refused > 30, "{corrected} {refused}");
    console.close(None, "");
    Ok(())
}
