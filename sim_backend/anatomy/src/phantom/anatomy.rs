//! The nominal anatomy: a torso from the upper chest to the hips, mm, x to the right, y to the
//! front, z to the head.
//!
//! Proportions are stylised, and chosen so that parts that must not meet don't: a test proves the
//! nominal anatomy free of conflicts. The order of parts matters, since later ones carve earlier
//! ones. Labels are VISTA3D's numbers, so phantoms go through the same tables as scans.

use nalgebra::{Matrix3, Point3, Rotation3, UnitVector3, Vector3};

use super::shape::{Shape, ellipsoid, tube};

/// A labelled part of the body.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// What it is; `CARVES` and the parts of a phantom's report go by it.
    pub(super) name: String,
    /// VISTA3D's number.
    pub(super) label: u8,
    /// Its solid, nominal mm.
    pub(super) shape: Shape,
    /// Heights (z, mm) below and above which there is nothing of it, as between vertebrae.
    pub(super) between: Option<[f64; 2]>,
    /// Whether patients differ in its place; all but vertebrae and sacrum differ in thickness.
    pub(super) varies: bool,
}

/// Names of parts with the parts into which they reach: the second of a pair is what the first
/// leaves of it.
pub(super) const CARVES: [(&str, &str); 21] = [
    ("heart", "left lung"),
    ("heart", "right lung"),
    ("liver", "right lung"),
    ("liver", "left lung"),
    ("spleen", "left lung"),
    ("stomach", "left lung"),
    ("aorta", "left lung"),
    ("esophagus", "left lung"),
    ("esophagus", "right lung"),
    ("esophagus", "stomach"),
    ("trachea", "left lung"),
    ("trachea", "right lung"),
    ("inferior vena cava", "liver"),
    ("inferior vena cava", "right lung"),
    ("portal vein", "liver"),
    ("gallbladder", "liver"),
    ("right kidney", "liver"),
    ("left iliac artery", "aorta"),
    ("right iliac artery", "aorta"),
    ("right iliac artery", "left iliac artery"),
    ("right iliac vena", "inferior vena cava"),
];

/// Half of the torso's width and depth.
const TORSO: [f64; 2] = [165.0, 110.0];

/// How far `p` is inside of the torso, which is `fat` times as wide and deep as the nominal one;
/// about mm, negative inside.
///
/// A superellipse with the exponent 2.4 at each height, 3.5 % narrower at the waist. First order
/// near the skin only, which is where it is used.
pub(super) fn torso_distance(p: &Point3<f64>, fat: f64) -> f64 {
    // Waist and hips.
    let girth = 1.0 - 0.035 * (p.z / 62.0).cos() * (-(p.z / 160.0).powi(2)).exp();
    let [a, b] = TORSO.map(|half| half * fat * girth);
    let r = ((p.x / a).abs().powf(2.4) + (p.y / b).abs().powf(2.4)).powf(1.0 / 2.4);
    (r - 1.0) * b
}

/// A box around the torso across z, mm.
pub(super) fn torso_reach(fat: f64) -> [f64; 2] {
    TORSO.map(|half| half * fat * 1.04)
}

/// A part that patients vary, without ends.
fn part(name: &str, label: u8, shape: Shape) -> Part {
    Part {
        name: name.to_owned(),
        label,
        shape,
        between: None,
        varies: true,
    }
}

/// A part that stays in its place.
fn fixed(name: &str, label: u8, shape: Shape) -> Part {
    Part {
        varies: false,
        ..part(name, label, shape)
    }
}

/// All parts; where two overlap, the later one carves the earlier.
pub(super) fn parts() -> Vec<Part> {
    let mut parts = chest();
    parts.extend(upper_abdomen());
    parts.extend(bowels());
    parts.extend(vessels());
    parts.extend(spine());
    parts.extend([1.0, -1.0].into_iter().flat_map(ribs));
    parts.extend([1.0, -1.0].into_iter().flat_map(pelvis));
    parts.push(fixed(
        "sternum",
        122,
        ellipsoid([0.0, 91.0, 150.0], [17.0, 5.0, 75.0]),
    ));
    parts
}

