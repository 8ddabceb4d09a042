//! Meshes of the needle driver, from the shaft to the finger tips.
//!
//! All parts use one convention: z towards the tip, the wrist-pitch axis along y, the wrist-yaw
//! axis (and the jaw's hinge) along x. With the wrist straight all frames are parallel and the yaw
//! axis lies [`psm::WRIST_M`] beyond the pitch axis.
//!
//! Dimensions of the arm come from [`hal::psm`]; the others are for looks alone. Physics has
//! simpler shapes of its own. Lengths are metres.

use core::f64::consts::PI;

use hal::{Mesh, psm};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::{cylinder, placed, revolved, sheet};

/// Which finger of the jaw: the half space of the tip frame that it fills when the jaw is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finger {
    /// y above zero; opens by turning about -x.
    PlusY,
    /// y below zero; opens by turning about +x.
    MinusY,
}

/// Half the thickness of the sheet that the wrist's ears are cut from, m.
const EAR_HALF_M: f64 = 0.0007;

/// The shaft, `length_m` of it, up to the two ears that hold the pitch axle. The origin is on the
/// wrist-pitch axis.
#[must_use]
pub fn shaft(length_m: f64) -> Mesh {
    let radius = psm::SHAFT_RADIUS_M;
    let end = -0.0065;
    let tube = revolved(
        &[
            [0.0, -length_m],
            [radius, -length_m],
            [radius, end - 0.0080],
            [radius - 0.0003, end - 0.0078],
            [radius - 0.0003, end - 0.0010],
            [radius - 0.0010, end],
            [0.0, end],
        ],
        28,
    );
    let ears = [-1.0, 1.0].map(|side| ear(side * 0.0027, end - 0.0005, 0.0021));
    Mesh::merged([tube].into_iter().chain(ears))
}

/// The wrist: from the pitch axis, where the origin is, to the ears that hold the yaw axle.
#[must_use]
pub fn wrist() -> Mesh {
    let quarter_about_z =
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), core::f64::consts::FRAC_PI_2);
    let pulley = lying(&cylinder(0.0022, -0.0019, 0.0019, 18), 0.0);
    let body = tapered([0.0016, 0.0017], [0.0026, 0.0025], 0.0005, 0.0046);
    let ears = [-1.0, 1.0].map(|side| ear(side * 0.0025, 0.0040, psm::WRIST_M + 0.0021));
    let turned = Mesh::merged(ears);
    Mesh::merged([
        pulley,
        body,
        placed(
            turned,
            &Isometry3::from_parts(Translation3::identity(), quarter_about_z),
        ),
    ])
}

/// One finger: a hub on the yaw axis, where the origin is, and a tapered, toothed blade that ends
/// [`psm::FINGER_M`] further along z. The gripping face lies in the plane y = 0.
///
/// The blade has no end caps. The other finger is the same, turned by half a turn about z.
#[must_use]
pub fn finger(which: Finger) -> Mesh {
    let turn = match which {
        Finger::PlusY => 0.0,
        Finger::MinusY => PI,
    };
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    let hub = placed(
        cylinder(0.0020, 0.00005, 0.0016, 16),
        &Isometry3::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), core::f64::consts::FRAC_PI_2),
        ),
    );
    let tip = psm::FINGER_M;
    let blade = blade(&[
        (0.0008, 0.0016, 0.0020),
        (0.0040, 0.0014, 0.0016),
        (tip - 0.0014, 0.0011, 0.0011),
        (tip - 0.0004, 0.0008, 0.0006),
        (tip - 0.0001, 0.0005, 0.0003),
        (tip, 0.0001, 0.00005),
    ]);
    let teeth = (0..9).map(|tooth| {
        let z = 0.0030 + 0.0007 * f64::from(tooth);
        let ridge = |z: f64, depth: f64, half: f64| {
            [(-half, -depth), (half, -depth), (half, 0.0), (-half, 0.0)]
                .map(|(x, y)| Point3::new(x, y + GAP_M, z))
        };
        Mesh::merged([
            Mesh::hexahedron([ridge(z, 0.0, 0.0010), ridge(z + 0.00022, GAP_M, 0.0010)]),
            Mesh::hexahedron([
                ridge(z + 0.00022, GAP_M, 0.0010),
                ridge(z + 0.00045, 0.0, 0.0010),
            ]),
        ])
    });
    placed(
        Mesh::merged([hub, blade].into_iter().chain(teeth)),
        &Isometry3::from_parts(Translation3::identity(), rotation),
    )
}

/// How far the floor between the teeth lies behind the gripping face, m; also how far the teeth
/// stand out.
const GAP_M: f64 = 0.00012;

/// A blade along z with a flat gripping side and a round back, through sections of `(z, half width,
/// thickness)`.
///
/// Two sheets, neither with ends.
fn blade(sections: &[(f64, f64, f64)]) -> Mesh {
    let across = 8;
    let back: Vec<Vec<_>> = sections
        .iter()
        .map(|&(z, half, thickness)| {
            (0..=across)
                .map(|step| {
                    let (sin, cos) = (PI * f64::from(step) / f64::from(across)).sin_cos();
                    let point = Point3::new(half * cos, GAP_M + thickness * sin, z);
                    (point, Vector3::new(cos / half, sin / thickness, 0.0))
                })
                .collect()
        })
        .collect();
    let face: Vec<Vec<_>> = sections
        .iter()
        .map(|&(z, half, _)| {
            [-half, half]
                .map(|x| (Point3::new(x, GAP_M, z), -Vector3::y()))
                .to_vec()
        })
        .collect();
    let mut mesh = Mesh::default();
    sheet(&mut mesh, &back);
    sheet(&mut mesh, &face);
    mesh
}

/// A frustum with rectangular ends of the given half widths.
///
/// Between the heights `z_low` and `z_high`, m, centred on the z axis.
fn tapered(low: [f64; 2], high: [f64; 2], z_low: f64, z_high: f64) -> Mesh {
    let quad = |[x, y]: [f64; 2], z: f64| {
        [
            Point3::new(-x, -y, z),
            Point3::new(x, -y, z),
            Point3::new(x, y, z),
            Point3::new(-x, y, z),
        ]
    };
    Mesh::hexahedron([quad(low, z_low), quad(high, z_high)])
}

/// A rounded plate at `y`, from `z_from` to `z_to`, with the head of an axle on it.
///
/// The plate stands in the xz plane, its round end at `z_to`.
fn ear(y: f64, z_from: f64, z_to: f64) -> Mesh {
    let half_width = 0.0021;
    let plate = placed(
        tapered(
            [half_width, EAR_HALF_M],
            [half_width, EAR_HALF_M],
            z_from,
            z_to - half_width,
        ),
        &Translation3::new(0.0, y, 0.0).into(),
    );
    let round = lying(
        &cylinder(half_width, y - EAR_HALF_M, y + EAR_HALF_M, 18),
        z_to - half_width,
    );
    let head = lying(
        &cylinder(0.0009, y - EAR_HALF_M - 0.0002, y + EAR_HALF_M + 0.0002, 12),
        z_to - half_width,
    );
    Mesh::merged([plate, round, head])
}

/// A solid about z laid along y, its z turned to y, at height `z`.
fn lying(mesh: &Mesh, z: f64) -> Mesh {
    let rotation =
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -core::f64::consts::FRAC_PI_2);
    placed(
        mesh.clone(),
        &Isometry3::from_parts(Translation3::new(0.0, 0.0, z), rotation),
    )
}
