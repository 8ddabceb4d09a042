//! Recordings that are disturbed and varied: what is kept, what is said of it, and how often
//! experts recover.

use serde_json::Value;
use trocar_data::dataset::Notes;
use trocar_tasks::disturbance::Disturber;
use trocar_tasks::task::{Outcome, Variation};

use super::*;
use crate::session::episode::NoObserver;
use crate::session::record::notes::DISTURBED_TIME_FACTOR;
use crate::session::scene_options::SceneOptions;

/// The needle lift with small pictures, `varied`.
pub(super) fn small_lift(varied: &[Variation]) -> Plan {
    let options = SceneOptions {
        varied: varied.to_vec(),
        ..SceneOptions::default()
    };
    let setup = Setup::load("needle-lift", None, &PolicyChoice::Expert).unwrap();
    let mut setup = setup.with_scene(&options).unwrap();
    setup.task.shading = Shading::Plain;
    for camera in &mut setup.task.cameras {
        (camera.width, camera.height) = (64, 64);
    }
    Plan {
        seed: 40,
        ..Plan::new(setup, PolicyChoice::Expert)
    }
}

pub(super) fn options(out: &Path, disturb: Option<f64>) -> RecordOptions {
    RecordOptions {
        episodes: 2,
        out: out.to_owned(),
        resume: false,
        jobs: 2,
        depth: false,
        video: None,
        disturb,
        instruction: None,
        failures: None,
    }
}

#[test]
fn a_disturbed_and_varied_recording_says_so() {
    let folder = Scratch::new("session-disturbed");
    let plan = small_lift(&Variation::ALL);
    let options = options(&folder.0, Some(1.0));
    let summary = record(&plan, &options, &|| false, &mut |_| {}).unwrap();
    assert_eq!((summary.episodes, summary.needle), (2, None));
    let kept: Vec<_> = summary.attempts.iter().filter(|it| it.kept).collect();
    let counts = summary.disturbed.unwrap();
    assert_eq!((counts.kept, counts.attempts), (2, summary.attempts.len()));

    let dataset = Dataset::open(&folder.0).unwrap();
    let notes = Notes::read(&folder.0).unwrap();
    let recording = notes.recording.unwrap();
    assert_eq!(
        recording["varied"],
        serde_json::json!(["needles", "views", "light", "lens"])
    );
    assert_eq!(
        recording["disturb"],
        serde_json::json!({"share": 1.0, "time_limit_s": 24.0})
    );
    assert_eq!(
        (&recording["task"], &recording["seed"]),
        (&"needle-lift".into(), &40.into())
    );
    assert_eq!(recording["needle"], Value::Null);
    assert_eq!(notes.episodes.len(), 2);
    for (index, (note, attempt)) in notes.episodes.iter().zip(kept).enumerate() {
        assert_eq!(
            (&note["episode_index"], &note["seed"]),
            (&index.into(), &attempt.seed.into())
        );
        let drawn = serde_json::to_value(plan.setup.task.drawn(attempt.seed)).unwrap();
        for (key, value) in drawn.as_object().unwrap() {
            assert_eq!(&note[key], value, "{key}");
        }
        assert_eq!(drawn.as_object().unwrap().len(), 4);
        let disturbances = note["disturbances"].as_array().unwrap();
        assert_eq!(disturbances.len(), attempt.disturbances);
        let steps = dataset.episodes()[index].len;
        let end_s = f64::from(u32::try_from(steps).unwrap()) / 25.0;
        for disturbance in disturbances {
            let [from_s, to_s] = ["from_s", "to_s"].map(|key| disturbance[key].as_f64().unwrap());
            assert!(from_s < to_s && from_s < end_s && disturbance["kind"].is_string());
        }
    }
}

/// A plain recording says nothing that LeRobot sees and is as it was.
#[test]
fn plain_recording_stays_as_lerobot_knows_it() {
    let folder = Scratch::new("session-undisturbed");
    let plan = small_lift(&[]);
    let record_in = |name: &str, disturb| {
        let out = folder.0.join(name);
        let summary = record(&plan, &options(&out, disturb), &|| false, &mut |_| {}).unwrap();
        (out, summary)
    };
    let (plain, summary) = record_in("plain", None);
    assert_eq!(summary.disturbed, None);
    let notes = Notes::read(&plain).unwrap();
    assert_eq!((notes.recording, notes.episodes.len()), (None, 2));
    assert_eq!(notes.episodes[0]["seed"], 40);
    assert_eq!(notes.options.unwrap()["seed"], 40);
    let info = fs::read_to_string(plain.join("meta/info.json")).unwrap();
    assert!(!info.contains("trocar"), "{info}");
    // A share so small that it comes to nothing leaves every number as it is.
    let (spared, _) = record_in("spared", Some(1e-9));
    let notes = Notes::read(&spared).unwrap();
    assert_eq!(notes.episodes[0]["disturbances"], Value::Null);
    let [plain, spared] = [plain, spared].map(|out| Dataset::open(&out).unwrap());
    assert_eq!(plain.len(), spared.len());
    for frame in 0..plain.len() {
        let bits = |dataset: &Dataset| dataset.action(frame, 0).map(f64::to_bits);
        assert_eq!(bits(&plain), bits(&spared));
        assert_eq!(
            plain.state(frame, 0).map(f32::to_bits),
            spared.state(frame, 0).map(f32::to_bits)
        );
    }
}

#[expect(clippy::print_stdout, reason = "figures of a long test")]
/// How many of `seeds` the expert of `task` succeeds in, all disturbed, with the controller that a
/// session has and without cameras.
fn successes(task: &str, seeds: std::ops::Range<u64>) -> usize {
    let mut setup = Setup::load(task, None, &PolicyChoice::Expert).unwrap();
    setup.task.time_limit_s *= f64::from(DISTURBED_TIME_FACTOR);
    let (mut done, mut retried, count) = (0, 0, seeds.end - seeds.start);
    for seed in seeds {
        let mut disturber = Disturber::draw(&setup.task, seed, 1.0).unwrap();
        let mut simulation = Simulation::new(&setup.task, seed, Rendering::Off).unwrap();
        let mut controller = setup.controller().unwrap();
        let mut source = setup
            .source(&PolicyChoice::Expert, seed, Device::Cpu)
            .unwrap();
        let timing = Timing {
            latency: Latency::fixed(0),
            tick_limit: setup.tick_limit(),
        };
        let episode = Episode {
            simulation: &mut simulation,
            controller: &mut controller,
            source: &mut source,
        };
        let end = episode
            .run_disturbed(&timing, &mut NoObserver, Some(&mut disturber))
            .unwrap();
        assert_eq!(end.tally.faults(), None, "{task}, seed {seed}");
        if end.outcome == Outcome::Success {
            done += 1;
            retried += usize::from(source.attempts() > 1);
        } else {
            println!(
                "{task}, seed {seed}: {}: {:?}",
                end.reason(),
                disturber.happened()
            );
        }
    }
    println!("{task}: {done} of {count}, {retried} with another attempt");
    done
}

#[test]
fn disturbed_experts_recover_under_the_controller() {
    for task in crate::session::tasks::names() {
        assert!(successes(task, 200..202) >= 1, "{task}");
    }
}

#[test]
#[ignore = "takes minutes"]
fn disturbed_experts_succeed_45_times_of_50() {
    for task in crate::session::tasks::names() {
        assert!(successes(task, 0..50) >= 45, "{task}");
    }
}