/// Lungs, heart and windpipe.
fn chest() -> Vec<Part> {
    vec![
        part(
            "left lung",
            135,
            ellipsoid([-63.0, 0.0, 130.0], [56.0, 63.0, 116.0]),
        ),
        part(
            "right lung",
            136,
            ellipsoid([63.0, 0.0, 130.0], [56.0, 63.0, 116.0]),
        ),
        part(
            "heart",
            115,
            ellipsoid([-15.0, 27.0, 127.0], [46.0, 38.0, 48.0]),
        ),
        fixed(
            "trachea",
            57,
            tube(&[[0.0, 0.0, 200.0, 8.0], [0.0, -4.0, 290.0, 8.0]]),
        ),
    ]
}

/// Liver, kidneys, spleen, gallbladder, stomach, gullet and pancreas.
fn upper_abdomen() -> Vec<Part> {
    // A dome of three lobes under the diaphragm; the visceral face is nearly flat.
    let lobes = Shape::Blend {
        of: vec![
            ellipsoid([62.0, 4.0, 28.0], [57.0, 58.0, 62.0]),
            ellipsoid([26.0, 34.0, 34.0], [44.0, 34.0, 36.0]),
            ellipsoid([-12.0, 50.0, 52.0], [32.0, 18.0, 18.0]),
        ],
        over: 26.0,
    };
    let liver = Shape::Cut {
        of: Box::new(lobes),
        at: Point3::new(50.0, 10.0, -12.0),
        outward: UnitVector3::new_normalize(Vector3::new(-0.30, -0.45, -0.84)),
        over: 9.0,
    };
    let stomach = [
        [-46.0, 14.0, 43.0, 19.0],
        [-60.0, 22.0, 15.0, 23.0],
        [-52.0, 36.0, -18.0, 17.0],
        [-25.0, 44.0, -32.0, 11.0],
    ];
    let esophagus = [
        [2.0, -26.0, 240.0, 5.0],
        [2.0, -26.0, 92.0, 5.0],
        [-20.0, -4.0, 62.0, 6.0],
        [-40.0, 10.0, 50.0, 7.0],
    ];
    let pancreas = [
        [4.0, 12.0, -24.0, 10.0],
        [-15.0, 4.0, -18.0, 9.0],
        [-45.0, -12.0, -8.0, 7.0],
    ];
    vec![
        part("liver", 1, liver),
        part(
            "right kidney",
            5,
            ellipsoid([68.0, -45.0, -22.0], [24.0, 21.0, 45.0]),
        ),
        part(
            "left kidney",
            14,
            ellipsoid([-66.0, -45.0, -40.0], [24.0, 21.0, 45.0]),
        ),
        part(
            "spleen",
            3,
            ellipsoid([-90.0, -20.0, 55.0], [22.0, 32.0, 38.0]),
        ),
        part(
            "gallbladder",
            10,
            ellipsoid([55.0, 42.0, -25.0], [12.0, 14.0, 20.0]),
        ),
        part("stomach", 12, tube(&stomach)),
        fixed("esophagus", 11, tube(&esophagus)),
        part("pancreas", 4, tube(&pancreas)),
    ]
}

/// A tube with folds every 28 mm.
fn haustra(points: &[[f64; 4]]) -> Shape {
    let mut fine = Vec::new();
    let mut travelled = 0.0;
    for pair in points.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        let length = (0..3).map(|i| (b[i] - a[i]).powi(2)).sum::<f64>().sqrt();
        for step in 0..10 {
            let t = f64::from(step) / 10.0;
            let mut at = [0, 1, 2, 3].map(|i| a[i] + (b[i] - a[i]) * t);
            at[3] += 1.5 * ((travelled + t * length) * std::f64::consts::TAU / 28.0).cos();
            fine.push(at);
        }
        travelled += length;
    }
    fine.extend(points.last().copied());
    tube(&fine)
}

