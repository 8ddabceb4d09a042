//! What `nvidia-smi` reports of GPUs: their names, and how much memory each process has there.
//! Without `nvidia-smi` the figures are missing, and nothing fails.

use std::collections::BTreeMap;
use std::io::Read;
use std::process::{Child, Command, Stdio};

use hal::TimeNs;

/// Polling period for the memory.
const EVERY_NS: u64 = 3_000_000_000;

/// The names of GPUs by what `CUDA_VISIBLE_DEVICES` calls them; none where there is no
/// `nvidia-smi`.
#[must_use]
pub fn names() -> BTreeMap<String, String> {
    let asked = Command::new("nvidia-smi")
        .args(["--query-gpu=index,name", "--format=csv,noheader"])
        .stderr(Stdio::null())
        .output();
    let Ok(answer) = asked else {
        return BTreeMap::new();
    };
    let text = String::from_utf8_lossy(&answer.stdout).into_owned();
    let pairs = text.lines().filter_map(|line| line.split_once(','));
    pairs
        .map(|(index, name)| (index.trim().to_owned(), name.trim().to_owned()))
        .collect()
}

/// Greatest memory of processes on GPUs, looked at now and then without waiting for the answer.
#[derive(Debug, Default)]
pub struct MemoryWatch {
    /// The `nvidia-smi` that has been asked and has not answered.
    asked: Option<Child>,
    /// When it is asked next, at the earliest.
    next: TimeNs,
    /// By process, bytes.
    peaks: BTreeMap<u32, u64>,
    /// There is no `nvidia-smi`.
    absent: bool,
}

impl MemoryWatch {
    /// Looks, if it is time to.
    pub fn look(&mut self, now: TimeNs) {
        self.collect();
        if self.asked.is_none() && !self.absent && now >= self.next {
            self.next = now.plus_ns(EVERY_NS);
            self.ask();
        }
    }

    /// Notes the answer, if it has come.
    fn collect(&mut self) {
        let Some(asked) = &mut self.asked else {
            return;
        };
        match asked.try_wait() {
            Ok(None) => return,
            Ok(Some(_)) => {
                let mut text = String::new();
                if let Some(out) = &mut asked.stdout
                    && out.read_to_string(&mut text).is_ok()
                {
                    self.note(&text);
                }
            }
            Err(_) => self.absent = true,
        }
        self.asked = None;
    }

    /// It runs beside the study, whose thread never waits for it.
    fn ask(&mut self) {
        let asked = Command::new("nvidia-smi")
            .args([
                "--query-compute-apps=pid,used_memory",
                "--format=csv,noheader,nounits",
            ])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        match asked {
            Ok(child) => self.asked = Some(child),
            Err(_) => self.absent = true,
        }
    }

    /// Takes an answer: lines of a process and its memory, MiB.
    fn note(&mut self, text: &str) {
        for line in text.lines() {
            let Some((process, mib)) = line.split_once(',') else {
                continue;
            };
            if let (Ok(process), Ok(mib)) = (process.trim().parse(), mib.trim().parse::<u64>()) {
                let peak: &mut u64 = self.peaks.entry(process).or_default();
                *peak = (*peak).max(mib << 20);
            }
        }
    }

    /// The greatest memory of `process` that was seen, bytes; forgotten after.
    pub fn take(&mut self, process: u32) -> Option<u64> {
        self.peaks.remove(&process)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_greatest_memory_of_each_process_is_kept() {
        let mut watch = MemoryWatch::default();
        watch.note("12, 300\n40, 10\n");
        watch.note("12, 200\n40, [N/A]\n");
        assert_eq!(watch.take(12), Some(300 << 20));
        assert_eq!((watch.take(12), watch.take(40)), (None, Some(10 << 20)));
    }
}
