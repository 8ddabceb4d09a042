//! What the benches share: one way to measure, and one way to set a figure against what it must be.

use std::fs;
use std::time::Duration;

use criterion::Criterion;
use trocar::histogram::Histogram;

/// Criterion, set for benches that end within seconds; the command line may change it.
///
/// Says first how busy the machine is: on one that is shared, percentiles measure the neighbours
/// too.
#[expect(clippy::print_stdout, reason = "a bench tells a person")]
pub(crate) fn criterion() -> Criterion {
    let load = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!("load average: {}", load.trim_end());
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args()
}

/// Criterion's estimate of `work`'s mean, then the distribution over `runs` more.
///
/// `work` does the thing once and gives the time it took, ns: what it prepares before is not
/// counted.
pub(crate) fn measure(
    criterion: &mut Criterion,
    name: &str,
    runs: u32,
    mut work: impl FnMut() -> u64,
) -> Histogram {
    criterion.bench_function(name, |bencher| {
        bencher
            .iter_custom(|iterations| Duration::from_nanos((0..iterations).map(|_| work()).sum()));
    });
    let mut histogram = Histogram::new();
    for _ in 0..runs {
        histogram.record(work());
    }
    histogram
}

/// A figure beside what it must be; `margin` is how many times better it is, so that 1 just meets
/// it.
#[expect(clippy::print_stdout, reason = "a bench tells a person")]
pub(crate) fn report(figure: &str, target: &str, margin: f64) {
    let verdict = if margin >= 1.0 { "met" } else { "MISSED" };
    println!("{figure}; {target}: {verdict}, {margin:.2} times");
}
