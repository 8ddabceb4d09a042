//! Studies from their files to their cells, and the folder that they are kept in.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use hal::config::Source;

use super::address::Address;
use super::axis::Axis;
use super::file::StudyFile;
use super::job::{Job, Kind};
use super::plan::{Plan, Shard};
use super::store::{Attempts, EXECUTED, MANIFEST_FORMAT, Manifest, State, Store};
use super::{Materials, StudyError, expand};
use crate::session::scratch::Scratch;

const TINY: &str = include_str!("../../../../config/studies/tiny.toml");
const SUFIA_BC: &str = include_str!("../../../../config/studies/sufia-bc.toml");

fn plan_with(text: &str, code: &str) -> Result<Plan, StudyError> {
    let source = Source::embedded("study.toml", text);
    let file: StudyFile = source.parse()?;
    file.check(&source)?;
    let materials = Materials::gather(&file, Path::new("study.toml"), code.to_owned())?;
    expand(&file, text, &materials)
}

fn plan(text: &str) -> Plan {
    plan_with(text, "code").unwrap()
}

fn refused(from: &str, to: &str) -> String {
    assert!(TINY.contains(from), "{from}");
    plan_with(&TINY.replacen(from, to, 1), "code")
        .unwrap_err()
        .to_string()
}

fn count(plan: &Plan, kind: Kind) -> usize {
    plan.cells
        .iter()
        .filter(|cell| cell.job.kind() == kind)
        .count()
}

fn addresses(plan: &Plan, kind: Kind) -> Vec<&str> {
    let cells = plan.cells.iter().filter(|cell| cell.job.kind() == kind);
    cells.map(|cell| cell.address.as_str()).collect()
}

#[test]
fn the_papers_studies_are_one_grid_that_shares_its_cells() {
    let plan = plan(SUFIA_BC);
    // 20 of disturbed demonstrations, 50 short ones of 10 to 50; of the lift alone 4 each of plain
    // ones, of varied needles and of moved cameras.
    assert_eq!(count(&plan, Kind::Training), 20 + 50 + 4 + 4 + 4);
    // With one camera, with several, and with one and its depth: of disturbed demonstrations, the
    // lift's varied needles and its moved cameras; of plain ones the last two and the lift's first.
    assert_eq!(count(&plan, Kind::Recording), 3 * 5 + 3 + 3 + 2 * 5 + 1);
    let table: Vec<_> = plan
        .record
        .entries
        .iter()
        .filter(|entry| entry.grid == "table-1")
        .collect();
    assert_eq!(table.len(), 20);
    let rates = &plan.record.grids[0].published.as_ref().unwrap().rates;
    let best = |task: &str| {
        let of_task = rates
            .iter()
            .filter(|rate| rate.task.as_deref() == Some(task));
        of_task.map(|rate| rate.rate).fold(0.0, f64::max)
    };
    for (task, rate) in [
        ("needle-lift", 0.88),
        ("needle-handover", 0.58),
        ("block-transfer", 0.78),
    ] {
        assert!((best(task) - rate).abs() < 1e-12, "{task}");
    }
    // A disturbed recording is another, and its options are the verb's.
    let options: BTreeSet<Vec<String>> = plan
        .cells
        .iter()
        .filter_map(|cell| match &cell.job {
            Job::Recording(job) => Some(job.options.clone()),
            Job::Training(_) | Job::Evaluation(_) => None,
        })
        .collect();
    let given = |options: &[&str]| {
        options
            .iter()
            .map(|&option| option.to_owned())
            .collect::<Vec<_>>()
    };
    let expected = [
        given(&[]),
        given(&["--disturb", "0.5"]),
        given(&["--vary", "needles"]),
        given(&["--vary", "views"]),
    ];
    assert_eq!(options, expected.into());
}

