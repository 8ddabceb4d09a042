//! Chunks that come late and unevenly: drawn by seed, told by the tally, and taken by the
//! controller without harm.

use super::*;
use crate::session::latency::Latency;

/// The first second and a half of a needle lift by the expert, whose chunks come late.
fn late(latency: Latency) -> EpisodeEnd {
    let setup = Setup::load("needle-lift", None, &PolicyChoice::Expert).unwrap();
    let episode = Episode {
        simulation: &mut Simulation::new(&setup.task, 3, Rendering::Off).unwrap(),
        controller: &mut setup.controller().unwrap(),
        source: &mut setup.source(&PolicyChoice::Expert, 3, Device::Cpu).unwrap(),
    };
    let timing = Timing {
        latency,
        tick_limit: 1500,
    };
    episode
        .run(&timing, &mut super::super::episode::NoObserver)
        .unwrap()
}

/// Injected latency and jitter are measured repeat themselves and fault nothing.
#[test]
fn injected_latency_repeats_and_causes_no_fault() {
    let prompt = late(Latency::fixed(0));
    let steady = late(Latency::fixed(60));
    let uneven = Latency {
        ticks: 60,
        jitter_ticks: 80,
        seed: 5,
    };
    let first = late(uneven);
    let summary = |end: &EpisodeEnd| end.tally.policy();
    let (steady_ms, uneven_ms) = (summary(&steady).latency_ms, summary(&first).latency_ms);
    assert!((steady_ms.p50 - 60.0).abs() < 2.0, "{steady_ms:?}");
    assert!(
        uneven_ms.p50 > 70.0 && uneven_ms.p99 > 110.0,
        "{uneven_ms:?}"
    );
    for end in [&prompt, &steady, &first] {
        assert_eq!(end.tally.faults(), None);
        assert_eq!(summary(end).refused, 0, "{:?}", summary(end));
    }
    let hash = |end: &EpisodeEnd| end.tally.command_hash();
    assert_eq!(hash(&first), hash(&late(uneven)));
    let other = late(Latency { seed: 6, ..uneven });
    let all = [&prompt, &steady, &first, &other].map(hash);
    for (index, one) in all.iter().enumerate() {
        assert!(!all[..index].contains(one), "{all:?}");
    }
}
