//! The flap as a closed surface for drawing: Catmull-Rom splines through the grid, both faces and a
//! round rim.
//!
//! Its outline is that of cut tissue: rounded free corners, edges that wander by less than a
//! millimetre about those of the physics, and a root that sinks into the organ behind the grid's
//! first row. Vertices and triangles are chosen once; a frame only moves them and allocates nothing.

use core::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

use hal::Mesh;
use hal::count::count_u32;
use hal::mesh::single;
use nalgebra::Vector3;

use super::sheet::{Sheet, count};

/// Parts into which each cell side is split for drawing.
const SPLIT: usize = 3;

/// Radius of the faces' free corners, m; a quarter of the shorter side at most. The rim is around
/// them.
const CORNER_M: f64 = 0.007;

/// By how much the outline wanders about that of the physics, m, and how far from it points follow.
const WANDER_M: f64 = 0.0007;
const FOLLOW_M: f64 = 0.010;

/// How deep the root's end lies under the organ at least where that is flat, m, and its rows.
const ROOT_DEPTH_M: f64 = 0.0025;
const ROOT_ROWS: usize = 5;
/// Radius with which the root bends down, m; one and a half thicknesses at least, so that its inner
/// side does not fold.
const ROOT_RADIUS_M: f64 = 0.0030;

/// The rim's section, a half circle from the upper face to the lower one: outwards and upwards, in
/// half thicknesses.
const SECTION: [[f64; 2]; 5] = [
    [0.0, 1.0],
    [FRAC_1_SQRT_2, FRAC_1_SQRT_2],
    [1.0, 0.0],
    [FRAC_1_SQRT_2, -FRAC_1_SQRT_2],
    [0.0, -1.0],
];

/// What to draw of a sheet.
#[derive(Clone, Debug)]
pub struct Surface {
    mesh: Mesh,
    nodes: [usize; 2],
    /// Distance of the nodes in the material, m.
    spacing_m: [f64; 2],
    outline: Outline,
    /// The sheet's nodes, scene frame, m.
    sheet: Vec<Vector3<f64>>,
    /// How each point of the mid-surface follows the nodes, row by row.
    follow: Vec<Follow>,
    /// The points of the mid-surface and the unit normals there.
    middle: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Points of the mid-surface around the sheet, in order.
    rim: Vec<usize>,
}

/// A point of the sheet's mid-surface: a cubic spline along each axis, extrapolated linearly beyond
/// the ends.
#[derive(Clone, Copy, Debug)]
struct Follow {
    along: [Weights; 2],
    /// How far behind the first row it is, m.
    behind_m: f64,
}

/// Four nodes along one axis, their weights for the place and for its derivative per node.
#[derive(Clone, Copy, Debug)]
struct Weights {
    nodes: [usize; 4],
    place: [f64; 4],
    derivative: [f64; 4],
}

impl Surface {
    /// The surface of `sheet` as it is now; the upper face is the one that u cross v points out of.
    #[must_use]
    pub fn new(sheet: &Sheet) -> Self {
        let nodes = sheet.nodes();
        let [columns, rows] = nodes.map(|nodes| (nodes - 1) * SPLIT + 1);
        let points = [columns, rows + ROOT_ROWS];
        let size_m = [0, 1].map(|axis| sheet.spacing_m[axis] * count(nodes[axis] - 1));
        let outline = Outline::new(size_m, sheet.material.thickness_m);
        let follow = (0..points[1]).flat_map(|row| {
            (0..points[0]).map(move |column| {
                let at_m = outline.place(points, [column, row]);
                Follow::at(nodes, sheet.spacing_m, at_m)
            })
        });
        let follow: Vec<Follow> = follow.collect();
        let rim = rim(points);
        let vertices = 2 * follow.len() + SECTION.len() * rim.len();
        let mut surface = Self {
            mesh: Mesh {
                positions: vec![[0.0; 3]; vertices],
                normals: vec![[0.0; 3]; vertices],
                indices: indices(points, rim.len()),
            },
            nodes,
            spacing_m: sheet.spacing_m,
            outline,
            sheet: sheet.positions.clone(),
            middle: vec![(Vector3::zeros(), Vector3::z()); follow.len()],
            follow,
            rim,
        };
        surface.update(&sheet.positions);
        surface
    }

    /// The mesh, scene frame: the upper face's vertices, as many of the lower face, then the rim's.
    #[must_use]
    pub const fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// How many nodes it is laid through.
    #[must_use]
    pub const fn node_count(&self) -> usize {
        self.nodes[0] * self.nodes[1]
    }

