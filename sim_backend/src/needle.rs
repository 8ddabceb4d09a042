//! The suture needle: a tapered wire bent to an arc, as mass properties, centre line and mesh.

use core::f64::consts::TAU;

use hal::config::{ConfigError, Source};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

use crate::visual::Mesh;

/// Shape and mass of a needle.
///
/// The needle frame has its origin in the centre of the arc, the arc in its xy-plane and the middle of the arc on +x;
/// the point is at the end with positive y.
///
/// A real needle of this size weighs 0.2 g. A contact's stiffness is proportional to the mass it acts on, and at 0.2 g
/// no stiffness that one sub-step can resolve carries a grip of newtons without the jaws closing through the wire, so
/// `mass_kg` is meant to be raised to 1 or 2 g; weight and inertia stay small beside grip and drives.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NeedleShape {
    /// Radius of the arc's centre line, m.
    pub arc_radius_m: f64,
    /// Angle that the arc spans, rad.
    pub arc_angle_rad: f64,
    /// Radius of the wire, m.
    pub wire_radius_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
}

/// Mass properties of a needle in its own frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MassProperties {
    /// Centre of mass, m.
    pub(crate) centre: Point3<f64>,
    /// Moments of inertia about the centre of mass along the frame's axes, kg m².
    pub(crate) inertia: Vector3<f64>,
}

/// Share of the arc that tapers to the point.
const TAPER: f64 = 0.18;
/// Segments of the mesh along the arc.
const MESH_SEGMENTS: u32 = 24;
/// Sides of the mesh's tube.
const MESH_SIDES: u32 = 12;

impl NeedleShape {
    /// Checks the ranges of a needle read from `source` at the dotted `key`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        source.check_range(
            &format!("{key}.arc_radius_m"),
            self.arc_radius_m,
            0.004,
            0.03,
        )?;
        source.check_range(
            &format!("{key}.arc_angle_rad"),
            self.arc_angle_rad,
            0.5,
            5.0,
        )?;
        source.check_range(
            &format!("{key}.wire_radius_m"),
            self.wire_radius_m,
            0.000_2,
            0.001_5,
        )?;
        source.check_range(&format!("{key}.mass_kg"), self.mass_kg, 0.000_5, 0.01)
    }

    /// `count` points on the wire's centre line at equal steps from end to end, the pointed end last, in the needle
    /// frame; a single point is the middle.
    #[must_use]
    pub fn centre_line(&self, count: usize) -> Vec<Point3<f64>> {
        if count < 2 {
            return vec![self.arc_point(0.0); count];
        }
        (0..count)
            .map(|index| self.arc_point(self.arc_angle_rad * (ratio(index, count - 1) - 0.5)))
            .collect()
    }

    /// The tube with its tapered point, in the needle frame: 600 triangles.
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        let mut mesh = Mesh::default();
        for segment in 0..=MESH_SEGMENTS {
            self.push_ring(&mut mesh, f64::from(segment) / f64::from(MESH_SEGMENTS));
        }
        for segment in 0..MESH_SEGMENTS {
            for side in 0..MESH_SIDES {
                let next = (side + 1) % MESH_SIDES;
                let (here, there) = (segment * MESH_SIDES, (segment + 1) * MESH_SIDES);
                mesh.indices
                    .extend([here + side, there + next, here + next]);
                mesh.indices
                    .extend([here + side, there + side, there + next]);
            }
        }
        self.push_blunt_end(&mut mesh);
        mesh
    }

    pub(crate) fn mass_properties(&self) -> MassProperties {
        let half = 0.5 * self.arc_angle_rad;
        let square = self.arc_radius_m * self.arc_radius_m;
        let centre_x = self.arc_radius_m * half.sin() / half;
        let doubled = self.arc_angle_rad.sin() / self.arc_angle_rad;
        let wire = 0.5 * self.wire_radius_m * self.wire_radius_m;
        let inertia = Vector3::new(
            0.5 * square * (1.0 - doubled) + wire,
            0.5 * square * (1.0 + doubled) - centre_x * centre_x + wire,
            square - centre_x * centre_x + wire,
        );
        MassProperties {
            centre: Point3::new(centre_x, 0.0, 0.0),
            inertia: inertia * self.mass_kg,
        }
    }

    fn arc_point(&self, angle: f64) -> Point3<f64> {
        Point3::new(
            self.arc_radius_m * angle.cos(),
            self.arc_radius_m * angle.sin(),
            0.0,
        )
    }

    fn push_ring(&self, mesh: &mut Mesh, along: f64) {
        let angle = self.arc_angle_rad * (along - 0.5);
        let radial = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let centre = self.arc_point(angle);
        // Square root: the point looks ground, not like a cone.
        let radius = self.wire_radius_m * ((1.0 - along) / TAPER).clamp(0.0, 1.0).sqrt();
        for side in 0..MESH_SIDES {
            let turn = TAU * f64::from(side) / f64::from(MESH_SIDES);
            let normal = radial * turn.cos() + Vector3::z() * turn.sin();
            mesh.positions
                .push(single((centre + normal * radius).coords));
            mesh.normals.push(single(normal));
        }
    }

    fn push_blunt_end(&self, mesh: &mut Mesh) {
        let angle = -0.5 * self.arc_angle_rad;
        let normal = Vector3::new(angle.sin(), -angle.cos(), 0.0);
        let ring: Vec<[f32; 3]> = mesh
            .positions
            .iter()
            .copied()
            .take(MESH_SIDES as usize)
            .collect();
        let centre = MESH_SIDES * (MESH_SEGMENTS + 1);
        mesh.positions.push(single(self.arc_point(angle).coords));
        mesh.positions.extend(ring);
        mesh.normals
            .extend((0..=MESH_SIDES).map(|_| single(normal)));
        for side in 0..MESH_SIDES {
            let next = (side + 1) % MESH_SIDES;
            mesh.indices
                .extend([centre, centre + 1 + side, centre + 1 + next]);
        }
    }
}

