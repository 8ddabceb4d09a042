//! The documents say what is: the files, modules and tests that they name exist, the absences that
//! ARCHITECTURE.md states hold, and what is read first stays short.

#![expect(
    clippy::expect_used,
    reason = "in a test, a failure to read is a failure"
)]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use tests::repository;

/// Folders at the top whose contents the document may name.
const FOLDERS: [&str; 7] = [
    "hal/",
    "policy/",
    "sim_backend/",
    "runtime/",
    "tests/",
    "config/",
    ".ci/",
];

/// A crate of ours.
struct Member {
    folder: &'static str,
    name: &'static str,
    /// The crates of ours that it may depend on.
    may_use: &'static [&'static str],
}

const fn member(
    folder: &'static str,
    name: &'static str,
    may_use: &'static [&'static str],
) -> Member {
    Member {
        folder,
        name,
        may_use,
    }
}

const MEMBERS: [Member; 15] = [
    member("hal", "hal", &[]),
    member("hal/topics", "trocar-topics", &["hal"]),
    member("hal/canopen", "trocar-canopen", &["hal"]),
    member("hal/drives", "trocar-drives", &["hal", "trocar-canopen"]),
    member("policy/data", "trocar-data", &["hal"]),
    member("policy/nets", "trocar-nets", &["hal", "trocar-data"]),
    member(
        "policy/train",
        "trocar-train",
        &["hal", "trocar-data", "trocar-nets"],
    ),
    member("sim_backend/world", "trocar-world", &["hal"]),
    member("sim_backend/render", "trocar-render", &["hal"]),
    member(
        "sim_backend/tasks",
        "trocar-tasks",
        &["hal", "trocar-anatomy", "trocar-render", "trocar-world"],
    ),
    member("sim_backend/anatomy", "trocar-anatomy", &["hal"]),
    member("runtime/control", "trocar-control", &["hal"]),
    member("runtime/verify", "trocar-verify", &["hal"]),
    member(
        "runtime/log",
        "trocar-log",
        &["hal", "trocar-control", "trocar-verify"],
    ),
    member(
        "runtime/app",
        "trocar",
        &[
            "hal",
            "trocar-anatomy",
            "trocar-canopen",
            "trocar-control",
            "trocar-data",
            "trocar-drives",
            "trocar-log",
            "trocar-nets",
            "trocar-render",
            "trocar-tasks",
            "trocar-topics",
            "trocar-train",
            "trocar-world",
        ],
    ),
];

/// Folders with what no file in them may mention: what Cargo can't keep them from.
const MUST_NOT_MENTION: [(&str, &[&str]); 2] = [
    (
        "runtime/control/src",
        &["std::fs", "std::thread", "std::net"],
    ),
    (
        "runtime/verify/src",
        &["std::fs", "std::thread", "std::net"],
    ),
];

fn read(path: &Path) -> String {
    fs::read_to_string(path).expect("the file can be read")
}

fn document() -> String {
    read(&repository().join("ARCHITECTURE.md"))
}

fn safety() -> String {
    read(&repository().join("runtime/SAFETY.md"))
}

/// The lines of `text` from `heading` to the next heading of the same rank, without fenced blocks.
fn section<'a>(text: &'a str, heading: &str) -> Vec<&'a str> {
    let mut fenced = false;
    text.lines()
        .skip_while(|line| *line != heading)
        .skip(1)
        .take_while(|line| !line.starts_with("## "))
        .filter(|line| {
            let fence = line.starts_with("```");
            fenced ^= fence;
            !fenced && !fence
        })
        .collect()
}

/// What stands between backticks.
fn quoted(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// Quoted names that begin with a folder of the repository.
fn paths<'a>(lines: &[&'a str]) -> Vec<&'a str> {
    lines
        .iter()
        .flat_map(|line| quoted(line))
        .filter(|name| FOLDERS.iter().any(|folder| name.starts_with(folder)))
        .collect()
}