    /// Follows the sheet, whose nodes are at `positions` (m, in their order), [`Self::node_count`]
    /// of them. Indices and the number of vertices stay.
    pub fn update(&mut self, positions: &[Vector3<f64>]) {
        self.sheet.copy_from_slice(positions);
        let whole = self.follow.len();
        for here in 0..whole {
            let Point { at: middle, up, .. } = self.point(&self.follow[here]);
            let offset = up * self.outline.half_thickness_m;
            self.middle[here] = (middle, up);
            self.set(here, &(middle + offset), &up);
            self.set(whole + here, &(middle - offset), &-up);
        }
        self.update_rim();
    }

    /// The edge, round and as thick as the sheet.
    fn update_rim(&mut self) {
        let (whole, around) = (self.follow.len(), self.rim.len());
        for corner in 0..around {
            let (middle, up) = self.middle[self.rim[corner]];
            let (next, _) = self.middle[self.rim[(corner + 1) % around]];
            let (before, _) = self.middle[self.rim[(corner + around - 1) % around]];
            let out = (next - before).cross(&up).try_normalize(0.0).unwrap_or(up);
            for (row, [outwards, upwards]) in SECTION.into_iter().enumerate() {
                let normal = out * outwards + up * upwards;
                let at = middle + normal * self.outline.half_thickness_m;
                self.set(2 * whole + row * around + corner, &at, &normal);
            }
        }
    }

    /// The drawn upper side at the material coordinates `at_m`: place and unit normal. What is
    /// beyond the face lies on the rim, where it turns down.
    pub(super) fn upper(&self, at_m: [f64; 2]) -> (Vector3<f64>, Vector3<f64>) {
        let Held {
            at_m,
            beyond_m,
            out,
        } = self.outline.hold(at_m);
        let point = self.point(&Follow::at(self.nodes, self.spacing_m, at_m));
        let half_m = self.outline.half_thickness_m;
        let (sin, cos) = (beyond_m / half_m).min(FRAC_PI_2).sin_cos();
        let aside = unit(point.along[0]) * out[0] + unit(point.along[1]) * out[1];
        let normal = point.up * cos + aside * sin;
        (point.at + normal * half_m, normal)
    }

    /// Where a point is now.
    fn point(&self, follow: &Follow) -> Point {
        follow.of(self.nodes[0], self.outline.root_radius_m, &self.sheet)
    }

    fn set(&mut self, vertex: usize, position: &Vector3<f64>, normal: &Vector3<f64>) {
        self.mesh.positions[vertex] = single(position);
        self.mesh.normals[vertex] = single(normal);
    }
}

/// A point of the mid-surface.
struct Point {
    /// Scene frame, m.
    at: Vector3<f64>,
    /// Unit normal.
    up: Vector3<f64>,
    /// Derivatives along u and v, m a node.
    along: [Vector3<f64>; 2],
}

impl Follow {
    /// The point at the material coordinates `at_m`, m.
    fn at(nodes: [usize; 2], spacing_m: [f64; 2], at_m: [f64; 2]) -> Self {
        Self {
            along: [0, 1].map(|axis| Weights::at(nodes[axis], at_m[axis] / spacing_m[axis])),
            behind_m: (-at_m[1]).max(0.0),
        }
    }

    /// Where it is with the nodes at `positions`, `columns` a row, and a root that bends down with
    /// `root_radius_m`.
    fn of(&self, columns: usize, root_radius_m: f64, positions: &[Vector3<f64>]) -> Point {
        let [u, v] = &self.along;
        let [mut at, mut along_u, mut along_v] = [Vector3::zeros(); 3];
        for (row, (place_v, derivative_v)) in v.nodes.iter().zip(v.place.iter().zip(&v.derivative))
        {
            let (mut in_row, mut along_row) = (Vector3::zeros(), Vector3::zeros());
            let weights_u = u.place.iter().zip(&u.derivative);
            for (column, (place_u, derivative_u)) in u.nodes.iter().zip(weights_u) {
                let node = positions[row * columns + column];
                in_row += node * *place_u;
                along_row += node * *derivative_u;
            }
            at += in_row * *place_v;
            along_u += along_row * *place_v;
            along_v += in_row * *derivative_v;
        }
        let mut up = unit(along_u.cross(&along_v));
        if self.behind_m > 0.0 {
            // The root bends down about an axis along u.
            let steep = self.behind_m / root_radius_m;
            at -= up * (0.5 * self.behind_m * steep);
            up = unit(up - unit(along_v) * steep);
        }
        let along = [along_u, along_v];
        Point { at, up, along }
    }
}

