//! Decides whether the block has been moved, and catches what would only look like it.

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use trocar_world::block::BlockShape;

use super::{BlockTransfer, BoardShape};
use crate::task::judge::{DwellTimer, Limits, PressLimit, Safeguard};
use crate::task::{Criteria, Monitor, MonitorInput, Outcome};

/// What counts as a moved block, and what ends the episode at once.
///
/// Success: once the whole block has been `clear_m` above the pegs in the grip of both fingers, it
/// sits on the goal peg as the limits down to `away_m` say, for `hold_s` without a break. That it
/// was clear is remembered, also if it is dropped later.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuccessConfig {
    /// How far above the pegs' tops the whole block must have been, held by both fingers, m.
    pub clear_m: f64,
    /// Distance of the goal peg from the block's axis, at both ends of the block, m.
    pub around_m: f64,
    /// How far from its resting height the block may be, m.
    pub height_m: f64,
    /// Tilt of the block's axis, rad.
    pub tilt_rad: f64,
    /// Speed of any point of the block, m/s.
    pub speed_m_s: f64,
    /// Distance of the control point from the middle of the block, m; no finger may touch it.
    pub away_m: f64,
    /// How long all this must hold without a break, s.
    pub hold_s: f64,
    /// Largest penetration depth of the fingers and the block, m; deeper is a fault of the
    /// simulation.
    pub penetration_m_max: f64,
    /// Largest penetration depth of the block with board and pegs, m; deeper is a fault of the
    /// simulation.
    pub sunk_m_max: f64,
    /// Speed of a corner of the block above which it counts as thrown, m/s.
    pub block_speed_m_s_max: f64,
    /// Force of one finger on the block above which it counts as crushed, N.
    pub block_force_n_max: f64,
    /// Energy that the block may gain while no instrument touches it, J: more is a fault of the
    /// simulation.
    pub block_gain_j_max: f64,
    /// How hard the ground may be pressed.
    pub press: PressLimit,
}

impl SuccessConfig {
    pub(super) fn check(&self, source: &Source) -> Result<(), ConfigError> {
        let check = |key: &str, value, low, high| {
            source.check_range(&format!("success.{key}"), value, low, high)
        };
        check("clear_m", self.clear_m, 0.0, 0.02)?;
        check("around_m", self.around_m, 0.000_5, 0.01)?;
        check("height_m", self.height_m, 0.000_1, 0.005)?;
        check("tilt_rad", self.tilt_rad, 0.01, 0.5)?;
        check("speed_m_s", self.speed_m_s, 0.000_1, 0.1)?;
        check("away_m", self.away_m, 0.0, 0.05)?;
        check("hold_s", self.hold_s, 0.05, 10.0)?;
        self.limits().check(source, "block")?;
        self.press.check(source)
    }

    const fn limits(&self) -> Limits {
        Limits {
            penetration_m: self.penetration_m_max,
            sunk_m: Some(self.sunk_m_max),
            speed_m_s: self.block_speed_m_s_max,
            force_n: self.block_force_n_max,
            gain_j: self.block_gain_j_max,
        }
    }
}

/// Watches the block.
pub(super) struct SuccessMonitor {
    config: SuccessConfig,
    block: BlockShape,
    board: BoardShape,
    /// Where the goal peg stands, scene x and y, m.
    goal: [f64; 2],
    /// The upper end of a blunt corner, block frame, by whose speed a throw is told.
    corner: Point3<f64>,
    /// The block's pose a millisecond before; none at the first step.
    before: Option<Pose>,
    /// Highest speed of its ends in the newest step, m/s.
    speed_m_s: f64,
    /// Whether the block has been above the pegs in the grip of both fingers; never taken back.
    cleared: bool,
    held: DwellTimer,
    safeguard: Safeguard,
}

impl SuccessMonitor {
    /// A monitor at the start of an episode whose goal is the peg at `goal`.
    pub(super) fn new(scene: &BlockTransfer, goal: [f64; 2]) -> Self {
        let config = scene.success.clone();
        let block = scene.block;
        Self {
            block,
            board: scene.board,
            goal,
            corner: Point3::new(block.corner_m, 0.0, 0.5 * block.height_m),
            before: None,
            speed_m_s: f64::INFINITY,
            cleared: false,
            held: DwellTimer::default(),
            safeguard: Safeguard::new("block", "board", config.limits(), config.press),
            config,
        }
    }

