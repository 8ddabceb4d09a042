//! `config/realtime.toml`: what the threads of a run in real time ask of the operating system. The
//! file says what is wanted; `rt/thread` and `rt/held` ask for it and report what was granted.

use hal::config::{ConfigError, Source};
use serde::Deserialize;

use super::held::Held;
use super::thread::{Grant, RtOptions, RtRefused, RtReport, configure_thread, lock_memory};

/// Most cores that a system's set of them holds.
const CORES_MAX: i32 = 1024;

/// What both threads ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RtProfile {
    /// The control thread.
    pub control: RtOptions,
    /// Whether to keep in memory what the process has mapped when the control thread begins.
    pub lock_memory: bool,
    /// Whether to keep all cores out of idle states while the run lasts:
    /// [`CPU_DMA_LATENCY`](super::CPU_DMA_LATENCY) at 0.
    pub hold_cpu_dma_latency: bool,
    /// How many periods the control thread may skip within a second; any number if not given.
    pub overruns_per_s_max: Option<u64>,
    /// The simulated arms' thread. Never strict: without it the arms are only less punctual.
    pub simulation: RtOptions,
}

impl Default for RtProfile {
    /// What [`Self::shipped`] says.
    fn default() -> Self {
        let fifo = |priority| RtOptions {
            priority: Some(priority),
            cpu: None,
            lock_stack: false,
            strict: false,
        };
        Self {
            control: RtOptions {
                lock_stack: true,
                ..fifo(80)
            },
            lock_memory: true,
            hold_cpu_dma_latency: true,
            overruns_per_s_max: None,
            simulation: fifo(70),
        }
    }
}

/// The file as it is written: all keys but one are needed, and unknown ones are refused.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    strict: bool,
    lock_memory: bool,
    hold_cpu_dma_latency: bool,
    /// 0, as without it, is no limit.
    #[serde(default)]
    overruns_per_s_max: u32,
    control: ThreadFile,
    simulation: ThreadFile,
}

/// A thread's part of it.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct ThreadFile {
    /// 0 is the ordinary class, 1 to 99 `SCHED_FIFO`.
    priority: i32,
    /// -1 is any core.
    cpu: i32,
}

impl ThreadFile {
    /// # Errors
    /// A priority or a core out of range, with the key below `name`.
    fn checked(self, source: &Source, name: &str) -> Result<RtOptions, ConfigError> {
        let (priority, cpu) = (format!("{name}.priority"), format!("{name}.cpu"));
        source.check_range(&priority, self.priority.into(), 0.0, 99.0)?;
        source.check_range(&cpu, self.cpu.into(), -1.0, f64::from(CORES_MAX - 1))?;
        Ok(RtOptions {
            priority: u8::try_from(self.priority)
                .ok()
                .filter(|priority| *priority > 0),
            cpu: usize::try_from(self.cpu).ok(),
            lock_stack: false,
            strict: false,
        })
    }
}

impl RtProfile {
    /// The file in the repository.
    #[must_use]
    pub fn shipped() -> Source {
        let text = include_str!("../../../../config/realtime.toml");
        Source::embedded("config/realtime.toml", text)
    }

    /// Reads and checks `source`.
    ///
    /// # Errors
    /// [`ConfigError`] with file, line, key and allowed range.
    pub fn load(source: &Source) -> Result<Self, ConfigError> {
        let file: File = source.parse()?;
        let overruns = f64::from(file.overruns_per_s_max);
        source.check_range("overruns_per_s_max", overruns, 0.0, 1000.0)?;
        let limit = u64::from(file.overruns_per_s_max);
        Ok(Self {
            overruns_per_s_max: Some(limit).filter(|limit| *limit > 0),
            lock_memory: file.lock_memory,
            hold_cpu_dma_latency: file.hold_cpu_dma_latency,
            control: RtOptions {
                lock_stack: file.lock_memory,
                strict: file.strict,
                ..file.control.checked(source, "control")?
            },
            simulation: file.simulation.checked(source, "simulation")?,
        })
    }

