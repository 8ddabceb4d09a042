//! Walls of every kind: along them, straight into them, and long in front of them.

use nalgebra::{Rotation3, Vector3};

use super::{follow, least_clearance, target, tip_m};
use crate::config::ControlConfig;
use crate::motion::{AXES, Axes};
use crate::region::{Block, Region, Shape};
use crate::tests::adversary::rig::{Rig, Scene};

/// The height of every wall below the remote centre, m; the finger tips at home are 30 mm above it.
const FLOOR_M: f64 = -0.154;

/// A horizontal wall of each kind: the workspace's floor, a plane, the face of a box, the back of a
/// capsule, the top of a ball.
fn walls() -> Vec<(&'static str, ControlConfig)> {
    let kinds = ["workspace", "half_space", "box", "capsule", "sphere"];
    kinds.map(|kind| (kind, wall(kind))).to_vec()
}

fn wall(kind: &str) -> ControlConfig {
    let mut config = Scene::crowded().config;
    let arm = &mut config.arms[0];
    arm.forbidden.clear();
    let (floor_m, top_m) = if kind == "workspace" {
        (FLOOR_M, -0.06)
    } else {
        (FLOOR_M - 0.04, -0.06)
    };
    arm.workspace = Block {
        center_m: Vector3::new(0.0, 0.0, (floor_m + top_m) / 2.0),
        half_m: Vector3::new(0.06, 0.06, (top_m - floor_m) / 2.0),
        axes: Rotation3::identity(),
    };
    let below = |depth_m: f64| Vector3::new(0.0, 0.0, FLOOR_M - depth_m);
    // The shaft's radius is about every link, so a region's surface is that much deeper.
    let radius_m = hal::psm::SHAFT_RADIUS_M;
    let shape = match kind {
        "half_space" => Some(Shape::HalfSpace {
            point_m: below(radius_m),
            normal: Vector3::z(),
        }),
        "box" => Some(Shape::Box(Block {
            center_m: below(radius_m + 0.01),
            half_m: Vector3::new(0.05, 0.05, 0.01),
            axes: Rotation3::identity(),
        })),
        "capsule" => Some(Shape::Capsule {
            from_m: below(radius_m + 0.03) - Vector3::x() * 0.05,
            to_m: below(radius_m + 0.03) + Vector3::x() * 0.05,
            radius_m: 0.03,
        }),
        "sphere" => Some(Shape::Sphere {
            center_m: below(radius_m + 0.15),
            radius_m: 0.15,
        }),
        _ => None,
    };
    if let Some(shape) = shape {
        let name = kind.to_owned();
        config.arms[0].forbidden.push(Region { name, shape });
    }
    config
}

/// The jerk as a drive sees it, third differences of the setpoints, as shares of the limits.
#[derive(Default)]
struct Jerk {
    last: [Axes; 3],
    ticks: u32,
    squares: f64,
    most: f64,
}

impl Jerk {
    fn look(&mut self, config: &ControlConfig, position: Axes) {
        let [a, b, c] = self.last;
        self.last = [position, a, b];
        self.ticks += 1;
        if self.ticks <= 3 {
            return;
        }
        for axis in 0..AXES {
            let difference = position[axis] - 3.0 * a[axis] + 3.0 * b[axis] - c[axis];
            let share = difference / 1e-9 / config.axes[axis].jerk;
            self.squares += share * share / AXES as f64;
            self.most = self.most.max(share.abs());
        }
    }

    /// Root of the mean over time and axes.
    fn rms(&self) -> f64 {
        (self.squares / f64::from(self.ticks - 3)).sqrt()
    }
}

/// What became of a motion along a wall that presses against it.
struct Slide {
    /// Of the wanted way along the wall.
    share: f64,
    /// Ticks in which the guard intervened, and in which the filter did, of all.
    stopped: usize,
    pressed: usize,
    ticks: usize,
    /// The least clearance of the measured arm, m.
    nearest_m: f64,
}