impl Weights {
    /// At `at` nodes from the first of `nodes`: Catmull-Rom splines between them, linear
    /// extrapolation beyond the ends.
    fn at(nodes: usize, at: f64) -> Self {
        let last = nodes - 2;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the number of cells"
        )]
        let cell = (at.clamp(0.0, count(last)) as usize).min(last);
        let t = at - count(cell);
        let (mut place, mut derivative) = if (0.0..=1.0).contains(&t) {
            (spline(t), spline_derivative(t))
        } else {
            ([0.0, 1.0 - t, t, 0.0], [0.0, -1.0, 1.0, 0.0])
        };
        for weights in [&mut place, &mut derivative] {
            let [before, low, high, after] = weights;
            if cell == 0 {
                (*low, *high) = (*low + 2.0 * *before, *high - *before);
                *before = 0.0;
            }
            if cell == last {
                (*low, *high) = (*low - *after, *high + 2.0 * *after);
                *after = 0.0;
            }
        }
        let nodes = [
            cell.saturating_sub(1),
            cell,
            cell + 1,
            (cell + 2).min(nodes - 1),
        ];
        Self {
            nodes,
            place,
            derivative,
        }
    }
}

/// The drawn outline of a sheet.
#[derive(Clone, Copy, Debug)]
struct Outline {
    /// Of the physics' sheet along u and v, m.
    size_m: [f64; 2],
    half_thickness_m: f64,
    /// Half the faces' width along u, and where they end along v, m: the rim is outside of them.
    half_m: f64,
    end_m: f64,
    /// Radius of the faces' free corners, m.
    corner_m: f64,
    /// Length of the root and radius with which it bends down, m.
    root_m: f64,
    root_radius_m: f64,
}

/// A material point held inside of the faces.
struct Held {
    /// Material coordinates of the nearest point of the faces, m.
    at_m: [f64; 2],
    /// How far beyond it was, m, and in which direction in the material.
    beyond_m: f64,
    out: [f64; 2],
}

impl Outline {
    fn new(size_m: [f64; 2], thickness_m: f64) -> Self {
        let inset_m = (0.5 * thickness_m).min(0.25 * size_m[0].min(size_m[1]));
        let (half_m, end_m) = (0.5 * size_m[0] - inset_m, size_m[1] - inset_m);
        let root_radius_m = ROOT_RADIUS_M.max(1.5 * thickness_m);
        // The sheet's mid-surface is half a thickness above the organ, its upper face a whole one.
        let depth_m = ROOT_DEPTH_M + 1.5 * thickness_m;
        Self {
            size_m,
            half_thickness_m: 0.5 * thickness_m,
            half_m,
            end_m,
            corner_m: CORNER_M.min(0.5 * half_m).min(0.25 * end_m),
            root_m: (2.0 * root_radius_m * depth_m).sqrt(),
            root_radius_m,
        }
    }

    /// Material coordinates of the point `[column, row]` of `points`, m.
    fn place(&self, points: [usize; 2], [column, row]: [usize; 2]) -> [f64; 2] {
        let aside_m = self.half_m * (2.0 * count(column) / count(points[0] - 1) - 1.0);
        let v_m = if row < ROOT_ROWS {
            -self.root_m * (1.0 - count(row) / count(ROOT_ROWS))
        } else {
            self.end_m * (count(row - ROOT_ROWS) / count(points[1] - 1 - ROOT_ROWS))
        };
        let [aside_m, v_m] = self.rounded([aside_m, v_m]);
        let side = self.follows(self.half_m - aside_m.abs()) * wander_beside(aside_m, v_m);
        let end = self.follows(self.end_m - v_m) * wander(aside_m);
        [
            0.5 * self.size_m[0] + aside_m + aside_m.signum() * WANDER_M * side,
            v_m + WANDER_M * end,
        ]
    }

    /// A point of the faces' rectangle, `[aside, v]`, m, where it is after the two free corners are
    /// rounded: squares about them become quarters of a disc.
    fn rounded(&self, [aside_m, v_m]: [f64; 2]) -> [f64; 2] {
        let radius_m = self.corner_m;
        let x = (aside_m.abs() - (self.half_m - radius_m)) / radius_m;
        let y = (v_m - (self.end_m - radius_m)) / radius_m;
        if x <= 0.0 || y <= 0.0 {
            return [aside_m, v_m];
        }
        let share = x.max(y) / x.hypot(y);
        [
            (self.half_m - radius_m + share * x * radius_m) * aside_m.signum(),
            self.end_m - radius_m + share * y * radius_m,
        ]
    }

