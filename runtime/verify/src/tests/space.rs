//! Workspaces and forbidden regions: each limit broken alone, and kept by a hair.

use core::f64::consts::FRAC_PI_2;

use hal::JointVector;
use hal::psm::{FINGER_M, RCC_M, SHAFT_RADIUS_M, TOOL_M, WRIST_M};
use nalgebra::{Point3, Rotation3, Vector3};

use super::distances::sampled;
use super::scene::{HOME, Random, Scene};
use crate::chain::{Instrument, LINK_NAMES};
use crate::differences::AXES;
use crate::tip_in_rcm;

/// A rotation by quarter turns that takes `from` to `to`.
fn quarter_turns(from: Vector3<f64>, to: Vector3<f64>) -> [f64; 3] {
    let angles = [-FRAC_PI_2, 0.0, FRAC_PI_2, 2.0 * FRAC_PI_2];
    let all = angles
        .iter()
        .flat_map(|&roll| angles.iter().map(move |&pitch| (roll, pitch)))
        .flat_map(|(roll, pitch)| angles.iter().map(move |&yaw| [roll, pitch, yaw]));
    let takes = |[roll, pitch, yaw]: &[f64; 3]| {
        (Rotation3::from_euler_angles(*roll, *pitch, *yaw) * from - to).norm() < 1e-9
    };
    all.into_iter().find(takes).unwrap()
}

#[test]
fn each_side_of_the_workspace_is_caught_alone_for_each_point() {
    let depth = HOME[2] - RCC_M + TOOL_M + WRIST_M;
    let half_jaw: f64 = 0.6;
    let mut closed = HOME;
    closed[6] = 0.0;
    let mut open = HOME;
    open[6] = 2.0 * half_jaw;
    let mut deep = HOME;
    deep[2] += 0.02;
    // At home the left finger opens towards the RCM frame's x, and the control point is above both
    // finger tips.
    let cases = [
        (
            "left_finger_tip",
            Vector3::x(),
            closed,
            open,
            FINGER_M * half_jaw.sin(),
        ),
        (
            "right_finger_tip",
            -Vector3::x(),
            closed,
            open,
            FINGER_M * half_jaw.sin(),
        ),
        ("control_point", Vector3::z(), deep, HOME, -depth),
    ];
    for (point, outward_in_rcm, before, after, reach) in cases {
        for axis in 0..3 {
            for (side, sign) in [("min", -1.0), ("max", 1.0)] {
                let mut outward = Vector3::zeros();
                outward[axis] = sign;
                let broken_at = |slack: f64| {
                    let mut scene = Scene::loose(1);
                    let arm = &mut scene.arms[0];
                    arm.place = [0.1, -0.2, 0.3];
                    arm.rpy = quarter_turns(outward_in_rcm, outward);
                    let bound = arm.place[axis] + sign * (reach + slack);
                    let end = if sign < 0.0 {
                        &mut arm.low
                    } else {
                        &mut arm.high
                    };
                    end[axis] = bound;
                    scene.broken_by(&[before, after, after])
                };
                let letter = ["x", "y", "z"][axis];
                let name = format!("workspace.{point}.{letter}_{side}");
                assert_eq!(broken_at(-2e-6), [name.as_str()]);
                assert!(broken_at(1e-9).is_empty(), "{name}");
            }
        }
    }
}

/// A region as a text, and as a measure of its own: how far outside a point is.
#[derive(Clone, Debug)]
struct Region {
    shape: usize,
    center: [f64; 3],
    direction: Vector3<f64>,
    size: [f64; 3],
    rpy: [f64; 3],
}

const SHAPES: [&str; 4] = ["sphere", "capsule", "half_space", "box"];

impl Region {
    fn text(&self) -> String {
        let Self {
            shape,
            center,
            size,
            rpy,
            ..
        } = self;
        let (center, direction) = (Vector3::from(*center), self.direction);
        let numbers = |vector: Vector3<f64>| format!("{:?}", <[f64; 3]>::from(vector));
        let radius = size[0];
        let keys = match shape {
            0 => format!("center_m = {}\nradius_m = {radius:?}", numbers(center)),
            1 => format!(
                "from_m = {}\nto_m = {}\nradius_m = {radius:?}",
                numbers(center - direction * size[1]),
                numbers(center + direction * size[1])
            ),
            2 => format!(
                "point_m = {}\nnormal = {}",
                numbers(center),
                numbers(direction)
            ),
            _ => format!(
                "center_m = {}\nsize_m = {size:?}\nrpy_rad = {rpy:?}",
                numbers(center)
            ),
        };
        let shape = SHAPES[*shape];
        format!("[[forbidden]]\nname = \"it\"\nshape = \"{shape}\"\n{keys}\n")
    }

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        let from_center = point - Vector3::from(self.center);
        match self.shape {
            0 => from_center.norm() - self.size[0],
            1 => {
                let along = from_center.dot(&self.direction);
                let beyond = (along.abs() - self.size[1]).max(0.0);
                let aside = (from_center - self.direction * along).norm();
                aside.hypot(beyond) - self.size[0]
            }
            2 => from_center.dot(&self.direction),
            _ => {
                let [roll, pitch, yaw] = self.rpy;
                let axes = Rotation3::from_euler_angles(roll, pitch, yaw);
                let seen = axes.inverse() * from_center;
                let excess: [f64; 3] =
                    core::array::from_fn(|axis| seen[axis].abs() - self.size[axis] / 2.0);
                let [x, y, z] = excess;
                if x > 0.0 || y > 0.0 || z > 0.0 {
                    (x.max(0.0).powi(2) + y.max(0.0).powi(2) + z.max(0.0).powi(2)).sqrt()
                } else {
                    x.max(y).max(z)
                }
            }
        }
    }

    /// Gap to a link's surface, by sampling.
    fn gap(&self, (start, end): (Point3<f64>, Point3<f64>)) -> f64 {
        sampled(start, end, |point| self.distance(&point.coords)) - SHAFT_RADIUS_M
    }
}