/// Colon, small bowel, duodenum and bladder. The bowel is one tube a part and not connected to the
/// stomach.
fn bowels() -> Vec<Part> {
    let colon = [
        [78.0, 20.0, -128.0, 13.0],
        [96.0, 18.0, -84.0, 13.0],
        [88.0, 42.0, -72.0, 12.0],
        [40.0, 68.0, -80.0, 12.0],
        [0.0, 72.0, -84.0, 12.0],
        [-40.0, 68.0, -78.0, 12.0],
        [-88.0, 42.0, -66.0, 12.0],
        [-98.0, 12.0, -74.0, 12.0],
        [-94.0, 8.0, -104.0, 12.0],
        [-80.0, 14.0, -132.0, 12.0],
        [-52.0, 0.0, -165.0, 12.0],
        [-8.0, -32.0, -182.0, 12.0],
        [0.0, -40.0, -235.0, 13.0],
    ];
    let loops = [
        [45.0, 28.0, -90.0, 9.5],
        [-45.0, 28.0, -90.0, 9.5],
        [-52.0, 30.0, -114.0, 9.5],
        [52.0, 30.0, -114.0, 9.5],
        [52.0, 56.0, -116.0, 9.5],
        [-52.0, 56.0, -116.0, 9.5],
        [-50.0, 56.0, -141.0, 9.5],
        [50.0, 56.0, -141.0, 9.5],
        [50.0, 30.0, -140.0, 9.5],
        [-30.0, 30.0, -140.0, 9.5],
    ];
    let duodenum = [
        [30.0, 34.0, -46.0, 8.0],
        [40.0, 8.0, -66.0, 8.0],
        [8.0, 0.0, -70.0, 8.0],
    ];
    vec![
        part("colon", 62, haustra(&colon)),
        part("small bowel", 19, tube(&loops)),
        part("duodenum", 13, tube(&duodenum)),
        part(
            "bladder",
            15,
            ellipsoid([0.0, 25.0, -197.0], [38.0, 33.0, 25.0]),
        ),
    ]
}

/// Straight pieces of the large ones.
fn vessels() -> Vec<Part> {
    vec![
        fixed(
            "aorta",
            6,
            tube(&[[-25.0, -32.0, 185.0, 11.0], [-25.0, -32.0, -105.0, 9.0]]),
        ),
        fixed(
            "inferior vena cava",
            7,
            tube(&[[25.0, -30.0, 72.0, 10.0], [25.0, -30.0, -103.0, 9.0]]),
        ),
        fixed(
            "portal vein",
            17,
            tube(&[[30.0, -6.0, -30.0, 6.0], [42.0, 0.0, 4.0, 5.0]]),
        ),
        fixed(
            "left iliac artery",
            58,
            tube(&[[-25.0, -32.0, -105.0, 6.5], [-36.0, -22.0, -138.0, 6.0]]),
        ),
        fixed(
            "right iliac artery",
            59,
            tube(&[
                [-25.0, -32.0, -105.0, 6.5],
                [0.0, -8.0, -124.0, 6.0],
                [30.0, 4.0, -165.0, 6.0],
            ]),
        ),
        fixed(
            "right iliac vena",
            61,
            tube(&[[25.0, -30.0, -103.0, 7.5], [40.0, -22.0, -165.0, 7.0]]),
        ),
    ]
}

