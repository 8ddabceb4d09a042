//! `trocar doctor`: what this machine offers, what that means for a run, and what would help.
//!
//! `realtime` asks the kernel, `devices` what else a run opens; graphics and networks are probes of
//! the caller's, so that this module depends on neither. Nothing is changed on the machine: a lock
//! or a scheduling class that is tried goes with its thread or at once.

mod devices;

pub(crate) use devices::NO_CAN_REMEDY;
mod realtime;

use core::fmt;

use serde::Serialize;

/// How well a need is met.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// As a run on a real arm wants it.
    Ok,
    /// Good enough for simulation.
    Limited,
    /// What needs it will not work.
    Missing,
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ok => "ok",
            Self::Limited => "limited",
            Self::Missing => "missing",
        })
    }
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub name: &'static str,
    /// How well the need is met.
    pub status: Status,
    /// What was found.
    pub detail: String,
    /// What would help; empty if all is well.
    pub remedy: String,
}

impl Finding {
    /// A remedy of what is well is dropped.
    fn new(name: &'static str, status: Status, detail: impl Into<String>, remedy: &str) -> Self {
        let remedy = if status == Status::Ok {
            String::new()
        } else {
            remedy.to_owned()
        };
        Self {
            name,
            status,
            detail: detail.into(),
            remedy,
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<8} {:<15} {}", self.status, self.name, self.detail)?;
        if self.remedy.is_empty() {
            return Ok(());
        }
        write!(f, "\n{:24} -> {}", "", self.remedy)
    }
}

/// Asks a library that only the caller links: what it found, or why nothing.
pub type Probe<'a> = &'a dyn Fn() -> Result<String, String>;

/// How to look at what the runtime itself does not know.
pub struct Probes<'a> {
    /// Names the devices that the renderer can use.
    pub graphics: Probe<'a>,
    /// Names the network library and its devices.
    pub networks: Probe<'a>,
}

impl fmt::Debug for Probes<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Probes").finish_non_exhaustive()
    }
}

/// Looks at everything; takes about half a second, and what the probes take.
#[must_use]
pub fn examine(probes: &Probes<'_>) -> Vec<Finding> {
    vec![
        realtime::kernel(),
        realtime::cores(),
        realtime::fifo(),
        realtime::memory_locking(),
        realtime::idle_states(),
        realtime::timer(),
        devices::shared_memory(),
        devices::can(),
        devices::graphics(probes.graphics),
        devices::networks(probes.networks),
    ]
}

/// All findings as a table for people. One line each, and under it what would help.
#[must_use]
pub fn table(findings: &[Finding]) -> String {
    findings
        .iter()
        .map(|finding| format!("{finding}\n"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shortcoming_comes_with_a_remedy_and_nothing_else_does() {
        let findings = examine(&Probes {
            graphics: &|| Ok("llvmpipe (software)".into()),
            networks: &|| Err("no library".into()),
        });
        assert_eq!(findings.len(), 10);
        for finding in &findings {
            assert_eq!(
                finding.remedy.is_empty(),
                finding.status == Status::Ok,
                "{finding}"
            );
            assert!(!finding.detail.is_empty(), "{finding}");
        }
    }

    #[test]
    fn probes_speak_in_the_report() {
        let probes = Probes {
            graphics: &|| Ok("llvmpipe (software)".into()),
            networks: &|| Err("no library".into()),
        };
        let findings = examine(&probes);
        let find = |name| {
            findings
                .iter()
                .find(|finding| finding.name == name)
                .unwrap()
        };
        assert_eq!(
            (find("graphics").status, find("graphics").detail.as_str()),
            (Status::Ok, "llvmpipe (software)")
        );
        assert_eq!(
            (find("networks").status, find("networks").detail.as_str()),
            (Status::Missing, "no library")
        );
    }

    #[test]
    fn findings_read_as_json_and_as_a_table() {
        let finding = Finding::new("can", Status::Missing, "no PF_CAN", "load can_raw");
        let json = serde_json::to_value(&finding).unwrap();
        let expected = serde_json::json!({"name": "can", "status": "missing", "detail": "no PF_CAN", "remedy": "load can_raw"});
        assert_eq!(json, expected);
        let lines = table(&[finding]);
        assert_eq!(
            lines,
            "missing  can             no PF_CAN\n                         -> load can_raw\n"
        );
    }
}