/// A vector in the single precision that meshes use.
#[expect(
    clippy::cast_possible_truncation,
    reason = "meshes are single precision"
)]
pub(crate) fn single(v: Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// `part / whole` of two counts.
#[expect(
    clippy::cast_precision_loss,
    reason = "counts of points, far below 2^52"
)]
pub(crate) fn ratio(part: usize, whole: usize) -> f64 {
    part as f64 / whole as f64
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const HALF_CIRCLE: NeedleShape = NeedleShape {
        arc_radius_m: 0.012,
        arc_angle_rad: core::f64::consts::PI,
        wire_radius_m: 0.000_7,
        mass_kg: 0.001_5,
    };

    #[test]
    fn centre_line_is_an_arc_with_its_middle_on_x() {
        let points = HALF_CIRCLE.centre_line(11);
        assert_eq!(points.len(), 11);
        assert!(
            points
                .iter()
                .all(|p| (p.coords.norm() - 0.012).abs() < 1e-15 && p.z.abs() < 1e-15)
        );
        assert!((points[5] - Point3::new(0.012, 0.0, 0.0)).norm() < 1e-15);
        assert!((points[10] - Point3::new(0.0, 0.012, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn mass_properties_equal_those_of_many_beads() {
        let exact = HALF_CIRCLE.mass_properties();
        let beads = HALF_CIRCLE.centre_line(20_001);
        let bead_kg = HALF_CIRCLE.mass_kg / 20_001.0;
        let centre = beads.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 20_001.0;
        let mut inertia = Vector3::zeros();
        for bead in &beads {
            let arm = bead.coords - centre;
            inertia += (Vector3::repeat(arm.norm_squared()) - arm.component_mul(&arm)) * bead_kg;
        }
        assert!((exact.centre.coords - centre).norm() < 1e-6);
        // The beads have no thickness; the wire does.
        assert!(
            (exact.inertia - inertia).norm() < 5e-3 * inertia.norm(),
            "{} against {inertia}",
            exact.inertia
        );
    }

    #[test]
    fn mesh_faces_outwards_and_stays_on_the_wire() {
        let mesh = HALF_CIRCLE.mesh();
        assert!((560..=640).contains(&(mesh.indices.len() / 3)));
        for triangle in mesh.indices.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|k| {
                let [x, y, z] = mesh.positions[triangle[k] as usize].map(f64::from);
                Vector3::new(x, y, z)
            });
            let face = (b - a).cross(&(c - a));
            let normal: Vector3<f64> = triangle
                .iter()
                .map(|&index| Vector3::from(mesh.normals[index as usize].map(f64::from)))
                .sum();
            assert!(
                face.norm() < 1e-12 || face.dot(&normal) > 0.0,
                "{a} {b} {c} {normal}"
            );
        }
        let wire = mesh.positions.iter().map(|p| {
            let flat = f64::from(p[0]).hypot(f64::from(p[1])) - 0.012;
            flat.hypot(f64::from(p[2]))
        });
        assert!(wire.fold(0.0, f64::max) < 0.000_701);
    }
}
