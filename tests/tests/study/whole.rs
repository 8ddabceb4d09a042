//! The tiny study: interrupted, killed, resumed; in two shards; reported; its page in a browser.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};

use tests::{json, scratch, stderr};

use crate::support::{cell_folders, refused, report, run, stdout, study, tiny};

/// Starts the study in `one`.
fn begin(folder: &Path) -> (Child, BufReader<ChildStderr>) {
    let mut child = study(folder, &["--out", "one", "--jobs", "2"])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let said = BufReader::new(child.stderr.take().unwrap());
    (child, said)
}

/// Waits until a training of it has kept a state.
fn wait_for_a_state(folder: &Path, child: &mut Child) {
    let trainings = folder.join("one/training");
    let has_state = || {
        let cells = fs::read_dir(&trainings).into_iter().flatten();
        let mut cells = cells.map(|cell| cell.unwrap().path());
        cells.any(|cell| cell.join("checkpoint/training_state.safetensors").is_file())
    };
    while !has_state() {
        let ended = child.try_wait().unwrap();
        assert_eq!(ended, None, "it ended before a training kept its state");
        std::thread::yield_now();
    }
}

fn rest(said: BufReader<ChildStderr>) -> String {
    said.lines().map(|line| line.unwrap() + "\n").collect()
}

/// Every recording's manifest as it is.
fn recordings(results: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let cells = cell_folders(results, "recording").into_iter();
    let manifests = cells
        .map(|cell| cell.join("cell.json"))
        .filter(|path| path.exists());
    manifests
        .map(|path| (path.clone(), fs::read(&path).unwrap()))
        .collect()
}

/// The tiny study in `one`: interrupted by SIGINT, killed by SIGKILL, and resumed.
fn interrupted_killed_and_ended(folder: &Path) {
    let results = folder.join("one");
    let (mut child, said) = begin(folder);
    wait_for_a_state(folder, &mut child);
    let id = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &id])
            .status()
            .unwrap()
            .success()
    );
    let said = rest(said);
    assert_eq!(child.wait().unwrap().code(), Some(1), "{said}");
    assert!(
        said.contains("interrupted: what runs is asked to end"),
        "{said}"
    );
    let before = recordings(&results);
    assert!(!before.is_empty());

    let (mut child, mut said) = begin(folder);
    let mut line = String::new();
    while !line.contains("goes on") {
        line.clear();
        assert!(
            said.read_line(&mut line).unwrap() > 0,
            "no training went on"
        );
    }
    child.kill().unwrap();
    child.wait().unwrap();
    // Children of the killed study end by themselves; until they have, their cells are locked.
    let listed = stdout(&run(&study(folder, &["--out", "one", "--dry-run"])));
    assert!(
        listed.contains("begun") && listed.contains("to do"),
        "{listed}"
    );

    let ended = run(&study(folder, &["--out", "one", "--jobs", "2"]));
    assert!(
        stdout(&ended).contains("0 failed, 0 damaged, 0 skipped"),
        "{}",
        stdout(&ended)
    );
    for (path, manifest) in before {
        assert_eq!(
            fs::read(&path).unwrap(),
            manifest,
            "a recording was made again"
        );
    }
    let attempts = cell_folders(&results, "training").into_iter();
    let attempts = attempts.map(|cell| json(&cell.join("cell.json"))["attempts"].as_u64().unwrap());
    assert!(attempts.max() >= Some(2), "a training went on");
}

