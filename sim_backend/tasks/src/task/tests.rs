//! Facts about scene files: what ships is valid, and what is wrong is named.

use trocar_world::{Grasp, World};

use super::*;
use crate::scene::THINGS_MAX;
use crate::task::needle_lift::NeedleLift;
use hal::ARMS_MAX;

fn needle_lift_text() -> String {
    let files = TaskFiles::built_in("needle-lift").unwrap();
    files.scene.text().to_owned()
}

/// The shipped file with one line replaced, and the number of that line.
fn doctored(old: &str, new: &str) -> (Source, usize) {
    let text = needle_lift_text();
    let line = text
        .lines()
        .position(|line| line.starts_with(old))
        .expect("line to replace")
        + 1;
    let lines: Vec<&str> = text
        .lines()
        .map(|line| if line.starts_with(old) { new } else { line })
        .collect();
    (Source::embedded("scene.toml", &lines.join("\n")), line)
}

#[test]
fn shipped_scene_is_valid_and_starts_above_the_organ() {
    let task = TaskConfig::shipped("needle-lift");
    assert_eq!(task.cameras[0].name, "endoscope");
    assert_eq!((task.cameras[0].width, task.cameras[0].height), (512, 512));
    let arm = task.arms[0];
    // Straight down at zero wrist angles: insertion less 6.5 mm below the RCM.
    let tip_z = arm.scene_from_rcm.translation.z - (arm.joints[2] - 0.0065);
    let height = tip_z - NeedleLift::shipped().organ.height_m(0.0, 0.0);
    assert!((0.04..0.05).contains(&height), "{height}");
}

#[test]
fn unknown_key_is_named_with_its_line() {
    let (source, line) = doctored("jaw_rad", "jaw_rad = 0.6\nspeling = 1");
    let message = TaskConfig::parse("mine", &source).unwrap_err().to_string();
    assert!(
        message.starts_with(&format!("scene.toml:{}: ", line + 1)) && message.contains("speling"),
        "{message}"
    );
}

#[test]
fn shading_is_full_unless_the_scene_says_plain() {
    let shading = |line: &str| {
        let (source, number) = doctored("shading", line);
        (
            TaskConfig::parse("mine", &source).map(|task| task.shading),
            number,
        )
    };
    let table = |value: &str| shading(&format!("shading = \"{value}\""));
    assert_eq!(shading("").0.unwrap(), Shading::Full);
    let text = needle_lift_text();
    let without = text
        .replace("[rendering]\n", "")
        .replace("shading = \"full\"\n", "");
    assert!(!without.contains("shading ="));
    let without = TaskConfig::parse("mine", &Source::embedded("scene.toml", &without)).unwrap();
    assert_eq!(without.shading, Shading::Full);
    assert_eq!(table("full").0.unwrap(), Shading::Full);
    assert_eq!(table("fine").0.unwrap(), Shading::Fine);
    assert_eq!(table("plain").0.unwrap(), Shading::Plain);
    let (refused, line) = table("glossy");
    let message = refused.unwrap_err().to_string();
    let place = format!("scene.toml:{line}: ");
    assert!(
        message.starts_with(&place)
            && message.contains("rendering.shading = glossy")
            && message.contains("full, fine, plain"),
        "{message}"
    );
}

/// That the scene with `new` in place of the line that begins with `old` is refused with that line
/// and `key`.
fn is_refused_by_line(old: &str, new: &str, key: &str) {
    let (source, line) = doctored(old, new);
    let message = TaskConfig::parse("mine", &source).unwrap_err().to_string();
    assert!(
        message.starts_with(&format!("scene.toml:{line}: {key}")),
        "{message}"
    );
}

