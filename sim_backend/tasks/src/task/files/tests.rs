//! Facts about tasks as folders: what is one, and why others are not.

use std::fs;
use std::path::PathBuf;

use super::*;

/// An empty folder `name` of the test `test`.
fn folder(test: &str, name: &str) -> PathBuf {
    let scratch = format!("trocar-tasks-{}-{test}", std::process::id());
    let folder = std::env::temp_dir().join(scratch).join(name);
    let _absent = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// A copy of the built-in task `task` as `folder`.
fn copy(task: &str, folder: &Path) {
    let files = TaskFiles::built_in(task).unwrap();
    fs::write(folder.join(SCENE_FILE), files.scene.text()).unwrap();
    fs::write(folder.join(SAFETY_FILE), files.safety.text()).unwrap();
}

fn refusal(asked: &Path) -> String {
    let error = TaskFiles::find(asked.to_str().unwrap()).unwrap_err();
    error.to_string()
}

#[test]
fn every_folder_is_built_in_with_the_texts_of_its_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/tasks");
    let mut folders: Vec<String> = fs::read_dir(&root)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    folders.sort();
    let mut built_in: Vec<&str> = names().collect();
    built_in.sort_unstable();
    assert_eq!(folders, built_in);
    for name in built_in {
        let files = TaskFiles::built_in(name).unwrap();
        let read = TaskFiles::read(&root.join(name)).unwrap();
        assert_eq!(files.name, read.name);
        assert_eq!(files.scene.text(), read.scene.text());
        assert_eq!(files.safety.text(), read.safety.text());
    }
}

#[test]
fn built_in_tasks_are_listed_by_the_order_of_their_files() {
    let orders: Vec<u32> = names()
        .map(|name| title(&TaskFiles::built_in(name).unwrap().scene))
        .map(|title| title.unwrap().order.unwrap())
        .collect();
    assert!(orders.is_sorted_by(|a, b| a < b), "{orders:?}");
}

#[test]
fn a_folder_is_a_task_of_its_own_name() {
    let folder = folder("own", "Lift_2-small");
    copy("needle-lift", &folder);
    let files = TaskFiles::find(folder.to_str().unwrap()).unwrap();
    let task = files.config().unwrap();
    assert_eq!(
        (task.name.as_str(), task.kind),
        ("Lift_2-small", "needle-lift")
    );
    // A path that ends in no name leads to a folder that has one.
    let dotted = folder.join("../Lift_2-small/.");
    let files = TaskFiles::find(dotted.to_str().unwrap()).unwrap();
    assert_eq!(files.name, "Lift_2-small");
    // A task without an order is one as well.
    let text = files.scene.text().replace("order = 1\n", "");
    assert_ne!(text, files.scene.text());
    fs::write(folder.join(SCENE_FILE), text).unwrap();
    assert!(TaskFiles::read(&folder).unwrap().config().is_ok());
}

#[test]
fn what_is_no_task_is_refused_with_what_would_be_one() {
    let message = TaskFiles::find("needle-drop").unwrap_err().to_string();
    for part in [
        "\"needle-drop\"",
        "needle-lift, needle-handover",
        SCENE_FILE,
        SAFETY_FILE,
    ] {
        assert!(message.contains(part), "{message}");
    }
    let empty = folder("none", "mine");
    let nowhere = refusal(&empty.join("nowhere"));
    assert!(
        nowhere.ends_with("nowhere: there is no such folder"),
        "{nowhere}"
    );
    let message = refusal(&empty);
    assert!(
        message.contains("mine/scene.toml: cannot be read"),
        "{message}"
    );
    copy("suture-pad", &empty);
    fs::remove_file(empty.join(SAFETY_FILE)).unwrap();
    let message = refusal(&empty);
    assert!(
        message.contains("mine/safety.toml: cannot be read"),
        "{message}"
    );
}

#[test]
fn a_name_that_is_none_or_anothers_is_refused() {
    for name in ["two words", "näh", "a".repeat(65).as_str()] {
        let folder = folder("names", name);
        copy("needle-lift", &folder);
        let message = refusal(&folder);
        assert!(
            message.contains("the folder's name is the task's"),
            "{message}"
        );
    }
    let taken = folder("names", "needle-lift");
    copy("needle-lift", &taken);
    assert_eq!(TaskFiles::read(&taken).unwrap().name, "needle-lift");
    for file in [SCENE_FILE, SAFETY_FILE] {
        copy("needle-lift", &taken);
        let text = fs::read_to_string(taken.join(file)).unwrap();
        fs::write(taken.join(file), format!("{text}# changed\n")).unwrap();
        let message = refusal(&taken);
        let reason = format!("{file} is not that of the built-in task of this name");
        assert!(message.contains(&reason), "{message}");
    }
}