/// The same study in two shards at a time, which share a folder.
fn in_two_shards(folder: &Path) {
    let shards: Vec<Child> = ["1/2", "2/2"]
        .map(|shard| {
            let mut shard = study(folder, &["--out", "two", "--jobs", "1", "--shard", shard]);
            shard
                .stderr(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap()
        })
        .into();
    for shard in shards {
        let output = shard.wait_with_output().unwrap();
        assert!(
            output.status.success(),
            "{}{}",
            stdout(&output),
            stderr(&output)
        );
    }
}

/// Moves every other evaluation of `two` into `three`, as if its shards had had a folder each.
fn apart(folder: &Path) {
    let (two, three) = (folder.join("two"), folder.join("three"));
    fs::create_dir_all(three.join("evaluation")).unwrap();
    fs::copy(two.join("study.json"), three.join("study.json")).unwrap();
    for cell in cell_folders(&two, "evaluation").into_iter().step_by(2) {
        let name = cell.file_name().unwrap().to_owned();
        fs::rename(&cell, three.join("evaluation").join(name)).unwrap();
    }
}

/// The page as a browser makes it, and what it complained of.
fn in_the_browser(folder: &Path, page: &str) -> (String, String) {
    let output = Command::new("chromium")
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
        ])
        .args([
            "--enable-logging=stderr",
            "--window-size=1100,2400",
            "--screenshot=page.png",
            "--dump-dom",
        ])
        .arg(format!(
            "--user-data-dir={}",
            folder.join("chromium").display()
        ))
        .arg(format!("file://{}", folder.join(page).display()))
        .current_dir(folder)
        .output()
        .expect("`make test-study` installs chromium");
    (stdout(&output), stderr(&output))
}

#[test]
#[ignore = "minutes, and needs chromium: `make test-study` runs it"]
fn a_study_cut_off_or_in_shards_comes_to_the_same_report() {
    let folder = scratch("study-whole");
    tiny(&folder);
    interrupted_killed_and_ended(&folder);
    in_two_shards(&folder);
    run(&report(
        &folder,
        &["one", "--out", "one.html", "--json", "one.json"],
    ));
    run(&report(
        &folder,
        &["two", "--out", "two.html", "--json", "two.json"],
    ));
    let figures = fs::read_to_string(folder.join("one.json")).unwrap();
    assert_eq!(
        figures,
        fs::read_to_string(folder.join("two.json")).unwrap()
    );
    let read = json(&folder.join("one.json"));
    assert_eq!(read["evaluations"], serde_json::json!([7, 7]));
    let expert = &read["tables"][0]["rows"][0]["places"][2];
    assert_eq!(expert["score"]["successes"], 2, "{expert}");
    apart(&folder);
    run(&report(
        &folder,
        &["two", "three", "--out", "three.md", "--json", "three.json"],
    ));
    assert_eq!(
        figures,
        fs::read_to_string(folder.join("three.json")).unwrap()
    );

    let (dom, complaints) = in_the_browser(&folder, "one.html");
    assert!(dom.contains("<h1>A tiny study</h1>"), "{complaints}");
    // Tables of rates and one curve over demonstrations, with a line for the loss of either
    // network.
    let count = |what: &str| dom.matches(what).count();
    assert!(
        count("<svg") == 3 && count("<polyline") >= 3,
        "{} plots",
        count("<svg")
    );
    assert!(count("<table>") >= 6 && count("published 0.70") == 1);
    assert!(!complaints.contains("CONSOLE"), "{complaints}");
    let picture = fs::metadata(folder.join("page.png")).unwrap();
    assert!(picture.len() > 20_000, "{} bytes", picture.len());

    a_changed_dataset_is_told(&folder);
}

/// A dataset that was changed since is no longer trained on, and all else goes on.
fn a_changed_dataset_is_told(folder: &Path) {
    let path = folder.join("study.toml");
    let text = fs::read_to_string(&path).unwrap();
    // Another training of each network.
    fs::write(
        &path,
        text.replace("training_seeds = [1]", "training_seeds = [1, 2]"),
    )
    .unwrap();
    let mut recordings = cell_folders(&folder.join("one"), "recording").into_iter();
    let of_lift = |cell: &PathBuf| {
        let label = json(&cell.join("cell.json"))["label"].clone();
        label.as_str().unwrap().starts_with("needle-lift")
    };
    let cell = recordings.find(of_lift).unwrap();
    let data = cell.join("data/data/chunk-000/file-000.parquet");
    let mut bytes = fs::read(&data).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&data, &bytes).unwrap();
    let message = refused(&study(folder, &["--out", "one", "--jobs", "2"]));
    assert!(
        message.contains("file-000.parquet: its content has changed since its cell was done"),
        "{message}"
    );
    assert!(message.contains("skipped: it needs recording"), "{message}");
    assert_eq!(fs::read(&data).unwrap(), bytes, "nothing was overwritten");
    // The other task's networks were trained all the same.
    assert!(
        message.contains("training")
            && message.contains("block-transfer, act, 2 of plain, seed 2: done"),
        "{message}"
    );
}
