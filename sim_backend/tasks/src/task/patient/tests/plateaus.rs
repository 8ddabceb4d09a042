//! Which patch is taken, and which needles lie on it, on livers that are plateaus: where a needle
//! slides, and which is too large, is known.

use std::collections::BTreeSet;
use std::fs;

use hal::config::Source;
use hal::count::count_u32;
use hal::mesh::single;
use nalgebra::{Point3, Vector3};
use trocar_anatomy::assets::{Asset, GLB_FILE, glb};
use trocar_anatomy::groups::Groups;
use trocar_anatomy::mesh::GroupMesh;

use super::{Folder, scene};
use crate::task::{NeedleError, TaskConfig, Variation};

/// Vertices along a side.
const SIDE: u32 = 15;

/// A square that faces the front.
struct Plateau {
    /// Its middle along the body, mm.
    at_mm: f64,
    /// Half its size, mm.
    half_mm: f64,
    /// Distance from its middle beyond which it is 9 mm lower, mm.
    flat_mm: f64,
    /// By how much its normals are off: under the instruments it is a slope as steep.
    slope_deg: f64,
}

/// Flat all over and level.
const LEVEL: Plateau = Plateau {
    at_mm: 0.0,
    half_mm: 21.5,
    flat_mm: 100.0,
    slope_deg: 0.0,
};

impl Plateau {
    fn add_to(&self, mesh: &mut GroupMesh) {
        let first = count_u32(mesh.positions.len());
        let (sin, cos) = self.slope_deg.to_radians().sin_cos();
        let normal = single(&Vector3::new(sin, cos, 0.0));
        let at = |index: u32| self.half_mm * (2.0 * f64::from(index) / f64::from(SIDE - 1) - 1.0);
        for i in 0..SIDE {
            for j in 0..SIDE {
                let (x, z) = (at(i), at(j));
                let y = if x.hypot(z) > self.flat_mm { -9.0 } else { 0.0 };
                mesh.positions.push(Point3::new(x, y, self.at_mm + z));
                mesh.normals.push(normal);
                if i > 0 && j > 0 {
                    let here = first + SIDE * i + j;
                    let [below, left, right] = [here - SIDE - 1, here - SIDE, here - 1];
                    mesh.triangles.push([below, left, right]);
                    mesh.triangles.push([right, left, here]);
                }
            }
        }
    }
}

impl Folder {
    /// A patient whose liver is `plateaus`.
    fn with_plateaus(test: &str, plateaus: &[Plateau]) -> Self {
        let folder = Self::new(test);
        fs::create_dir(&folder.0).unwrap();
        let mut mesh = GroupMesh::default();
        for plateau in plateaus {
            plateau.add_to(&mut mesh);
        }
        mesh.uv = vec![[[0.0; 2]; 3]; mesh.triangles.len()];
        let groups = Groups::load("vista3d").unwrap();
        let group = groups.groups.iter().find(|group| group.name == "liver");
        let asset = Asset {
            group: group.unwrap(),
            mesh: &mesh,
            texture: None,
        };
        fs::write(folder.0.join(GLB_FILE), glb(&[asset])).unwrap();
        folder
    }

    /// The text of a needle lift on its liver, with `new` in the place of `old`.
    fn lift_with(&self, old: &str, new: &str) -> Source {
        let lift = scene("needle-lift", &self.0, "liver");
        let changed = lift.text().replace(old, new);
        assert_ne!(changed, lift.text(), "{old}");
        Source::embedded("liver.toml", &changed)
    }
}

fn refused(source: &Source) -> String {
    let refused = TaskConfig::parse("needle-lift", source);
    refused.unwrap_err().to_string()
}

/// The flattest patch is a slope of 6 degrees. With little friction, on which the needle slides off
/// it, the next one is taken, which is level, but lower at its rim.
#[test]
fn where_a_needle_slides_off_the_next_patch_is_taken() {
    let slope = Plateau {
        half_mm: 35.0,
        slope_deg: 6.0,
        ..LEVEL
    };
    let lower_rim = Plateau {
        at_mm: 300.0,
        half_mm: 35.0,
        flat_mm: 27.5,
        ..LEVEL
    };
    let folder = Folder::with_plateaus("next", &[slope, lower_rim]);
    let lie = |friction: &str| {
        let source = folder.lift_with("friction = 0.5", friction);
        let task = TaskConfig::parse("needle-lift", &source).unwrap();
        task.patient().unwrap().clone()
    };
    let [rough, smooth] = ["friction = 0.45", "friction = 0.04"].map(lie);
    assert!(rough.patch_in_scan_m[2].abs() < 0.02, "{rough:?}");
    assert!((smooth.patch_in_scan_m[2] - 0.3).abs() < 0.02, "{smooth:?}");
    assert!(rough.roughness_m < smooth.roughness_m);
}

