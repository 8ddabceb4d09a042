//! Pauses that the run itself makes while nobody answers, beside those of the operator, and its
//! end. Hot path: bounded, no allocation.

use trocar_control::OperatorEvent;

/// Who wants the arms to hold.
#[derive(Debug, Default)]
pub(super) struct Hold {
    /// The run does.
    holds: bool,
    /// The operator does.
    paused: bool,
    /// The run's own hold has ended under the operator's: whoever ends that lets the arms go on
    /// from where they are.
    held: bool,
    /// What the run has said at its end.
    ending: Option<OperatorEvent>,
    /// An arm that was enabled meanwhile is yet to be paused.
    renews: bool,
}

impl Hold {
    /// What the controller is told next: the run's own pause as it is `wanted`, then what the
    /// `operator` asks for. The end of the run's pause is not the end of the operator's, and the
    /// operator does not end the run's: arms that are enabled while it lasts are paused in the next
    /// tick.
    pub(super) fn next(
        &mut self,
        wanted: bool,
        operator: impl FnOnce() -> Option<OperatorEvent>,
    ) -> Option<OperatorEvent> {
        if self.holds != wanted {
            self.holds = wanted;
            self.renews = false;
            self.held = !wanted && self.paused;
            let resumes = (!self.paused).then_some(OperatorEvent::GoOn);
            return if wanted {
                Some(OperatorEvent::Pause)
            } else {
                resumes
            };
        }
        if core::mem::take(&mut self.renews) {
            return Some(OperatorEvent::Pause);
        }
        let mut asked = operator()?;
        self.renews = self.holds && asked == OperatorEvent::Enable;
        match asked {
            OperatorEvent::Pause => self.paused = true,
            OperatorEvent::Resume => self.paused = false,
            OperatorEvent::Disable => (self.paused, self.held) = (false, false),
            OperatorEvent::Enable
            | OperatorEvent::GoOn
            | OperatorEvent::Clear
            | OperatorEvent::Speed { .. }
            | OperatorEvent::TakeOver
            | OperatorEvent::HandBack => {}
        }
        if asked == OperatorEvent::Resume {
            if self.holds {
                return None;
            }
            if core::mem::take(&mut self.held) {
                asked = OperatorEvent::GoOn;
            }
        }
        Some(asked)
    }

    /// An arm has a fault: it is no longer paused, and the controller has paused the `others`, whom
    /// only the operator lets go on.
    pub(super) fn faulted(&mut self, others: bool) {
        (self.paused, self.held) = (others, false);
    }

    /// What the controller is told next at the run's end: to come to rest, then, when it is time,
    /// to let the arms have no torque.
    pub(super) fn end(&mut self, releases: bool) -> Option<OperatorEvent> {
        let wanted = match (self.ending, releases) {
            (None, _) => OperatorEvent::Pause,
            (Some(OperatorEvent::Pause), true) => OperatorEvent::Disable,
            (Some(_), _) => return None,
        };
        self.ending = Some(wanted);
        Some(wanted)
    }
}

#[cfg(test)]
mod tests {
    use super::Hold;
    use trocar_control::OperatorEvent::{self, Disable, Enable, GoOn, Pause, Resume, Speed};

    /// Each line: whether the run wants the arms to hold, what the operator asks for, what the
    /// controller hears.
    #[test]
    fn neither_ends_the_pause_of_the_other() {
        let slow = Speed { percent: 30 };
        let mut hold = Hold::default();
        let mut expect = |wanted, asked: Option<OperatorEvent>, expected| {
            assert_eq!(hold.next(wanted, || asked), expected, "{wanted} {asked:?}");
        };
        expect(false, None, None);
        expect(true, None, Some(Pause));
        expect(true, Some(slow), Some(slow));
        expect(true, Some(Resume), None);
        expect(false, None, Some(GoOn));
        // The operator pauses while nobody answers, and goes on pausing.
        expect(true, None, Some(Pause));
        expect(true, Some(Pause), Some(Pause));
        expect(false, None, None);
        expect(false, Some(Resume), Some(GoOn));
        expect(false, Some(Resume), Some(Resume));
        // And so if the pause is from before.
        expect(false, Some(Pause), Some(Pause));
        expect(true, None, Some(Pause));
        expect(false, None, None);
        expect(false, Some(Resume), Some(GoOn));
        expect(false, Some(Resume), Some(Resume));
        // Disabled and enabled while nobody answers: the arm goes on holding.
        expect(true, None, Some(Pause));
        expect(true, Some(Disable), Some(Disable));
        expect(true, Some(Enable), Some(Enable));
        expect(true, Some(Speed { percent: 30 }), Some(Pause));
        expect(true, None, None);
        expect(false, None, Some(GoOn));
        // The policy answers in that very tick.
        expect(true, None, Some(Pause));
        expect(true, Some(Enable), Some(Enable));
        expect(false, None, Some(GoOn));
        expect(false, None, None);
    }

    /// The controller pauses an arm beside one with a fault: the end of the run's hold does not end
    /// that.
    #[test]
    fn beside_a_fault_only_the_operator_lets_arms_go_on() {
        let mut hold = Hold::default();
        assert_eq!(hold.next(true, || None), Some(Pause));
        hold.faulted(true);
        assert_eq!(hold.next(false, || None), None);
        assert_eq!(hold.next(false, || Some(Resume)), Some(GoOn));
        // An arm alone is paused no more after its fault.
        assert_eq!(hold.next(false, || Some(Pause)), Some(Pause));
        hold.faulted(false);
        assert_eq!(hold.next(true, || None), Some(Pause));
        assert_eq!(hold.next(false, || None), Some(GoOn));
    }

    /// Once each, and in order, however late it is.
    #[test]
    fn a_run_ends_at_rest_and_then_without_torque() {
        let mut hold = Hold::default();
        let told = [false, false, true, true].map(|releases| hold.end(releases));
        assert_eq!(told, [Some(Pause), None, Some(Disable), None]);
        let mut hold = Hold::default();
        let told = [true, true].map(|releases| hold.end(releases));
        assert_eq!(told, [Some(Pause), Some(Disable)]);
    }
}