/// A network can be trained otherwise in one task, and is then another cell there alone.
#[test]
fn a_network_is_trained_otherwise_in_one_task() {
    let trained = |plan: &Plan| {
        let jobs = plan.cells.iter().filter_map(|cell| match &cell.job {
            Job::Training(job) => Some((cell.label.clone(), job.clone())),
            Job::Recording(_) | Job::Evaluation(_) => None,
        });
        jobs.collect::<Vec<_>>()
    };
    let before = trained(&plan(TINY));
    let on = "[network.act.on]\nblock-transfer = { steps = 7, options = [\"--lr\", \"3e-4\"] }\n\n[network.";
    let after = trained(&plan(&TINY.replacen("[network.", on, 1)));
    assert_eq!(before.len(), after.len());
    for ((label, before), (_, after)) in before.into_iter().zip(after) {
        if label.starts_with("block-transfer, act,") {
            assert_eq!(
                (after.steps, &after.options[..]),
                (Some(7), &["--lr".to_owned(), "3e-4".to_owned()][..])
            );
            assert_eq!(after.preset, before.preset);
        } else {
            assert_eq!(after, before, "{label}");
        }
    }
    let unknown = TINY.replacen(
        "[network.",
        "[network.act.on]\nsewing = { steps = 7 }\n\n[network.",
        1,
    );
    let error = plan_with(&unknown, "code").unwrap_err().to_string();
    assert!(
        error.contains("network.act.on") && error.contains("sewing"),
        "{error}"
    );
}

#[test]
fn fewer_demonstrations_are_the_first_of_one_recording() {
    let plan = plan(TINY);
    assert_eq!(count(&plan, Kind::Training), 5);
    // Both networks learn from the same clouds.
    assert_eq!(count(&plan, Kind::Recording), 2);
    for cell in &plan.cells {
        if let Job::Recording(job) = &cell.job {
            assert_eq!(job.episodes, 2, "{}", cell.label);
        }
    }
    // More of them do not make another recording, nor other trainings on the first ones.
    let more =
        self::plan(&TINY.replacen("demonstrations = [1, 2]", "demonstrations = [1, 2, 7]", 1));
    assert_eq!(
        addresses(&plan, Kind::Recording),
        addresses(&more, Kind::Recording)
    );
    let (before, after) = (
        addresses(&plan, Kind::Training),
        addresses(&more, Kind::Training),
    );
    assert!(
        before.iter().all(|address| after.contains(address)) && after.len() == before.len() + 1
    );
}

/// An address is of everything that makes a cell and of nothing else.
#[test]
fn address_covers_all_that_makes_a_cell() {
    let before = plan(TINY);
    let changed = |from: &str, to: &str| {
        assert!(TINY.contains(from), "{from}");
        let after = plan(&TINY.replacen(from, to, 1));
        Kind::ALL.map(|kind| addresses(&before, kind) != addresses(&after, kind))
    };
    // Recording, training, evaluation.
    assert_eq!(changed("seed = 0", "seed = 5"), [true, true, true]);
    assert_eq!(changed("steps = 10", "steps = 11"), [false, true, true]);
    assert_eq!(
        changed("training_seeds = [1]", "training_seeds = [2]"),
        [false, true, true]
    );
    assert_eq!(
        changed("first_seed = 1000", "first_seed = 2000"),
        [false, false, true]
    );
    assert_eq!(
        changed("record_jobs = 2", "record_jobs = 1"),
        [false, false, false]
    );
    assert_eq!(
        changed("save_every = 2", "save_every = 3"),
        [false, false, false]
    );
    assert_eq!(
        changed("title = \"A tiny study\"", "title = \"Another\""),
        [false, false, false]
    );
    let other = plan_with(TINY, "other code").unwrap();
    assert_ne!(
        addresses(&before, Kind::Recording),
        addresses(&other, Kind::Recording)
    );
    assert_ne!(before.record.grid, other.record.grid);
}

#[test]
fn shards_are_a_partition_that_has_what_it_needs() {
    let plan = plan(SUFIA_BC);
    let all: BTreeSet<Address> = plan.part(None);
    assert_eq!(all.len(), plan.cells.len());
    for shards in [1, 2, 7] {
        let parts: Vec<BTreeSet<Address>> = (1..=shards)
            .map(|index| plan.part(Some(format!("{index}/{shards}").parse().unwrap())))
            .collect();
        for cell in &plan.cells {
            let here = parts.iter().filter(|part| part.contains(&cell.address));
            let here: Vec<_> = here.collect();
            if cell.job.kind() == Kind::Recording {
                assert!(!here.is_empty(), "{}", cell.label);
            } else {
                assert_eq!(here.len(), 1, "{}", cell.label);
            }
            for part in here {
                assert!(
                    cell.job.inputs().iter().all(|input| part.contains(input)),
                    "{}",
                    cell.label
                );
            }
        }
        let sizes: Vec<usize> = parts.iter().map(BTreeSet::len).collect();
        let (least, most) = (sizes.iter().min().unwrap(), sizes.iter().max().unwrap());
        assert!(2 * least >= *most, "{sizes:?}");
    }
    for wrong in ["0/2", "3/2", "1", "a/b", "1/0", "-1/2"] {
        assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
    }
}

