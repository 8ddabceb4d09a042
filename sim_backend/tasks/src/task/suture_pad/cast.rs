//! The suture pad as it is drawn: cast silicone with rounded edges, where physics has sharp boxes.
//!
//! The skin is one sheet from its underside over the plate's edge and a fillet up to the lip, and
//! the lip a second one across its rim; flat faces and the hole's walls close them. Radii shrink
//! with the pad, so that what is flat between two rounded edges stays so.

use core::f64::consts::FRAC_PI_2;

use hal::Mesh;
use nalgebra::{Point3, Vector3};
use trocar_render::shapes::{arc, rounded_rectangle, shaded_sheet};

use super::PadShape;

/// Radius of the plate's vertical corners, m.
const CORNER_M: f64 = 0.004;
/// Radius of the plate's upper edge, m.
const EDGE_M: f64 = 0.001_2;
/// Radius of the lip's upper corners, seen along y, m.
const LIP_CORNER_M: f64 = 0.002;
/// Radius of the edges between the lip's faces and its rim, m.
const RIM_M: f64 = 0.000_8;
/// Radius of the concave fillet between plate and lip, m.
const FILLET_M: f64 = 0.000_8;
/// Radius of the edges of the hole's mouths, m. Less than the ink's distance from the hole.
const MOUTH_M: f64 = 0.000_25;
/// Share of a wall, or of the plate beside the lip, that one rounded edge may take.
const SHARE: f64 = 0.3;

/// Where skin and fat end, as shares of the plate's thickness from its top.
const SKIN: f64 = 0.25;
const FAT: f64 = 0.6;
/// How far the layer of fat lies behind the others, m.
const INSET_M: f64 = 0.000_3;

/// How far from the fillet the plate has vertices of its own, m: as far as the lip takes light from
/// it.
const APRON_M: f64 = 0.013;
/// How many rings of them.
const APRON_RINGS: u32 = 4;

/// Pieces of a quarter of a turn.
const STEPS: u32 = 8;

/// Signs of x and z of the hole's corners, from the lower left one clockwise, seen along +y.
const HOLE_CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]];

/// Position (scene frame, m) and normal.
type Vertex = (Point3<f64>, Vector3<f64>);

/// The cast of a pad.
pub(super) struct Cast<'a> {
    pad: &'a PadShape,
    corner_m: f64,
    edge_m: f64,
    lip_corner_m: f64,
    rim_m: f64,
    fillet_m: f64,
    mouth_m: f64,
    apron_m: f64,
}

/// A place on the way along y over one edge of the lip, through it, and over the other edge.
#[derive(Clone, Copy)]
struct Turn {
    /// How far behind the side the surface lies, m.
    inset_m: f64,
    y_m: f64,
    /// Parts of the normal away from the side and along y.
    out: f64,
    along: f64,
}

impl Turn {
    /// The normal over a side that faces `out`.
    fn normal(self, out: Vector3<f64>) -> Vector3<f64> {
        self.out * out + self.along * Vector3::y()
    }
}

impl<'a> Cast<'a> {
    pub(super) fn of(pad: &'a PadShape) -> Self {
        let beside_m = 0.5 * pad.lip_length_m - pad.hole_half_m;
        let [under_m, over_m, aside_m, before_m, behind_m] = [
            pad.hole_height_m - pad.hole_half_m,
            pad.lip_height_m - pad.hole_height_m - pad.hole_half_m,
            0.5 * (pad.length_m - pad.lip_length_m),
            0.5 * pad.width_m + pad.lip_front_m,
            0.5 * pad.width_m - pad.lip_back_m(),
        ]
        .map(|extent_m: f64| extent_m.max(0.0));
        let wall_m = pad.lip_thickness_m.min(beside_m).min(over_m);
        let rim_m = RIM_M.min(SHARE * wall_m);
        let mouth_m = MOUTH_M.min(SHARE * wall_m.min(under_m));
        let margin_m = aside_m.min(before_m).min(behind_m);
        let fillet_m = FILLET_M.min(SHARE * under_m.min(margin_m));
        let skin_m = SKIN * pad.thickness_m;
        let edge_m = EDGE_M.min(SHARE * margin_m).min(0.5 * skin_m);
        let apron_m = APRON_M.min(0.5 * (margin_m - edge_m - fillet_m));
        let beyond_m = edge_m + fillet_m + apron_m;
        let on_plate_m = [aside_m, before_m.min(behind_m)].map(|extent_m| extent_m - beyond_m);
        let on_lip_m = [beside_m, over_m].map(|extent_m| extent_m - mouth_m - rim_m);
        let size_m = pad.lip_height_m.min(pad.lip_length_m);
        Self {
            pad,
            corner_m: CORNER_M.min(edge_m + radius_around_m(on_plate_m)),
            edge_m,
            lip_corner_m: LIP_CORNER_M
                .min(rim_m + radius_around_m(on_lip_m))
                .min(SHARE * size_m),
            rim_m,
            fillet_m,
            mouth_m,
            apron_m,
        }
    }

