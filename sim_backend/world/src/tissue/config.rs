//! Everything about the tissue that a file may say, and the check that the numbers are stable
//! together.

use core::f64::consts::PI;

use hal::config::{ConfigError, Source};
use hal::{Pose, TICK_S};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::grasp::GraspConfig;
use super::ground::ContactParameters;
use super::material::Material;
use super::sheet::{Sheet, SheetShape, count, longest_step_s};
use super::surface::Surface;

/// A flap of tissue, attached to the body along one edge, and what touches it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TissueConfig {
    /// Length of the attached edge and of the free edge opposite, m: the material's u axis.
    pub length_m: f64,
    /// From the attached to the free edge, m, along the material's v axis. The grid goes on behind
    /// the attached edge for half a cell: its first two rows of nodes are fixed, and the edge is
    /// half way between them.
    pub depth_m: f64,
    /// Cells along u and v. Elasticity needs none smaller than a few times the thickness.
    pub cells: [usize; 2],
    /// Middle of the attached edge, scene x and y, m; its height is the ground's.
    pub edge_m: [f64; 2],
    /// Rotation of the material's axes about the scene's z, rad; at 0 the free edge is towards +y.
    pub yaw_rad: f64,
    /// What the flap is made of.
    pub material: Material,
    /// Contact with the organ below.
    pub ground: ContactParameters,
    /// Contact with the instrument.
    pub instrument: ContactParameters,
    /// How a jaw holds it.
    pub grasp: GraspConfig,
    /// Where the mark may be.
    pub mark: MarkConfig,
    /// Steps of the integrator in one millisecond.
    pub substeps: u32,
    /// Gravity, m/s², along -z.
    pub gravity_m_s2: f64,
}

/// Where the mark may be.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkConfig {
    /// Length of the middle part of the free edge over which it is drawn uniformly, m.
    pub span_m: f64,
    /// Its distance from the free edge, m.
    pub inset_m: f64,
}

/// Share of the stability limit of the sheet at rest that a sub-step may use: a sheet stretched by
/// half as much again is 1.6 times as fast.
const STRETCHED_SHARE: f64 = 0.62;
/// Share of the stability limit of the contacts that a sub-step may use: the sheet bends beside
/// them.
const CONTACT_SHARE: f64 = 0.85;

impl TissueConfig {
    /// Checks the ranges of a tissue read from `source` at the dotted `key`, and that its sub-steps
    /// are short enough.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        let of = |name: &str| format!("{key}.{name}");
        source.check_range(&of("length_m"), self.length_m, 0.01, 0.3)?;
        source.check_range(&of("depth_m"), self.depth_m, 0.01, 0.3)?;
        for axis in 0..2 {
            let (key, cells) = (of(&format!("cells.{axis}")), count(self.cells[axis]));
            source.check_range(&key, cells, 2.0, 60.0)?;
            source.check_range(&of(&format!("edge_m.{axis}")), self.edge_m[axis], -0.2, 0.2)?;
        }
        source.check_range(&of("yaw_rad"), self.yaw_rad, -PI, PI)?;
        self.material.check(source, &of("material"))?;
        self.ground.check(source, &of("ground"))?;
        self.instrument.check(source, &of("instrument"))?;
        self.grasp.check(source, &of("grasp"))?;
        self.mark.check(source, &of("mark"), self)?;
        source.check_range(&of("gravity_m_s2"), self.gravity_m_s2, 0.0, 20.0)?;
        let (substeps, least) = (f64::from(self.substeps), self.substeps_min());
        source.check_range(&of("substeps"), substeps, least, 64.0)
    }

    /// Fewest sub-steps that are stable, with room for a stretched sheet and for the stiffness of
    /// its contacts.
    #[must_use]
    pub fn substeps_min(&self) -> f64 {
        let elastic = self.sheet(&Pose::identity()).fastest_rad_s();
        let step_s = longest_step_s(elastic * elastic, self.material.relaxation_s);
        let mut most_s = STRETCHED_SHARE * step_s;
        // The ground on one side and both fingers of a shut jaw on the other.
        let per_kg = self.material.mass_kg_m2().recip();
        let stiffness = self.ground.stiffness_n_m3 + 2.0 * self.instrument.stiffness_n_m3;
        let fastest = stiffness * per_kg;
        let damping_ratio = self.ground.damping_ratio.max(self.instrument.damping_ratio);
        let step_s = longest_step_s(fastest, 2.0 * damping_ratio / fastest.sqrt());
        most_s = most_s.min(CONTACT_SHARE * step_s);
        (TICK_S / most_s).ceil()
    }

    /// The sheet at rest in `pose`, its first two rows fixed: the attached edge keeps its place and
    /// its slope.
    pub(super) fn sheet(&self, pose: &Pose) -> Sheet {
        let shape = SheetShape {
            size_m: [self.length_m, self.grid_depth_m()],
            cells: self.cells,
        };
        let gravity = Vector3::new(0.0, 0.0, -self.gravity_m_s2);
        let mut sheet = Sheet::new(&shape, &self.material, pose, gravity);
        for node in 0..2 * sheet.nodes()[0] {
            sheet.fix(node);
        }
        sheet
    }

    /// The scene frame from the grid's frame (u along x, v along y) before the flap is laid down.
    pub(super) fn scene_from_material(&self) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw_rad);
        let edge = Translation3::new(self.edge_m[0], self.edge_m[1], 0.0);
        let behind_m = self.grid_depth_m() - self.depth_m;
        edge * turn * Translation3::new(-0.5 * self.length_m, -behind_m, 0.0)
    }

    /// What to draw of the flap, before it is laid down.
    #[must_use]
    pub fn surface(&self) -> Surface {
        Surface::new(&self.sheet(&self.scene_from_material()))
    }

    /// Size of the grid along v, m: the depth and half a cell.
    #[must_use]
    pub fn grid_depth_m(&self) -> f64 {
        let cells = count(self.cells[1]);
        self.depth_m * cells / (cells - 0.5)
    }
}
