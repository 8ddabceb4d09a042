//! How long a millisecond of tissue takes. Run in release: `cargo test --release -p sim_backend --lib tissue -- --ignored --nocapture bench`.

use super::{flap_config, jaw_at, organ_ground};
use crate::tissue::Tissue;

#[test]
#[ignore = "prints a time, judges nothing"]
fn bench_of_a_millisecond() {
    let config = flap_config();
    let jaw = jaw_at([0.0, 0.0, 0.08], 0.4, 0.0);
    let mut tissue = Tissue::new(&config, organ_ground(), 1, &[jaw]);
    let mut time = |name: &str, steps: u32, mut input: Box<dyn FnMut(u32) -> crate::tissue::JawInput>| {
        #[expect(clippy::disallowed_methods, reason = "a bench reads the clock")]
        let start = std::time::Instant::now();
        for step in 0..steps {
            tissue.step(&[input(step)]);
        }
        let micros = start.elapsed().as_secs_f64() * 1e6 / f64::from(steps);
        println!("{name}: {micros:.1} us a step, {:.1} times real time; {:?}", 1e3 / micros, tissue.report());
    };
    time("nothing near", 2000, Box::new(move |_| jaw));
}
