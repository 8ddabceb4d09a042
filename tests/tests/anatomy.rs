//! `trocar anatomy` from the command line: a phantom, its meshes, the report, and what is refused.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::process::Output;

use tests::{Profile, json, scratch, stderr, trocar};

fn anatomy(arguments: &[&str]) -> Output {
    trocar(Profile::Debug)
        .arg("anatomy")
        .args(arguments)
        .output()
        .unwrap()
}

/// Runs and expects success.
fn done(arguments: &[&str]) {
    let output = anatomy(arguments);
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        stderr(&output)
    );
}

#[test]
fn phantom_becomes_a_patient_with_a_report() {
    let folder = scratch("anatomy");
    let out = folder.display().to_string();
    let [labels, result] = ["labels.nii.gz", "out/result.json"].map(|name| format!("{out}/{name}"));
    done(&[
        "phantom", "--seed", "3", "--size", "72x72x86", "--out", &out,
    ]);
    let options = ["--max-error-mm", "1", "--json", &result];
    done(&[&["build", &labels, "--out", &out], &options[..]].concat());
    let told = json(&folder.join("out/result.json"));
    let groups = told["groups"].as_array().unwrap();
    assert_eq!(groups.len(), 17);
    for group in groups {
        assert_eq!(group["watertight"], true, "{group}");
        assert!(
            (group["volume_ratio"].as_f64().unwrap() - 1.0).abs() < 0.01,
            "{group}"
        );
    }
    let stages = told["stages"].as_array().unwrap();
    assert_eq!(stages.len(), 8);
    assert!(
        stages
            .iter()
            .all(|stage| stage["peak_mib"].as_f64().unwrap() > 1.0)
    );
    assert_eq!(&fs::read(folder.join("patient.glb")).unwrap()[..4], b"glTF");
    assert!(
        fs::read_to_string(folder.join("patient.usda"))
            .unwrap()
            .starts_with("#usda 1.0")
    );
    // The labels are VISTA3D's.
    refused(
        &[
            "build",
            &labels,
            "--out",
            &out,
            "--groups",
            "totalsegmentator",
        ],
        "totalsegmentator.toml has no label",
    );
}

/// A patient is drawn, and the expert works on its liver, which the result tells.
#[test]
fn patient_is_drawn_and_worked_on() {
    let folder = scratch("anatomy-scene");
    let out = folder.display().to_string();
    let labels = format!("{out}/labels.nii.gz");
    done(&[
        "phantom", "--seed", "3", "--size", "64x64x77", "--out", &out,
    ]);
    done(&["build", &labels, "--out", &out]);
    let picture = folder.join("turn.png").display().to_string();
    let small = ["--groups", "liver", "--width", "48", "--frames", "2"];
    done(&[&["preview", &out, "--out", &picture], &small[..]].concat());
    assert!(fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
    refused(
        &["preview", &out, "--out", &picture, "--groups", "brain"],
        "--groups brain",
    );
    refused(&["preview", &out, "--out", &labels], "a .gif or a .png");

    let result = folder.join("run.json");
    let run = |organ: &str| {
        let scene = [format!("patient={out}"), format!("organ={organ}")];
        let [patient, organ] = scene.map(|change| format!("scene.scene.{change}"));
        let task = ["run", "--task", "needle-lift", "--policy", "expert"];
        let set = ["--lockstep", "--set", &patient, "--set", &organ, "--json"];
        let json = result.display().to_string();
        let mut run = trocar(Profile::Debug);
        run.args(task).args(set).arg(json).output().unwrap()
    };
    assert!(run("liver").status.success());
    let told = json(&result);
    assert_eq!(told["success"], true);
    assert_eq!(told["patient"]["organ"], "liver");
    assert!(told["patient"]["patch_in_scan_m"][1].as_f64().unwrap() > 0.0);
    let brain = run("brain");
    assert_eq!(brain.status.code(), Some(2));
    assert!(stderr(&brain).contains("scene.organ = brain is outside liver"));
}

/// Runs and expects exit code 2 with `message`.
fn refused(arguments: &[&str], message: &str) {
    let output = anatomy(arguments);
    assert_eq!(
        output.status.code(),
        Some(2),
        "{arguments:?}: {}",
        stderr(&output)
    );
    assert!(
        stderr(&output).contains(message),
        "{arguments:?}: {}",
        stderr(&output)
    );
}

#[test]
fn bad_volumes_tables_and_options_are_refused() {
    let folder = scratch("anatomy-refused");
    let out = folder.display().to_string();
    let path = |name: &str| folder.join(name).display().to_string();
    fs::write(folder.join("short.nii"), [0; 100]).unwrap();
    fs::write(folder.join("other.nii"), [7; 400]).unwrap();
    fs::write(folder.join("table.toml"), "[groups.liver]\n0 = \"air\"\n").unwrap();
    refused(
        &["build", &path("none.nii.gz"), "--out", &out],
        "cannot be read",
    );
    refused(
        &["build", &path("short.nii"), "--out", &out],
        "within the header",
    );
    refused(&["build", &path("other.nii"), "--out", &out], "sizeof_hdr");
    let table = path("table.toml");
    refused(
        &[
            "build",
            &path("other.nii"),
            "--out",
            &out,
            "--groups",
            &table,
        ],
        "table.toml:2: groups.liver.0",
    );
    refused(
        &[
            "build",
            &path("other.nii"),
            "--out",
            &out,
            "--max-error-mm",
            "0",
        ],
        "[0.01, 10]",
    );
    refused(
        &["phantom", "--out", &out, "--size", "8x16x16"],
        "from 16 to 1024",
    );
}
