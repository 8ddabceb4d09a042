//! What a file may say, and where the mark falls.

use hal::config::Source;

use super::{TaskFile, flap_config, task_source};

/// The message of the check after `from` became `to` in the task's file.
fn complaint(from: &str, to: &str) -> String {
    let text = task_source().text().to_owned();
    assert!(text.contains(from), "{from}");
    let source = Source::embedded("scene.toml", &text.replacen(from, to, 1));
    match source.parse::<TaskFile>() {
        Err(error) => error.to_string(),
        Ok(file) => {
            let checked = file
                .tissue
                .check(&source, "tissue")
                .and(file.success.check(&source, "success"));
            checked.unwrap_err().to_string()
        }
    }
}

#[test]
fn numbers_out_of_range_are_named_with_key_and_range() {
    for (from, to, key) in [
        (
            "young_pa = 1.0e5",
            "young_pa = -1.0",
            "tissue.material.young_pa = -1 is outside [1000, 2000000]",
        ),
        (
            "poisson = 0.45",
            "poisson = 0.5",
            "tissue.material.poisson = 0.5",
        ),
        ("cells = [15, 12]", "cells = [15, 1]", "tissue.cells.1 = 1"),
        (
            "span_m = 0.040",
            "span_m = 0.080",
            "tissue.mark.span_m = 0.08 is outside [0, 0.06]",
        ),
        (
            "break_force_n = 1.0",
            "break_force_n = nan",
            "tissue.grasp.break_force_n = NaN",
        ),
        ("hold_s = 0.5", "hold_s = -0.5", "success.hold_s = -0.5"),
        ("relaxation_s = 5.0e-5", "relaxation = 5.0e-5", "relaxation"),
    ] {
        let message = complaint(from, to);
        assert!(message.contains(key), "{message}");
    }
}

#[test]
fn sub_steps_too_long_for_the_stiffness_are_refused() {
    let message = complaint("substeps = 8", "substeps = 6");
    assert!(
        message.contains("tissue.substeps = 6 is outside [7, 64]"),
        "{message}"
    );
    let message = complaint("young_pa = 1.0e5", "young_pa = 4.0e5");
    assert!(
        message.contains("tissue.substeps = 8 is outside [1"),
        "{message}"
    );
}

#[test]
fn mark_covers_its_span_evenly_and_hangs_on_the_seed_alone() {
    let config = flap_config();
    let draws: Vec<f64> = (0..4000)
        .map(|seed| config.mark.draw(seed, &config)[0] - 0.030)
        .collect();
    assert!(draws.iter().all(|u| u.abs() <= 0.020));
    for quarter in 0..4 {
        let low = -0.020 + 0.010 * f64::from(quarter);
        let inside = draws
            .iter()
            .filter(|u| (low..low + 0.010).contains(*u))
            .count();
        assert!(
            (900..1100).contains(&inside),
            "{inside} of 4000 in quarter {quarter}"
        );
    }
    let bits = |seed| config.mark.draw(seed, &config).map(f64::to_bits);
    assert_eq!(bits(7), bits(7));
    assert_ne!(bits(7), bits(8));
    assert!((config.grid_depth_m() - config.mark.draw(7, &config)[1] - 0.003).abs() < 1e-12);
}
