//! The cast against the physics' boxes, of pads of every size that a scene file may have.

use std::collections::BTreeMap;

use trocar_world::Shape;

use super::*;
use crate::task::suture_pad::SuturePad;

/// Rounding of single precision, m.
const ROUNDING_M: f64 = 1e-7;

fn shipped() -> PadShape {
    SuturePad::shipped().pad
}

/// The smallest pad that is allowed, with a hole in the middle of its lip.
const SMALLEST: PadShape = PadShape {
    length_m: 0.02,
    width_m: 0.02,
    thickness_m: 0.002,
    lip_length_m: 0.01,
    lip_height_m: 0.004,
    lip_front_m: -0.000_5,
    lip_thickness_m: 0.001,
    hole_height_m: 0.002,
    hole_half_m: 0.000_5,
};

/// The largest one, its lip as long as the plate and along its edge.
const LARGEST: PadShape = PadShape {
    length_m: 0.4,
    width_m: 0.4,
    thickness_m: 0.05,
    lip_length_m: 0.4,
    lip_height_m: 0.05,
    lip_front_m: -0.2,
    lip_thickness_m: 0.02,
    hole_height_m: 0.02,
    hole_half_m: 0.005,
};

/// The last three have thin walls around the hole: 0.1 mm over and under it, as little and half
/// a millimetre beside it, none under it.
fn pads() -> [PadShape; 6] {
    let wide = PadShape {
        hole_half_m: 0.001_9,
        ..SMALLEST
    };
    let tall = PadShape {
        lip_height_m: 0.0092,
        hole_half_m: 0.0045,
        hole_height_m: 0.0046,
        ..SMALLEST
    };
    let low = PadShape {
        hole_height_m: SMALLEST.hole_half_m,
        lip_front_m: 0.009,
        ..SMALLEST
    };
    [shipped(), SMALLEST, LARGEST, wide, tall, low]
}

type Corner = [Vector3<f64>; 2];

/// Position and normal of each triangle's corners.
fn triangles(mesh: &Mesh) -> Vec<[Corner; 3]> {
    let corner = |index: u32| {
        let index = index as usize;
        [mesh.positions[index], mesh.normals[index]].map(|v| Vector3::from(v.map(f64::from)))
    };
    let triangles = mesh.indices.as_chunks::<3>().0.iter();
    triangles.map(|t| t.map(corner)).collect()
}

fn across([a, b, c]: &[Corner; 3]) -> Vector3<f64> {
    (b[0] - a[0]).cross(&(c[0] - a[0]))
}

#[test]
fn triangles_face_as_their_normals_do() {
    for pad in pads() {
        for mesh in Cast::of(&pad).layers() {
            assert!(mesh.positions.len() < 2000);
            for triangle in triangles(&mesh) {
                for [at, normal] in triangle {
                    assert!((normal.norm() - 1.0).abs() < 1e-5, "{at} {pad:?}");
                    assert!(normal.dot(&across(&triangle)) > 0.0, "{at} {pad:?}");
                }
            }
        }
    }
}

/// Each edge of a triangle is one of another triangle the other way round. A pad without room for
/// rounding has edges that end amid others, and is not asked.
#[test]
fn a_cast_is_closed() {
    for pad in [shipped(), SMALLEST] {
        for mesh in Cast::of(&pad).layers() {
            let mut open: BTreeMap<[[u32; 3]; 2], i32> = BTreeMap::new();
            for triangle in mesh.indices.as_chunks::<3>().0 {
                // Plus zero, so that there is one zero.
                let [a, b, c] = triangle
                    .map(|index| mesh.positions[index as usize].map(|v| (v + 0.0).to_bits()));
                for [from, to] in [[a, b], [b, c], [c, a]] {
                    *open.entry([from, to]).or_default() += 1;
                    *open.entry([to, from]).or_default() -= 1;
                }
            }
            assert!(open.values().all(|count| *count == 0), "{pad:?}");
        }
    }
}

/// Only a little material is missing at the edges, and the fillet is more than that.
#[test]
fn a_cast_is_as_large_as_its_boxes() {
    let pad = shipped();
    let [skin, fat, muscle] = Cast::of(&pad).layers().map(|mesh| {
        let signed_m3 = |[a, b, c]: [Corner; 3]| a[0].dot(&b[0].cross(&c[0])) / 6.0;
        triangles(&mesh).into_iter().map(signed_m3).sum::<f64>()
    });
    let plate_m3 = pad.length_m * pad.width_m * pad.thickness_m;
    let hole_m2 = (2.0 * pad.hole_half_m).powi(2);
    let lip_m3 = (pad.lip_length_m * pad.lip_height_m - hole_m2) * pad.lip_thickness_m;
    let boxes_m3 = [SKIN * plate_m3 + lip_m3, 0.35 * plate_m3, 0.4 * plate_m3];
    for (drawn_m3, box_m3) in [skin, fat, muscle].into_iter().zip(boxes_m3) {
        assert!((0.97..1.0).contains(&(drawn_m3 / box_m3)), "{drawn_m3}");
    }
}

/// How far a point is outside of the nearest of the physics' boxes, m.
fn outside_m(pad: &PadShape, at: &Vector3<f64>) -> f64 {
    let distances = pad.solids().into_iter().skip(1).filter_map(|shape| {
        let Shape::Block { low, high } = shape else {
            return None;
        };
        let beyond = (low.coords - at).sup(&(at - high.coords));
        Some(beyond.sup(&Vector3::zeros()).norm())
    });
    distances.fold(f64::INFINITY, f64::min)
}

