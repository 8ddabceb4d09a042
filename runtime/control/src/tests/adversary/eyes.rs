//! What an outsider sees: the distance to every boundary, worked out from the arm's table by
//! search. It shares no code with the controller but the parsed configuration.

use hal::Pose;
use hal::psm::{DH, DhRow, FINGER_M, SHAFT_RADIUS_M, TIP_FROM_WRIST_YAW};
use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Rotation3, Vector3};

use crate::config::ControlConfig;
use crate::motion::{AXES, Axes, JAW};
use crate::region::{Block, Shape};

/// Shaft, wrist, left and right finger.
pub(in crate::tests) const LINKS: usize = 4;

/// One limit on where an arm may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::tests) enum Boundary {
    /// An end of an axis's range.
    Axis { arm: usize, axis: usize, high: bool },
    /// A face of the workspace for the control point (0) or a finger tip (1, 2).
    Workspace {
        arm: usize,
        point: usize,
        axis: usize,
        high: bool,
    },
    /// A forbidden region for one link.
    Region {
        arm: usize,
        region: usize,
        link: usize,
    },
    /// A forbidden region for the far end of a link alone.
    End {
        arm: usize,
        region: usize,
        link: usize,
    },
    /// The gap between the shafts of two arms.
    Shafts,
    /// The gap between one arm's link and the other one's shaft.
    ToShaft { arm: usize, link: usize },
}

impl Boundary {
    /// Every boundary of `config`'s arms.
    pub(in crate::tests) fn all(config: &ControlConfig) -> Vec<Self> {
        let mut all = Vec::new();
        for (arm, place) in config.arms.iter().enumerate() {
            for high in [false, true] {
                all.extend((0..AXES).map(|axis| Self::Axis { arm, axis, high }));
                all.extend((0..9).map(|index| Self::Workspace {
                    arm,
                    point: index / 3,
                    axis: index % 3,
                    high,
                }));
            }
            for region in 0..place.forbidden.len() {
                all.extend((0..LINKS).map(|link| Self::Region { arm, region, link }));
            }
        }
        if config.arms.len() == 2 {
            all.push(Self::Shafts);
            for arm in 0..2 {
                all.extend((1..LINKS).map(|link| Self::ToShaft { arm, link }));
            }
        }
        all
    }

    /// Every link's end at every region with flat faces; where a link is nearest to these can jump
    /// from end to end.
    pub(in crate::tests) fn ends(config: &ControlConfig) -> Vec<Self> {
        let mut ends = Vec::new();
        for (arm, place) in config.arms.iter().enumerate() {
            for (region, forbidden) in place.forbidden.iter().enumerate() {
                if matches!(forbidden.shape, Shape::Box(_) | Shape::HalfSpace { .. }) {
                    ends.extend((0..LINKS).map(|link| Self::End { arm, region, link }));
                }
            }
        }
        ends
    }

    /// How far the arms at `positions` are from it, m (rad for a turning axis); negative beyond it.
    pub(in crate::tests) fn clearance(self, config: &ControlConfig, positions: &[Axes]) -> f64 {
        match self {
            Self::Axis { arm, axis, high } => {
                let (limits, position) = (&config.axes[axis], positions[arm][axis]);
                if high {
                    limits.high - position
                } else {
                    position - limits.low
                }
            }
            Self::Workspace {
                arm,
                point,
                axis,
                high,
            } => {
                let body = Body::at(&positions[arm]);
                let point_m = [body.tip, body.left, body.right][point];
                let block = &config.arms[arm].workspace;
                let local = into_block(block, &point_m)[axis];
                if high {
                    block.half_m[axis] - local
                } else {
                    block.half_m[axis] + local
                }
            }
            Self::Region { arm, region, link } => {
                let (from, to) = Body::at(&positions[arm]).links()[link];
                let shape = &config.arms[arm].forbidden[region].shape;
                least(|s| distance(shape, &from.lerp(&to, s))) - SHAFT_RADIUS_M
            }
            Self::End { arm, region, link } => {
                let end = Body::at(&positions[arm]).links()[link].1;
                distance(&config.arms[arm].forbidden[region].shape, &end) - SHAFT_RADIUS_M
            }
            Self::Shafts => between(config, positions, (0, 0), (1, 0), |gaps| {
                gaps.shaft_to_shaft_m
            }),
            Self::ToShaft { arm, link } => {
                between(config, positions, (arm, link), (1 - arm, 0), |gaps| {
                    gaps.tip_to_shaft_m
                })
            }
        }
    }
}

fn between(
    config: &ControlConfig,
    positions: &[Axes],
    one: (usize, usize),
    other: (usize, usize),
    gap_m: impl Fn(&crate::config::BetweenArms) -> f64,
) -> f64 {
    let ends = |(arm, link): (usize, usize)| {
        let body = Body::at(&positions[arm]).moved(&config.arms[arm].scene_from_rcm);
        body.links()[link]
    };
    let ((a, b), (c, d)) = (ends(one), ends(other));
    let gap_m = config.between_arms.as_ref().map_or(0.0, gap_m);
    least(|s| to_segment(&a.lerp(&b, s), &c, &d)) - 2.0 * SHAFT_RADIUS_M - gap_m
}

