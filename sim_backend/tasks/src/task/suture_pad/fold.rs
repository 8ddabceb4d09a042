//! A fold of tissue in the place of the pad's lip: as thick, as high and with the same hole, with a
//! round back, round ends and a foot that widens into the organ. Physics has the convex hulls of
//! what is drawn.

use core::f64::consts::PI;

use hal::Mesh;
use hal::count::count_u32;
use nalgebra::{Point3, Vector3};
use trocar_render::shapes::smooth_sheet;
use trocar_world::Shape;

use super::PadShape;

/// How deep the foot goes, scene z, m, and how much thicker it gets on each side for each metre
/// down.
pub(super) const ROOT_M: f64 = 0.030;
const WIDENING: f64 = 0.4;
/// Height of the foot as a share of the height at which the hole begins.
const FOOT: f64 = 0.85;
/// Share of its length over which each end is round.
const ENDS: f64 = 0.3;
/// Points around the back, and sections over an end.
const BACK_POINTS: u32 = 12;
const END_SECTIONS: u32 = 10;
/// Size of the last section, as a share: a section has an area.
const LEAST: f64 = 0.01;

/// The fold of a pad.
pub(super) struct Fold<'a> {
    pad: &'a PadShape,
}

/// Points across the fold from its front over its back to its rear, y from its middle and z, m.
type Profile = Vec<[f64; 2]>;

impl<'a> Fold<'a> {
    pub(super) const fn of(pad: &'a PadShape) -> Self {
        Self { pad }
    }

    /// What it is made of, for the physics.
    pub(super) fn solids(&self) -> Vec<Shape> {
        let hull = |rows: Vec<Vec<Point3<f64>>>| Shape::Hull(rows.concat());
        self.parts().into_iter().map(hull).collect()
    }

    /// What is drawn of it, scene frame.
    pub(super) fn mesh(&self) -> Mesh {
        let [foot, under, over, left, right] = self.parts();
        let walls = [
            left.last().map(|row| cap(row, 1.0)),
            right.first().map(|row| cap(row, -1.0)),
        ];
        let ceiling = over.first().zip(over.last());
        let ceiling = ceiling.map(|(from, to)| smooth_sheet(&[edges(from), edges(to)]));
        // Sharp where they meet the rest.
        let sides = [0..2, 2..4].map(|side| {
            let side = |row: &Vec<Point3<f64>>| row[side.clone()].to_vec();
            foot.iter().map(side).collect()
        });
        let sheets = sides.into_iter().chain([under, over, left, right]);
        let outside = sheets.map(|mut rows: Vec<Vec<Point3<f64>>>| {
            // A section goes from the front over the back, so outside is where sections follow each
            // other towards -x.
            rows.reverse();
            smooth_sheet(&rows)
        });
        let inside = walls.into_iter().chain([ceiling]).flatten();
        Mesh::merged(outside.chain(inside))
    }

    /// The foot, what is under and over the hole, and what is left and right of it, as sections
    /// along x.
    fn parts(&self) -> [Vec<Vec<Point3<f64>>>; 5] {
        let hole = self.pad.hole_half_m;
        let under_m = self.pad.hole_height_m - hole;
        let (foot_m, over_m) = (FOOT * under_m, self.pad.hole_height_m + hole);
        let half_m = 0.5 * self.pad.lip_thickness_m;
        let wide_m = half_m + WIDENING * (foot_m + ROOT_M);
        let slab = |low_m: f64, high_m: f64| {
            vec![
                [-half_m, low_m],
                [-half_m, high_m],
                [half_m, high_m],
                [half_m, low_m],
            ]
        };
        let foot = vec![
            [-wide_m, -ROOT_M],
            [-half_m, foot_m],
            [half_m, foot_m],
            [wide_m, -ROOT_M],
        ];
        let end = 0.5 * self.pad.lip_length_m;
        let straight = |profile: Profile| {
            let section = |x: f64| self.section(&profile, x, 1.0, foot_m);
            vec![section(-hole), section(hole)]
        };
        let ended = |profile: &Profile, xs: Vec<(f64, f64)>| {
            let section = |(x, size): (f64, f64)| self.section(profile, x, size, foot_m);
            xs.into_iter().map(section).collect()
        };
        let back = self.back(foot_m);
        let rounded_left = || round_end(end, hole).map(|(x, size)| (-x, size));
        let rounded_right = || round_end(end, hole).collect::<Vec<_>>().into_iter().rev();
        [
            ended(&foot, rounded_left().chain(rounded_right()).collect()),
            straight(slab(foot_m, under_m)),
            straight(self.back(over_m)),
            ended(&back, rounded_left().chain([(-hole, 1.0)]).collect()),
            ended(
                &back,
                [(hole, 1.0)].into_iter().chain(rounded_right()).collect(),
            ),
        ]
    }

    /// The profile above the height `from_m`, with a round back.
    fn back(&self, from_m: f64) -> Profile {
        let half_m = 0.5 * self.pad.lip_thickness_m;
        let top_m = self.pad.lip_height_m;
        let high_m = half_m.min(0.9 * (top_m - from_m));
        let round = (0..=BACK_POINTS).map(|index| {
            let (sin, cos) = (PI * f64::from(index) / f64::from(BACK_POINTS)).sin_cos();
            [-half_m * cos, top_m - high_m + high_m * sin]
        });
        let (front, rear) = ([-half_m, from_m], [half_m, from_m]);
        [front].into_iter().chain(round).chain([rear]).collect()
    }

