//! Events of a run in words, from its ticks: the operator's, changes of mode, faults, and what
//! holds an arm although there are answers.

use hal::{ARM_NAMES, ARMS_MAX};
use trocar_control::{Fault, GateDecision, OperatingState, OperatorEvent};

use super::level::Level;
use super::record::TickRecord;

/// Tells changes of each arm's state from its ticks.
///
/// Deterministic: the same ticks give the same events, in the log, for a live viewer and when a log
/// is read.
#[derive(Debug)]
pub struct StateChanges([Said; ARMS_MAX]);

/// Its state, its fault, and what the gate said of its newest chunk.
type Said = (OperatingState, Option<Fault>, Option<GateDecision>);

impl StateChanges {
    /// Of a run that has not begun.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "a run begins somewhere")]
    pub const fn new() -> Self {
        Self([(OperatingState::Disabled, None, None); ARMS_MAX])
    }

    /// What is new in `tick`, in order; nothing in nearly all.
    pub fn since(&mut self, tick: &TickRecord) -> Vec<(Level, String)> {
        let mut news = Vec::new();
        let arms = tick.arms.iter().zip(ARM_NAMES).zip(&mut self.0);
        for ((arm, name), (state, fault, gate)) in arms {
            if let Some(event) = arm.operator {
                news.push((Level::Info, format!("{name}: operator: {}", words(event))));
            }
            let now = arm.report.mode.state;
            let before = core::mem::replace(state, now);
            if before != now {
                let change = format!("{name}: {} to {}", before.name(), now.name());
                news.push((Level::Info, change));
            }
            let had = core::mem::replace(fault, arm.report.fault);
            if let (Some(fault), None) = (arm.report.fault, had) {
                news.push((Level::Error, format!("{name}: fault: {fault}")));
            }
            if let Some(decision) = arm.report.gate
                && gate.replace(decision) != Some(decision)
                && decision == GateDecision::Elsewhere
            {
                let text = "chunks are refused: they do not start where the arm was held";
                news.push((Level::Warning, format!("{name}: {text}")));
            }
        }
        news
    }
}

/// As an operator would call it, in lower case.
fn words(event: OperatorEvent) -> String {
    match event {
        OperatorEvent::Enable => "enable".to_owned(),
        OperatorEvent::Disable => "disable".to_owned(),
        OperatorEvent::Pause => "pause".to_owned(),
        OperatorEvent::Resume => "resume".to_owned(),
        OperatorEvent::Clear => "clear".to_owned(),
        OperatorEvent::Speed { percent } => format!("speed {percent} %"),
        OperatorEvent::TakeOver => "take over".to_owned(),
        OperatorEvent::HandBack => "hand back".to_owned(),
        OperatorEvent::GoOn => "go on".to_owned(),
    }
}