/// The instrument's points, m.
#[derive(Clone, Copy, Debug)]
pub(in crate::tests) struct Body {
    pub(in crate::tests) rcm: Point3<f64>,
    pub(in crate::tests) wrist: Point3<f64>,
    pub(in crate::tests) tip: Point3<f64>,
    pub(in crate::tests) left: Point3<f64>,
    pub(in crate::tests) right: Point3<f64>,
}

impl Body {
    /// The instrument in the RCM frame, the product of the table's rows.
    pub(in crate::tests) fn at(position: &Axes) -> Self {
        let (wrist, tip) = chain(position);
        let half = 0.5 * position[JAW].max(0.0);
        let finger = |side: f64| {
            tip.transform_point(&Point3::new(
                0.0,
                side * half.sin() * FINGER_M,
                half.cos() * FINGER_M,
            ))
        };
        Self {
            rcm: Point3::origin(),
            wrist,
            tip: tip.transform_point(&Point3::origin()),
            left: finger(1.0),
            right: finger(-1.0),
        }
    }

    /// The instrument seen from another frame.
    pub(in crate::tests) fn moved(&self, frame: &Pose) -> Self {
        let frame: &Isometry3<f64> = frame;
        Self {
            rcm: frame * self.rcm,
            wrist: frame * self.wrist,
            tip: frame * self.tip,
            left: frame * self.left,
            right: frame * self.right,
        }
    }

    /// The ends of its links.
    pub(in crate::tests) fn links(&self) -> [(Point3<f64>, Point3<f64>); LINKS] {
        [
            (self.rcm, self.wrist),
            (self.wrist, self.tip),
            (self.tip, self.left),
            (self.tip, self.right),
        ]
    }
}

/// The wrist-pitch axis and the tip frame, both from the RCM frame.
fn chain(position: &Axes) -> (Point3<f64>, Matrix4<f64>) {
    let mut here = Matrix4::identity();
    let mut wrist = Point3::origin();
    for (index, (row, &value)) in DH.iter().zip(position).enumerate() {
        here *= link(row, value);
        if index == DH.len() - 2 {
            wrist = here.transform_point(&Point3::origin());
        }
    }
    let turn = Matrix3::from_fn(|row, column| TIP_FROM_WRIST_YAW[row][column]);
    (wrist, here * turn.to_homogeneous())
}

/// `Rx(alpha) Tx(a) Rz(theta) Tz(d)`.
fn link(row: &DhRow, value: f64) -> Matrix4<f64> {
    let (theta, d) = if row.prismatic {
        (row.theta, row.d + value)
    } else {
        (row.theta + value, row.d)
    };
    let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle).to_homogeneous();
    about(Vector3::x_axis(), row.alpha)
        * Matrix4::new_translation(&Vector3::new(row.a, 0.0, 0.0))
        * about(Vector3::z_axis(), theta)
        * Matrix4::new_translation(&Vector3::new(0.0, 0.0, d))
}

/// The least value of a convex function on 0..=1, by golden sections.
fn least(value: impl Fn(f64) -> f64) -> f64 {
    const SECTION: f64 = 0.618_033_988_749_894_9;
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    let mut best = value(low).min(value(high));
    let (mut a, mut b) = (high - SECTION, low + SECTION);
    let (mut at_a, mut at_b) = (value(a), value(b));
    for _ in 0..44 {
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - SECTION * (high - low);
            at_a = value(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + SECTION * (high - low);
            at_b = value(b);
        }
        best = best.min(at_a).min(at_b);
    }
    best
}

fn into_block(block: &Block, point: &Point3<f64>) -> Vector3<f64> {
    block.axes.inverse() * (point.coords - block.center_m)
}

/// From a point to the surface of a shape, negative inside.
pub(in crate::tests) fn distance(shape: &Shape, point: &Point3<f64>) -> f64 {
    match shape {
        Shape::Sphere { center_m, radius_m } => (point.coords - center_m).norm() - radius_m,
        Shape::Capsule {
            from_m,
            to_m,
            radius_m,
        } => to_segment(point, &Point3::from(*from_m), &Point3::from(*to_m)) - radius_m,
        Shape::HalfSpace { point_m, normal } => (point.coords - point_m).dot(normal),
        Shape::Box(block) => {
            let over = into_block(block, point).abs() - block.half_m;
            over.map(|x| x.max(0.0)).norm() + over.max().min(0.0)
        }
    }
}

fn to_segment(point: &Point3<f64>, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
    let along = to - from;
    let fraction = (point - from).dot(&along) / along.norm_squared().max(1e-30);
    (point - from.lerp(to, fraction.clamp(0.0, 1.0))).norm()
}
