//! The ticks of a log, one after another: from when to when the arms are asked, and what they
//! measured and were given at each step.

use std::path::Path;

use hal::{ARM_NAMES, PerArm, TimeNs, TipTarget};
use trocar_control::kinematics::forward;
use trocar_control::{OperatingState, OperatorEvent};
use trocar_data::dataset::ArmFrame;
use trocar_log::{LoggedArm, LoggedReport, LoggedTick, Step};

use super::LogImportError;
use super::frames::LoggedCamera;
use super::grid::Grid;
use crate::session::record::arm_frame;
use crate::session::source::seen_arm;
use crate::session::teleop::Driver;

/// The numbers of a step.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) arms: Vec<ArmFrame>,
    /// Whether an operator drove, who had taken over.
    pub(super) by_hand: bool,
}

/// A tick, and what was reported of it.
struct Moment {
    tick: LoggedTick,
    reports: PerArm<LoggedReport>,
    by_hand: bool,
}

impl Moment {
    /// When the arms were as they were measured: of arms elsewhere that may be before the tick.
    fn at(&self) -> TimeNs {
        let measured = self.tick.arms.first.measured.as_ref();
        measured.map_or(self.tick.now, |state| state.stamp)
    }
}

/// A log under way.
pub(super) struct Ticks<'a> {
    log: &'a Path,
    cameras: &'a [LoggedCamera],
    fps: u32,
    driver: Driver,
    before: Option<Moment>,
    /// From the first target on.
    grid: Option<Grid<'a>>,
    /// The grid's next point.
    point: usize,
    rows: Vec<Row>,
    /// Whether an arm had a fault.
    pub(super) faulted: bool,
    /// The last tick in which all arms were ENABLED.
    end: TimeNs,
    /// The first step that has no row, and why.
    failure: Option<(TimeNs, LogImportError)>,
}

impl<'a> Ticks<'a> {
    /// Nothing yet of `log`, whose steps are those of `cameras`, `fps` a second.
    pub(super) const fn new(log: &'a Path, cameras: &'a [LoggedCamera], fps: u32) -> Self {
        Self {
            log,
            cameras,
            fps,
            driver: Driver::Policy,
            before: None,
            grid: None,
            point: 0,
            rows: Vec::new(),
            faulted: false,
            end: TimeNs(0),
            failure: None,
        }
    }

    /// Takes in the next tick.
    ///
    /// # Errors
    /// [`LogImportError::Missing`] for one without a report.
    pub(super) fn take(&mut self, step: &Step<'_>) -> Result<(), LogImportError> {
        let tick = *step.tick;
        if step.dropped_before > 0 && self.failure.is_none() {
            let lost = self.missing("ticks, which the logger dropped,", tick.now);
            self.failure = Some((tick.now, lost));
        }
        let reports = step.reports.iter().copied();
        let reports = reports.map(|report| report.and_then(LoggedReport::read));
        let reports: Option<Vec<LoggedReport>> = reports.collect();
        let Some(reports) = reports.and_then(PerArm::collect) else {
            return Err(self.missing("an arm's safety report", tick.now));
        };
        match tick.arms.first.operator {
            Some(OperatorEvent::TakeOver) => self.driver = Driver::Operator,
            Some(OperatorEvent::HandBack) => self.driver = Driver::Policy,
            Some(_) | None => {}
        }
        let enabled = reports
            .iter()
            .all(|report| report.state == OperatingState::Enabled);
        self.faulted |= reports
            .iter()
            .any(|report| report.state == OperatingState::Fault);
        let asked = reports.iter().any(|report| report.target.is_some());
        if self.grid.is_none() && enabled && asked {
            self.grid = Some(Grid::lay(self.cameras, self.fps, tick.now));
        }
        if self.grid.is_some() && enabled {
            self.end = tick.now;
        }
        let now = Moment {
            tick,
            reports,
            by_hand: self.driver == Driver::Operator,
        };
        self.reach(&now);
        self.before = Some(now);
        Ok(())
    }

    /// Adds the rows of the steps up to `now`, each that of the tick nearest to it.
    fn reach(&mut self, now: &Moment) {
        let Some(grid) = self.grid.as_ref().filter(|_| self.failure.is_none()) else {
            return;
        };
        while let Some(step) = grid.get(self.point) {
            let Some(step) = step else {
                self.point += 1;
                continue;
            };
            if step.at > now.at() {
                return;
            }
            let apart = |moment: &&Moment| moment.at().0.abs_diff(step.at.0);
            let near = self.before.iter().chain([now]).min_by_key(apart);
            let near = near.filter(|near| grid.is_within_steps(near.at(), step.at, 1));
            let row = match near {
                Some(near) => self.row(near),
                None => Err(self.missing("ticks, which the logger dropped,", step.at)),
            };
            match row {
                Ok(row) => self.rows.push(row),
                Err(error) => {
                    self.failure = Some((step.at, error));
                    return;
                }
            }
            self.point += 1;
        }
    }

    fn row(&self, moment: &Moment) -> Result<Row, LogImportError> {
        let now = moment.tick.now;
        let arms = moment.tick.arms.iter().zip(moment.reports.iter());
        let arms = ARM_NAMES.iter().zip(arms).map(|(name, (arm, report))| {
            let Ok(measured) = &arm.measured else {
                return Err(self.missing(&format!("a measurement of {name}"), now));
            };
            let frame = arm_frame(&seen_arm(measured), &target(arm, report));
            match not_finite(&frame) {
                None => Ok(frame),
                Some(what) => Err(LogImportError::NotFinite {
                    log: self.log.to_owned(),
                    what,
                    arm: name,
                    at_s: now.seconds(),
                }),
            }
        });
        Ok(Row {
            arms: arms.collect::<Result<_, _>>()?,
            by_hand: moment.by_hand,
        })
    }

    fn missing(&self, what: &str, at: TimeNs) -> LogImportError {
        LogImportError::Missing {
            log: self.log.to_owned(),
            what: what.to_owned(),
            at_s: at.seconds(),
        }
    }

    /// From the end of the log: the grid with all its rows, and when the episode ends.
    ///
    /// # Errors
    /// [`LogImportError::NeverAsked`]; that of the first step which has no row.
    pub(super) fn finish(self) -> Result<(Grid<'a>, Vec<Row>, TimeNs), LogImportError> {
        let Some(grid) = self.grid else {
            let log = self.log.to_owned();
            return Err(LogImportError::NeverAsked { log });
        };
        match self.failure {
            Some((at, error)) if at <= self.end => Err(error),
            Some(_) | None => Ok((grid, self.rows, self.end)),
        }
    }
}

/// Where the chunks wanted the tip; the commanded tip if nobody asked.
fn target(arm: &LoggedArm, report: &LoggedReport) -> TipTarget {
    let here = || TipTarget::new(&forward(&arm.command.position), arm.command.jaw_position);
    report.target.unwrap_or_else(here)
}

/// What of `frame` is non-finite, if anything is.
fn not_finite(frame: &ArmFrame) -> Option<&'static str> {
    let measured = frame.state.iter().all(|value| value.is_finite());
    let target = frame.action.iter().all(|value| value.is_finite());
    match (measured, target) {
        (true, true) => None,
        (false, _) => Some("the measurement"),
        (true, false) => Some("the target"),
    }
}
