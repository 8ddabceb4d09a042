//! A run in lockstep whose log becomes a dataset, against another reading of the log.

use serde_json::Value;
use trocar_data::dataset::Notes;
use trocar_log::{LoggedItem, read_items};

use super::disturbed::small_lift;
use super::*;
use crate::session::import_log::{LogImportOptions, import_logs};
use crate::session::run::run_lockstep;

/// The images of `camera` in the log, decoded, by their stamp in ns.
fn images(log: &Path, camera: &str) -> Vec<(u64, image::RgbImage)> {
    let mut images = Vec::new();
    read_items(log, |item| {
        if let LoggedItem::Image {
            camera: of,
            at,
            image,
        } = item
            && of == camera
        {
            let image = image::load_from_memory(image).unwrap();
            images.push((at.0, image.into_rgb8()));
        }
    })
    .unwrap();
    images
}

/// Every policy step from the first target on is a frame: states, tip targets and pictures are
/// those of its tick.
#[test]
fn a_log_in_lockstep_becomes_the_steps_of_its_run() {
    let folder = Scratch::folder("session-logged");
    let log = folder.join("lift.mcap");
    let plan = Plan {
        log: Some(log.clone()),
        ..small_lift(&[])
    };
    let result = run_lockstep(&plan).unwrap();
    assert!(result.ok, "{:?}", result.summary);
    let options = LogImportOptions {
        logs: vec![log.clone()],
        out: folder.join("demos"),
        task: "Lift the needle".to_owned(),
        fps: 25,
        cameras: Vec::new(),
        size: None,
        video: None,
        failures: false,
    };
    import_logs(&options, &mut |_, _| {}).unwrap();

    let read = RunLog::open(&log).unwrap();
    let asked = |report: &Value| report["target"].is_array() && report["mode"] == "ENABLED";
    let steps = read.steps().map(|step| {
        let report = step.reports.first.unwrap();
        (*step.tick, serde_json::from_slice::<Value>(report).unwrap())
    });
    let steps: Vec<_> = steps.skip_while(|(_, report)| !asked(report)).collect();
    let steps: Vec<_> = steps
        .iter()
        .filter(|(tick, _)| tick.tick % 40 == 0)
        .collect();
    let dataset = Dataset::open(&options.out).unwrap();
    assert_eq!(dataset.len(), steps.len());
    assert!(dataset.len() > 50, "{}", dataset.len());
    let images = images(&log, "endoscope");
    for (frame, (tick, report)) in steps.iter().enumerate() {
        let state = tick.arms.first.measured.unwrap();
        let numbers = state.position.iter().chain([&state.jaw_position]);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a dataset's numbers are f32"
        )]
        let short = |value: f64| value as f32;
        let expected: Vec<f32> = numbers.map(|value| short(*value)).collect();
        assert_eq!(dataset.state(frame, 0).to_vec(), expected, "{frame}");
        let target = report["target"].as_array().unwrap().iter();
        let target = target.map(|value| f64::from(short(value.as_f64().unwrap())));
        assert_eq!(
            dataset.action(frame, 0).to_vec(),
            target.collect::<Vec<_>>(),
            "{frame}"
        );
        let seen = images.iter().find(|(at, _)| *at == tick.now.0);
        assert!(
            dataset.image_rgb(frame, 0).unwrap() == seen.unwrap().1,
            "{frame}"
        );
    }
    let notes = Notes::read(&options.out).unwrap();
    assert_eq!(notes.recording.unwrap()["task"], "needle-lift");
    assert_eq!(
        notes.episodes[0]["command_hash"],
        result.summary.command_hash
    );
    assert_eq!(
        (dataset.task(), dataset.spec().task.as_str()),
        ("needle-lift", "Lift the needle")
    );
}
