//! Procedural meshes: solids of revolution, boxes, tubes along a line, height fields, sheets.
//!
//! All in metres, with outward counter-clockwise triangles; see [`instrument`] for the parts of the
//! arm's tool.
//!
//! Vertices are shared where a surface is smooth and double where it has an edge, since normals are
//! theirs. `segments` is how many pieces a full turn is cut into; fewer than three make a flat
//! mesh. Triangles without area, as at poles, are taken out; meshes are not welded, so they look
//! closed and need not be watertight.

pub mod instrument;

use core::f64::consts::TAU;

use hal::Mesh;
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};

/// Adds rows of equal length, joined by quads. `u` runs along a row, `v` over the rows; outside is
/// where `u x v` points.
///
/// Each vertex is added once; neighbouring quads of a sheet share them. Rows of different lengths
/// are joined as far as the shorter one goes.
fn sheet(mesh: &mut Mesh, rows: &[Vec<(Point3<f64>, Vector3<f64>)>]) {
    let mut before: Vec<u32> = Vec::new();
    for row in rows {
        let now: Vec<u32> = row
            .iter()
            .map(|(position, normal)| mesh.vertex(*position, *normal))
            .collect();
        for (low, high) in before.windows(2).zip(now.windows(2)) {
            if let ([a, b], [d, c]) = (low, high) {
                mesh.triangle([*a, *b, *c]);
                mesh.triangle([*a, *c, *d]);
            }
        }
        before = now;
    }
}

/// A smooth sheet through rows of points, all of one length; outside is where `u x v` points, with
/// `u` along a row and `v` over the rows.
///
/// Normals are by central differences, one-sided at the rims; +z where the points give none. Panics
/// if a row is shorter than one beside it.
#[must_use]
pub fn smooth_sheet(rows: &[Vec<Point3<f64>>]) -> Mesh {
    let rate = |row: usize, point: usize, along_row: bool| {
        let (at, last) = if along_row {
            (point, rows[row].len() - 1)
        } else {
            (row, rows.len() - 1)
        };
        let ends = [at.saturating_sub(1), (at + 1).min(last)];
        let [from, to] = ends.map(|at| {
            if along_row {
                rows[row][at]
            } else {
                rows[at][point]
            }
        });
        to - from
    };
    let vertices = rows.iter().enumerate().map(|(row, points)| {
        let points = points.iter().enumerate();
        let vertex = |(point, at): (usize, &Point3<f64>)| {
            let normal = rate(row, point, true).cross(&rate(row, point, false));
            (*at, normal.try_normalize(0.0).unwrap_or_else(Vector3::z))
        };
        points.map(vertex).collect()
    });
    let vertices: Vec<Vec<(Point3<f64>, Vector3<f64>)>> = vertices.collect();
    let mut mesh = Mesh::default();
    sheet(&mut mesh, &vertices);
    mesh
}

/// A sheet through rows of points with their normals, all of one length; outside is where `u x v`
/// points, with `u` along a row and `v` over the rows.
///
/// For flat faces beside rounded edges: a face is flat where its two rows have the same normals.
/// Rows that coincide make a sharp edge. Rows of different lengths are joined as far as the shorter
/// one goes.
#[must_use]
pub fn shaded_sheet(rows: &[Vec<(Point3<f64>, Vector3<f64>)>]) -> Mesh {
    let mut mesh = Mesh::default();
    sheet(&mut mesh, rows);
    mesh.without_slivers()
}

/// A rectangle about the origin in the xy plane with rounded corners: points with outward normals,
/// counter-clockwise from the -y side of the +x -y corner, the first one again at the end.
///
/// `4 * (steps + 1) + 1` points. A radius of 0 makes sharp corners, whose points coincide; one of
/// more than half the shorter side turns the rectangle inside out.
#[must_use]
pub fn rounded_rectangle(
    half_m: [f64; 2],
    radius_m: f64,
    steps: u32,
) -> Vec<(Point3<f64>, Vector3<f64>)> {
    let [x, y] = half_m.map(|half| half - radius_m);
    let (aside, ahead): (Vector3<f64>, Vector3<f64>) = (Vector3::x(), Vector3::y());
    let sides = [-ahead, aside, ahead, -aside];
    let corners = sides.into_iter().zip(sides.into_iter().cycle().skip(1));
    let mut points: Vec<(Point3<f64>, Vector3<f64>)> = Vec::new();
    for (from, to) in corners {
        let centre = Vector3::new(x, y, 0.0).component_mul(&(from + to));
        points.extend(arc(1.0, 0.0, 0.25 * TAU, steps).into_iter().map(|turn| {
            let out = turn.x * from + turn.y * to;
            (Point3::from(centre + radius_m * out), out)
        }));
    }
    points.extend(points.first().copied());
    points
}

