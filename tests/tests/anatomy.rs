//! `trocar anatomy` from the command line: a phantom, its meshes, the report, and what is refused.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::Path;
use std::process::Output;

use tests::{json, scratch, stderr, trocar};

fn anatomy(arguments: &[&str]) -> Output {
    trocar().arg("anatomy").args(arguments).output().unwrap()
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
    let options = [
        "--max-error-mm",
        "1",
        "--json",
        &result,
        "--measure-stages",
        "--tetrahedra",
        "12",
        "--textures",
        "32",
    ];
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
    assert_eq!(told["stage_distances"].as_array().unwrap().len(), 3 * 17);
    let tetrahedra = &told["tetrahedra"][0];
    assert_eq!(tetrahedra["group"], "liver");
    assert!(
        (tetrahedra["volume_ratio"].as_f64().unwrap() - 1.0).abs() < 0.01,
        "{tetrahedra}"
    );
    let stages = told["stages"].as_array().unwrap();
    assert_eq!(stages.len(), 8);
    assert!(
        stages
            .iter()
            .all(|stage| stage["peak_mib"].as_f64().unwrap() > 1.0)
    );
    for (name, start) in [
        ("patient.glb", "glTF"),
        ("patient.usdz", "PK"),
        ("patient-textured.glb", "glTF"),
        ("patient-textured.usdz", "PK"),
        ("tetrahedra.usda", "#usda 1.0"),
    ] {
        let bytes = fs::read(folder.join(name)).unwrap();
        assert!(bytes.starts_with(start.as_bytes()), "{name}");
    }
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
    let run = |patient: &str, organ: &str| {
        let scene = [format!("patient={patient}"), format!("organ={organ}")];
        let [patient, organ] = scene.map(|change| format!("scene.scene.{change}"));
        let task = ["run", "--task", "needle-lift", "--policy", "expert"];
        let set = ["--lockstep", "--set", &patient, "--set", &organ, "--json"];
        let json = result.display().to_string();
        let mut run = trocar();
        run.args(task).args(set).arg(json).output().unwrap()
    };
    assert!(run(&out, "liver").status.success());
    let told = json(&result);
    assert_eq!(told["success"], true);
    assert_eq!(told["patient"]["organ"], "liver");
    assert!(told["patient"]["patch_in_scan_m"][1].as_f64().unwrap() > 0.0);
    // Our stage, as one of another program.
    let stage = run(&format!("{out}/patient.usda"), "liver");
    assert!(stage.status.success(), "{}", stderr(&stage));
    // The patch may be another one: it is chosen among some of the vertices, whose order is each
    // file's.
    let told = json(&result);
    assert_eq!(told["success"], true);
    assert_eq!(told["patient"]["organ"], "liver");
    let brain = run(&out, "brain");
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

/// Trains a very small network, which is written as `out`, and says what came of it in
/// `trained.json` beside it.
fn train(folder: &Path, out: &str) -> Vec<u8> {
    let told = folder.join("trained.json").display().to_string();
    let size = ["--spacing-mm", "12", "--patch", "24", "--widths", "8,16"];
    let run = ["--patients", "2", "--steps", "60", "--lr", "0.01"];
    let files = ["--validate", "1", "--out", out, "--json", &told];
    done(&[&["train-segmenter"], &size[..], &run[..], &files[..]].concat());
    fs::read(out).unwrap()
}

/// From a CT to meshes with a network that was trained here: files are whole, the same seed gives
/// the same network, and little memory the same labels.
#[test]
fn ct_becomes_labels_and_meshes() {
    let folder = scratch("anatomy-segment");
    let path = |name: &str| folder.join(name).display().to_string();
    let model = path("model.safetensors");
    let network = train(&folder, &model);
    assert_eq!(network, train(&folder, &path("again.safetensors")));
    let trained = json(&folder.join("trained.json"));
    assert_eq!(trained["groups"].as_array().unwrap().len(), 17);
    let body = &trained["groups"][16];
    assert!(
        body["name"] == "body" && body["mean"].as_f64().unwrap() > 0.5,
        "{trained}"
    );

    let out = folder.display().to_string();
    done(&[
        "phantom", "--seed", "3", "--size", "48x48x58", "--out", &out,
    ]);
    let [ct, truth, found] = ["ct.nii.gz", "labels.nii.gz", "found.nii.gz"].map(path);
    let segment = ["segment", &ct, "--model", &model, "--out", &found];
    let compare = ["--against", &truth, "--json", &path("found.json")];
    done(&[&segment[..], &compare[..]].concat());
    let told = json(&folder.join("found.json"));
    let size = serde_json::Value::from(vec![48, 48, 58]);
    assert!(told["table"] == "groups" && told["size"] == size, "{told}");
    assert!(told["groups"][16]["dice"].as_f64().unwrap() > 0.5, "{told}");
    let all = fs::read(&found).unwrap();
    done(&[&segment[..], &["--memory-gb", "0.001"]].concat());
    assert_eq!(fs::read(&found).unwrap(), all);

    let options = ["--groups", "groups", "--max-error-mm", "2"];
    let build = ["build", &found, "--out", &path("patient")];
    done(&[&build[..], &options[..]].concat());
    let patient = json(&folder.join("patient/patient.json"));
    let groups = patient["groups"].as_array().unwrap();
    assert!(
        groups.iter().any(|group| group["name"] == "body"),
        "{patient}"
    );
    assert!(
        groups.iter().all(|group| group["watertight"] == true),
        "{patient}"
    );
    assert_eq!(patient["size"], size);
}

/// The network of `config/anatomy` labels a patient that it was not trained on. Its CT is coarser
/// than the network's 3 mm, so thin tissues cost no Dice at the voxels' faces.
#[test]
fn committed_segmenter_labels_an_unseen_patient() {
    let folder = scratch("anatomy-segmenter");
    let path = |name: &str| folder.join(name).display().to_string();
    let phantom = ["phantom", "--seed", "900001", "--size", "64x64x77"];
    done(&[&phantom[..], &["--out", &folder.display().to_string()]].concat());
    let model = tests::repository().join("config/anatomy/segmenter.safetensors");
    let model = model.display().to_string();
    let [ct, truth, found, told] =
        ["ct.nii.gz", "labels.nii.gz", "found.nii.gz", "found.json"].map(path);
    let segment = ["segment", &ct, "--model", &model, "--out", &found];
    // Windows side by side: a quarter of the time.
    let compare = ["--overlap", "0", "--against", &truth, "--json", &told];
    done(&[&segment[..], &compare[..]].concat());
    let told = json(Path::new(&told));
    let groups = told["groups"].as_array().unwrap();
    assert_eq!(groups.len(), 17);
    for group in groups {
        assert!(group["dice"].as_f64().unwrap() > 0.98, "{told}");
    }
    assert!(told["mean_dice"].as_f64().unwrap() > 0.995, "{told}");
}

/// Runs `segment` into `folder`, and expects exit code 2 with `message` and no labels.
fn not_segmented(folder: &Path, ct: &str, model: &str, more: &[&str], message: &str) {
    let labels = folder.join("labels.nii.gz");
    let out = labels.display().to_string();
    let words = ["segment", ct, "--model", model, "--out", &out];
    refused(&[&words[..], more].concat(), message);
    assert!(!labels.exists(), "{message}");
}

/// A TorchScript model of five classes.
fn script() -> String {
    let file = tests::repository().join("tests/golden/segmenter.ts");
    file.display().to_string()
}

#[test]
fn bad_models_and_scans_are_refused() {
    let folder = scratch("anatomy-segment-refused");
    let path = |name: &str| folder.join(name).display().to_string();
    let refused = |ct: &str, model: &str, more: &[&str], message: &str| {
        not_segmented(&folder, ct, model, more, message);
    };
    fs::write(folder.join("ct.nii"), [7; 400]).unwrap();
    fs::write(folder.join("no.safetensors"), "no model").unwrap();
    fs::create_dir(folder.join("empty")).unwrap();
    let vista = ["--settings", "vista3d"];
    let [ct, own, script] = [path("ct.nii"), path("no.safetensors"), script()];
    refused(&ct, &own, &[], "no intact safetensors file");
    refused(&ct, &own, &vista, "has its own");
    refused(&ct, &path("none.safetensors"), &[], "file is missing");
    refused(&ct, &path("none.ts"), &vista, "file is missing");
    refused(&ct, &script, &[], "needs --settings, or ");
    refused(&ct, &script, &vista, "sizeof_hdr");
    refused(&ct, &script, &["--overlap", "1"], "[0, 0.9]");
    refused(&path("empty"), &script, &vista, "no DICOM file is in it");
}

#[test]
fn settings_of_models_are_checked() {
    let folder = scratch("anatomy-segment-settings");
    let path = |name: &str| folder.join(name).display().to_string();
    let good = "patch = [16, 16, 16]\nspacing_mm = [9.0, 9.0, 9.0]\norientation = \"RAS\"\nwindow_hu = [-500.0, 600.0]\n\
                range = [0.0, 1.0]\noverlap = 0.25\ntable = \"groups\"\nclasses = [0, 1, 2, 3, 17]\n";
    let [settings, scan] = ["settings.toml", "scan/ct.nii.gz"].map(path);
    let options = ["--settings", &settings];
    done(&["phantom", "--size", "16x16x16", "--out", &path("scan")]);
    for (from, to, message) in [
        (
            "9.0, 9.0, 9.0",
            "9.0, nan, 9.0",
            "settings.toml:2: spacing_mm",
        ),
        (
            "\"RAS\"",
            "\"RAP\"",
            "settings.toml:3: orientation = RAP is outside three of",
        ),
        (
            "0.25",
            "0.95",
            "settings.toml:6: overlap = 0.95 is outside [0, 0.9]",
        ),
        ("17", "18", "class 4 of the model is label 18"),
        ("overlap", "overlaps", "unknown field"),
        // The model has five classes.
        (
            ", 17",
            "",
            "the model answers a window with [1, 5, 16, 16, 16]",
        ),
    ] {
        fs::write(&settings, good.replace(from, to)).unwrap();
        not_segmented(&folder, &scan, &script(), &options, message);
    }
    // Those for Auto3DSeg's networks are good ones, of 18 classes.
    let shipped = tests::repository().join("config/anatomy/models/auto3dseg.toml");
    let shipped = ["--settings", &shipped.display().to_string()];
    let message = "the model answers a window with [1, 5, 96, 96, 96]";
    not_segmented(&folder, &scan, &script(), &shipped, message);
    fs::write(&settings, good).unwrap();
    let out = path("out.nii.gz");
    let words = ["segment", &scan, "--model", &script(), "--out", &out];
    done(&[&words[..], &options].concat());
    assert!(fs::read(out).unwrap().starts_with(&[0x1f, 0x8b]));
}