/// Leads the finger tips down to 8 mm beyond the wall and then along it; the measured yaw is
/// `off_rad` from the commanded one.
fn slide(config: &ControlConfig, speed_m_s: f64, off_rad: f64) -> Slide {
    let mut rig = Rig::<1>::enabled(config);
    if off_rad > 0.0 {
        (rig.follows, rig.off_rad) = (0.9999, off_rad);
    }
    let path = |_: usize, time_s: f64| {
        let along_m = speed_m_s * (time_s - 3.0).max(0.0);
        let down_m = 0.038 * (time_s / 2.0).min(1.0);
        let x_m = -0.015 + along_m;
        target(Vector3::new(x_m, 0.0, -0.1135 - down_m), Vector3::zeros())
    };
    let mut xs = Vec::new();
    let (mut stopped, mut nearest_m, mut pressed) = (0, f64::INFINITY, 0);
    follow(&mut rig, 3.0 + 0.03 / speed_m_s, path, |rig, outputs| {
        let positions = rig.positions();
        nearest_m = nearest_m.min(least_clearance(config, &positions));
        if rig.now().seconds() > 3.3 {
            xs.push(tip_m(&positions[0]).x);
            stopped += usize::from(outputs[0].report.guard_intervened);
            pressed += usize::from(outputs[0].report.correction > 1e-6);
        }
    });
    let way_m = xs.last().unwrap() - xs.first().unwrap();
    Slide {
        share: way_m / (speed_m_s * 1e-3 * (xs.len() - 1) as f64),
        stopped,
        pressed,
        ticks: xs.len(),
        nearest_m,
    }
}

/// Slides along every wall at two speeds.
fn slide_along_all(off_rad: f64) {
    for (kind, config) in walls() {
        for speed_m_s in [0.01, 0.03] {
            let slide = slide(&config, speed_m_s, off_rad);
            println!(
                "sliding, {kind} at {speed_m_s} m/s, off {off_rad} rad: {:.1} % of the speed, guard {} of {} ticks, nearest {:.3} mm",
                100.0 * slide.share,
                slide.stopped,
                slide.ticks,
                1e3 * slide.nearest_m,
            );
            let Slide {
                share, nearest_m, ..
            } = slide;
            assert!(share >= 0.9, "{kind}: {share}");
            assert!(slide.pressed > slide.ticks / 2, "{kind}: {}", slide.pressed);
            assert!(nearest_m >= config.margins.guard_m, "{kind}: {nearest_m}");
        }
    }
}

#[test]
fn sliding_along_a_wall_keeps_the_speed_along_it() {
    slide_along_all(0.0);
}

/// A constant following error of 2 mm is more than the filter's margin has over the guard's: the
/// filter keeps its distance as the guard does, so that the arm slides along the wall instead of
/// being stopped in front of it.
#[test]
fn a_constant_following_error_leaves_the_speed_along_it() {
    slide_along_all(0.016);
}

/// A minute with the target 15 mm beyond the wall, at rest or on a circle of 4 mm; gives the jerk,
/// after 3 s.
fn minute(kind: &str, config: &ControlConfig, circle_m: f64, depth_m: f64) -> Jerk {
    let mut rig = Rig::<1>::enabled(config);
    let path = |_: usize, time_s: f64| {
        let down_m = depth_m * (time_s / 2.0).min(1.0);
        let (sine, cosine) = (0.25 * core::f64::consts::TAU * time_s).sin_cos();
        let place_m = Vector3::new(circle_m * cosine, circle_m * sine, -0.1135 - down_m);
        target(place_m, Vector3::zeros())
    };
    let (mut jerk, mut stopped, mut nearest_m) = (Jerk::default(), 0_u32, f64::INFINITY);
    follow(&mut rig, 60.0, path, |rig, outputs| {
        if rig.now().seconds() > 3.0 {
            let positions = rig.positions();
            jerk.look(config, positions[0]);
            stopped += u32::from(outputs[0].report.guard_intervened);
            if rig.tick % 10 == 0 {
                nearest_m = nearest_m.min(least_clearance(config, &positions));
            }
        }
    });
    println!(
        "a minute, {kind}, depth {depth_m} m, circle of {circle_m} m: jerk rms {:.1e} of the limits, most {:.1e}, guard {stopped}, \
         nearest {:.3} mm",
        jerk.rms(),
        jerk.most,
        1e3 * nearest_m,
    );
    assert!(nearest_m >= config.margins.guard_m, "{kind}: {nearest_m}");
    jerk
}

