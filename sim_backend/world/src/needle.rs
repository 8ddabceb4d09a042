//! The suture needle: a tapered wire bent to an arc or unevenly, as mass properties, centre line
//! and mesh.

use core::f64::consts::TAU;

use hal::Mesh;
use hal::config::{ConfigError, Source};
use hal::mesh::single;
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

/// Shape and mass of a needle.
///
/// The needle frame has its origin in the centre of the arc, the arc in its xy-plane and the middle
/// of the arc on +x; the point is at the end with positive y. If the needle is bent unevenly the
/// same holds for the circle that fits the wire in its middle.
///
/// A real needle of this size weighs 0.2 g. A contact's stiffness is proportional to the mass it
/// acts on, and at 0.2 g no stiffness that one sub-step can resolve carries a grip of newtons
/// without the jaws closing through the wire, so `mass_kg` is meant to be raised to 1 or 2 g;
/// weight and inertia stay small beside grip and drives.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NeedleShape {
    /// Radius of the arc's centre line, m.
    pub arc_radius_m: f64,
    /// Angle that the arc spans, rad; if the needle is bent unevenly, the wire's length over the
    /// radius.
    pub arc_angle_rad: f64,
    /// How the wire's curvature changes from its middle to its ends: where `u` is -1 at the blunt
    /// end, 0 in the middle and 1 at the point, the curvature is that of the arc times `1 +
    /// uneven[0] * u + uneven[1] * u²`. Zeros make an arc.
    pub uneven: [f64; 2],
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
    /// Principal moments of inertia about the centre of mass, kg m².
    pub(crate) inertia: Vector3<f64>,
    /// Angle from the frame's x-axis to the first principal axis, about z, rad; the third one is z.
    pub(crate) axes_rad: f64,
}

