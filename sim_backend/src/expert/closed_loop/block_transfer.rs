//! The block transfer's expert.

use super::{hold, run};
use crate::task::{Outcome, TaskConfig};

fn task() -> TaskConfig {
    TaskConfig::parse(&TaskConfig::source("block-transfer").unwrap()).unwrap()
}

#[test]
fn expert_moves_the_block() {
    let task = task();
    let mut lost = Vec::new();
    for seed in 0..8 {
        let episode = run(&task, seed, |_, _| {});
        if episode.outcome != Outcome::Success {
            lost.push(format!(
                "seed {seed}: {} after {} attempts",
                episode.outcome, episode.attempts
            ));
        }
        println!(
            "seed {seed}: {} {} s {} attempts {} m/s",
            episode.outcome, episode.seconds, episode.attempts, episode.speed_m_s_max
        );
    }
    assert!(lost.is_empty(), "{lost:#?}");
}
