//! The control thread's end of a log with a bound: it hands over the controller's state now and
//! then.

use std::error::Error;

use hal::{ArmState, Chunk, JointVector, PerArm, TimeNs, TipTarget};
use nalgebra::Translation3;
use tests::scratch;
use trocar::rt::thread_allocations;
use trocar_control::aggregate::Aggregation;
use trocar_control::kinematics::forward;
use trocar_control::{AnyController, ControlConfig, OperatorEvent, TickInput};
use trocar_log::{Pressure, Recorder, RunHeader, TickRecord, TickTiming, Writing};

use super::{HOME, one_arm, two_arms};

/// A chunk every policy step, so that as many as there can be overlap.
fn chunk(now: TimeNs, sequence: u64) -> Chunk {
    let home = forward(&JointVector::from(HOME));
    let side = if (sequence / 25).is_multiple_of(2) {
        0.01
    } else {
        -0.01
    };
    let target = TipTarget::new(&(Translation3::new(side, 0.0, 0.0) * home), 0.3);
    Chunk::new(now, sequence, 40_000_000, &[target; 128])
}

fn allocates_nothing(name: &str, config: &ControlConfig) -> Result<(), Box<dyn Error>> {
    let mut controller = AnyController::new(config)?;
    let path = scratch("no_alloc-log").join(name);
    let writing = Writing {
        bytes_max: Some(16 << 20),
        ..Writing::new(Pressure::Drop)
    };
    let recorder = Recorder::create_with(&path, &RunHeader::default(), writing)?;
    let (mut log, side, scenes, file) = recorder.split();
    let state = ArmState::at_rest(TimeNs(0), JointVector::from(HOME), 0.2);
    let mut arms = match controller.arm_count() {
        1 => PerArm::one(state),
        _ => PerArm::two(state, state),
    };
    for tick in 0..8000 {
        let now = TimeNs::from_tick(tick);
        let newest = tick.is_multiple_of(40).then(|| chunk(now, tick / 40 + 1));
        let inputs = arms.map(|mut arm| {
            arm.stamp = now;
            TickInput {
                now,
                measured: Ok(arm),
                chunk: newest.as_ref(),
                operator: (tick == 0).then_some(OperatorEvent::Enable),
            }
        });
        let outputs = controller.tick(&inputs);
        let record = TickRecord::new(tick, inputs, outputs, TickTiming::default());
        let before = thread_allocations();
        if let Some(chunk) = &newest {
            for arm in 0..arms.count() {
                log.chunk(arm, chunk);
            }
        }
        log.tick(&record);
        log.snapshot(&controller);
        assert_eq!(thread_allocations() - before, 0, "{name}, tick {tick}");
        arms = arms.zip(outputs).map(|(mut arm, output)| {
            arm.position = output.command.position;
            arm.velocity = output.command.velocity;
            arm.jaw_position = output.command.jaw_position;
            arm
        });
    }
    drop((log, side, scenes));
    file.finish(None)?;
    Ok(())
}

#[test]
fn a_log_with_a_bound_allocates_nothing() -> Result<(), Box<dyn Error>> {
    for (name, config) in [("one.mcap", one_arm()?), ("two.mcap", two_arms()?)] {
        let config = ControlConfig {
            aggregation: Aggregation::Ensemble { decay: 0.01 },
            ..config
        };
        allocates_nothing(name, &config)?;
    }
    Ok(())
}
