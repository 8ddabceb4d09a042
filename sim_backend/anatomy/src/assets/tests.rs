//! Files have what their formats ask for; other programs judge the rest in
//! `tests/scripts/anatomy.py`.

use nalgebra::Point3;
use serde_json::Value;

use super::foreign::of_usd;
use super::read::parts;
use super::{Asset, Part, glb, usda, usdz};
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
        texture: None,
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

/// Our reader takes the archive as it takes the stage, whose bytes begin at a multiple of 64.
#[test]
fn usdz_has_the_stage_as_it_is() {
    let groups = Groups::load("vista3d").expect("the table is right");
    let mesh = tetrahedron();
    let text = usda(&[Asset {
        group: &groups.groups[0],
        mesh: &mesh,
        texture: None,
    }]);
    let archive = usdz(&[("patient.usda".to_owned(), text.as_bytes())]);
    assert_eq!(&archive[64..64 + text.len()], text.as_bytes());
    let [stage, packed] = [text.as_bytes(), &archive].map(|file| of_usd(file).expect("it is read"));
    assert_eq!(stage[0].mesh.positions, packed[0].mesh.positions);
    let cut = of_usd(&archive[..archive.len() - 23]).expect_err("the end is missing");
    assert!(cut.contains("cut off"), "{cut}");
}

