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
mod tests;
