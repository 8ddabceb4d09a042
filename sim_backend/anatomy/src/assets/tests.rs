//! Files have what their formats ask for; other programs judge the rest in `tests/scripts/anatomy.py`.

use nalgebra::Point3;
use serde_json::Value;

use super::{Asset, glb, usda};
use crate::atlas::unwrap;
use crate::groups::Groups;
use crate::mesh::GroupMesh;

/// A tetrahedron of 60 mm.
fn tetrahedron() -> GroupMesh {
    let at = |x: f64, y: f64, z: f64| Point3::new(x, y, z);
    let mut mesh = GroupMesh {
        positions: vec![
            at(0.0, 0.0, 0.0),
            at(60.0, 0.0, 0.0),
            at(0.0, 60.0, 0.0),
            at(0.0, 0.0, 60.0),
        ],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        normals: vec![[1.0, 0.0, 0.0]; 4],
        ..GroupMesh::default()
    };
    unwrap(&mut mesh);
    mesh
}

#[test]
fn glb_is_two_chunks_whose_views_lie_in_the_buffer() {
    let groups = Groups::load("vista3d").expect("the table is right");
    let mesh = tetrahedron();
    let bytes = glb(&[Asset {
        group: &groups.groups[0],
        mesh: &mesh,
    }]);
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four")) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!(word(8), bytes.len());
    let json: Value = serde_json::from_slice(&bytes[20..20 + word(12)]).expect("JSON");
    let length = word(20 + word(12));
    assert_eq!(json["buffers"][0]["byteLength"], length);
    for view in json["bufferViews"].as_array().expect("views") {
        let end = view["byteOffset"].as_u64().expect("a number")
            + view["byteLength"].as_u64().expect("a number");
        assert!(end <= length as u64);
    }
    assert_eq!(json["accessors"][3]["count"], 12);
    let most = json["accessors"][0]["max"][0].as_f64().expect("a number");
    assert!((most - 0.06).abs() < 1e-8, "metres: {most}");
}

#[test]
fn usda_has_points_in_metres_and_mass() {
    let groups = Groups::load("vista3d").expect("the table is right");
    let mesh = tetrahedron();
    let asset = Asset {
        group: &groups.groups[0],
        mesh: &mesh,
    };
    // 60³ / 6 mm³ of 1060 kg/m³.
    assert!((asset.mass_kg() - 36e-6 * 1060.0).abs() < 1e-12);
    let text = usda(&[asset]);
    for part in [
        "metersPerUnit = 1",
        "upAxis = \"Z\"",
        "def Mesh \"liver\"",
        "(0.06, 0, 0)",
        "semantics:labels:class = [\"liver\"]",
    ] {
        assert!(text.contains(part), "{part}");
    }
    assert_eq!(text.matches('{').count(), text.matches('}').count());
}
