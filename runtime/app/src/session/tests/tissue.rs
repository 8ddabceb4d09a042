//! What a soft tissue adds to the results, and that only the expert retracts it.

use crate::session::eval::{EvalOptions, evaluate};
use crate::session::{Plan, PolicyChoice};

fn evaluated(
    task: &str,
    policy: PolicyChoice,
    seed: u64,
    limit_s: Option<f64>,
) -> serde_json::Value {
    let mut plan = Plan {
        seed,
        ..Plan::load(task, policy).unwrap()
    };
    let time_limit_s = &mut plan.setup.task.time_limit_s;
    *time_limit_s = limit_s.unwrap_or(*time_limit_s);
    let options = EvalOptions {
        trials: 1,
        jobs: 1,
        keep: None,
    };
    let summary = evaluate(&plan, &options, &|| false, &mut |_| {}).unwrap();
    serde_json::to_value(&summary).unwrap()
}

/// Expert retracts the flap through the whole chain and the tissue is reported.
#[test]
fn expert_retracts_the_flap_and_reports_the_tissue() {
    let result = evaluated("tissue-retraction", PolicyChoice::Expert, 1, None);
    assert_eq!(result["successes"], 1, "{result}");
    let tissue = &result["episodes"][0]["tissue"];
    let value = |key: &str| tissue[key].as_f64().unwrap();
    assert!((0.03..0.8).contains(&value("force_n_max")), "{tissue}");
    assert!((0.5..2.8).contains(&value("squeeze_n_max")), "{tissue}");
    assert!((0.005..0.4).contains(&value("stretch_max")), "{tissue}");
    assert!((0.02..0.03).contains(&value("mark_rise_m_max")), "{tissue}");
}

#[test]
fn nobody_retracts_the_flap_by_doing_nothing_or_anything() {
    for policy in [PolicyChoice::Noop, PolicyChoice::Random] {
        // Longer than the expert takes.
        let result = evaluated("tissue-retraction", policy, 1, Some(6.0));
        assert_eq!(result["successes"], 0, "{result}");
    }
}

#[test]
fn tasks_without_a_tissue_report_none() {
    let result = evaluated("needle-lift", PolicyChoice::Noop, 1, Some(1.0));
    let episode = result["episodes"][0].as_object().unwrap();
    assert!(!episode.contains_key("tissue"), "{result}");
}