#[test]
fn what_is_wrong_with_a_file_is_told_with_line_and_key() {
    let line_of = |text: &str| {
        TINY.lines()
            .position(|line| line.starts_with(text))
            .unwrap()
            + 1
    };
    let error = refused("[training]\n", "[training]\ndevise = \"cpu\"\n");
    let line = line_of("[training]") + 1;
    assert!(
        error.starts_with(&format!("study.toml:{line}: ")) && error.contains("`devise`"),
        "{error}"
    );
    let error = refused(
        "tasks = [\"needle-lift\", \"block-transfer\"]",
        "tasks = []",
    );
    let line = line_of("tasks = [");
    assert!(
        error.starts_with(&format!("study.toml:{line}: grid.0.tasks = []")),
        "{error}"
    );
    let error = refused(
        "networks = [\"act\", \"dp3\", \"expert\"]",
        "networks = [\"act\", \"dp4\"]",
    );
    assert!(
        error.contains("grid.0.networks = dp4") && error.contains("act, dp3, expert"),
        "{error}"
    );
    let grids = TINY.find("[[grid]]").unwrap();
    let error = plan_with(&TINY[..grids], "code").unwrap_err();
    assert!(
        error.is_bad_input()
            && error
                .to_string()
                .contains("grid = [] is outside one [[grid]] or more"),
        "{error}"
    );
}