/// Vertebrae L5 to T6, 32 mm each, with their muscles, and the sacrum.
fn spine() -> Vec<Part> {
    let mut parts = Vec::new();
    for level in 0..12_u8 {
        let z = -110.0 + 32.0 * f64::from(level);
        let body = [
            [0.0, -60.0, z - 8.0, 18.0],
            [0.0, -60.0, z + 3.0, 20.0],
            [0.0, -60.0, z + 16.0, 17.5],
            [0.0, -60.0, z + 29.0, 20.0],
            [0.0, -60.0, z + if level == 11 { 90.0 } else { 40.0 }, 18.0],
        ];
        let process = [[0.0, -72.0, z + 16.0, 9.0], [0.0, -93.0, z + 10.0, 5.0]];
        let name = format!("vertebra {}", level + 1);
        let shape = Shape::Blend {
            of: vec![tube(&body), tube(&process)],
            over: 4.0,
        };
        parts.push(Part {
            // The highest leaves the scan.
            between: Some([z, if level == 11 { 330.0 } else { z + 32.0 }]),
            ..fixed(&name, 33 + level, shape)
        });
    }
    let sacrum = [
        [0.0, -62.0, -104.0, 20.0],
        [0.0, -75.0, -150.0, 18.0],
        [0.0, -80.0, -190.0, 12.0],
    ];
    parts.push(Part {
        between: Some([-230.0, -110.0]),
        ..fixed("sacrum", 97, tube(&sacrum))
    });
    for (side, name, label) in [(-1.0, "left", 104), (1.0, "right", 105)] {
        let along = [
            [32.0 * side, -86.0, -110.0, 13.0],
            [33.0 * side, -86.0, 300.0, 14.0],
        ];
        parts.push(fixed(&format!("{name} autochthon"), label, tube(&along)));
        let psoas = [
            [50.0 * side, -54.0, -112.0, 12.0],
            [52.0 * side, -50.0, -150.0, 14.0],
            [56.0 * side, -40.0, -190.0, 12.0],
        ];
        parts.push(fixed(&format!("{name} iliopsoas"), label + 2, tube(&psoas)));
    }
    parts
}

/// Ten ribs of a side (1 right, -1 left).
fn ribs(side: f64) -> Vec<Part> {
    let (name, first) = if side > 0.0 {
        ("right", 75)
    } else {
        ("left", 63)
    };
    (0..10_u8)
        .map(|rib| {
            let z = 236.0 - 25.0 * f64::from(rib);
            // The lower ones do not reach the front.
            let end = if rib < 7 {
                2.78
            } else {
                2.4 - 0.35 * f64::from(rib - 7)
            };
            let points: Vec<[f64; 4]> = (0..=24)
                .map(|step| {
                    let angle = 0.43 + (end - 0.43) * f64::from(step) / 24.0;
                    let fall = 40.0 * (angle - 0.43) / 2.35;
                    [
                        side * 140.0 * angle.sin(),
                        -90.0 * angle.cos(),
                        z - fall,
                        5.0,
                    ]
                })
                .collect();
            fixed(
                &format!("{name} rib {}", rib + 1),
                first + rib,
                tube(&points),
            )
        })
        .collect()
}

/// The hip bone and the head of the thigh bone of a side.
fn pelvis(side: f64) -> Vec<Part> {
    let (name, offset) = if side > 0.0 {
        ("right", 1)
    } else {
        ("left", 0)
    };
    // The thin axis points outwards and back.
    let thin = Vector3::new(0.78 * side, -0.62, 0.0).normalize();
    let up = Vector3::z();
    let axes = Matrix3::from_columns(&[thin, up.cross(&thin), up]);
    let tilt = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.12 * side);
    let wing = Shape::Ellipsoid {
        centre: Point3::new(98.0 * side, -40.0, -165.0),
        radii: Vector3::new(8.0, 42.0, 48.0),
        axes: tilt.matrix() * axes,
    };
    let femur = tube(&[
        [92.0 * side, -10.0, -246.0, 19.0],
        [110.0 * side, -10.0, -262.0, 15.0],
        [114.0 * side, -10.0, -320.0, 14.0],
    ]);
    vec![
        fixed(&format!("{name} hip"), 95 + offset, wing),
        fixed(&format!("{name} femur"), 93 + offset, femur),
    ]
}