    /// How much of the outline's wandering a point has that is `inside_m` away from it: 1 to 0.
    fn follows(&self, inside_m: f64) -> f64 {
        let share = 1.0 - (inside_m / FOLLOW_M.min(self.half_m)).clamp(0.0, 1.0);
        share * share
    }

    /// The point of the faces next to the material coordinates `at_m`.
    fn hold(&self, at_m: [f64; 2]) -> Held {
        let middle_m = 0.5 * self.size_m[0];
        let aside_m = at_m[0] - middle_m;
        let v_m = at_m[1].max(0.0);
        // All that is within the corners' radius of the inner rectangle is on the faces.
        let [across_m, end_m] = [self.half_m, self.end_m].map(|side_m| side_m - self.corner_m);
        let inner = [aside_m.clamp(-across_m, across_m), v_m.min(end_m)];
        let away = [aside_m - inner[0], v_m - inner[1]];
        let away_m = away[0].hypot(away[1]);
        if away_m <= 0.0 {
            let at_m = [middle_m + aside_m, v_m];
            let (beyond_m, out) = (0.0, [0.0; 2]);
            return Held {
                at_m,
                beyond_m,
                out,
            };
        }
        let out = away.map(|part| part / away_m);
        let wander =
            out[0] * out[0] * wander_beside(aside_m, v_m) + out[1] * out[1] * wander(aside_m);
        let reach_m = away_m.min(self.corner_m + WANDER_M * wander);
        Held {
            at_m: [
                middle_m + inner[0] + reach_m * out[0],
                inner[1] + reach_m * out[1],
            ],
            beyond_m: away_m - reach_m,
            out,
        }
    }
}

/// The outline's wandering, between -1 and 1, at `along_m`.
fn wander(along_m: f64) -> f64 {
    0.6 * (190.0 * along_m + 0.7).sin() + 0.4 * (430.0 * along_m + 2.1).sin()
}

/// The same of the sides, each of them another; none where the tissue is attached.
fn wander_beside(aside_m: f64, v_m: f64) -> f64 {
    (v_m / FOLLOW_M).clamp(0.0, 1.0) * wander(v_m + aside_m.signum())
}

fn unit(vector: Vector3<f64>) -> Vector3<f64> {
    vector.try_normalize(0.0).unwrap_or_else(Vector3::z)
}

/// Weights of four neighbouring nodes at the share `t` between the inner two (Catmull and Rom).
fn spline(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (2.0 * t2 - t - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (t3 - t2),
    ]
}

/// Their derivatives with `t`.
fn spline_derivative(t: f64) -> [f64; 4] {
    let t2 = t * t;
    [
        0.5 * (4.0 * t - 3.0 * t2 - 1.0),
        0.5 * (9.0 * t2 - 10.0 * t),
        0.5 * (1.0 + 8.0 * t - 9.0 * t2),
        0.5 * (3.0 * t2 - 2.0 * t),
    ]
}

/// Points around a grid, so that the outside is on the right: along u, up v, and back.
fn rim([columns, rows]: [usize; 2]) -> Vec<usize> {
    let bottom = 0..columns - 1;
    let right = (0..rows - 1).map(|j| j * columns + columns - 1);
    let top = (1..columns).rev().map(|i| (rows - 1) * columns + i);
    let left = (1..rows).rev().map(|j| j * columns);
    bottom.chain(right).chain(top).chain(left).collect()
}

/// Triangles of the upper face, the lower face and the rim.
fn indices([columns, rows]: [usize; 2], rim: usize) -> Vec<u32> {
    let whole = columns * rows;
    let mut triangles: Vec<usize> = Vec::new();
    for j in 0..rows - 1 {
        for i in 0..columns - 1 {
            let here = j * columns + i;
            let (beside, above) = (here + 1, here + columns);
            triangles.extend([here, beside, above + 1, here, above + 1, above]);
            let lower = [here, above + 1, beside, here, above, above + 1];
            triangles.extend(lower.map(|vertex| vertex + whole));
        }
    }
    for row in 1..SECTION.len() {
        let [upper, lower] = [row - 1, row].map(|row| 2 * whole + row * rim);
        for corner in 0..rim {
            let next = (corner + 1) % rim;
            let (here, below) = (upper + corner, lower + corner);
            let (beside, across) = (upper + next, lower + next);
            triangles.extend([here, below, across, here, across, beside]);
        }
    }
    triangles.into_iter().map(count_u32).collect()
}