#[test]
fn a_value_outside_of_its_range_is_told_with_the_range() {
    for (from, to, told) in [
        (
            "demonstrations = [2]",
            "demonstrations = []",
            "grid.0.demonstrations = []",
        ),
        ("training_seeds = [1]", "training_seeds = [1, 1]", "1 twice"),
        (
            "trials = 2",
            "trials = 0",
            "grid.0.trials = 0 is outside [1, 1000000]",
        ),
        (
            "rate = 0.70",
            "rate = 68",
            "grid.0.published.rates.0.rate = 68 is outside [0, 1]",
        ),
        (
            "name = \"samples\"",
            "name = \"success\"",
            "names that no other grid has",
        ),
        (
            "threads = 1",
            "threads = 0",
            "training.threads = 0 is outside [1, 1024]",
        ),
        (
            "columns = \"network\"",
            "columns = \"networks\"",
            "unknown variant `networks`",
        ),
        (
            "steps = 10",
            "steps = 10\noptions = [\"--seed\", \"3\"]",
            "network.act.options: --seed is the study's own",
        ),
        ("cameras = \"single\"\n", "", "network.act.cameras = none"),
        (
            "policy = \"expert\"",
            "policy = \"checkpoint\"",
            "network.expert.checkpoint = none",
        ),
    ] {
        let error = refused(from, to);
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn nothing_is_evaluated_on_seeds_of_its_demonstrations() {
    // Two demonstrations may take seeds 0 to 29.
    let error = refused("first_seed = 1000", "first_seed = 29");
    assert!(
        error.contains("grid success") && error.contains("29 to 30") && error.contains("0 to 29"),
        "{error}"
    );
    plan(&TINY.replacen("first_seed = 1000", "first_seed = 30", 1));
    let error = refused("seed = 0", "seed = 1001");
    assert!(error.contains("1000 to 1001"), "{error}");
}

/// Untrained policies stand once whatever is trained beside them.
#[test]
fn untrained_policies_are_listed_once() {
    let plan = plan(&TINY.replacen("demonstrations = [2]", "demonstrations = [1, 2]", 1));
    let expert = |entry: &&super::plan::Entry| entry.at.network == "expert";
    let places: Vec<_> = plan
        .record
        .entries
        .iter()
        .filter(expert)
        .map(|entry| entry.at.on(Axis::Demonstrations))
        .collect();
    assert_eq!(places, ["", ""]);
}

/// A cell that is done, with one file of content.
fn done(store: &Store) -> Address {
    let address = Address::of(&serde_json::json!("cell"));
    let _lock = store.lock(Kind::Evaluation, &address).unwrap().unwrap();
    let result = store.result(Kind::Evaluation, &address);
    fs::write(&result, "{\"trials\": 3}").unwrap();
    let manifest = Manifest {
        format: MANIFEST_FORMAT,
        address: address.clone(),
        label: "cell".to_owned(),
        recipe: serde_json::json!("cell"),
        command: Vec::new(),
        executable_sha256: String::new(),
        host: String::new(),
        gpu: None,
        seconds: 1.5,
        memory_bytes: None,
        gpu_memory_bytes: None,
        attempts: 1,
        episodes: None,
        weights_sha256: None,
        files: Vec::new(),
    };
    store.finish(Kind::Evaluation, manifest).unwrap();
    address
}

fn damage(store: &Store, address: &Address) -> String {
    match store.state(Kind::Evaluation, address) {
        State::Damaged(reason) => reason,
        other @ (State::Missing | State::Begun | State::Done(_) | State::Bare(_)) => {
            panic!("{other:?}")
        }
    }
}

#[test]
fn a_cell_is_done_only_as_long_as_its_files_are_what_they_were() {
    let folder = Scratch::new("study-done");
    let store = Store::new(folder.0.clone());
    let missing = Address::of(&serde_json::json!("other"));
    assert_eq!(store.state(Kind::Evaluation, &missing), State::Missing);
    store
        .keep_attempts(Kind::Evaluation, &missing, Attempts::default())
        .unwrap();
    assert_eq!(store.state(Kind::Evaluation, &missing), State::Begun);

    let address = done(&store);
    let result = store.result(Kind::Evaluation, &address);
    let whole = fs::read(&result).unwrap();
    let State::Done(manifest) = store.state(Kind::Evaluation, &address) else {
        panic!("it is done");
    };
    assert_eq!(
        manifest.files.len(),
        1,
        "the lock and the log are not part of it"
    );
    // Written again, the same: another time, the same content.
    fs::write(&result, &whole).unwrap();
    assert!(matches!(
        store.state(Kind::Evaluation, &address),
        State::Done(_)
    ));
    fs::write(&result, &whole[..5]).unwrap();
    assert!(damage(&store, &address).contains("has 5 bytes and had 13"));
    fs::write(&result, "{\"trials\": 4}").unwrap();
    assert!(damage(&store, &address).contains("its content has changed"));
    fs::remove_file(&result).unwrap();
    assert!(damage(&store, &address).contains("result.json"));
    fs::write(&result, &whole).unwrap();
    assert!(matches!(
        store.state(Kind::Evaluation, &address),
        State::Done(_)
    ));

    let manifest = store.cell(Kind::Evaluation, &address).join("cell.json");
    let text = fs::read(&manifest).unwrap();
    fs::write(&manifest, &text[..text.len() / 2]).unwrap();
    assert!(damage(&store, &address).contains("cell.json: cut off or changed"));
}

#[test]
fn a_cells_result_outlives_what_it_made() {
    let folder = Scratch::new("study-bare");
    let store = Store::new(folder.0.clone());
    let address = Address::of(&serde_json::json!("cell"));
    let kept = store.product(Kind::Evaluation, &address);
    fs::create_dir_all(&kept).unwrap();
    fs::write(kept.join("seed-1.gif"), "strip").unwrap();
    fs::write(kept.join("seed-1.mcap"), "log").unwrap();
    let executed = store.cell(Kind::Evaluation, &address).join(EXECUTED);
    fs::create_dir_all(&executed).unwrap();
    fs::write(executed.join("trocar.json"), "whole chunks").unwrap();
    assert_eq!(done(&store), address);
    fs::remove_file(kept.join("seed-1.mcap")).unwrap();
    let state = || store.state(Kind::Evaluation, &address);
    assert!(matches!(state(), State::Bare(_)), "{:?}", state());
    // What is here has to be what was written.
    fs::write(kept.join("seed-1.gif"), "other").unwrap();
    assert!(damage(&store, &address).contains("seed-1.gif"));
    fs::remove_dir_all(&kept).unwrap();
    fs::remove_dir_all(&executed).unwrap();
    assert!(matches!(state(), State::Bare(_)));
    fs::remove_file(store.result(Kind::Evaluation, &address)).unwrap();
    assert!(damage(&store, &address).contains("result.json"));
}

#[test]
fn a_cell_is_locked_by_one_and_read_by_many() {
    let folder = Scratch::new("study-lock");
    let store = Store::new(folder.0.clone());
    let address = Address::of(&serde_json::json!("cell"));
    let lock = store.lock(Kind::Recording, &address).unwrap();
    assert!(lock.is_some());
    assert!(store.lock(Kind::Recording, &address).unwrap().is_none());
    assert!(
        store
            .lock_to_read(Kind::Recording, &address)
            .unwrap()
            .is_none()
    );
    drop(lock);
    let readers = [0, 1].map(|_| store.lock_to_read(Kind::Recording, &address).unwrap());
    assert!(readers.iter().all(Option::is_some));
    assert!(store.lock(Kind::Recording, &address).unwrap().is_none());
}
