//! The organ as it is drawn: the patch that physics knows, with a rounded rim instead of an edge.

use core::f64::consts::TAU;

use hal::Mesh;
use hal::count::count_u32;
use hal::mesh::single;
use nalgebra::Vector3;

use super::OrganShape;
use crate::needle::ratio;

/// Outline and rim of a drawn organ.
struct Outline {
    /// How far inside the patch's border the rim begins, m.
    inset_m: f64,
    /// How the outline squares up: 2 is an ellipse, more is nearer to the rectangle.
    squareness: f64,
    /// Shares by which the outline swells and shrinks: amplitude, waves once around, phase.
    lobes: [(f64, f64, f64); 2],
    /// A notch between two lobes: depth as a share, direction, rad, and half width, rad.
    notch: (f64, f64, f64),
    /// Radius of the rounded rim, m.
    rim_m: f64,
}

/// A cut of flesh: nearly the whole patch.
const SLAB: Outline = Outline {
    inset_m: 0.007,
    squareness: 5.0,
    lobes: [(0.012, 5.0, 0.3), (0.010, 3.0, 1.7)],
    notch: (0.0, 0.0, 1.0),
    rim_m: 0.007,
};

/// A liver: two lobes, the notch between them on the far side, a thick rim.
const LOBED: Outline = Outline {
    inset_m: 0.005,
    squareness: 2.7,
    lobes: [(0.030, 3.0, 0.9), (0.020, 2.0, 2.4)],
    notch: (0.18, 1.05, 0.42),
    rim_m: 0.011,
};

/// Sectors around, and rings from the middle to the rim.
const SECTORS: usize = 120;
const RINGS: usize = 24;

/// Rings of the rounded rim, which turns by a little more than a quarter.
const RIM_RINGS: usize = 7;
const RIM_TURN_RAD: f64 = 1.65;

/// How far down the flank reaches, m.
const FLANK_M: f64 = 0.030;

impl OrganShape {
    /// The patch in the scene frame, its border rounded off. Inside of the rim, nearly everywhere,
    /// it is the surface of [`OrganShape::height_m`].
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        self.drawn(&SLAB)
    }

    /// The same as a liver, with lobes and a thick rim that falls off.
    #[must_use]
    pub fn lobed_mesh(&self) -> Mesh {
        self.drawn(&LOBED)
    }

    fn drawn(&self, outline: &Outline) -> Mesh {
        let mut mesh = Mesh::default();
        for ring in 0..=RINGS {
            for sector in 0..SECTORS {
                let border = self.border(outline, angle(sector));
                let at = border * ratio(ring, RINGS);
                let top = Vector3::new(at.x, at.y, self.height_m(at.x, at.y));
                push(&mut mesh, top, self.normal(at.x, at.y).into_inner());
            }
        }
        for ring in 1..=RIM_RINGS {
            let (sin, cos) = (RIM_TURN_RAD * ratio(ring, RIM_RINGS)).sin_cos();
            self.push_rim(&mut mesh, outline, |outward, up| {
                (
                    outline.rim_m * (outward * sin + up * (cos - 1.0)),
                    outward * sin + up * cos,
                )
            });
        }
        self.push_rim(&mut mesh, outline, |outward, up| {
            (outward * outline.rim_m - up * FLANK_M, outward)
        });
        join(&mut mesh, RINGS + RIM_RINGS + 1);
        mesh
    }

    /// One ring beyond the border; `turn` makes offset and normal of the directions outwards and
    /// up.
    fn push_rim(
        &self,
        mesh: &mut Mesh,
        outline: &Outline,
        turn: impl Fn(Vector3<f64>, Vector3<f64>) -> (Vector3<f64>, Vector3<f64>),
    ) {
        for sector in 0..SECTORS {
            let at = self.border(outline, angle(sector));
            let step = 1e-4;
            let along = self.border(outline, angle(sector) + step)
                - self.border(outline, angle(sector) - step);
            let up = self.normal(at.x, at.y).into_inner();
            let outward = along.cross(&up).normalize();
            let (offset, normal) = turn(outward, up);
            let top = Vector3::new(at.x, at.y, self.height_m(at.x, at.y));
            push(mesh, top + offset, normal.normalize());
        }
    }

    /// The point of the outline in the direction `angle_rad`, in the plane.
    fn border(&self, outline: &Outline, angle_rad: f64) -> Vector3<f64> {
        let (sin, cos) = angle_rad.sin_cos();
        let half = |extent_m: f64| 0.5 * extent_m - outline.inset_m;
        let share = |part: f64, half: f64| (part.abs() / half).powf(outline.squareness);
        let reach = share(cos, half(self.length_m)) + share(sin, half(self.width_m));
        let lobes: f64 = outline
            .lobes
            .iter()
            .map(|(amplitude, waves, phase)| amplitude * ((waves * angle_rad + phase).sin() - 1.0))
            .sum();
        let (depth, direction, width) = outline.notch;
        let away = ((angle_rad - direction + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU) / width;
        let notch = depth * (-away * away).exp();
        let radius_m = reach.powf(-1.0 / outline.squareness) * (1.0 + lobes - notch);
        Vector3::new(radius_m * cos, radius_m * sin, 0.0)
    }
}

fn angle(sector: usize) -> f64 {
    TAU * ratio(sector, SECTORS)
}

fn push(mesh: &mut Mesh, position: Vector3<f64>, normal: Vector3<f64>) {
    mesh.positions.push(single(&position));
    mesh.normals.push(single(&normal));
}

/// Joins `rings + 1` rings of points by triangles that face up and outwards.
fn join(mesh: &mut Mesh, rings: usize) {
    let [rings, sectors] = [rings, SECTORS].map(count_u32);
    for ring in 0..rings {
        for sector in 0..sectors {
            let next = (sector + 1) % sectors;
            let (inner, outer) = (ring * sectors, (ring + 1) * sectors);
            // All points of the first ring are the middle.
            if ring > 0 {
                mesh.indices
                    .extend([inner + sector, outer + next, inner + next]);
            }
            mesh.indices
                .extend([inner + sector, outer + sector, outer + next]);
        }
    }
}
