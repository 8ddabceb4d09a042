//! How long a millisecond of tissue takes on one core: `cargo test --release -p trocar-world --lib
//! tissue::tests::bench -- --ignored --nocapture --test-threads 1`.
//!
//! The time is what the kernel counts as this thread's own, so that neighbours on the machine count
//! less; the best of several rounds counts, so that they hardly count at all.

use super::{Puppet, flap_config, jaw, jaw_at, organ_ground};
use crate::tissue::{JawInput, Tissue};

/// Nanoseconds that this thread has run.
fn own_ns() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse().unwrap()
}

fn time(name: &str, tissue: &mut Tissue, mut input: impl FnMut(u32) -> JawInput) {
    const STEPS: u32 = 200;
    let mut times_us: Vec<f64> = (0..10)
        .map(|round| {
            let start = own_ns();
            for step in 0..STEPS {
                tissue.step(&[input(round * STEPS + step)]);
            }
            #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
            let ns = (own_ns() - start) as f64;
            ns * 1e-3 / f64::from(STEPS)
        })
        .collect();
    times_us.sort_by(f64::total_cmp);
    #[expect(clippy::print_stdout, reason = "what a bench is for")]
    {
        println!(
            "{name}: best {:.1}, median {:.1} us a step; {:.1} times real time",
            times_us[0],
            times_us[5],
            1e3 / times_us[5]
        );
    }
}

#[test]
#[ignore = "prints a time, judges nothing"]
fn bench_of_a_millisecond() {
    let config = flap_config();
    let away = jaw_at([0.0, 0.0, 0.08], 0.4, 0.0);
    let mut tissue = Tissue::new(&config, organ_ground(), 1, &[away]);
    time("nothing near", &mut tissue, |_| away);
}

#[test]
#[ignore = "prints a time, judges nothing"]
fn bench_of_a_lift() {
    let config = flap_config();
    let mut puppet = Puppet::at_edge(&config, 0.006, 0.0);
    let jaw_with = |tip: &hal::Pose, opening_rad, grip_n| jaw(tip, opening_rad, grip_n);
    let tip = puppet.tip;
    time("closing around the edge", &mut puppet.tissue, |step| {
        jaw_with(&tip, 0.6 - 0.4 * f64::from(step) / 2000.0, 0.0)
    });
    puppet.close(2.0);
    assert!(puppet.tissue.report().grasp.is_some());
    let (tip, opening_rad) = (puppet.tip, puppet.opening_rad);
    time("held and lifted", &mut puppet.tissue, |step| {
        let up = nalgebra::Translation3::new(0.0, 0.0, 0.02 * f64::from(step) / 2000.0);
        jaw_with(&(up * tip), opening_rad, 2.0)
    });
}
