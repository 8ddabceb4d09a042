//! Who drove, in each frame of a dataset.

use std::error::Error;
use std::fs;

use serde_json::{Value, json};

use super::{ArmFrame, Dataset, DatasetError, DatasetSpec, DatasetWriter, FrameRecord};

fn record(writer: &mut DatasetWriter, by_hand: &[bool]) -> Result<(), DatasetError> {
    let still = ArmFrame {
        state: [0.0; 7],
        tip_pose: [0.0; 7],
        action: [0.0; 8],
    };
    let frame = FrameRecord {
        arms: &[still],
        images: &[],
        depth: &[],
    };
    for &intervention in by_hand {
        writer.push_frame_of(&frame, intervention)?;
    }
    writer.end_episode()
}

/// Who drove is LeRobot's column of truth values: it comes back, goes on behind a break, and is not
/// there in other datasets.
#[test]
fn who_drove_is_kept_and_goes_on() -> Result<(), Box<dyn Error>> {
    let folder = std::env::temp_dir().join(format!("trocar-intervention-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    let spec = |intervention| DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "lift".to_owned(),
        cameras: Vec::new(),
        intervention,
    };
    let mut writer = DatasetWriter::create(&folder, &spec(true))?;
    record(&mut writer, &[false, true, true, false])?;
    drop(writer);
    let mut writer = DatasetWriter::resume(&folder, &spec(true), None)?;
    record(&mut writer, &[true, false])?;
    drop(writer);
    let dataset = Dataset::open(&folder)?;
    let of = |episode: usize| dataset.interventions(dataset.episodes()[episode]);
    assert_eq!(of(0)?, [false, true, true, false]);
    assert_eq!(of(1)?, [true, false]);
    let stats: Value = serde_json::from_slice(&fs::read(folder.join("meta/stats.json"))?)?;
    assert_eq!(stats["intervention"]["mean"], json!([0.5]));
    let other = DatasetWriter::resume(&folder, &spec(false), None);
    assert!(matches!(other, Err(DatasetError::Differs { .. })));

    let plain = folder.join("plain");
    record(&mut DatasetWriter::create(&plain, &spec(false))?, &[true])?;
    let plain = Dataset::open(&plain)?;
    let missing = plain.interventions(plain.episodes()[0]);
    assert!(matches!(missing, Err(DatasetError::Missing { .. })));
    fs::remove_dir_all(&folder)?;
    Ok(())
}
