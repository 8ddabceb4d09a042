//! What of an arm's limits has a place: forbidden regions, workspaces, remote centres. They are
//! drawn where the configuration has them, in the scene frame; whether an arm keeps them is the
//! guard's matter.

use hal::Pose;
use hal::mesh::single;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use trocar_control::config::ArmConfig;
use trocar_control::region::{Block, Region, Shape};
use trocar_render::shapes::{capsule, cuboid, placed, sphere};

use super::glb::{Glass, Writer};

/// Sides of what is round.
const SEGMENTS: u32 = 32;

/// How far a half-space's plane is drawn, m to each side of its point.
const PLANE_M: f64 = 0.1;

const REGION: Glass = Glass {
    colour: [0.9, 0.05, 0.03, 0.22],
};
const WORKSPACE: Glass = Glass {
    colour: [0.05, 0.35, 0.8, 0.9],
};
const REMOTE_CENTRE: Glass = Glass {
    colour: [0.9, 0.6, 0.05, 0.8],
};

/// Draws the limits of `arms`.
pub(super) fn draw(writer: &mut Writer, arms: &[ArmConfig]) {
    // All arms have the same regions, each in its own frame.
    if let Some(arm) = arms.first() {
        for region in &arm.forbidden {
            draw_region(writer, region, &arm.scene_from_rcm);
        }
    }
    for arm in arms {
        let block = arm.workspace.moved(&arm.scene_from_rcm);
        writer.lines(("workspace", &arm.name), &edges(&block), WORKSPACE);
        let ball = placed(sphere(0.002, SEGMENTS), &arm.scene_from_rcm);
        writer.glass(("remote centre", &arm.name), &ball, REMOTE_CENTRE);
    }
}

/// A half-space is drawn as a thin sheet on its plane, since it has no end.
fn draw_region(writer: &mut Writer, region: &Region, scene_from_rcm: &Pose) {
    let mesh = match region.shape.moved(scene_from_rcm) {
        Shape::Sphere { center_m, radius_m } => {
            placed(sphere(radius_m, SEGMENTS), &at(center_m, Vector3::z()))
        }
        Shape::Capsule {
            from_m,
            to_m,
            radius_m,
        } => {
            let along = to_m - from_m;
            placed(
                capsule(radius_m, 0.0, along.norm(), SEGMENTS),
                &at(from_m, along),
            )
        }
        Shape::HalfSpace { point_m, normal } => {
            let sheet = Vector3::new(PLANE_M, PLANE_M, 1e-5);
            placed(cuboid(sheet), &at(point_m, normal))
        }
        Shape::Box(block) => placed(cuboid(block.half_m), &frame(&block)),
    };
    writer.glass(("region", &region.name), &mesh, REGION);
}

/// A frame at `point_m` whose z axis is along `z`.
fn at(point_m: Vector3<f64>, z: Vector3<f64>) -> Pose {
    let turned = UnitQuaternion::rotation_between(&Vector3::z(), &z);
    let turned = turned.unwrap_or_else(|| {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    });
    Pose::from_parts(Translation3::from(point_m), turned)
}

/// The frame of a box: its middle, and its axes.
fn frame(block: &Block) -> Pose {
    Pose::from_parts(
        Translation3::from(block.center_m),
        UnitQuaternion::from_rotation_matrix(&block.axes),
    )
}

/// The twelve edges of a box, two points each, m.
fn edges(block: &Block) -> Vec<[f32; 3]> {
    let frame = frame(block);
    let corner = |signs: [f64; 3]| {
        let local = block.half_m.component_mul(&Vector3::from(signs));
        single(&(frame * Point3::from(local)).coords)
    };
    let mut points = Vec::with_capacity(24);
    for axis in 0..3 {
        for (one, other) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            for end in [-1.0, 1.0] {
                let mut signs = [end; 3];
                signs[(axis + 1) % 3] = one;
                signs[(axis + 2) % 3] = other;
                points.push(corner(signs));
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn a_box_has_twelve_edges_of_its_size() {
        let block = Block {
            center_m: Vector3::new(0.1, 0.0, 0.0),
            half_m: Vector3::new(0.01, 0.02, 0.03),
            axes: Rotation3::from_euler_angles(0.3, 0.2, 0.1),
        };
        let points = edges(&block);
        let mut lengths: Vec<f32> = points
            .chunks_exact(2)
            .map(|ends| Vector3::from(ends[0]).metric_distance(&Vector3::from(ends[1])))
            .collect();
        lengths.sort_by(f32::total_cmp);
        for (index, length) in lengths.into_iter().enumerate() {
            let expected = [0.02, 0.04, 0.06][index / 4];
            assert!((length - expected).abs() < 1e-6, "{length} {expected}");
        }
    }

    #[test]
    fn a_direction_and_its_opposite_have_frames() {
        for z in [Vector3::z(), -Vector3::z(), Vector3::new(1.0, 2.0, -3.0)] {
            let turned = at(Vector3::zeros(), z) * Vector3::z();
            assert!((turned - z.normalize()).norm() < 1e-12);
        }
    }
}
