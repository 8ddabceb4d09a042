//! Patients of many seeds are whole and have no overlap.

use super::paint::{self, Size};
use super::patient::Patient;
use crate::groups::Groups;

/// What is wrong with `patient`.
fn defects(patient: &Patient, size: Size) -> Vec<String> {
    let paint::Scan {
        labels: volume,
        phantom: result,
        ..
    } = paint::scan(patient, size);
    let mut defects = Vec::new();
    if result.overlapping_voxels > 0 {
        defects.push(format!("{} voxels overlap", result.overlapping_voxels));
    }
    let groups = Groups::load("vista3d").expect("the table is right");
    let body = result.parts.last().expect("a body").volume_mm3;
    if !(5e6..6e7).contains(&body) {
        defects.push(format!("{body} mm3 of body"));
    }
    for part in &result.parts {
        if part.voxels == 0 {
            defects.push(format!("no {}", part.name));
        }
        if groups
            .group_of(u16::from(part.label))
            .is_none_or(|group| group == 0)
        {
            defects.push(format!("{} is in no group", part.name));
        }
    }
    for (name, least, most) in [
        ("liver", 0.45e6, 2.2e6),
        ("spleen", 0.4e5, 2.5e5),
        ("right kidney", 0.4e5, 2.0e5),
        ("heart", 1.2e5, 6.0e5),
        ("left lung", 0.5e6, 3.0e6),
        ("bladder", 0.4e5, 2.5e5),
        ("gallbladder", 0.4e4, 3.0e4),
    ] {
        let found = result
            .parts
            .iter()
            .find(|part| part.name == name)
            .expect("there");
        if !(least..most).contains(&found.volume_mm3) {
            defects.push(format!("{name}: {} mm3", found.volume_mm3));
        }
    }
    // Air all around, but for head and feet.
    let [width, depth, _] = volume.grid.dims;
    let rim = volume.voxels.iter().enumerate().filter(|(i, _)| {
        let (x, y) = (i % width, i / width % depth);
        x == 0 || y == 0 || x == width - 1 || y == depth - 1
    });
    if rim.into_iter().any(|(_, &label)| label != 0) {
        defects.push("the body leaves the scan sideways".to_owned());
    }
    defects
}

/// At 7 mm the thinnest tubes have few voxels, but overlaps are proved absent before anything is
/// painted.
#[test]
fn some_seeds_are_whole_patients() {
    for seed in 0..4 {
        let found = defects(&Patient::new(seed), Size([64, 64, 77]));
        assert!(found.is_empty(), "seed {seed}: {found:#?}");
    }
}

/// Minutes; `make test-anatomy` runs it.
#[test]
#[ignore = "takes minutes"]
fn a_thousand_seeds_are_whole_patients() {
    let mut variations = [0; 5];
    for seed in 0..1000 {
        let patient = Patient::new(seed);
        let found = defects(&patient, Size([90, 90, 108]));
        assert!(found.is_empty(), "seed {seed}: {found:#?}");
        variations[crate::number::floor_to(4.0 * patient.variation, 4)] += 1;
    }
    // Most differ in their organs, not only in their outer shape.
    assert!(variations[0] < 100, "{variations:?}");
}

#[test]
fn the_same_seed_gives_the_same_files_and_another_seed_others() {
    let folder = std::env::temp_dir().join(format!("trocar-phantom-{}", std::process::id()));
    let files = |seed: u64, name: &str| {
        let out = folder.join(name);
        super::write(&Patient::new(seed), Size([24, 24, 20]), &out, |_, _| ()).expect("written");
        ["ct.nii.gz", "labels.nii.gz"].map(|file| std::fs::read(out.join(file)).expect("there"))
    };
    let first = files(3, "a");
    assert_eq!(first, files(3, "b"));
    let other = files(4, "c");
    assert!(first[0] != other[0] && first[1] != other[1]);
    std::fs::remove_dir_all(folder).expect("the folder can go");
}
