//! An arm of your own behind the controller: anything that can be measured and given a set-point
//! once a millisecond.
//!
//! ```sh
//! cargo run -p trocar-control --example own_arm
//! ```
//!
//! This one follows its command with a delay of 5 ms. The crate has no clock, so that the caller
//! says what time it is: here time is counted, on a robot a real-time thread waits for each
//! millisecond.

use std::error::Error;

use hal::{
    Arm, ArmCommand, ArmError, ArmState, Chunk, JointVector, SafeTail, TICK_NS, TimeNs, TipTarget,
};
use nalgebra::Translation3;
use trocar_control::{ControlConfig, Controller, OperatorEvent, TickInput};

/// How much of the way to its command the arm goes in a tick: a lag of 5 ms.
const SHARE: f64 = 0.2;

/// An arm that lags behind its command.
struct Lagging {
    state: ArmState,
    command: Option<ArmCommand>,
}

impl Arm for Lagging {
    fn read(&mut self, now: TimeNs) -> Result<ArmState, ArmError> {
        self.state.stamp = now;
        if let Some(command) = &self.command {
            let moved = (command.position - self.state.position) * SHARE;
            self.state.position += moved;
            self.state.velocity = moved / (TimeNs(TICK_NS).seconds());
            self.state.jaw_position += (command.jaw_position - self.state.jaw_position) * SHARE;
        }
        Ok(self.state)
    }

    /// A real arm would play `tail` to rest if no further command came.
    fn write(&mut self, command: &ArmCommand, _tail: &SafeTail) -> Result<(), ArmError> {
        self.command = Some(*command);
        Ok(())
    }
}

/// Moves the tip by 1 cm within a second; how far it is from there in the end, m.
///
/// # Errors
/// From the configuration or the arm.
pub fn run() -> Result<f64, Box<dyn Error>> {
    let config = ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )?;
    let mut controller = Controller::<1>::new(&config)?;
    let home = JointVector::from([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
    let mut arm = Lagging {
        state: ArmState::at_rest(TimeNs(0), home, 0.2),
        command: None,
    };
    let wanted = Translation3::new(0.01, 0.0, 0.0) * Controller::<1>::tip_in_rcm(&home);
    let chunk = Chunk::new(
        TimeNs(0),
        1,
        40_000_000,
        &[TipTarget::new(&wanted, 0.2); 50],
    );
    for tick in 0..1000 {
        let now = TimeNs(tick * TICK_NS);
        let output = controller.tick(&TickInput {
            now,
            measured: arm.read(now),
            chunk: (tick == 1).then_some(&chunk),
            operator: (tick == 0).then_some(OperatorEvent::Enable),
        });
        arm.write(&output.command, &output.tail)?;
    }
    let tip = Controller::<1>::tip_in_rcm(&arm.state.position);
    Ok((tip.translation.vector - wanted.translation.vector).norm())
}

#[expect(clippy::print_stdout, reason = "an example tells what it does")]
fn main() -> Result<(), Box<dyn Error>> {
    println!("the tip is {:.3} mm from its target", run()? * 1e3);
    Ok(())
}
