//! The simulated arms in a real-time run: one step a millisecond, and the local policies that look
//! at its scene.

use std::sync::Arc;
use std::thread::Thread;

use hal::{Arm, ArmObservation, ArmState, Chunk, PerArm, Setpoint, TICK_NS, TimeNs, TipTarget};
use rtrb::{Consumer, Producer};
use trocar_tasks::simulation::Simulation;
use trocar_tasks::task::Outcome;
use trocar_world::tissue::TissueExtremes;

use super::arm_states::StepStates;
use super::scene_topics::Snapshot;
use super::signals::{EndRunOnDrop, Signals};
use crate::console::{BETWEEN_NS, FrameTap};
use crate::histogram::Histogram;
use crate::mailbox::MailboxWriter;
use crate::rt::{MonotonicClock, Periodic, RtOptions, configure_thread};
use crate::session::source::{ChunkSource, Query, STEP_TICKS, precedes_query, seen_arm};
use crate::session::teleop::{CHUNK_TICKS, Demonstrating, Demonstration, Driver, Intervention};
use crate::session::world_report::TaskState;
use crate::session::{SessionError, scene_record};
use trocar_log::{Level, SceneLog};
use trocar_topics::TaskReport;

/// Steps from one frame for the log or the pictures to the next. Drawing in software takes half a
/// core at every step.
const FRAME_EVERY_STEPS: u64 = 5;

/// Ticks from one instant that the console sees to the next: thirty a second, as many as it hands
/// on of a stream.
const CONSOLE_TICKS: u64 = BETWEEN_NS / TICK_NS;

/// Ticks that a picture for the console may take to be drawn; one that would still be at it when a
/// policy asks is left out.
const DRAWING_TICKS: u64 = 20;

/// What is shown of a policy step, to whom, and when.
pub(super) struct Shown {
    /// The scene, for the cameras.
    pub(super) scene: Option<MailboxWriter<Snapshot>>,
    /// The arms, for a policy process.
    pub(super) states: Option<Producer<StepStates>>,
    /// The thread that hands on both, once it runs.
    pub(super) wakes: Vec<Thread>,
    /// Steps from one query of a policy process to the next, if there is one.
    pub(super) query_every_steps: Option<u64>,
    /// Steps before a query that it wants to have observed too.
    pub(super) history_steps: u64,
    /// Whether the log or a policy wants frames in between.
    pub(super) frames: bool,
    /// Whether others' cameras want to draw each step.
    pub(super) every_step: bool,
    /// What is measured each period, for whoever goes by others' cameras.
    pub(super) seen: Option<MailboxWriter<PerArm<ArmState>>>,
    /// What the console sees, if there is one.
    pub(super) console: Option<ConsoleView>,
    /// Where the scene of each step is kept, if there is a log.
    pub(super) log: Option<SceneLog>,
}

/// What the console sees of the simulation.
pub(super) struct ConsoleView {
    pub(super) to: MailboxWriter<Snapshot>,
    pub(super) frames: FrameTap,
    /// How the task stands.
    pub(super) task: MailboxWriter<TaskReport>,
}

impl Shown {
    fn wanted(&self, step: u64) -> bool {
        self.query_every_steps.is_some_and(|every| {
            step.is_multiple_of(every) || precedes_query(step, every, self.history_steps)
        }) || self.every_step
            || self.frames && step.is_multiple_of(FRAME_EVERY_STEPS)
    }

    /// Shows the step to those that want to see it. One that is still busy with another step finds
    /// the newest when it is done.
    fn show(&mut self, step: u64, arms: &PerArm<ArmObservation>, simulation: &Simulation) {
        let stamp = arms.first.state.stamp;
        let snapshot = || Snapshot {
            step,
            stamp,
            scene: simulation.snapshot(),
        };
        if self.wanted(step) {
            if let Some(states) = &mut self.states {
                // Full only if their thread has not run for many steps: what it would say then is
                // of no interest.
                let _late = states.push(StepStates { step, arms: *arms });
            }
            if let Some(scene) = &mut self.scene {
                scene.put(snapshot());
            }
        }
        let task = TaskState::of(simulation).report(stamp, step);
        if let Some(log) = &mut self.log {
            log.scene(stamp, scene_record::record(&snapshot().scene, &task));
        }
        if let Some(console) = &mut self.console {
            console.task.put(task);
        }
        self.wakes.iter().for_each(Thread::unpark);
    }

    /// Shows the console `tick`, whose instant is `stamp`, if it is its turn and a page looks at a
    /// camera.
    fn show_console(&mut self, tick: u64, stamp: TimeNs, simulation: &Simulation) {
        let turn = is_for_console(tick, self.query_every_steps);
        let console = self.console.as_mut();
        if let Some(console) = console.filter(|it| turn && it.frames.wants_any()) {
            console.to.put(Snapshot {
                step: tick / STEP_TICKS,
                stamp,
                scene: simulation.snapshot(),
            });
            self.wakes.iter().for_each(Thread::unpark);
        }
    }
}

