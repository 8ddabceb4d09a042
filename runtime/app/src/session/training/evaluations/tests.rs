//! Which weights are kept, and when they are asked for.

use super::*;
use crate::session::scratch::Scratch;

fn evaluations(out: &Path) -> Evaluations {
    Evaluations {
        plan: TrainingEval {
            every: 100,
            task: None,
            trials: 10,
            seed: 7,
            jobs: 1,
            latency_ms: None,
        },
        task: "needle-lift".to_owned(),
        out: out.to_owned(),
        device: Device::Cpu,
        rows: Vec::new(),
        best: best_in(out).unwrap(),
    }
}

/// Settles a checkpoint whose only file tells its step.
fn settle(evaluations: &mut Evaluations, step: u64, successes: usize) {
    let part = evaluations.out.join(PART);
    fs::create_dir_all(&part).unwrap();
    fs::write(part.join("weights"), step.to_string()).unwrap();
    let score = Score {
        successes,
        failures: 10 - successes,
        invalid: 0,
    };
    evaluations
        .settle(&part, Evaluation::of(step, score))
        .unwrap();
    assert!(!part.exists());
}

fn kept(out: &Path) -> String {
    fs::read_to_string(out.join(BEST).join("weights")).unwrap()
}

#[test]
fn the_best_weights_are_kept_and_of_equals_the_later() {
    let out = Scratch::folder("evaluations-best");
    let mut evaluations = evaluations(&out);
    for (step, successes, best) in [
        (100, 2, "100"),
        (200, 7, "200"),
        (300, 6, "200"),
        (400, 7, "400"),
        (450, 0, "400"),
    ] {
        settle(&mut evaluations, step, successes);
        assert_eq!(kept(&out), best);
    }
    assert!(!out.join(OLD).exists());
    let table = fs::read_to_string(out.join(TABLE_FILE)).unwrap();
    let steps: Vec<&str> = table
        .lines()
        .map(|line| line.split(',').next().unwrap())
        .collect();
    assert_eq!(steps, ["step", "100", "200", "300", "400", "450"]);
    assert!(table.contains("\n200,10,7,0.7,0.39"), "{table}");
    let best = evaluations.best().unwrap();
    assert_eq!((best.step, best.successes), (400, 7));
}

#[test]
fn a_training_that_goes_on_knows_the_best_of_before() {
    let out = Scratch::folder("evaluations-resumed");
    settle(&mut evaluations(&out), 100, 8);
    // Cut off while the best were replaced.
    fs::rename(out.join(BEST), out.join(OLD)).unwrap();
    let mut resumed = evaluations(&out);
    assert_eq!(resumed.best().map(|best| best.step), Some(100));
    settle(&mut resumed, 200, 5);
    assert_eq!(kept(&out), "100");
    settle(&mut resumed, 300, 9);
    assert_eq!(kept(&out), "300");
    let file = out.join(BEST).join(RESULT_FILE);
    for text in ["{", "{}", "{\"evaluation\": {\"step\": 1}}"] {
        fs::write(&file, text).unwrap();
        let error = best_in(&out).unwrap_err();
        assert!(error.is_bad_input() && error.to_string().contains(RESULT_FILE));
    }
}

#[test]
fn evaluations_are_due_every_so_many_steps_and_at_the_end() {
    let out = Scratch::folder("evaluations-due");
    let mut evaluations = evaluations(&out);
    let due: Vec<u64> = (1..=250)
        .filter(|&step| evaluations.wants(step, 250))
        .collect();
    assert_eq!(due, [100, 200, 250]);
    let left = [0, 99, 100, 200, 250].map(|step| evaluations.left(step, 250));
    assert_eq!(left, [3, 3, 2, 1, 0]);
    assert_eq!(
        [0, 100, 200].map(|step| evaluations.left(step, 200)),
        [2, 1, 0]
    );
    settle(&mut evaluations, 100, 1);
    assert!(!evaluations.wants(100, 250), "once");
}