/// `mesh` moved by `pose`, in the frame that `pose` is in.
///
/// Through double precision. `pose` is rigid, so normals stay of length 1.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    reason = "meshes are drawn in single precision"
)]
pub fn placed(mut mesh: Mesh, pose: &Isometry3<f64>) -> Mesh {
    for position in &mut mesh.positions {
        *position = (pose * Point3::from(position.map(f64::from)))
            .coords
            .map(|v| v as f32)
            .into();
    }
    for normal in &mut mesh.normals {
        *normal = (pose * Vector3::from(normal.map(f64::from)))
            .map(|v| v as f32)
            .into();
    }
    mesh
}

/// A box about the origin.
#[must_use]
pub fn cuboid(half_extents_m: Vector3<f64>) -> Mesh {
    let h = half_extents_m;
    Mesh::hexahedron(
        [-1.0, 1.0].map(|z| [(-1, -1), (1, -1), (1, 1), (-1, 1)].map(|(x, y)| corner(h, x, y, z))),
    )
}

/// A corner of the box: `x` and `y` are -1 or 1, `z` too.
fn corner(h: Vector3<f64>, x: i32, y: i32, z: f64) -> Point3<f64> {
    Point3::new(f64::from(x) * h.x, f64::from(y) * h.y, z * h.z)
}

/// A closed cylinder about z from `z_from_m` up to `z_to_m`, of four triangles a segment.
#[must_use]
pub fn cylinder(radius_m: f64, z_from_m: f64, z_to_m: f64, segments: u32) -> Mesh {
    revolved(
        &[
            [0.0, z_from_m],
            [radius_m, z_from_m],
            [radius_m, z_to_m],
            [0.0, z_to_m],
        ],
        segments,
    )
}

/// A solid of revolution about z with sharp edges, from a profile of `[radius, z]` points that goes
/// from the lower end of the axis to the upper one.
///
/// Each segment of the profile has vertices of its own, so every ring is an edge; many short
/// segments look round. A profile that goes down instead of up has its inside out.
#[must_use]
pub fn revolved(profile_m: &[[f64; 2]], segments: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for pair in profile_m.windows(2) {
        let &[[r0, z0], [r1, z1]] = pair else {
            continue;
        };
        let ring = |r: f64, z: f64| {
            around(segments).map(move |(c, s)| {
                (
                    Point3::new(r * c, r * s, z),
                    Vector3::new((z1 - z0) * c, (z1 - z0) * s, r0 - r1),
                )
            })
        };
        sheet(&mut mesh, &[ring(r0, z0).collect(), ring(r1, z1).collect()]);
    }
    mesh.without_slivers()
}

/// A capsule about z: half spheres of `radius_m` about the two ends of the axis.
#[must_use]
pub fn capsule(radius_m: f64, z_from_m: f64, z_to_m: f64, segments: u32) -> Mesh {
    tube(
        &[
            Point3::new(0.0, 0.0, z_from_m),
            Point3::new(0.0, 0.0, z_to_m),
        ],
        &[radius_m; 2],
        segments,
    )
}

/// A ball about the origin.
///
/// Poles on z; half as many rings as segments.
#[must_use]
pub fn sphere(radius_m: f64, segments: u32) -> Mesh {
    let rings = segments.div_ceil(2);
    let mut mesh = Mesh::default();
    let rows: Vec<_> = (0..=rings)
        .map(|ring| {
            let (s, c) = (0.5 * TAU * f64::from(ring) / f64::from(rings)).sin_cos();
            let row = around(segments).map(|(x, y)| Vector3::new(s * x, s * y, -c));
            row.map(|normal| (Point3::from(radius_m * normal), normal))
                .collect()
        })
        .collect();
    sheet(&mut mesh, &rows);
    mesh.without_slivers()
}