/// Whether the console sees `tick`, beside a policy process that is asked every so many steps: what
/// it sees comes first.
fn is_for_console(tick: u64, query_every_steps: Option<u64>) -> bool {
    let asked = |every| precedes_query(tick, every * STEP_TICKS, DRAWING_TICKS);
    tick.is_multiple_of(CONSOLE_TICKS) && !query_every_steps.is_some_and(asked)
}

/// The simulation thread before it runs.
pub(super) struct SimulationThread {
    pub(super) simulation: Simulation,
    pub(super) measured: MailboxWriter<PerArm<ArmState>>,
    /// Every command, in order: a thread that makes up for missed milliseconds needs those of then.
    pub(super) commands: Consumer<PerArm<Setpoint>>,
    pub(super) shown: Shown,
    pub(super) local: Option<(ChunkSource, Producer<PerArm<Chunk>>)>,
    /// An operator who may take over from the policy, if there is one.
    pub(super) intervention: Option<Box<Intervention>>,
    /// What is written down, if a person demonstrates.
    pub(super) demonstrating: Option<Demonstrating>,
    pub(super) signals: Arc<Signals>,
    /// What the thread asks of the system: the arms that it stands for never wait for a core.
    pub(super) profile: RtOptions,
}

/// What it leaves behind.
pub(super) struct SimulationEnd {
    pub(super) outcome: Outcome,
    /// How long the local policy took for its chunks.
    pub(super) inference: Histogram,
    /// What a soft tissue went through, if the task has one.
    pub(super) tissue: Option<TissueExtremes>,
    /// What a person has demonstrated, if one was to.
    pub(super) demonstration: Option<Demonstration>,
}

impl SimulationThread {
    /// Runs until the control thread has stopped; says so when the task has its verdict.
    pub(super) fn run(
        mut self,
        clock: MonotonicClock,
        first: TimeNs,
    ) -> Result<SimulationEnd, SessionError> {
        let signals = Arc::clone(&self.signals);
        let _ends = EndRunOnDrop(&signals);
        // Never strict: without it the arm is only less punctual.
        let _granted = configure_thread(&self.profile);
        let mut periodic = Periodic::new(clock, first, TICK_NS);
        let mut end = SimulationEnd {
            outcome: Outcome::Running,
            inference: Histogram::new(),
            tissue: None,
            demonstration: None,
        };
        while !signals.stopped() {
            let wake = periodic.wait();
            // After a late wake-up the missed milliseconds are made up for, so that simulated time
            // stays real time.
            for late in (0..=wake.skipped).rev() {
                if signals.stopped() {
                    break;
                }
                let now = TimeNs(wake.due.0.saturating_sub(late * TICK_NS));
                self.command(late, now)?;
                self.step(wake.index.saturating_sub(late), now, &mut end.inference)?;
                if self.has_ended(&mut end.outcome) {
                    signals.end_run();
                }
            }
        }
        end.tissue = self.simulation.tissue_extremes();
        end.demonstration = self.demonstrating.map(Demonstrating::end);
        Ok(end)
    }

    /// Whether the person or the judge has ended the episode: whoever is first has the word.
    fn has_ended(&mut self, outcome: &mut Outcome) -> bool {
        if !matches!(outcome, Outcome::Running) {
            return true;
        }
        let by_hand = self.demonstrating.as_mut();
        if by_hand.is_some_and(Demonstrating::has_ended) {
            return true;
        }
        *outcome = self.simulation.outcome();
        !matches!(outcome, Outcome::Running)
    }

    /// Hands over the newest commands that are for the step at `now`, which is `late` steps behind;
    /// without them the arms play the last ones' tails.
    fn command(&mut self, late: u64, now: TimeNs) -> Result<(), SessionError> {
        let mut newest = None;
        while let Ok(commands) = self.commands.peek()
            && is_due(commands.first.0.stamp, late, now)
        {
            newest = self.commands.pop().ok();
        }
        for (index, (command, tail)) in newest.iter().flat_map(PerArm::iter).enumerate() {
            if let Some(mut arm) = self.simulation.arm(index) {
                arm.write(command, tail)?;
            }
        }
        Ok(())
    }

    fn step(
        &mut self,
        tick: u64,
        now: TimeNs,
        inference: &mut Histogram,
    ) -> Result<(), SessionError> {
        // A demonstration's time stands still until a person starts it.
        let runs = self.demonstrating.as_mut().is_none_or(Demonstrating::runs);
        if runs {
            self.simulation.step();
        }
        let states = self.read(now)?;
        self.measured.put(states);
        if let Some(seen) = &mut self.shown.seen {
            seen.put(states);
        }
        if !self.signals.done() {
            let stamp = states.first.stamp;
            self.shown.show_console(tick, stamp, &self.simulation);
        }
        let (observes, asks) = (tick.is_multiple_of(STEP_TICKS), self.asks(tick, runs));
        let by_hand = self.intervention.is_some() && tick.is_multiple_of(CHUNK_TICKS);
        if self.signals.done() || !(observes || asks || by_hand) {
            return Ok(());
        }
        let arms = states.map(|state| seen_arm(&state));
        if observes {
            self.shown.show(tick / STEP_TICKS, &arms, &self.simulation);
        }
        if by_hand {
            self.look_at_hands(tick, &arms)?;
        }
        if asks {
            self.ask(tick, &arms, inference)?;
        }
        Ok(())
    }