/// All Rust files below `folder`.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("the folder can be read") {
        let path = entry.expect("the entry can be read").path();
        if path.is_dir() {
            found.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Names of the functions under `#[test]` in `text`.
fn tests_in(text: &str) -> Vec<String> {
    let mut names = Vec::new();
    let mut lines = text.lines().map(str::trim);
    while lines.any(|line| line == "#[test]") {
        let name = lines
            .by_ref()
            .find_map(|line| line.strip_prefix("fn ")?.split('(').next());
        names.extend(name.map(str::to_owned));
    }
    names
}

fn all_tests() -> BTreeSet<String> {
    ["hal", "policy", "sim_backend", "runtime", "tests"]
        .iter()
        .flat_map(|folder| rust_files(&repository().join(folder)))
        .flat_map(|file| tests_in(&read(&file)))
        .collect()
}

/// Rows of the safety table as hazard, mechanism, file, test.
fn safety_rows(text: &str) -> Vec<Vec<&str>> {
    section(text, "## Safety table")
        .into_iter()
        .filter(|line| line.starts_with('|'))
        .skip(2)
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect()
}

/// What is wrong with the safety table of `text`.
fn safety_defects(text: &str, tests: &BTreeSet<String>) -> Vec<String> {
    let mut defects = Vec::new();
    for row in safety_rows(text) {
        let [hazard, mechanism, file, test] = row[..] else {
            defects.push(format!("not four cells: {row:?}"));
            continue;
        };
        if hazard.is_empty() || mechanism.is_empty() {
            defects.push(format!("an empty cell: {row:?}"));
        }
        for (kind, cell) in [("file", file), ("test", test)] {
            if quoted(cell).next().is_none() {
                defects.push(format!("{hazard}: names no {kind}"));
            }
        }
        defects.extend(
            quoted(file)
                .filter(|file| !repository().join(file).is_file())
                .map(|file| format!("{hazard}: there is no file {file}")),
        );
        defects.extend(
            quoted(test)
                .filter(|test| !tests.contains(*test))
                .map(|test| format!("{hazard}: there is no test {test}")),
        );
    }
    defects
}

/// Modules of `name`'s library at its root, without extension.
fn root_modules(name: &str) -> BTreeSet<String> {
    fs::read_dir(repository().join(name).join("src"))
        .expect("the crate has sources")
        .filter_map(|entry| {
            let path = entry.expect("the entry can be read").path();
            path.file_stem()?.to_str().map(str::to_owned)
        })
        .filter(|stem| stem != "lib")
        .collect()
}

/// The README of a crate.
fn readme(member: &Member) -> String {
    read(&repository().join(member.folder).join("README.md"))
}

#[test]
fn the_safety_table_names_files_and_tests_that_exist() {
    let text = safety();
    let rows = safety_rows(&text).len();
    assert!(rows >= 12, "{rows} rows");
    let defects = safety_defects(&text, &all_tests());
    assert!(defects.is_empty(), "{defects:#?}");
}

#[test]
fn a_tampered_safety_table_is_caught() {
    let tests = all_tests();
    let text = safety();
    let tampered = [
        ("`a_good_chunk_is_accepted_once`", "`a_good_chunk_is_used`"),
        ("`runtime/control/src/mode.rs`", "`runtime/app/src/mode.rs`"),
        ("`runtime/control/src/mode.rs`", "the mode machine"),
        // A function that is none of the tests.
        ("`a_fault_is_left_only_by_clearing_it`", "`safety_rows`"),
    ];
    for (from, to) in tampered {
        assert!(text.contains(from), "{from}");
        let defects = safety_defects(&text.replace(from, to), &tests);
        assert_eq!(defects.len(), 1, "{to}: {defects:#?}");
    }
}

#[test]
fn the_map_has_every_crate_and_each_crates_readme_every_module() {
    let text = document();
    let lines = section(&text, "## Map");
    let named = paths(&lines);
    for member in MEMBERS {
        let folder = format!("{}/", member.folder);
        assert!(
            named.contains(&folder.as_str()),
            "{folder} is not on the map"
        );
        let tour = readme(&member);
        for module in root_modules(member.folder) {
            let toured = tour.contains(&format!("`{module}`"));
            assert!(toured, "{folder}README.md has no `{module}`");
        }
    }
}

/// A crate's README is its documentation with an example that compiles.
#[test]
fn crate_readme_is_its_documentation() {
    for member in MEMBERS {
        let library = repository().join(member.folder).join("src/lib.rs");
        let included = read(&library).starts_with("#![doc = include_str!(\"../README.md\")]");
        assert!(included, "{}", library.display());
        let examples = readme(&member);
        // Every second fence closes a block.
        let mut opening = examples
            .lines()
            .filter(|line| line.starts_with("```"))
            .step_by(2);
        assert!(
            opening.any(|fence| matches!(fence, "```" | "```rust" | "```no_run")),
            "{}: no example in Rust",
            member.folder
        );
    }
}

/// A first-time reader reads both from top to bottom: what is added is paid for by shortening.
#[test]
fn readme_and_architecture_stay_short() {
    for (name, bytes_max) in [("README.md", 8192), ("ARCHITECTURE.md", 15_360)] {
        let bytes = read(&repository().join(name)).len();
        assert!(bytes <= bytes_max, "{name}: {bytes} of {bytes_max} bytes");
    }
}

#[test]
fn every_path_in_the_documents_exists() {
    let [front, contributing] =
        ["README.md", "CONTRIBUTING.md"].map(|name| read(&repository().join(name)));
    let texts = [
        (document(), 5),
        (safety(), 3),
        (front, 6),
        (contributing, 3),
    ];
    for (text, sections) in texts {
        let headings: Vec<&str> = text
            .lines()
            .filter(|line| line.starts_with("## "))
            .collect();
        assert!(headings.len() >= sections, "{headings:?}");
        for heading in headings {
            for path in paths(&section(&text, heading)) {
                assert!(repository().join(path).exists(), "{heading}: no {path}");
            }
        }
    }
}

#[test]
fn crates_depend_on_no_crate_that_they_must_not_know() {
    for member in MEMBERS {
        let manifest = read(&repository().join(member.folder).join("Cargo.toml"));
        let mut used: Vec<&str> = manifest
            .lines()
            .skip_while(|line| *line != "[dependencies]")
            .skip(1)
            .take_while(|line| !line.starts_with('['))
            .filter_map(|line| line.split(['.', ' ', '=']).next())
            .filter(|word| MEMBERS.iter().any(|other| other.name == *word))
            .collect();
        used.sort_unstable();
        assert_eq!(used, member.may_use, "{}", member.name);
    }
}

#[test]
fn modules_mention_nothing_that_they_must_not_know() {
    for (folder, forbidden) in MUST_NOT_MENTION {
        let files = rust_files(&repository().join(folder));
        assert!(files.len() >= 4, "{folder}");
        // Tests compare with what the module itself must not know.
        let is_test = |file: &Path| {
            file.ends_with("tests.rs") || file.components().any(|part| part.as_os_str() == "tests")
        };
        let folder = repository().join(folder);
        let is_code = |file: &&PathBuf| {
            file.strip_prefix(&folder)
                .is_ok_and(|inside| !is_test(inside))
        };
        for file in files.iter().filter(is_code) {
            let text = read(file);
            for word in forbidden {
                assert!(!text.contains(word), "{} mentions {word}", file.display());
            }
        }
    }
}