    /// What is drawn, scene frame: skin with the lip, fat, and muscle.
    pub(super) fn layers(&self) -> [Mesh; 3] {
        [
            self.skin(),
            self.slab([FAT, SKIN], INSET_M),
            self.slab([1.0, FAT], 0.0),
        ]
    }

    fn skin(&self) -> Mesh {
        let rim = self.rim();
        let (plate, foot) = (self.plate(0.0), footprint(&rim));
        let low_m = -SKIN * self.pad.thickness_m;
        let mut rows = vec![
            middle(&plate, low_m, -1.0),
            ring(&plate, 0.0, low_m, [0.0, -1.0]),
            ring(&plate, 0.0, low_m, [1.0, 0.0]),
        ];
        rows.extend(quarter().map(|[out, up]| {
            let [inset_m, down_m] = [out, up].map(|part| self.edge_m * (1.0 - part));
            ring(&plate, -inset_m, -down_m, [out, up])
        }));
        rows.extend((1..=APRON_RINGS).rev().map(|index| {
            let share = f64::from(index) / f64::from(APRON_RINGS);
            let outset_m = self.fillet_m + share * share * self.apron_m;
            ring(&foot, outset_m, 0.0, [0.0, 1.0])
        }));
        rows.extend(quarter().rev().map(|[out, up]| {
            let [outset_m, z_m] = [out, up].map(|part| self.fillet_m * (1.0 - part));
            ring(&foot, outset_m, z_m, [out, up])
        }));
        let faces = [
            rim.first()
                .map(|row| self.face(row, self.pad.lip_front_m, -1.0)),
            rim.last()
                .map(|row| self.face(row, self.pad.lip_back_m(), 1.0)),
        ];
        let sheets = [shaded_sheet(&rows), shaded_sheet(&rim), self.walls()];
        Mesh::merged(sheets.into_iter().chain(faces.into_iter().flatten()))
    }

    /// A layer under the skin, from the first to the second share of the thickness, with sharp
    /// edges.
    fn slab(&self, shares: [f64; 2], inset_m: f64) -> Mesh {
        let plate = self.plate(inset_m);
        let [low_m, high_m] = shares.map(|share| -share * self.pad.thickness_m);
        shaded_sheet(&[
            middle(&plate, low_m, -1.0),
            ring(&plate, 0.0, low_m, [0.0, -1.0]),
            ring(&plate, 0.0, low_m, [1.0, 0.0]),
            ring(&plate, 0.0, high_m, [1.0, 0.0]),
            ring(&plate, 0.0, high_m, [0.0, 1.0]),
            middle(&plate, high_m, 1.0),
        ])
    }

    /// The plate's outline, `inset_m` behind the physics' one.
    fn plate(&self, inset_m: f64) -> Vec<Vertex> {
        let half_m = [self.pad.length_m, self.pad.width_m].map(|extent| 0.5 * extent - inset_m);
        rounded_rectangle(half_m, (self.corner_m - inset_m).max(0.0), STEPS)
    }

    /// The lip's outline at y = 0, from the fillet at the left end over the top to the right end,
    /// with outward normals.
    fn outline(&self) -> Vec<Vertex> {
        let (end_m, top_m) = (0.5 * self.pad.lip_length_m, self.pad.lip_height_m);
        let radius_m = self.lip_corner_m;
        let foot = |side: f64| {
            let at = Point3::new(side * end_m, 0.0, self.fillet_m);
            (at, side * Vector3::x())
        };
        let corner = |side: f64, [out, up]: [f64; 2]| {
            let centre = Point3::new(side * (end_m - radius_m), 0.0, top_m - radius_m);
            let normal = Vector3::new(side * out, 0.0, up);
            (centre + radius_m * normal, normal)
        };
        let left = quarter().map(|turn| corner(-1.0, turn));
        let right = quarter().rev().map(|turn| corner(1.0, turn));
        [foot(-1.0)]
            .into_iter()
            .chain(left)
            .chain(right)
            .chain([foot(1.0)])
            .collect()
    }

    /// The lip's ends and top with the edges to both faces: the outline at each turn along y.
    fn rim(&self) -> Vec<Vec<Vertex>> {
        let outline = self.outline();
        let row = |turn: Turn| -> Vec<Vertex> {
            let vertex = |&(at, out): &Vertex| {
                let at = at - turn.inset_m * out + turn.y_m * Vector3::y();
                (at, turn.normal(out))
            };
            outline.iter().map(vertex).collect()
        };
        self.turns(self.rim_m).map(row).collect()
    }