#[test]
fn value_out_of_range_is_named_with_line_key_and_range() {
    for (old, new, key) in [
        (
            "hold_s",
            "hold_s = -1.0",
            "success.hold_s = -1 is outside [0.05, 10]",
        ),
        (
            "mass_kg",
            "mass_kg = 5.0",
            "needle.N1.mass_kg = 5 is outside",
        ),
        (
            "vertical_fov_rad",
            "vertical_fov_rad = 4.0",
            "camera.0.vertical_fov_rad = 4 is outside",
        ),
        (
            "vertical_fov_rad",
            "intrinsics = { fx_px = 400.0, fy_px = 500.0, cx_px = 512.0, cy_px = 200.0 }",
            "camera.0.intrinsics.cx_px = 512 is outside [-0.5, 511.5]",
        ),
        (
            "vertical_fov_rad",
            "intrinsics = { fx_px = 400.0, fy_px = 4.0, cx_px = 250.0, cy_px = 200.0 }",
            "camera.0.intrinsics.fy_px = 4 is outside [40.96, 10240]",
        ),
        (
            "vertical_fov_rad",
            "vertical_fov_rad = 0.6\nintrinsics = { fx_px = 400.0, fy_px = 500.0, cx_px = 250.0, cy_px = 200.0 }",
            "camera.0.vertical_fov_rad = 0.6: intrinsics say what the lens is like",
        ),
        (
            "range_m",
            "range_m = [0.025, 0.5]",
            "needle_start.range_m.1 = 0.5 is outside",
        ),
        (
            "joints",
            "joints = [0.0, 0.0, 0.3, 0.0, 0.0, 0.0]",
            "arm.0.joints.2 = 0.3 is outside",
        ),
        ("up", "up = [0.0, 0.0, 2.0]", "camera.0.up.2 = 2 is outside"),
    ] {
        is_refused_by_line(old, new, key);
    }
}

#[test]
fn camera_that_cannot_be_is_named_with_line_and_key() {
    for (old, new, key) in [
        (
            "name = \"side\"",
            "name = \"endoscope\"",
            "camera.1.name = endoscope is outside names used once",
        ),
        (
            "name = \"side\"",
            "name = \"a side\"",
            "camera.1.name = a side is outside letters",
        ),
        (
            "name = \"side\"",
            "vignette = 1.5\nname = \"side\"",
            "camera.1.vignette = 1.5 is outside [0, 1]",
        ),
        ("arm = 0", "arm = 1", "camera.2.arm = 1 is outside"),
        (
            "name = \"side\"",
            "arm = 0\nname = \"side\"",
            "camera.1.arm = 0 is outside cameras with mount = \"wrist\"",
        ),
    ] {
        is_refused_by_line(old, new, key);
    }
}

/// OpenCV's formula, whose columns and rows count from the centre of the first pixel; and the same
/// lens in smaller pictures.
#[test]
fn calibrated_camera_projects_as_opencv_does() {
    let lens = "intrinsics = { fx_px = 610.5, fy_px = 598.25, cx_px = 240.75, cy_px = 270.5 }\n\
                distortion = [-0.31, 0.09, 0.0012, -0.0018]";
    let (source, _) = doctored("vertical_fov_rad", lens);
    let task = TaskConfig::parse("mine", &source).unwrap();
    let mut camera = task.cameras[0].clone();
    let [x, y] = [0.21_f64, -0.17];
    let r2 = x * x + y * y;
    let radial = 1.0 - 0.31 * r2 + 0.09 * r2 * r2;
    let bent_x = x * radial + 2.0 * 0.0012 * x * y - 0.0018 * (r2 + 2.0 * x * x);
    let bent_y = y * radial + 0.0012 * (r2 + 2.0 * y * y) - 2.0 * 0.0018 * x * y;
    let (column, row) = (610.5 * bent_x + 240.75, 598.25 * bent_y + 270.5);
    let [u, v] = camera.intrinsics().pixel([x, y]);
    assert!((u - 0.5 - column).abs() < 1e-9 && (v - 0.5 - row).abs() < 1e-9);
    camera.resize(256, 128);
    let [small_u, small_v] = camera.intrinsics().pixel([x, y]);
    assert!((small_u - 0.5 * u).abs() < 1e-9 && (small_v - 0.25 * v).abs() < 1e-9);
}

