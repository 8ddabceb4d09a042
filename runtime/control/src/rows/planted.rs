//! Faults that a test plants in the rows, to see that something finds them.

use super::pair::PAIRS;
use super::{Rows, Velocities};
use crate::config::ControlConfig;
use crate::instrument::Link;
use crate::region::Shape;

/// Which row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// Lower bound of an axis.
    Low(usize),
    /// Upper bound of an axis.
    High(usize),
    /// A row of geometry, by its place.
    Geometry(usize),
    /// A tip's speed or angular speed, by its place.
    Cone(usize),
}

/// What is wrong with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wrong {
    /// It is not there.
    Dropped,
    /// It asks for the opposite.
    Negated,
}

/// A fault in one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RowFault {
    pub(crate) which: Which,
    pub(crate) wrong: Wrong,
}

impl RowFault {
    /// Every fault that these rows can have. A cone is the same with its matrix negated, so it can
    /// only be dropped.
    pub(crate) fn all(rows: &Rows) -> Vec<Self> {
        let axes = (0..rows.variables).flat_map(|axis| [Which::Low(axis), Which::High(axis)]);
        let geometry = (0..rows.geometry.len()).map(Which::Geometry);
        let cones = (0..rows.cones.len()).map(Which::Cone);
        let dropped = axes.clone().chain(geometry.clone()).chain(cones);
        let dropped = dropped.map(|which| (which, Wrong::Dropped));
        let negated = axes.chain(geometry).map(|which| (which, Wrong::Negated));
        dropped
            .chain(negated)
            .map(|(which, wrong)| Self { which, wrong })
            .collect()
    }
}

/// What each row of geometry is about, in their order.
pub(crate) fn geometry_names(config: &ControlConfig) -> Vec<String> {
    let mut names = Vec::new();
    for arm in &config.arms {
        for point in ["control_point", "left_finger", "right_finger"] {
            for side in ["x_min", "x_max", "y_min", "y_max", "z_min", "z_max"] {
                names.push(format!("{}.workspace.{point}.{side}", arm.name));
            }
        }
        for region in &arm.forbidden {
            let flat = matches!(region.shape, Shape::HalfSpace { .. } | Shape::Box(_));
            for link in Link::ALL {
                let name = format!("{}.{}.{}", arm.name, region.name, link.name());
                names.push(name.clone());
                if flat {
                    names.push(format!("{name}.end"));
                }
            }
        }
    }
    if config.arms.len() > 1 && config.between_arms.is_some() {
        names.extend(PAIRS.map(|(one, other)| format!("between.{}.{}", one.name(), other.name())));
    }
    names
}

impl Rows {
    /// Makes the row wrong. A negated bound `x >= low` reads `x <= -low`.
    pub(crate) fn plant(&mut self, fault: &RowFault) {
        let negated = fault.wrong == Wrong::Negated;
        match fault.which {
            Which::Low(axis) => {
                if negated {
                    self.high[axis] = self.high[axis].min(-self.low[axis]);
                }
                self.low[axis] = -1e3;
            }
            Which::High(axis) => {
                if negated {
                    self.low[axis] = self.low[axis].max(-self.high[axis]);
                }
                self.high[axis] = 1e3;
            }
            Which::Geometry(index) => {
                let row = &mut self.geometry[index];
                let turn: fn(&mut f64) = if negated { |x| *x = -*x } else { |x| *x = 0.0 };
                let coefficients: &mut Velocities = &mut row.coefficients;
                coefficients.iter_mut().for_each(turn);
            }
            Which::Cone(index) => self.cones[index].limit = 1e3,
        }
    }
}