#[test]
fn a_target_within_a_region_for_a_minute_makes_no_chatter() {
    for (kind, config) in walls() {
        let at_rest = minute(kind, &config, 0.0, 0.045).rms();
        assert!(at_rest < 1e-4, "{kind}: {at_rest}");
        // What the kinks between the steps of a chunk make of the same motion without a wall.
        let free = minute(kind, &config, 0.004, 0.0).rms();
        let pressed = minute(kind, &config, 0.004, 0.045).rms();
        assert!(pressed < 1.2 * free, "{kind}: {pressed}, free {free}");
    }
}

#[test]
fn head_on_at_full_speed_stops_in_front_of_the_wall() {
    for (kind, mut config) in walls() {
        config.gate.jump_m_max = 1.0;
        let mut rig = Rig::<1>::enabled(&config);
        // Half a second at home for the soft start, then 10 cm beyond the wall at once.
        let path = |_: usize, time_s: f64| {
            let down_m = if time_s > 1.0 { 0.13 } else { 0.0 };
            target(Vector3::new(0.0, 0.0, -0.1135 - down_m), Vector3::zeros())
        };
        let (mut nearest_m, mut fastest_m_s, mut before) = (f64::INFINITY, 0.0_f64, None);
        follow(&mut rig, 6.0, path, |rig, _| {
            let positions = rig.positions();
            nearest_m = nearest_m.min(least_clearance(&config, &positions));
            let tip = tip_m(&positions[0]);
            if let Some(before) = before.replace(tip) {
                fastest_m_s = fastest_m_s.max((tip - before).norm() / 1e-3);
            }
        });
        let left_m = least_clearance(&config, &rig.positions());
        println!(
            "head-on, {kind}: up to {:.1} mm/s, nearest {:.3} mm, {:.3} mm left at rest",
            1e3 * fastest_m_s,
            1e3 * nearest_m,
            1e3 * left_m,
        );
        assert!(nearest_m >= config.margins.guard_m, "{kind}: {nearest_m}");
        assert!(
            fastest_m_s > 0.05 && fastest_m_s <= config.tip_speed_m_s,
            "{kind}: {fastest_m_s}"
        );
        assert!(left_m < config.margins.filter_m + 1e-3, "{kind}: {left_m}");
    }
}

#[test]
fn in_a_corner_of_three_walls_the_arm_comes_to_rest() {
    let config = wall("workspace");
    for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
        let mut rig = Rig::<1>::enabled(&config);
        let path = |_: usize, time_s: f64| {
            let part = (time_s / 4.0).min(1.0);
            let corner_m = Vector3::new(0.08 * signs[0], 0.08 * signs[1], -0.06);
            target(
                Vector3::new(0.0, 0.0, -0.1135) + corner_m * part,
                Vector3::zeros(),
            )
        };
        let (mut nearest_m, mut speed, mut most_rows) = (f64::INFINITY, 0.0_f64, 0);
        follow(&mut rig, 12.0, path, |rig, outputs| {
            nearest_m = nearest_m.min(least_clearance(&config, &rig.positions()));
            if rig.now().seconds() > 10.0 {
                speed = speed.max(outputs[0].command.velocity.amax());
                most_rows = most_rows.max(outputs[0].report.rows_active);
            }
        });
        println!(
            "corner {signs:?}: nearest {:.3} mm, speed at the end {speed:.1e}, {most_rows} rows active",
            1e3 * nearest_m
        );
        assert!(nearest_m >= config.margins.guard_m, "{nearest_m}");
        assert!(speed < 1e-2, "{speed}");
        assert!(most_rows >= 3, "{most_rows}");
    }
}
