//! An arm that plays a log's measurements back, so that a controller meets again what another one
//! met.

use hal::{Arm, ArmCommand, ArmError, ArmState, SafeTail, TICK_NS, TimeNs};

use super::{ReplayError, difference};
use crate::{Loss, RunLog};

/// One arm of a log.
///
/// It reports at each time what the log's arm did, failures included, and at the end that the
/// recording has ended. It does not obey: commands move nothing, they are only compared with those
/// in the log. Between two ticks of the log the earlier one counts; where the logger dropped ticks
/// the measurement is lost.
#[derive(Clone, Debug)]
pub struct RecordedArm {
    ticks: Vec<Tick>,
    /// The newest time that was read.
    now: TimeNs,
    end: TimeNs,
    differing: u64,
    refused: u64,
}

#[derive(Clone, Copy, Debug)]
struct Tick {
    now: TimeNs,
    measured: Result<ArmState, ArmError>,
    command: ArmCommand,
    /// Whether ticks that came after it are missing.
    gap: bool,
}

impl RecordedArm {
    /// The arm `index` of `log`, counted from 0, before its first tick.
    ///
    /// # Errors
    /// [`ReplayError::Empty`] if the log holds no tick, [`ReplayError::NoArm`] if it has not so
    /// many arms.
    pub fn new(log: &RunLog, index: usize) -> Result<Self, ReplayError> {
        let mut ticks = Vec::with_capacity(log.tick_count());
        for (place, (tick, _)) in log.ticks().enumerate() {
            let arm = tick.arms.get(index).ok_or(ReplayError::NoArm { index })?;
            ticks.push(Tick {
                now: tick.now,
                measured: arm.measured,
                command: arm.command,
                gap: lacks_ticks_before(log, place + 1),
            });
        }
        let last = ticks.last().ok_or(ReplayError::Empty)?.now;
        let periods = ticks.windows(2).map(|pair| pair[1].now.since(pair[0].now));
        let period_ns = periods.filter(|ns| *ns > 0).min().unwrap_or(TICK_NS);
        Ok(Self {
            ticks,
            now: TimeNs(0),
            end: TimeNs(last.0.saturating_add(period_ns)),
            differing: 0,
            refused: 0,
        })
    }

    /// Finite commands that were not, bit for bit, those of the log at the same time.
    #[must_use]
    pub const fn differing(&self) -> u64 {
        self.differing
    }

    /// Commands or tails with a number that was not finite.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// The log's tick at the newest time that was read.
    fn current(&self) -> Option<&Tick> {
        let after = self.ticks.partition_point(|tick| tick.now <= self.now);
        self.ticks.get(after.checked_sub(1)?)
    }

    fn measured(&self) -> Result<ArmState, ArmError> {
        if self.now >= self.end {
            return Err(ArmError::EndOfRecording);
        }
        let lost = |since: TimeNs| ArmError::MeasurementLost {
            age_ns: self.now.since(since),
        };
        let tick = self.current().ok_or(lost(TimeNs(0)))?;
        if tick.gap && self.now > tick.now {
            return Err(lost(tick.measured.map_or(tick.now, |state| state.stamp)));
        }
        tick.measured
    }
}

/// Whether ticks of `log` before the one at `place` were dropped.
fn lacks_ticks_before(log: &RunLog, place: usize) -> bool {
    let drops = |loss: &Loss| matches!(loss, Loss::Ticks { position, .. } if *position == place);
    log.losses.iter().any(drops)
}

impl Arm for RecordedArm {
    fn read(&mut self, now: TimeNs) -> Result<ArmState, ArmError> {
        self.now = now;
        self.measured()
    }

    /// # Errors
    /// Those of drives that had failed, and [`ArmError::EndOfRecording`].
    fn write(&mut self, command: &ArmCommand, tail: &SafeTail) -> Result<(), ArmError> {
        if !(command.is_finite() && tail.is_finite()) {
            self.refused += 1;
        } else if self
            .current()
            .is_none_or(|tick| difference(0, &tick.command, command).is_some())
        {
            self.differing += 1;
        }
        match self.measured() {
            Err(error @ (ArmError::DriveFault { .. } | ArmError::EndOfRecording)) => Err(error),
            Ok(_) | Err(ArmError::MeasurementLost { .. }) => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