/// How far a point of the skin is from the nearest face of the physics' lip or plate, m.
fn inside_m(pad: &PadShape, at: &Vector3<f64>) -> f64 {
    let faces = if at.z > 0.0 {
        [
            0.5 * pad.lip_length_m - at.x.abs(),
            0.5 * pad.lip_thickness_m - (at.y - pad.hole().y).abs(),
            pad.lip_height_m - at.z,
            from_hole_m(pad, at),
        ]
    } else {
        let [x_m, y_m] = [pad.length_m, pad.width_m].map(|extent_m| 0.5 * extent_m);
        [x_m - at.x.abs(), y_m - at.y.abs(), at.z, f64::INFINITY]
    };
    let distances = faces.into_iter().map(f64::abs);
    distances.fold(f64::INFINITY, f64::min)
}

/// How far a point is from the hole's walls seen along y, m: negative in the hole.
fn from_hole_m(pad: &PadShape, at: &Vector3<f64>) -> f64 {
    let from_middle_m = at.x.abs().max((at.z - pad.hole_height_m).abs());
    from_middle_m - pad.hole_half_m
}

/// Beyond the boxes is only the fillet; behind them, rounded edges are at most 0.3 radii.
#[test]
fn a_cast_keeps_to_the_physics_boxes() {
    for pad in pads() {
        let cast = Cast::of(&pad);
        let low_m = -SKIN * pad.thickness_m + ROUNDING_M;
        for at in cast.skin().positions {
            let at = Vector3::from(at.map(f64::from));
            let in_fillet = (0.0..=cast.fillet_m + ROUNDING_M).contains(&at.z);
            let beyond_m = if in_fillet {
                0.3 * FILLET_M
            } else {
                ROUNDING_M
            };
            assert!(outside_m(&pad, &at) < beyond_m, "{at} {pad:?}");
            if !in_fillet && at.z > low_m {
                let radius_m = if at.z > 0.0 { LIP_CORNER_M } else { CORNER_M };
                assert!(inside_m(&pad, &at) < 0.3 * radius_m, "{at} {pad:?}");
            }
        }
    }
}

/// The section in the middle of the hole: nothing inside of the physics' square, and all around
/// it a wall.
#[test]
fn a_cast_has_the_pads_hole() {
    for pad in pads() {
        let (middle_m, mut walls_m) = (pad.hole().y, 0.0);
        for triangle in triangles(&Cast::of(&pad).skin()) {
            let [a, b, c] = triangle.map(|[at, _]| at);
            let crossed = [[a, b], [b, c], [c, a]].map(|[from, to]| {
                let share = (middle_m - from.y) / (to.y - from.y);
                let crosses = (from.y < middle_m) != (to.y < middle_m);
                crosses.then(|| from + share * (to - from))
            });
            let ends: Vec<Vector3<f64>> = crossed.into_iter().flatten().collect();
            let [from, to] = ends[..] else {
                continue;
            };
            let distances_m = [from, to].map(|end| from_hole_m(&pad, &end));
            assert!(distances_m.iter().all(|m| *m > -ROUNDING_M), "{pad:?}");
            if distances_m.iter().all(|m| *m < ROUNDING_M) {
                walls_m += (to - from).norm();
            }
        }
        let square_m = 8.0 * pad.hole_half_m;
        assert!((walls_m - square_m).abs() < 1e-6, "{walls_m} {pad:?}");
    }
}

/// The plate's top and the lip's faces have one normal, and the ink lies on the latter.
#[test]
fn flat_faces_are_shaded_flat() {
    let pad = shipped();
    let cast = Cast::of(&pad);
    let fronts = [(pad.lip_front_m, -1.0), (pad.lip_back_m(), 1.0)];
    let (mut top_m2, mut faces_m2) = (0.0, 0.0);
    for triangle in triangles(&cast.skin()) {
        let normals = triangle.map(|[_, normal]| normal);
        let area_m2 = 0.5 * across(&triangle).norm();
        if triangle.iter().all(|[at, _]| at.z.abs() < 1e-9) {
            assert!(normals.iter().all(|normal| normal.z > 0.999_999));
            top_m2 += area_m2;
        }
        for (y, facing) in fronts {
            if triangle.iter().all(|[at, _]| (at.y - y).abs() < 1e-8) {
                assert!(normals.iter().all(|normal| facing * normal.y > 0.999_999));
                faces_m2 += area_m2;
            }
        }
    }
    let plate_m2 = pad.length_m * pad.width_m;
    assert!((0.9..1.0).contains(&(top_m2 / plate_m2)), "{top_m2}");
    let lip_m2 = 2.0 * pad.lip_length_m * pad.lip_height_m;
    assert!((0.8..1.0).contains(&(faces_m2 / lip_m2)), "{faces_m2}");
    for at in pad.ink().positions {
        let at = Vector3::from(at.map(f64::from));
        assert!(from_hole_m(&pad, &at) > cast.mouth_m + 0.000_1, "{at}");
        assert!(at.x.abs() < 0.5 * pad.lip_length_m - cast.rim_m, "{at}");
        assert!((cast.fillet_m..pad.lip_height_m - cast.rim_m).contains(&at.z));
    }
}