    /// Whether the system grants what a strict control thread insists on: tried on a thread of its
    /// own, before there is anything to lose.
    ///
    /// # Errors
    /// [`RtRefused`] with what was refused.
    pub fn check(&self) -> Result<(), RtRefused> {
        if !self.control.strict {
            return Ok(());
        }
        let options = self.control;
        let tried = std::thread::spawn(move || configure_thread(&options)).join();
        let report = tried.map_or(Ok(None), |granted| granted.map(Some))?;
        let held = self.hold_as_asked();
        match report {
            Some(report) if held.any_refused() => Err(RtRefused(RtReport {
                memory: held.memory,
                cpu_latency: held.cpu_latency,
                ..report
            })),
            Some(_) | None => Ok(()),
        }
    }

    /// Locks memory and keeps cores out of idle states, if that is asked for: see [`lock_memory`].
    /// What is held is held until the last clone of it is dropped.
    ///
    /// # Errors
    /// [`RtRefused`] if a strict profile does not get it.
    pub fn hold(&self) -> Result<Held, RtRefused> {
        let held = self.hold_as_asked();
        if self.control.strict && held.any_refused() {
            return Err(RtRefused(RtReport {
                fifo: Grant::NotAsked,
                cpu: Grant::NotAsked,
                memory: held.memory,
                cpu_latency: held.cpu_latency,
            }));
        }
        Ok(held)
    }

    /// Both requests, with what became of each; a refusal is no error here.
    fn hold_as_asked(&self) -> Held {
        let memory = if self.lock_memory {
            lock_memory()
        } else {
            Grant::NotAsked
        };
        Held::of(memory, self.hold_cpu_dma_latency)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_profile_asks_for_fifo_and_locked_memory() {
        let profile = RtProfile::load(&RtProfile::shipped()).unwrap();
        assert!(profile.lock_memory && profile.hold_cpu_dma_latency && !profile.control.strict);
        assert_eq!(profile, RtProfile::default());
        profile.check().unwrap();
    }

    #[test]
    fn values_out_of_range_are_named_with_line_and_range() {
        for (key, value, named) in [
            ("control.priority", "100", "[0, 99]"),
            ("control.cpu", "-2", "[-1, 1023]"),
            ("simulation.cpu", "1024", "[-1, 1023]"),
            ("overruns_per_s_max", "1001", "[0, 1000]"),
        ] {
            let source = RtProfile::shipped().with(key, value).unwrap();
            let error = RtProfile::load(&source).unwrap_err().to_string();
            assert!(error.contains("config/realtime.toml"), "{error}");
            for part in [key, value, named] {
                assert!(error.contains(part), "{error} lacks {part}");
            }
        }
    }

    #[test]
    fn strict_profile_is_refused_where_a_core_is_missing() {
        let strict = RtProfile::shipped().with("strict", "true").unwrap();
        let source = strict.with("control.cpu", "1023").unwrap();
        let refused = RtProfile::load(&source).unwrap().check().unwrap_err();
        assert!(refused.to_string().contains("core refused"), "{refused}");
    }

    /// Whether or not this system lets the device be held.
    #[test]
    fn strict_profile_insists_on_cores_out_of_idle_states() {
        let asked = RtProfile::shipped().with("hold_cpu_dma_latency", "true");
        // Nothing else that may be refused.
        let alone = asked
            .and_then(|it| it.with("lock_memory", "false"))
            .unwrap();
        let alone = alone.with("control.priority", "0").unwrap();
        let held = RtProfile::load(&alone).unwrap().hold().unwrap();
        let strict = RtProfile::load(&alone.with("strict", "true").unwrap()).unwrap();
        match held.cpu_latency {
            Grant::Granted => strict.check().unwrap(),
            Grant::Refused(_) => {
                for refused in [strict.check().err(), strict.hold().err()] {
                    let said = refused.unwrap().to_string();
                    assert!(said.contains("awake cores refused"), "{said}");
                }
            }
            Grant::NotAsked => panic!("it was asked for"),
        }
    }
}
