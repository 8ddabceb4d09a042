//! `trocar study` and `trocar report` as a user runs them.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "study/support.rs"]
mod support;
#[path = "study/whole.rs"]
mod whole;

use std::fs;

use tests::{json, scratch, stderr};

use support::{cell_folders, refused, report, run, stdout, study};

/// A study of nothing but the expert, which is done in seconds.
const EXPERT: &str = "title = \"Expert\"\n\
    [task.needle-lift]\n\
    [network.expert]\npolicy = \"expert\"\n\
    [[grid]]\nname = \"success\"\ntitle = \"Success\"\ntasks = [\"needle-lift\"]\nnetworks = [\"expert\"]\n\
    trials = 2\nfirst_seed = 1000\ncolumns = \"network\"\n";

#[test]
fn a_study_that_is_none_is_refused_before_anything_is_made() {
    let folder = scratch("study-refused");
    for (name, text, told) in [
        (
            "key",
            EXPERT.replace("trials = 2", "trails = 2"),
            "study.toml:10: unknown field `trails`",
        ),
        (
            "cell",
            EXPERT.replace("[\"needle-lift\"]", "[]"),
            "grid.0.tasks = [] is outside one or more",
        ),
        (
            "task",
            EXPERT.replace("needle-lift", "needle-drop"),
            "task.needle-drop: --task: there is no task",
        ),
        (
            "needle",
            EXPERT.replace("trials", "needles = [\"N9\"]\ntrials"),
            "--needle N9: needle-lift has no needle",
        ),
    ] {
        let here = folder.join(name);
        fs::create_dir_all(&here).unwrap();
        fs::write(here.join("study.toml"), text).unwrap();
        let message = refused(&study(&here, &["--out", "results"]));
        assert!(message.contains(told), "{message}");
        assert!(!here.join("results").exists(), "{name}");
    }
    let empty = EXPERT.split("[[grid]]").next().unwrap();
    fs::write(folder.join("study.toml"), empty).unwrap();
    let message = refused(&study(&folder, &[]));
    assert!(
        message.contains("grid = [] is outside one [[grid]] or more"),
        "{message}"
    );
    let message = refused(&study(&folder, &["--shard", "3/2"]));
    assert!(message.contains("3/2: a shard is i/n"), "{message}");
}

/// A network that can not be trained so is refused by its own verb.
#[test]
fn untrainable_network_is_refused_by_train() {
    let folder = scratch("study-options");
    let tiny = support::tiny(&folder);
    fs::write(
        &tiny,
        fs::read_to_string(&tiny)
            .unwrap()
            .replacen("preset = \"small\"", "preset = \"huge\"", 1),
    )
    .unwrap();
    let message = refused(&study(&folder, &[]));
    assert!(
        message.contains("training needle-lift, act") && message.contains("huge"),
        "{message}"
    );
}