    /// Lets an operator take over, who may take more time than the policy has.
    fn look_at_hands(
        &mut self,
        tick: u64,
        arms: &PerArm<ArmObservation>,
    ) -> Result<(), SessionError> {
        let Some(intervention) = &mut self.intervention else {
            return Ok(());
        };
        // What was asked is of whoever drove up to now: the control thread takes a change with a
        // later tick.
        let asked = intervention.asked();
        let more_s = intervention.answer(arms)?;
        self.simulation.grant_s(more_s);
        for text in intervention.take_notices() {
            let at = arms.first.state.stamp;
            self.signals.tell(at, Level::Info, &text);
        }
        if let (Some(demonstrating), Some((driver, targets)), true) = (
            &mut self.demonstrating,
            asked,
            tick.is_multiple_of(STEP_TICKS),
        ) {
            demonstrating.note(arms, (driver, &targets), || self.simulation.snapshot());
        }
        Ok(())
    }

    /// Whether it is a local policy's turn; one beside an operator has none before the episode
    /// `runs`.
    fn asks(&self, tick: u64, runs: bool) -> bool {
        let source = self.local.as_ref().map(|(source, _)| source);
        let source = source.filter(|_| runs || self.intervention.is_none());
        source.is_some_and(|source| tick.is_multiple_of(source.query_every_ticks()))
    }

    /// What each arm measures.
    fn read(&mut self, now: TimeNs) -> Result<PerArm<ArmState>, SessionError> {
        let first = self.simulation.read(now)?;
        let second = self.simulation.arm(1).map(|mut arm| arm.read(now));
        Ok(PerArm {
            first,
            second: second.transpose()?,
        })
    }

    /// Asks the local policy for chunks.
    fn ask(
        &mut self,
        tick: u64,
        arms: &PerArm<ArmObservation>,
        inference: &mut Histogram,
    ) -> Result<(), SessionError> {
        if let Some((source, chunks)) = &mut self.local {
            let scene = self.simulation.scene_state();
            let query = Query {
                arms: *arms,
                frames: &[],
                scene: Some(&scene),
            };
            let clock = MonotonicClock::new();
            let answer = source.answer(&query)?;
            inference.record(clock.now().0);
            // The control thread takes one a tick; a full queue means that it is gone.
            let _gone = chunks.push(answer);
            for text in source.take_notices() {
                let at = arms.first.state.stamp;
                self.signals.tell(at, Level::Info, &text);
            }
            // Beside an operator the hands' end knows who drives.
            let demonstrating = self.demonstrating.as_mut();
            let demonstrating = demonstrating.filter(|_| self.intervention.is_none());
            if let (Some(demonstrating), true, Some(targets)) = (
                demonstrating,
                tick.is_multiple_of(STEP_TICKS),
                firsts(&answer),
            ) {
                let by_hand = (Driver::Operator, &targets);
                demonstrating.note(arms, by_hand, || self.simulation.snapshot());
            }
        }
        Ok(())
    }
}

/// The first target of each chunk, if each has one.
fn firsts(chunks: &PerArm<Chunk>) -> Option<PerArm<TipTarget>> {
    let firsts = chunks
        .iter()
        .map(|chunk| chunk.valid_targets().first().copied());
    PerArm::collect(firsts.collect::<Option<Vec<_>>>()?)
}

/// Whether the step at `now`, which is `late` steps behind, follows the command of `stamp`.
///
/// A thread that makes up for missed milliseconds does not move the arm before its time. The step
/// that is not behind takes whatever there is.
pub(in crate::session) const fn is_due(stamp: TimeNs, late: u64, now: TimeNs) -> bool {
    late == 0 || stamp.0 <= now.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps that make up for missed ones follow no command from after them.
    #[test]
    fn catch_up_steps_follow_no_later_command() {
        let stamp = TimeNs(10 * TICK_NS + TICK_NS / 2);
        for (late, tick, expected) in [
            (3, 9, false),
            (2, 10, false),
            (1, 11, true),
            (0, 12, true),
            (0, 10, true),
        ] {
            let now = TimeNs::from_tick(tick);
            assert_eq!(is_due(stamp, late, now), expected, "{late} behind {tick}");
        }
        assert!(is_due(stamp, 1, stamp));
    }

    /// A page sees 25 instants a second and more, also beside a policy process, whose frames none
    /// delays.
    #[test]
    fn the_console_has_a_pace_of_its_own() {
        for every in [None, Some(25), Some(5), Some(4)] {
            let shown = || (0..10_000).filter(|tick| is_for_console(*tick, every));
            assert!((250..=304).contains(&shown().count()), "{every:?}");
            let before_query = |tick: &u64| every.map_or(0, |every| tick % (every * STEP_TICKS));
            let late =
                |tick: &u64| every.is_some_and(|it| before_query(tick) > it * STEP_TICKS - 20);
            assert_eq!(shown().find(late), None, "{every:?}");
        }
    }
}