/// Share of the arc that tapers to the point.
const TAPER: f64 = 0.18;
/// Beads that stand for an uneven wire's mass.
const MASS_BEADS: usize = 400;
/// Pairs of steps in which an uneven wire is followed from its middle.
const WIRE_STEPS: u32 = 24;
/// Segments of the mesh along the arc.
const MESH_SEGMENTS: u32 = 56;
/// Sides of the mesh's tube.
const MESH_SIDES: u32 = 10;

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
        for (index, uneven) in self.uneven.into_iter().enumerate() {
            source.check_range(&format!("{key}.uneven.{index}"), uneven, -2.0, 2.0)?;
        }
        source.check_range(&format!("{key}.mass_kg"), self.mass_kg, 0.000_5, 0.01)
    }

    /// `count` points on the wire's centre line at equal steps from end to end, the pointed end
    /// last, in the needle frame; a single point is the middle.
    #[must_use]
    pub fn centre_line(&self, count: usize) -> Vec<Point3<f64>> {
        if count < 2 {
            return vec![self.wire_at(0.0).0; count];
        }
        (0..count)
            .map(|index| self.wire_at(ratio(index, count - 1) - 0.5).0)
            .collect()
    }

    /// The tube with its tapered point, in the needle frame: 1130 triangles.
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
        if !self.is_arc() {
            return self.mass_properties_of_beads();
        }
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
            axes_rad: 0.0,
        }
    }

    fn mass_properties_of_beads(&self) -> MassProperties {
        let share = ratio(1, MASS_BEADS);
        let beads: Vec<_> = (0..MASS_BEADS)
            .map(|bead| self.wire_at(ratio(2 * bead + 1, 2 * MASS_BEADS) - 0.5).0)
            .collect();
        let centre = beads.iter().map(|p| p.coords).sum::<Vector3<f64>>() * share;
        // Second moments in the plane: of x, of y and mixed.
        let mut moments = Vector3::zeros();
        for bead in &beads {
            let arm = bead.coords - centre;
            moments += Vector3::new(arm.x * arm.x, arm.y * arm.y, arm.x * arm.y) * share;
        }
        let axes_rad = 0.5 * (2.0 * moments.z).atan2(moments.x - moments.y);
        let mean = 0.5 * (moments.x + moments.y);
        let apart = (0.5 * (moments.x - moments.y)).hypot(moments.z);
        let wire = 0.5 * self.wire_radius_m * self.wire_radius_m;
        let inertia = Vector3::new(mean - apart, mean + apart, 2.0 * mean);
        MassProperties {
            centre: Point3::from(centre),
            inertia: (inertia + Vector3::repeat(wire)) * self.mass_kg,
            axes_rad,
        }
    }

    /// Whether the wire is bent evenly.
    fn is_arc(&self) -> bool {
        self.uneven.iter().all(|uneven| uneven.abs() < 1e-12)
    }

    /// The wire's centre line at `along`, from -1/2 at the blunt end to 1/2 at the point, and the
    /// angle of its outer side from the frame's x-axis there.
    fn wire_at(&self, along: f64) -> (Point3<f64>, f64) {
        let angle = self.arc_angle_rad * along;
        if self.is_arc() {
            return (self.arc_point(angle), angle);
        }
        let turned = |along: f64| {
            let u = 2.0 * along;
            self.arc_angle_rad
                * along
                * (1.0 + u * (self.uneven[0] / 2.0 + u * self.uneven[1] / 3.0))
        };
        // Simpson's rule from the middle outwards.
        let step = along / f64::from(2 * WIRE_STEPS);
        let mut sum = Vector3::zeros();
        for index in 0..=2 * WIRE_STEPS {
            let weight = simpson_weight(index);
            let (sin, cos) = turned(step * f64::from(index)).sin_cos();
            sum += Vector3::new(-sin, cos, 0.0) * weight;
        }
        let length_m = self.arc_radius_m * self.arc_angle_rad;
        let offset = sum * (step * length_m / 3.0);
        let middle = Point3::new(self.arc_radius_m, 0.0, 0.0);
        (middle + offset, turned(along))
    }

    fn arc_point(&self, angle: f64) -> Point3<f64> {
        Point3::new(
            self.arc_radius_m * angle.cos(),
            self.arc_radius_m * angle.sin(),
            0.0,
        )
    }

    fn push_ring(&self, mesh: &mut Mesh, along: f64) {
        let (centre, angle) = self.wire_at(along - 0.5);
        let radial = Vector3::new(angle.cos(), angle.sin(), 0.0);
        // Square root: the point looks ground, not like a cone.
        let radius = self.wire_radius_m * ((1.0 - along) / TAPER).clamp(0.0, 1.0).sqrt();
        for side in 0..MESH_SIDES {
            let turn = TAU * f64::from(side) / f64::from(MESH_SIDES);
            let normal = radial * turn.cos() + Vector3::z() * turn.sin();
            mesh.positions
                .push(single(&(centre + normal * radius).coords));
            mesh.normals.push(single(&normal));
        }
    }

    fn push_blunt_end(&self, mesh: &mut Mesh) {
        let (end, angle) = self.wire_at(-0.5);
        let normal = Vector3::new(angle.sin(), -angle.cos(), 0.0);
        let ring: Vec<[f32; 3]> = mesh
            .positions
            .iter()
            .copied()
            .take(MESH_SIDES as usize)
            .collect();
        let centre = MESH_SIDES * (MESH_SEGMENTS + 1);
        mesh.positions.push(single(&end.coords));
        mesh.positions.extend(ring);
        mesh.normals
            .extend((0..=MESH_SIDES).map(|_| single(&normal)));
        for side in 0..MESH_SIDES {
            let next = (side + 1) % MESH_SIDES;
            mesh.indices
                .extend([centre, centre + 1 + side, centre + 1 + next]);
        }
    }
}

/// The weight of the point `index` of [`WIRE_STEPS`] double steps in Simpson's rule, in thirds of a
/// step.
fn simpson_weight(index: u32) -> f64 {
    match index {
        0 => 1.0,
        index if index == 2 * WIRE_STEPS => 1.0,
        index => 2.0 + 2.0 * f64::from(index % 2),
    }
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
pub(crate) mod tests;