/// What is done is not done again and a cut result is told and kept.
#[test]
fn finished_cells_are_not_run_again() {
    let folder = scratch("study-cut");
    fs::write(folder.join("study.toml"), EXPERT).unwrap();
    let first = run(&study(&folder, &["--out", "results"]));
    assert!(
        stdout(&first).contains("0 cells done before, 1 now, 0 failed"),
        "{}",
        stdout(&first)
    );
    let listed = run(&study(&folder, &["--out", "results", "--dry-run"]));
    assert!(
        stdout(&listed).contains("1 cells, 1 done, 0 left"),
        "{}",
        stdout(&listed)
    );
    let again = run(&study(&folder, &["--out", "results"]));
    assert!(
        stdout(&again).contains("1 cells done before, 0 now"),
        "{}",
        stdout(&again)
    );
    let page = folder.join("report.html");
    run(&report(
        &folder,
        &["results", "--out", "report.html", "--json", "report.json"],
    ));
    assert_eq!(json(&folder.join("report.json"))["total"]["trials"], 2);
    assert!(fs::read_to_string(&page).unwrap().contains("2 of 2"));

    let cells = cell_folders(&folder.join("results"), "evaluation");
    let [cell] = &cells[..] else {
        panic!("{cells:?}")
    };
    let result = cell.join("result.json");
    let whole = fs::read(&result).unwrap();
    fs::write(&result, &whole[..whole.len() / 2]).unwrap();
    for message in [
        refused(&study(&folder, &["--out", "results"])),
        refused(&report(&folder, &["results", "--out", "report.html"])),
    ] {
        let half = whole.len() / 2;
        let told = format!("has {half} bytes and had {}", whole.len());
        assert!(
            message.contains("result.json") && message.contains(&told),
            "{message}"
        );
        assert!(message.contains("put back what was there"), "{message}");
    }
    assert_eq!(
        fs::read(&result).unwrap(),
        whole[..whole.len() / 2],
        "nothing was overwritten"
    );
    let text = fs::read_to_string(&page).unwrap();
    assert!(
        text.contains("Left out") && text.contains("not run"),
        "the page says what it lacks"
    );
    fs::write(&result, &whole).unwrap();
    let again = run(&study(&folder, &["--out", "results"]));
    assert!(
        stdout(&again).contains("1 cells done before"),
        "{}",
        stdout(&again)
    );
}

#[test]
fn a_shard_of_another_grid_is_refused() {
    let folder = scratch("study-shards");
    fs::write(folder.join("study.toml"), EXPERT).unwrap();
    run(&study(&folder, &["--out", "first", "--shard", "1/1"]));
    fs::write(
        folder.join("study.toml"),
        EXPERT.replace("first_seed = 1000", "first_seed = 5000"),
    )
    .unwrap();
    let message = refused(&study(&folder, &["--out", "first", "--shard", "1/1"]));
    assert!(
        message.contains("shards of one grid belong together"),
        "{message}"
    );
    assert_eq!(cell_folders(&folder.join("first"), "evaluation").len(), 1);
    run(&study(&folder, &["--out", "second", "--shard", "1/1"]));
    let message = refused(&report(&folder, &["first", "second", "--out", "report.md"]));
    assert!(
        message.contains("only shards of one grid make one report"),
        "{message}"
    );
    let message = refused(&report(&folder, &["third", "--out", "report.md"]));
    assert!(message.contains("third: has no study.json"), "{message}");
    let message = refused(&report(&folder, &["first", "--out", "report.pdf"]));
    assert!(message.contains("FILE.html or FILE.md"), "{message}");
    assert!(!folder.join("report.md").exists());
    run(&report(&folder, &["first", "--out", "report.md"]));
    assert!(
        fs::read_to_string(folder.join("report.md"))
            .unwrap()
            .starts_with("# Expert\n")
    );
}

#[test]
fn a_cell_that_fails_is_reported_and_the_rest_goes_on() {
    let folder = scratch("study-fails");
    fs::create_dir_all(folder.join("broken")).unwrap();
    fs::write(folder.join("broken/config.json"), "{").unwrap();
    let text = EXPERT
        .replace(
            "[network.expert]",
            "[network.broken]\npolicy = \"checkpoint\"\ncheckpoint = \"broken\"\n[network.expert]",
        )
        .replace("[\"expert\"]", "[\"broken\", \"expert\"]");
    fs::write(folder.join("study.toml"), text).unwrap();
    let output = study(&folder, &["--out", "results"]).output().unwrap();
    let told = stdout(&output);
    assert_eq!(output.status.code(), Some(1), "{told}{}", stderr(&output));
    assert!(
        told.contains("1 now, 1 failed") && told.contains("failed: evaluation "),
        "{told}"
    );
    assert!(
        told.contains("broken") && told.contains("config.json"),
        "{told}"
    );
    run(&report(&folder, &["results", "--out", "report.md"]));
    let page = fs::read_to_string(folder.join("report.md")).unwrap();
    assert!(
        page.contains("1 of 2 evaluations") && page.contains("not run"),
        "{page}"
    );
}
