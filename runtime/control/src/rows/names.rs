//! What the rows are called, for people who look at a run.

use hal::joints::JOINT_NAMES;

use super::pair::PAIRS;
use crate::config::{ArmConfig, ControlConfig};
use crate::instrument::Link;
use crate::region::Shape;

/// Parts of an instrument that stay in the workspace, in the order of their rows.
const IN_WORKSPACE: [Link; 3] = [Link::Wrist, Link::LeftFinger, Link::RightFinger];

/// The upper and lower bound of each axis.
fn ranges(names: &mut Vec<String>, arm: &ArmConfig) {
    for axis in JOINT_NAMES.into_iter().chain(["jaw"]) {
        for side in ["upper", "lower"] {
            names.push(format!("{} {axis}, {side} bound", arm.name));
        }
    }
}

/// A name for each row of [`Problem`](crate::filter::Problem) in its order, the cones after the
/// linear rows, such as `psm1 insertion, upper bound`.
#[must_use]
pub fn names(config: &ControlConfig) -> Vec<String> {
    let mut names = Vec::new();
    for arm in &config.arms {
        ranges(&mut names, arm);
    }
    for arm in &config.arms {
        boundaries(&mut names, arm);
    }
    if let ([one, other], Some(_)) = (config.arms.as_slice(), &config.between_arms) {
        for (link, other_link) in PAIRS {
            let (link, other_link) = (link.name(), other_link.name());
            names.push(format!(
                "{} {link} to {} {other_link}",
                one.name, other.name
            ));
        }
    }
    for arm in &config.arms {
        names.push(format!("{} tip speed", arm.name));
        names.push(format!("{} tip angular speed", arm.name));
    }
    names
}

/// Three points of six faces, then the regions. Shapes with flat faces have two rows a link, the
/// nearest place and the end, under the same name.
fn boundaries(names: &mut Vec<String>, arm: &ArmConfig) {
    for link in IN_WORKSPACE {
        for axis in ["x", "y", "z"] {
            for side in ["lower", "upper"] {
                let (arm, link) = (&arm.name, link.name());
                names.push(format!("{arm} workspace, {side} {axis}, {link}"));
            }
        }
    }
    for region in &arm.forbidden {
        let flat = matches!(region.shape, Shape::HalfSpace { .. } | Shape::Box(_));
        for link in Link::ALL {
            for _ in 0..=usize::from(flat) {
                names.push(format!("{} {}, {}", arm.name, region.name, link.name()));
            }
        }
    }
}