/// On a slope without friction no needle stays.
#[test]
fn a_needle_that_slides_off_everywhere_is_refused() {
    let slope = Plateau {
        slope_deg: 6.0,
        ..LEVEL
    };
    let folder = Folder::with_plateaus("slope", &[slope]);
    let refused = refused(&folder.lift_with("friction = 0.5", "friction = 0.0"));
    assert!(
        refused.contains("scene.organ = liver: its needle slides off; a smaller one may lie; "),
        "{refused}"
    );
    assert!(
        refused.contains("tried on the patient's liver"),
        "{refused}"
    );
}

/// On a plateau of 36 mm the trained needle, 38 mm wide, does not lie, but N3 does if the scene
/// names it. There the trained one is neither chosen nor drawn.
#[test]
fn a_smaller_needle_of_the_scene_lies_where_the_trained_one_does_not() {
    let small = Plateau {
        half_mm: 18.0,
        ..LEVEL
    };
    let folder = Folder::with_plateaus("small", &[small]);
    let of_scene = |needle: &str| {
        let organ = "organ = \"liver\"\n";
        folder.lift_with(organ, &format!("{organ}needle = \"{needle}\"\n"))
    };
    let trained = refused(&of_scene("N1"));
    for part in [
        "needle_start.range_m",
        "a needle of 19.2 mm radius",
        "slope of 20 degrees",
        "one patch was tried on the patient's liver, the first 0.0 mm from flat (root mean square) within 16 mm of (",
    ] {
        assert!(trained.contains(part), "{trained}");
    }
    let task = TaskConfig::parse("needle-lift", &of_scene("N3")).unwrap();
    assert_eq!(task.needle(), Some("N3"));
    let trained = task.clone().with_needle("N1").unwrap_err().to_string();
    assert!(
        trained.starts_with("needle N1 does not lie on, or slides off, the chosen patch"),
        "{trained}"
    );
    let task = task.with_variations(&[Variation::Needles]).unwrap();
    let needles = (0..60).map(|seed| task.drawn(seed).needle.unwrap());
    let drawn: BTreeSet<String> = needles.collect();
    assert!(
        drawn.contains("N3") && !drawn.contains("N1"),
        "of a plateau for N3: {drawn:?}"
    );
    let unknown = refused(&of_scene("N9"));
    assert!(
        unknown.contains("scene.needle = N9 is outside N1, N2, N3, N4, N5"),
        "{unknown}"
    );

    let handover = scene("needle-handover", &folder.0, "liver");
    let handover = format!("{}needle = \"N3\"\n", handover.text());
    let handover = Source::embedded("handover.toml", &handover);
    let no_choice = TaskConfig::parse("needle-handover", &handover).unwrap_err();
    let no_choice = no_choice.to_string();
    assert!(
        no_choice.contains("scene.needle = N3: this kind of scene has no choice"),
        "{no_choice}"
    );
}

/// N5 as an open ring of 60 mm falls off a plateau of 43 mm wherever it is laid: it can't be
/// chosen, and is not drawn.
#[test]
fn a_needle_that_falls_off_the_patch_is_neither_chosen_nor_drawn() {
    let folder = Folder::with_plateaus("ring", &[LEVEL]);
    let source = folder.lift_with(
        "arc_angle_rad = 1.7\nuneven = [0.0, 2.0]",
        "arc_angle_rad = 5.0\nuneven = [0.0, 0.0]",
    );
    let task = TaskConfig::parse("needle-lift", &source).unwrap();
    let resting = ["N1", "N2", "N3", "N4"].map(str::to_owned);
    let ring = task.clone().with_needle("N5").unwrap_err();
    assert_eq!(
        ring.to_string(),
        "needle N5 does not lie on, or slides off, the chosen patch of the patient's liver; these come to rest there: N1, N2, N3, N4"
    );
    let expected = NeedleError::SlidesOff {
        name: "N5".to_owned(),
        organ: "liver".to_owned(),
        resting: resting.to_vec(),
    };
    assert_eq!(ring, expected);
    assert!(task.clone().with_needle("N2").is_ok());

    let task = task.with_variations(&[Variation::Needles]).unwrap();
    let needles = (0..60).map(|seed| task.drawn(seed).needle.unwrap());
    let drawn: BTreeSet<String> = needles.collect();
    assert_eq!(drawn, BTreeSet::from(resting));
}