    /// A profile at `x`, thinner by `size`, and lower by as much above the foot.
    fn section(&self, profile: &Profile, x: f64, size: f64, foot_m: f64) -> Vec<Point3<f64>> {
        let middle_m = self.pad.lip_front_m + 0.5 * self.pad.lip_thickness_m;
        let point = |[y, z]: &[f64; 2]| {
            let z = if *z > foot_m {
                foot_m + size * (z - foot_m)
            } else {
                *z
            };
            Point3::new(x, middle_m + size * y, z)
        };
        profile.iter().map(point).collect()
    }
}

/// Places and sizes of the sections from the end at `end_m` inwards, not as far as `hole_m`.
fn round_end(end_m: f64, hole_m: f64) -> impl Iterator<Item = (f64, f64)> {
    let round_m = (2.0 * ENDS * end_m).min(0.9 * (end_m - hole_m));
    (0..=END_SECTIONS).map(move |index| {
        let (sin, cos) = (0.5 * PI * f64::from(index) / f64::from(END_SECTIONS)).sin_cos();
        (end_m - round_m * (1.0 - cos), sin.max(LEAST))
    })
}

/// The front and rear ends of the section `row`.
fn edges(row: &[Point3<f64>]) -> Vec<Point3<f64>> {
    row.first().into_iter().chain(row.last()).copied().collect()
}

/// The convex section `row` as a face, towards +x or -x as `facing` says.
fn cap(row: &[Point3<f64>], facing: f64) -> Mesh {
    let mut mesh = Mesh::default();
    for point in row {
        mesh.vertex(*point, facing * Vector3::x());
    }
    for index in 2..count_u32(row.len()) {
        let [a, b, c] = [0, index - 1, index];
        mesh.triangle(if facing < 0.0 { [a, b, c] } else { [a, c, b] });
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::suture_pad::SuturePad;

    fn corners(mesh: &Mesh) -> impl Iterator<Item = [Vector3<f64>; 2]> + '_ {
        let pairs = mesh.positions.iter().zip(&mesh.normals);
        pairs.map(|(p, n)| [p, n].map(|v| Vector3::from(v.map(f64::from))))
    }

    /// Triangles face the way that their normals do, and those of the outside away from the fold's
    /// middle.
    #[test]
    fn a_fold_faces_outwards() {
        let pad = SuturePad::shipped().pad;
        let mesh = Fold::of(&pad).mesh();
        let vertices: Vec<[Vector3<f64>; 2]> = corners(&mesh).collect();
        let middle_m = pad.hole().y;
        let mut outside_m2 = 0.0;
        for triangle in mesh.indices.as_chunks::<3>().0 {
            let [a, b, c] = triangle.map(|index| vertices[index as usize]);
            let across = (b[0] - a[0]).cross(&(c[0] - a[0]));
            for [_, normal] in [a, b, c] {
                assert!(normal.dot(&across) > -1e-12, "{triangle:?}");
            }
            let (at, in_hole) = ((a[0] + b[0] + c[0]) / 3.0, pad.hole_half_m + 1e-6);
            let facing = across.y * (at.y - middle_m);
            if across.y.abs() > 0.5 * across.norm() && at.x.abs() > in_hole {
                assert!(facing > 0.0, "{at}");
                outside_m2 += 0.5 * across.norm();
            }
        }
        assert!(outside_m2 > 2.0 * 0.04 * 0.016, "{outside_m2}");
    }

    /// Its solids leave the hole free, and no more than the hole.
    #[test]
    fn a_fold_has_the_pads_hole() {
        for (lip_length_m, hole_half_m) in [(0.05, 0.002), (0.03, 0.003), (0.01, 0.0035)] {
            has_its_hole(&PadShape {
                lip_length_m,
                hole_half_m,
                ..SuturePad::shipped().pad
            });
        }
    }

    fn has_its_hole(pad: &PadShape) {
        let hulls: Vec<Vec<Point3<f64>>> = Fold::of(pad).parts().map(|rows| rows.concat()).into();
        let (hole, half_m) = (pad.hole(), pad.hole_half_m);
        let reaches = |x: f64, z: f64| {
            hulls.iter().any(|hull| {
                let range = |axis: usize| {
                    let along = || hull.iter().map(|p| p[axis]);
                    let low = along().fold(f64::INFINITY, f64::min);
                    low..=along().fold(f64::NEG_INFINITY, f64::max)
                };
                range(0).contains(&x) && range(2).contains(&z)
            })
        };
        for share in [-0.99, -0.5, 0.0, 0.5, 0.99] {
            assert!(!reaches(hole.x + share * half_m, hole.z));
            assert!(!reaches(hole.x, hole.z + share * half_m));
        }
        for share in [-1.01, 1.01] {
            assert!(reaches(hole.x + share * half_m, hole.z));
            assert!(reaches(hole.x, hole.z + share * half_m));
        }
    }
}
