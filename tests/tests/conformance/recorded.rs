//! An arm that plays a log back: what another arm answered to the same driver, through a file.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::atomic::{AtomicU32, Ordering};

use hal::PerArm;
use hal::tail::TAIL_AXES;
use hal::{Arm, ArmCommand, ArmError, ArmState, SafeTail, TimeNs};
use tests::scratch;
use trocar_control::{Mode, OperatingState, QpOutcome, TickReport};
use trocar_log::replay::RecordedArm;
use trocar_log::{ArmRecord, Pressure, Recorder, RunHeader, RunLog, TickRecord, TickTiming};

use crate::rig::{Make, Nature, Rig};

type Measured = Result<ArmState, ArmError>;

/// What one arm said in one run, as a log, and what was particular about that arm.
struct Tape {
    log: RunLog,
    nature: Nature,
    breaks: bool,
}

/// The tapes of the runs so far, oldest first.
#[derive(Clone, Default)]
pub(crate) struct Shelf(Rc<RefCell<VecDeque<Tape>>>);

/// An arm under test that is recorded. The recording is on the shelf when the test lets go of it.
struct Recording {
    inner: Box<dyn Rig>,
    measured: Option<Measured>,
    command: ArmCommand,
    breaks: bool,
    records: Vec<TickRecord>,
    shelf: Shelf,
}

impl Shelf {
    /// `make`'s arm, recorded.
    pub(crate) fn record(&self, make: Make<'_>) -> Box<dyn Rig> {
        Box::new(Recording {
            inner: make(),
            measured: None,
            command: SafeTail::at_rest(TimeNs(0), &[0.0; TAIL_AXES], false).command_at(TimeNs(0)),
            breaks: false,
            records: Vec::new(),
            shelf: self.clone(),
        })
    }

    /// The oldest recording that has not been played.
    pub(crate) fn play(&self) -> Box<dyn Rig> {
        let tape = self.0.borrow_mut().pop_front().unwrap();
        Box::new(Player {
            arm: RecordedArm::new(&tape.log, 0).unwrap(),
            now: tape.log.ticks().next().unwrap().0.now,
            nature: tape.nature,
            breaks: tape.breaks,
        })
    }

    /// How many wait to be played.
    pub(crate) fn len(&self) -> usize {
        self.0.borrow().len()
    }
}

impl Arm for Recording {
    fn read(&mut self, now: TimeNs) -> Measured {
        let measured = self.inner.arm().read(now);
        self.measured = Some(measured);
        measured
    }

    fn write(&mut self, command: &ArmCommand, tail: &SafeTail) -> Result<(), ArmError> {
        self.command = *command;
        self.inner.arm().write(command, tail)
    }
}

impl Rig for Recording {
    fn arm(&mut self) -> &mut dyn Arm {
        self
    }

    fn now(&self) -> TimeNs {
        self.inner.now()
    }

    fn pass(&mut self) {
        let now = self.now();
        let arm = ArmRecord {
            measured: self.measured.take().unwrap(),
            operator: None,
            chunk_sequence: None,
            command: self.command,
            report: report(),
        };
        self.records.push(TickRecord {
            tick: now.0 / self.nature().period_ns,
            now,
            arms: PerArm::one(arm),
            timing: TickTiming::default(),
        });
        self.inner.pass();
    }

    fn nature(&self) -> Nature {
        self.inner.nature()
    }

    fn deafen(&mut self, periods: u64) -> bool {
        self.breaks = self.inner.deafen(periods);
        self.breaks
    }

    fn fail(&mut self, axis: u8, code: u16) -> bool {
        self.breaks = self.inner.fail(axis, code);
        self.breaks
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        let tape = Tape {
            log: through_a_file(&self.records),
            nature: self.nature(),
            breaks: self.breaks,
        };
        self.shelf.0.borrow_mut().push_back(tape);
    }
}

/// The records as they come back from a log.
fn through_a_file(records: &[TickRecord]) -> RunLog {
    // Tests run beside each other.
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    let path = scratch(&format!("conformance-{number}")).join("arm.mcap");
    let header = RunHeader::default();
    let mut recorder = Recorder::create(&path, &header, Pressure::Block).unwrap();
    for record in records {
        recorder.tick(record);
    }
    recorder.finish(None).unwrap();
    RunLog::open(&path).unwrap()
}

/// There is no controller to report.
fn report() -> TickReport {
    TickReport {
        mode: Mode {
            state: OperatingState::Enabled,
            homed: true,
            busy: true,
        },
        gate: None,
        qp: QpOutcome::NotNeeded,
        rows_active: 0,
        correction: 0.0,
        guard_intervened: false,
        target: None,
        fault: None,
    }
}

/// A tape that is played to the driver that it was recorded with.
struct Player {
    arm: RecordedArm,
    now: TimeNs,
    nature: Nature,
    breaks: bool,
}

impl Rig for Player {
    fn arm(&mut self) -> &mut dyn Arm {
        &mut self.arm
    }

    fn now(&self) -> TimeNs {
        self.now
    }

    fn pass(&mut self) {
        self.now = self.now.plus_ns(self.nature.period_ns);
    }

    fn nature(&self) -> Nature {
        self.nature
    }

    fn deafen(&mut self, _periods: u64) -> bool {
        self.breaks
    }

    fn fail(&mut self, _axis: u8, _code: u16) -> bool {
        self.breaks
    }
}