    /// The way along y over a side of the lip or of the hole: a quarter of a turn at each face.
    fn turns(&self, radius_m: f64) -> impl Iterator<Item = Turn> {
        let (front_m, back_m) = (self.pad.lip_front_m, self.pad.lip_back_m());
        let turn = move |[out, along]: [f64; 2], face_m: f64, facing: f64| Turn {
            inset_m: radius_m * (1.0 - out),
            y_m: face_m - facing * radius_m * (1.0 - along),
            out,
            along: facing * along,
        };
        let front = quarter().rev().map(move |at| turn(at, front_m, -1.0));
        front.chain(quarter().map(move |at| turn(at, back_m, 1.0)))
    }

    /// The flat face at `y_m` between the hole's mouth and `rim`, an outermost row of the rim;
    /// `facing` is its normal's y.
    fn face(&self, rim: &[Vertex], y_m: f64, facing: f64) -> Mesh {
        let mut mesh = Mesh::default();
        let normal = facing * Vector3::y();
        let (half_m, height_m) = (self.pad.hole_half_m + self.mouth_m, self.pad.hole_height_m);
        let mouth = HOLE_CORNERS.map(|[x, z]| {
            let at = Point3::new(x * half_m, y_m, height_m + z * half_m);
            mesh.vertex(at, normal)
        });
        // Each point of the rim with the mouth's corner on its side: feet, left and right corner.
        let mut points = Vec::with_capacity(rim.len());
        for (index, (at, _)) in rim.iter().enumerate() {
            let corner = match index {
                0 => 0,
                _ if index + 1 == rim.len() => 3,
                _ if 2 * index < rim.len() => 1,
                _ => 2,
            };
            points.push([mesh.vertex(*at, normal), mouth[corner]]);
        }
        // They go clockwise seen along +y.
        let mut triangle = |[a, b, c]: [u32; 3]| {
            mesh.triangle(if facing > 0.0 { [a, b, c] } else { [a, c, b] });
        };
        for (&[from, near], &[to, next]) in points.iter().zip(points.iter().cycle().skip(1)) {
            triangle([near, from, to]);
            if near != next {
                triangle([near, to, next]);
            }
        }
        mesh.without_slivers()
    }

    /// The hole's four walls with its mouths.
    fn walls(&self) -> Mesh {
        let (half_m, height_m) = (self.pad.hole_half_m, self.pad.hole_height_m);
        let sides = HOLE_CORNERS
            .into_iter()
            .zip(HOLE_CORNERS.into_iter().cycle().skip(1));
        Mesh::merged(sides.map(|(to, from)| {
            let inwards = -0.5 * Vector3::new(from[0] + to[0], 0.0, from[1] + to[1]);
            let row = |turn: Turn| -> Vec<Vertex> {
                let half_m = half_m + turn.inset_m;
                let vertex = |[x, z]: [f64; 2]| {
                    let at = Point3::new(x * half_m, turn.y_m, height_m + z * half_m);
                    (at, turn.normal(inwards))
                };
                [from, to].map(vertex).to_vec()
            };
            let rows: Vec<Vec<Vertex>> = self.turns(self.mouth_m).map(row).collect();
            shaded_sheet(&rows)
        }))
    }
}

/// A quarter of a turn as parts of a normal: first all to the side, last all up.
fn quarter() -> impl DoubleEndedIterator<Item = [f64; 2]> {
    let turn = arc(1.0, 0.0, FRAC_PI_2, STEPS);
    turn.into_iter().map(|point| [point.x, point.y])
}

/// Half the largest radius, m, of a rounded corner that keeps a point inside which is `a` and `b`
/// (m) from its two sides: at twice this radius the circle goes through the point.
fn radius_around_m([a, b]: [f64; 2]) -> f64 {
    0.5 * (a + b + (2.0 * a * b).sqrt())
}

/// Where the lip meets the fillet, with level normals, in the order of [`rounded_rectangle`].
fn footprint(rim: &[Vec<Vertex>]) -> Vec<Vertex> {
    let right = rim.iter().filter_map(|row| row.last());
    let left = rim.iter().rev().filter_map(|row| row.first());
    let closing = right.clone().take(1);
    right.chain(left).chain(closing).copied().collect()
}

/// An outline at the height `z_m`, `outset_m` further out, with normals that are `out` and `up`.
fn ring(outline: &[Vertex], outset_m: f64, z_m: f64, [out, up]: [f64; 2]) -> Vec<Vertex> {
    let vertex = |&(at, normal): &Vertex| {
        let at = at + outset_m * normal;
        let tilted = out * normal + up * Vector3::z();
        (Point3::new(at.x, at.y, z_m), tilted)
    };
    outline.iter().map(vertex).collect()
}

/// The row that closes a ring of the plate: the plate's middle at the height `z_m`.
fn middle(outline: &[Vertex], z_m: f64, up: f64) -> Vec<Vertex> {
    vec![(Point3::new(0.0, 0.0, z_m), up * Vector3::z()); outline.len()]
}

#[cfg(test)]
mod tests {
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
}