#[test]
fn usda_has_points_in_metres_and_mass() {
    let groups = Groups::load("vista3d").expect("the table is right");
    let mesh = tetrahedron();
    let asset = Asset {
        group: &groups.groups[0],
        mesh: &mesh,
        texture: None,
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

/// The file of a tetrahedron.
fn file() -> Vec<u8> {
    let groups = Groups::load("vista3d").expect("the table is right");
    glb(&[Asset {
        group: &groups.groups[0],
        mesh: &tetrahedron(),
        texture: None,
    }])
}

/// A textured file is read with the colour of its group, not with the white that its texture is
/// multiplied with.
#[test]
fn a_textured_file_keeps_the_colour_of_its_group() {
    let groups = Groups::load("vista3d").expect("the table is right");
    let (group, mut mesh) = (&groups.groups[0], tetrahedron());
    crate::atlas::unwrap(&mut mesh);
    let png = crate::texture::png(group, &mesh, 16).expect("a PNG");
    let asset = Asset {
        group,
        mesh: &mesh,
        texture: Some(&png),
    };
    let [textured, plain] = [
        asset,
        Asset {
            texture: None,
            ..asset
        },
    ]
    .map(|asset| parts(&glb(&[asset])).expect("our own file").remove(0));
    assert_eq!(
        textured.colour.map(f32::to_bits),
        plain.colour.map(f32::to_bits)
    );
}

#[test]
fn what_is_written_is_read_again() {
    let parts = parts(&file()).expect("our own file");
    assert_eq!(parts.len(), 1);
    let liver = &parts[0];
    assert_eq!(liver.name, "liver");
    assert_eq!(liver.mesh.indices.len(), 12);
    assert_eq!(liver.mesh.positions.len(), liver.mesh.normals.len());
    let most = liver
        .mesh
        .positions
        .iter()
        .map(|p| p[0])
        .fold(0.0, f32::max);
    assert!((most - 0.06).abs() < 1e-8, "{most}");
    let group = &Groups::load("vista3d").expect("the table is right").groups[0];
    assert!((f64::from(liver.colour[0]) - group.colour[0]).abs() < 1e-6);
    assert!((f64::from(liver.wetness) - group.wetness).abs() < 1e-6);
}

/// The file with `old` replaced in its JSON, whose length stays.
fn changed(old: &str, new: &str) -> Vec<u8> {
    assert_eq!(old.len(), new.len());
    let mut bytes = file();
    let place = bytes
        .windows(old.len())
        .position(|part| part == old.as_bytes());
    let place = place.expect("it is there");
    bytes[place..place + old.len()].copy_from_slice(new.as_bytes());
    bytes
}

/// The file with the first word of its numbers, a coordinate, or the last, an index, replaced.
fn with_word(first: bool, word: [u8; 4]) -> Vec<u8> {
    let mut bytes = file();
    let json = u32::from_le_bytes(bytes[12..16].try_into().expect("four")) as usize;
    let place = if first { 28 + json } else { bytes.len() - 4 };
    bytes[place..place + 4].copy_from_slice(&word);
    bytes
}

#[test]
fn hostile_files_are_refused_with_the_reason() {
    let whole = file();
    for cut in 0..whole.len() {
        assert!(parts(&whole[..cut]).is_err(), "{cut} bytes");
    }
    for (bytes, reason) in [
        (b"glTE".to_vec(), "no binary glTF"),
        (whole[..whole.len() - 1].to_vec(), "the length"),
        (changed("\"count\":12", "\"count\":99"), "no place"),
        (changed("\"indices\":3", "\"indices\":9"), "no accessor 9"),
        (changed("\"indices\":3", "\"indices\":1"), "another type"),
        (changed("\"NORMAL\":1", "\"NORMAL\":0"), "the length 1"),
        (changed("\"material\":0", "\"material\":7"), "no material 7"),
        (with_word(true, f32::NAN.to_le_bytes()), "not finite"),
        (with_word(true, 1e9_f32.to_le_bytes()), "further than"),
        (with_word(false, [255; 4]), "not there"),
    ] {
        let error = parts(&bytes).expect_err(reason);
        assert!(error.contains(reason), "{error}, not {reason}");
    }
}

/// As another program would write it: without our word on the frame.
fn of_others() -> Vec<u8> {
    changed("RAS of the scan, m", "RAS of another's  ")
}

#[test]
fn a_file_of_another_program_lies_where_its_nodes_say() {
    let own = parts(&file()).expect("our own file");
    let others = parts(&of_others()).expect("another's file");
    let names = |parts: &[Part]| {
        parts
            .iter()
            .map(|part| part.name.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(names(&others), names(&own));
    let (own, other) = (&own[0].mesh, &others[0].mesh);
    // Vertices at one place are one there; corners are in the same order.
    assert_eq!(other.positions.len(), 4);
    assert_eq!(other.indices.len(), own.indices.len());
    for (a, b) in own.indices.iter().zip(&other.indices) {
        let (a, b) = (own.positions[*a as usize], other.positions[*b as usize]);
        let apart = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-7, "{a:?} {b:?}");
    }
    // The corner where three faces meet in right angles looks away from all.
    let corner = other
        .positions
        .iter()
        .position(|p| p.iter().all(|x| x.abs() < 1e-7));
    let normal = other.normals[corner.expect("it is there")];
    assert!(
        normal
            .iter()
            .all(|x| (x + 3_f32.sqrt().recip()).abs() < 1e-5),
        "{normal:?}"
    );
}

#[test]
fn hostile_files_of_others_are_refused() {
    let whole = of_others();
    for cut in 0..whole.len() {
        assert!(parts(&whole[..cut]).is_err(), "{cut} bytes");
    }
    // Whatever byte is another one, there is an answer.
    let mut read = 0;
    for at in 0..whole.len() {
        for value in [0, b'9', 0xFF] {
            let mut bytes = whole.clone();
            bytes[at] = value;
            read += usize::from(parts(&bytes).is_ok());
        }
    }
    assert!(read > 0);
    let with = |old: &str, new: &str| {
        let bytes = of_others();
        let place = bytes
            .windows(old.len())
            .position(|part| part == old.as_bytes());
        let place = place.expect("it is there");
        let mut bytes = bytes;
        bytes[place..place + old.len()].copy_from_slice(new.as_bytes());
        parts(&bytes).err()
    };
    let far = with("\"count\":12", "\"count\":99");
    assert!(far.is_some_and(|reason| reason.contains("accessor")));
}

/// Our own stage, read as another program's, is our own glTF file.
#[test]
fn our_stage_has_the_meshes_of_our_glb() {
    let groups = Groups::load("vista3d").expect("the table is right");
    let mesh = tetrahedron();
    let assets: Vec<Asset<'_>> = groups
        .groups
        .iter()
        .map(|group| Asset {
            group,
            mesh: &mesh,
            texture: None,
        })
        .collect();
    let own = parts(&glb(&assets)).expect("our file");
    let stage = parts(usda(&assets).as_bytes()).expect("our stage");
    assert_eq!(own.len(), stage.len());
    for (own, stage) in own.iter().zip(&stage) {
        assert_eq!(own.name, stage.name);
        assert_eq!(own.mesh.indices.len(), stage.mesh.indices.len());
        for (a, b) in own.mesh.indices.iter().zip(&stage.mesh.indices) {
            let (a, b) = (
                own.mesh.positions[*a as usize],
                stage.mesh.positions[*b as usize],
            );
            let apart = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-8, "{}: {a:?} {b:?}", own.name);
        }
        let looks = |part: &Part| [&part.colour[..], &[part.roughness, part.wetness]].concat();
        for (a, b) in looks(own).iter().zip(looks(stage)) {
            assert!((a - b).abs() < 1e-6, "{}: {a} {b}", own.name);
        }
    }
}