#[test]
fn camera_without_field_of_view_and_calibration_is_an_error() {
    let (source, _) = doctored("vertical_fov_rad", "");
    let message = TaskConfig::parse("mine", &source).unwrap_err().to_string();
    assert!(
        message.contains("camera.0.vertical_fov_rad = absent is outside a field of view"),
        "{message}"
    );
}

#[test]
fn missing_camera_is_an_error() {
    let text = needle_lift_text();
    let (before, rest) = text.split_once("[[camera]]").unwrap();
    let after = &rest[rest.find("\n[success]").unwrap()..];
    let source = Source::embedded("scene.toml", &format!("camera = []\n{before}{after}"));
    let message = TaskConfig::parse("mine", &source).unwrap_err().to_string();
    assert!(
        message.contains("camera = no camera is outside at least one"),
        "{message}"
    );
}

#[test]
fn every_task_ships_with_a_valid_scene_of_its_name() {
    for name in TaskConfig::names() {
        let task = TaskConfig::shipped(name);
        assert_eq!(task.name, name);
        assert!((1..=ARMS_MAX).contains(&task.arms.len()));
        let scene = &task.scene;
        let scenery = scene.scenery(1);
        let handled = scenery.things.len() + usize::from(scenery.flap.is_some());
        assert!((1..=THINGS_MAX).contains(&handled));
        let poses = scene.visual_poses(&[Pose::identity(); THINGS_MAX], &Pose::identity());
        assert_eq!(poses.len(), scene.visuals().len());
    }
    assert!(TaskFiles::built_in("needle-drop").is_none());
}

/// Every part that a task shows has a name and an id of its own.
#[test]
fn visible_parts_have_unique_names_and_ids() {
    let mut ids: Vec<u8> = parts().map(|part| part.instance).collect();
    for name in TaskConfig::names() {
        for visual in scene_visuals(&TaskConfig::shipped(name)) {
            assert!(ids.contains(&visual.instance), "{name}: {}", visual.name);
        }
    }
    ids.sort_unstable();
    let known = ids.len();
    ids.dedup();
    assert_eq!((ids.len(), ids.contains(&0)), (known, false));
    assert!(parts().all(|part| !part.name.is_empty()));
}

#[test]
fn unknown_kind_is_an_error() {
    let (source, line) = doctored("kind =", "kind = \"needle-drop\"");
    let message = TaskConfig::parse("mine", &source).unwrap_err().to_string();
    assert!(
        message.starts_with(&format!("scene.toml:{line}: task.kind = needle-drop")),
        "{message}"
    );
}

#[test]
fn a_scene_file_without_a_kind_is_told_where_it_belongs() {
    let source = Source::embedded("scene.toml", "# of old\ntask = \"needle-lift\"\n");
    let message = TaskConfig::parse("mine", &source).unwrap_err().to_string();
    assert!(
        message.starts_with(
            "scene.toml:2: task: invalid type: string \"needle-lift\", expected a table [task]"
        ),
        "{message}"
    );
}

#[test]
fn needles_can_be_chosen_by_name() {
    let task = TaskConfig::shipped("needle-lift");
    let of = |name: &str| {
        let chosen = TaskConfig::shipped("needle-lift")
            .with_needle(name)
            .unwrap();
        chosen.scene::<NeedleLift>().unwrap().needle
    };
    assert_eq!(of("N1"), NeedleLift::shipped().needle);
    for (name, other) in [("N1", "N2"), ("N2", "N3"), ("N3", "N4"), ("N4", "N5")] {
        assert_ne!(of(name), of(other));
    }
    let known = ["N1", "N2", "N3", "N4", "N5"].map(str::to_owned);
    let expected = NeedleError::Unknown {
        task: "needle-lift".to_owned(),
        name: "N6".to_owned(),
        known: known.to_vec(),
    };
    assert_eq!(task.with_needle("N6").unwrap_err(), expected);
    let pad = TaskConfig::shipped("suture-pad");
    assert!(pad.with_needle("N1").is_err());
}