fn instrument(place: &[f64; AXES]) -> Instrument {
    let [joints @ .., jaw] = *place;
    let tip = tip_in_rcm(&JointVector::from(joints));
    let at = Instrument::new(&hal::Pose::identity(), &JointVector::from(joints), jaw);
    assert!((at.control_point.coords - tip.translation.vector).norm() < 1e-15);
    at
}

/// A region aside of a place on a link, and the way there.
fn region(
    random: &mut Random,
    shape: usize,
    (start, end): (Point3<f64>, Point3<f64>),
) -> (Region, Vector3<f64>) {
    let target = start.lerp(&end, random.between(0.3, 0.7)).coords;
    let aside = Vector3::from(random.vector(1.0)).cross(&(end - start));
    let direction = Vector3::from(random.vector(1.0)).normalize();
    let way = if shape == 2 {
        direction
    } else {
        -aside.normalize()
    };
    let region = Region {
        shape,
        center: (target - way * 0.3).into(),
        direction,
        size: core::array::from_fn(|_| random.between(0.001, 0.004)),
        rpy: random.vector(3.0),
    };
    (region, way)
}

/// Moves the region on its way until its gap to the nearest link is `target_m`.
fn push(
    region: &mut Region,
    way: &Vector3<f64>,
    links: &[(Point3<f64>, Point3<f64>); 4],
    target_m: f64,
) {
    let start = Vector3::from(region.center);
    let (mut near, mut far) = (0.0, 0.3);
    for _ in 0..26 {
        let middle = f64::midpoint(near, far);
        region.center = (start + way * middle).into();
        let touches = links.iter().any(|link| region.gap(*link) < target_m);
        let end = if touches { &mut far } else { &mut near };
        *end = middle;
    }
}

#[test]
fn each_link_is_caught_alone_at_each_shape() {
    let mut random = Random(11);
    let mut alone = [[0; 4]; 4];
    let mut kept = 0;
    for trial in 0..800 {
        let (shape, link, touch) = (trial % 4, trial / 4 % 4, trial / 16 % 2 == 0);
        let (before, after) = (random.place(), random.place());
        let links = instrument(&after).links();
        let (mut region, way) = region(&mut random, shape, links[link]);
        push(&mut region, &way, &links, if touch { -1e-5 } else { 1e-7 });
        let was_clear = instrument(&before).links().into_iter();
        if was_clear.map(|link| region.gap(link)).any(|gap| gap < 1e-4) {
            continue;
        }
        let gaps = links.map(|link| region.gap(link));
        let found: Vec<_> = (0..4).filter(|&link| gaps[link] < -1e-6).collect();
        let names = found.iter().map(|&link| LINK_NAMES[link]);
        let mut names: Vec<_> = names.map(|link| format!("forbidden.it.{link}")).collect();
        names.sort();
        let mut scene = Scene::loose(1);
        scene.regions = region.text();
        assert_eq!(
            scene.broken_by(&[before, after]),
            names,
            "{region:?} {gaps:?}"
        );
        match found.as_slice() {
            [] => kept += 1,
            [link] => alone[shape][*link] += 1,
            _ => {}
        }
    }
    // A half-space touches ends of links only; where shaft and wrist end, others begin.
    for (shape, counts) in alone.iter().enumerate() {
        let possible = counts.iter().skip(if shape == 2 { 2 } else { 0 });
        assert!(possible.into_iter().all(|count| *count >= 3), "{alone:?}");
    }
    assert!(kept > 200, "{kept}");
}

#[test]
fn two_regions_and_two_frames_are_told_apart() {
    // The arm stands a quarter turn about its y and 0.3 m aside: its instrument points along the
    // scene's -x.
    let mut scene = Scene::loose(1);
    scene.arms[0].place = [0.3, 0.0, 0.1];
    scene.arms[0].rpy = [0.0, FRAC_PI_2, 0.0];
    let tips = HOME[2] - RCC_M + TOOL_M + WRIST_M + FINGER_M * (HOME[6] / 2.0).cos();
    let mut shallow = HOME;
    shallow[2] -= 0.02;
    let floor = |x: f64| {
        format!(
            "[[forbidden]]\nname = \"floor\"\nshape = \"half_space\"\npoint_m = [{x:?}, 0, 0]\nnormal = [1, 0, 0]\n\
             [[forbidden]]\nname = \"far\"\nshape = \"sphere\"\ncenter_m = [0, 1, 0]\nradius_m = 0.1\n"
        )
    };
    let surface = 0.3 - tips - SHAFT_RADIUS_M;
    scene.regions = floor(surface + 2e-6);
    assert_eq!(
        scene.broken_by(&[shallow, HOME]),
        [
            "forbidden.floor.left_finger",
            "forbidden.floor.right_finger"
        ]
    );
    scene.regions = floor(surface - 1e-9);
    assert!(scene.broken_by(&[shallow, HOME]).is_empty());
}