/// A round tube through `points_m` with a radius at each, closed by half spheres.
///
/// Fewer radii than points: the last one holds on. Fewer than two distinct points make an empty
/// mesh.
///
/// Six rows close the ends, three each. The cross-section is carried along by the smallest
/// rotations (a rotation-minimising frame), and is perpendicular to the chord between the
/// neighbours of a point.
#[must_use]
pub fn tube(points_m: &[Point3<f64>], radii_m: &[f64], segments: u32) -> Mesh {
    let mut line: Vec<Point3<f64>> = points_m.to_vec();
    line.dedup_by(|a, b| (*a - *b).norm() < 1e-9);
    let ([first, second, ..], [.., before, last], Some(radius_last)) =
        (&line[..], &line[..], radii_m.last())
    else {
        return Mesh::default();
    };
    let radius = |index: usize| *radii_m.get(index).unwrap_or(radius_last);
    let start = (second - first).normalize();
    let end = (last - before).normalize();
    let aside = if start.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let mut side = start.cross(&aside).normalize();
    let mut rows = Vec::new();
    for step in 0..3 {
        let lift = 0.25 * TAU * f64::from(step) / 3.0;
        rows.push(ring(
            first,
            start,
            side,
            radius(0),
            -lift.cos(),
            lift.sin(),
            segments,
        ));
    }
    let mut along = start;
    for (index, point) in line.iter().enumerate() {
        let from = index
            .checked_sub(1)
            .and_then(|i| line.get(i))
            .unwrap_or(point);
        let to = line.get(index + 1).unwrap_or(point);
        let next = (to - from).try_normalize(1e-12).unwrap_or(along);
        // Turned with the line by the smallest rotation, so that the tube is not twisted.
        side = UnitQuaternion::rotation_between(&along, &next).unwrap_or_default() * side;
        along = next;
        rows.push(ring(point, along, side, radius(index), 0.0, 1.0, segments));
    }
    for step in (0..3).rev() {
        let lift = 0.25 * TAU * f64::from(step) / 3.0;
        rows.push(ring(
            last,
            end,
            side,
            *radius_last,
            lift.cos(),
            lift.sin(),
            segments,
        ));
    }
    let mut mesh = Mesh::default();
    sheet(&mut mesh, &rows);
    mesh.without_slivers()
}

/// A circle about `along`, `rise` radii ahead of `centre` and `width` radii wide.
///
/// On the half spheres `rise` and `width` are cosine and sine of one angle; along the tube 0 and 1.
fn ring(
    centre: &Point3<f64>,
    along: Vector3<f64>,
    side: Vector3<f64>,
    radius_m: f64,
    rise: f64,
    width: f64,
    segments: u32,
) -> Vec<(Point3<f64>, Vector3<f64>)> {
    let other = Unit::new_normalize(along).cross(&side);
    around(segments)
        .map(|(c, s)| {
            let normal = width * (c * side + s * other) + rise * along;
            (centre + radius_m * normal, normal)
        })
        .collect()
}

/// Points of an arc about z in the xy plane, from `from_rad` to `to_rad`, both included.
///
/// `steps + 1` points; one, at the start, if `steps` is 0.
#[must_use]
pub fn arc(radius_m: f64, from_rad: f64, to_rad: f64, steps: u32) -> Vec<Point3<f64>> {
    (0..=steps)
        .map(|step| {
            let (s, c) = (from_rad
                + (to_rad - from_rad) * f64::from(step) / f64::from(steps.max(1)))
            .sin_cos();
            Point3::new(radius_m * c, radius_m * s, 0.0)
        })
        .collect()
}

/// The surface `z = height(x, y)` over a rectangle about the origin, facing up, of `2 * cells^2`
/// triangles.
///
/// Normals are by central differences over a thousandth of the shorter half side, so `height_m` is
/// asked a little beyond the rectangle too.
#[must_use]
pub fn height_field(
    half_x_m: f64,
    half_y_m: f64,
    cells: u32,
    height_m: impl Fn(f64, f64) -> f64,
) -> Mesh {
    let place =
        |half: f64, index: u32| half * (2.0 * f64::from(index) / f64::from(cells.max(1)) - 1.0);
    let delta = 1e-3 * half_x_m.min(half_y_m);
    let rows: Vec<_> = (0..=cells)
        .map(|v| {
            let point = |u| {
                let (x, y) = (place(half_x_m, u), place(half_y_m, v));
                let slope_x = (height_m(x + delta, y) - height_m(x - delta, y)) / (2.0 * delta);
                let slope_y = (height_m(x, y + delta) - height_m(x, y - delta)) / (2.0 * delta);
                (
                    Point3::new(x, y, height_m(x, y)),
                    Vector3::new(-slope_x, -slope_y, 1.0),
                )
            };
            (0..=cells).map(point).collect()
        })
        .collect();
    let mut mesh = Mesh::default();
    sheet(&mut mesh, &rows);
    mesh
}

/// Cosine and sine once around, the first point again at the end.
///
/// The last is the first bit by bit, so that seams close.
fn around(segments: u32) -> impl Iterator<Item = (f64, f64)> {
    (0..=segments).map(move |step| {
        let (s, c) =
            (TAU * f64::from(step % segments.max(1)) / f64::from(segments.max(1))).sin_cos();
        (c, s)
    })
}

#[cfg(test)]
mod tests;