/// The kind without a rigid thing, which the checks below leave out. Its flap has tests of its own:
/// crushing and sinking in through reports in `tissue/tests/retraction.rs`, crushing through the
/// simulation in `task/tissue_retraction/script/tests.rs`; why it has no energy check is said in
/// `tissue/retraction.rs`.
const FLAP: &str = "tissue-retraction";

/// What a judge of the task `name` says of a thing that lies where it starts while every finger and
/// its energy are as given.
fn judged(
    name: &str,
    force_n: f64,
    penetration_m: f64,
    energies_j: &[Option<f64>],
) -> Option<Outcome> {
    let task = TaskConfig::shipped(name);
    let scene = &task.scene;
    let thing = scene.scenery(1).things.first()?.in_scene;
    let grasp = Grasp {
        left_force_n: force_n,
        right_force_n: 0.0,
        both_touch: false,
        penetration_m,
    };
    let mut judge = Judge::new(scene.monitor(1), task.time_limit_s);
    let mut sight = MonitorInput::of(&World::new(&task.world, &scene.scenery(1), &task.arms));
    sight.thing_in_scene = thing;
    sight.grasps = vec![grasp; task.arms.len()];
    for &energy_j in energies_j {
        sight.free_energy_j = energy_j;
        judge.observe(&sight);
    }
    Some(judge.outcome())
}

#[test]
fn every_thing_can_be_crushed_but_not_by_a_solvers_hiccup() {
    for name in TaskConfig::names() {
        let squeezed = |force_n, steps| judged(name, force_n, 0.0, &vec![None; steps]);
        let Some(outcome) = squeezed(1000.0, 25) else {
            assert_eq!(TaskConfig::shipped(name).kind, FLAP);
            continue;
        };
        assert!(
            matches!(outcome, Outcome::Failure(Reason::Squeezed { force_n, .. }) if force_n > 999.0),
            "{name}: {outcome}"
        );
        assert_eq!(squeezed(1000.0, 15), Some(Outcome::Running), "{name}");
        assert_eq!(squeezed(1.0, 25), Some(Outcome::Running), "{name}");
    }
}

#[test]
fn energy_from_nowhere_makes_every_trial_invalid() {
    for name in TaskConfig::names() {
        let shown = |energies_j: &[Option<f64>]| judged(name, 0.0, 0.0, energies_j);
        let Some(outcome) = shown(&[Some(0.01), Some(0.005), Some(0.02)]) else {
            assert_eq!(TaskConfig::shipped(name).kind, FLAP);
            continue;
        };
        assert!(
            matches!(outcome, Outcome::Invalid(Reason::Gained { energy_j, .. }) if (energy_j - 0.015).abs() < 1e-12),
            "{name}: {outcome}"
        );
        // Falling loses energy, and what a hand lifts gains it from the hand.
        let fallen = shown(&[Some(0.02), Some(0.01), Some(0.005)]);
        assert_eq!(fallen, Some(Outcome::Running), "{name}");
        let lifted = shown(&[Some(0.005), None, Some(0.02), Some(0.02)]);
        assert_eq!(lifted, Some(Outcome::Running), "{name}");
    }
}

#[test]
fn fingers_inside_a_thing_make_every_trial_invalid() {
    for name in TaskConfig::names() {
        let Some(outcome) = judged(name, 0.0, 0.005, &[None; 25]) else {
            assert_eq!(TaskConfig::shipped(name).kind, FLAP);
            continue;
        };
        assert!(
            matches!(outcome, Outcome::Invalid(Reason::Penetration { .. })),
            "{name}: {outcome}"
        );
    }
}