    fn end(&mut self, sight: &MonitorInput) -> Option<Outcome> {
        let corner = sight.thing_in_scene * self.corner;
        let middle = sight.thing_in_scene.translation;
        let board = &self.board;
        let fallen = || !board.covers(middle.x, middle.y) || middle.z < 0.0;
        self.safeguard.end(&corner, sight, fallen)
    }

    /// Whether the whole block is above the pegs in the grip of both fingers. The lowest corner of
    /// its convex pieces decides.
    fn is_clear(&self, sight: &MonitorInput) -> bool {
        let ends = self.block.pieces().into_iter().flatten().flatten();
        let lowest = ends
            .map(|point| (sight.thing_in_scene * point).z)
            .fold(f64::INFINITY, f64::min);
        sight.grasps[0].both_touch && lowest >= self.board.peg_height_m + self.config.clear_m
    }

    /// Whether the block sits on the goal peg and no instrument touches it.
    fn placed(&self, sight: &MonitorInput) -> Criteria {
        let (pose, config) = (&sight.thing_in_scene, &self.config);
        let half = 0.5 * self.block.height_m;
        let aside_m = [-half, half].map(|z| {
            let end = pose * Point3::new(0.0, 0.0, z);
            (end.x - self.goal[0]).hypot(end.y - self.goal[1])
        });
        let aside_m = aside_m[0].max(aside_m[1]);
        let height_m = (pose.translation.z - half).abs();
        let up = (pose * Vector3::z()).z.clamp(-1.0, 1.0).acos();
        // A prism is as well placed upside down.
        let tilt_rad = up.min(core::f64::consts::PI - up);
        let grasp = &sight.grasps[0];
        let touched = grasp.left_force_n > 0.0 || grasp.right_force_n > 0.0;
        let away_m = (sight.tips_in_scene[0].translation.vector - pose.translation.vector).norm();
        Criteria::default()
            .so("lifted clear of the pegs", self.cleared)
            .at_most("axis from the goal peg", "m", aside_m, config.around_m)
            .at_most("from its height at rest", "m", height_m, config.height_m)
            .at_most("tilt", "rad", tilt_rad, config.tilt_rad)
            .at_most("speed", "m/s", self.speed_m_s, config.speed_m_s)
            .so("not touched", !touched)
            .at_least("tip away from it", "m", away_m, config.away_m)
    }

    /// Highest speed of the block's ends since the last step. Of an upper corner and of the middle
    /// of the side opposite at its lower edge, by how far they moved in this millisecond; infinite
    /// at the first step, so that it is never at rest there.
    fn speed_m_s(&mut self, pose: &Pose) -> f64 {
        let Some(before) = self.before.replace(*pose) else {
            return f64::INFINITY;
        };
        let z = 0.5 * self.block.height_m;
        let points = [self.corner, Point3::new(-self.block.side_m, 0.0, -z)];
        points
            .into_iter()
            .map(|point| (pose * point - before * point).norm() * 1e3)
            .fold(0.0, f64::max)
    }
}

impl Monitor for SuccessMonitor {
    fn observe(&mut self, sight: &MonitorInput) -> Outcome {
        if let Some(end) = self.end(sight) {
            return end;
        }
        self.speed_m_s = self.speed_m_s(&sight.thing_in_scene);
        self.cleared |= self.is_clear(sight);
        let held = self.cleared && self.placed(sight).are_met();
        self.held.outcome(held, self.config.hold_s)
    }

    fn missing(&self) -> &'static str {
        if self.cleared {
            "block not on the goal peg"
        } else {
            "block not lifted clear of the pegs"
        }
    }

    fn criteria(&self, sight: &MonitorInput) -> Criteria {
        let (held_s, hold_s) = (self.held.seconds(), self.config.hold_s);
        self.placed(sight)
            .at_least("for so long", "s", held_s, hold_s)
    }
}
