//! Datasets of version 2.1, and every number that a dataset's descriptions have.

use std::fs;
use std::path::Path;

use serde_json::json;

use crate::common::{Folder, seeds, within_memory};
use crate::damage::damaged;
use crate::datasets::{check, files, read};
use crate::digits::renumbered;
use crate::recorded::record;

/// Makes a recording as LeRobot 2.1 would have written it.
fn to_v21(dir: &Path) {
    let path = dir.join("meta/info.json");
    let mut info: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    info["codebase_version"] = json!("v2.1");
    info["total_chunks"] = json!(1);
    fs::write(&path, serde_json::to_string_pretty(&info).unwrap()).unwrap();
    let (mut episodes, mut stats) = (String::new(), String::new());
    for index in 0..2 {
        let line = json!({"episode_index": index, "tasks": ["Lift the needle"], "length": 4});
        episodes += &format!("{line}\n");
        let of = json!({"min": [0.0], "max": [1.0], "mean": [0.5], "std": [0.1], "count": [4]});
        let line = json!({"episode_index": index, "stats": {"action": of}});
        stats += &format!("{line}\n");
        let chunk = dir.join("data/chunk-000");
        let from = chunk.join(format!("file-{index:03}.parquet"));
        fs::rename(from, chunk.join(format!("episode_{index:06}.parquet"))).unwrap();
    }
    let meta = dir.join("meta");
    fs::write(meta.join("episodes.jsonl"), episodes).unwrap();
    fs::write(meta.join("episodes_stats.jsonl"), stats).unwrap();
    let task = json!({"task_index": 0, "task": "Lift the needle"});
    fs::write(meta.join("tasks.jsonl"), format!("{task}\n")).unwrap();
    fs::remove_dir_all(meta.join("episodes")).unwrap();
    fs::remove_file(meta.join("tasks.parquet")).unwrap();
}

/// Whether it is refused, by name.
fn refused(dir: &Path, case: &str) -> bool {
    let Err(error) = read(dir) else {
        return false;
    };
    check(&error, dir, case);
    true
}

#[test]
fn a_damaged_dataset_of_version_2_1_is_read_or_refused_by_name() {
    let folder = Folder::new("v21");
    let dir = folder.path().join("d");
    record(&dir, "scope");
    to_v21(&dir);
    read(&dir).expect("it is whole");
    let files = files(&dir);
    let whole: Vec<Vec<u8>> = files.iter().map(|file| fs::read(file).unwrap()).collect();
    within_memory(|| {
        let mut count = 0_u32;
        for seed in seeds(1) {
            let number = usize::try_from(seed).unwrap() % files.len();
            fs::write(&files[number], damaged(&whole[number], seed)).unwrap();
            let case = format!("seed {seed}, {}", files[number].display());
            count += u32::from(refused(&dir, &case));
            fs::write(&files[number], &whole[number]).unwrap();
        }
        assert!(count > 0, "nothing was refused: is anything damaged?");
    });
    read(&dir).expect("it is whole again");
}

#[test]
fn every_number_of_a_description_may_be_wrong() {
    let folder = Folder::new("described");
    for version in ["v3.0", "v2.1"] {
        let dir = folder.path().join(version);
        record(&dir, "scope");
        if version == "v2.1" {
            to_v21(&dir);
        }
        let mut files = files(&dir.join("meta"));
        files.retain(|file| file.extension().is_some_and(|it| it != "parquet"));
        assert!(files.len() >= 2, "{files:?}");
        within_memory(|| {
            let mut count = 0_u32;
            for file in files {
                let text = fs::read_to_string(&file).unwrap();
                for (case, other) in renumbered(&text) {
                    fs::write(&file, other).unwrap();
                    let case = format!("{}, {case}", file.display());
                    count += u32::from(refused(&dir, &case));
                }
                fs::write(&file, text).unwrap();
            }
            assert!(count > 0, "nothing was refused: is anything damaged?");
        });
        read(&dir).expect("it is whole again");
    }
}
