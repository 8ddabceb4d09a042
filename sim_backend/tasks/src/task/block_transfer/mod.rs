//! Block transfer: one arm takes a block off its peg, lifts it clear of the pegs and puts it on the
//! pink one.
//!
//! Drawn for each episode: the peg on which the block starts, each but the goal as likely, and the
//! goal peg too if the file names none; then how the block hangs on its peg, by [`BlockStart`]. The
//! goal is the foot of the goal peg. On a board alone: there is no patient.

mod board;
mod script;
mod success;

use core::f64::consts::PI;

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use trocar_render::visual::{Backdrop, Material, Part, Pattern, Visual, instance};
use trocar_world::block::BlockShape;
use trocar_world::rng::Rng;
use trocar_world::{
    ArmStart, Collider, CollisionMask, Ground, RigidBody, Scenery, Shape, WorldConfig,
};

pub use board::BoardShape;
use script::Mover;
pub use success::SuccessConfig;
use success::SuccessMonitor;

use super::common::{ArmFile, CommonFile, EpisodeFile, RenderingFile, TitleFile};
use super::{CameraConfig, Kind, Monitor, Parsed, TaskScene};
use crate::script::AnyScript;
use crate::script::alone::Alone;

/// The name by which scene files know this kind of scene.
pub const NAME: &str = "block-transfer";

/// Instance id of the training block.
pub const BLOCK: u8 = 9;

/// Instance id of the pegs of the board.
pub const PEG: u8 = 10;

/// Instance id of the peg that the block belongs on.
pub const GOAL_PEG: u8 = 11;

pub(super) const KIND: Kind = Kind {
    name: NAME,
    arms: 1,
    parts: &[
        Part::new(BLOCK, "block", [50, 100, 230]),
        Part::new(PEG, "peg", [240, 240, 240]),
        Part::new(GOAL_PEG, "goal peg", [250, 110, 190]),
    ],
    parse,
};

/// How far above the board the block is let go, m: it must not start inside.
const DROP_M: f64 = 0.000_1;

/// The scene of a block transfer.
#[derive(Clone, Debug)]
pub struct BlockTransfer {
    /// The block.
    pub block: BlockShape,
    /// How the block may sit on its peg at the start.
    pub start: BlockStart,
    /// The board.
    pub board: BoardShape,
    /// What counts as success.
    pub success: SuccessConfig,
}

/// Where the block may start, and how it may sit there.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockStart {
    /// The peg that is the goal, counted from 0 in the board's list; if not given it is drawn as
    /// well. The block starts on one that is drawn among the others.
    pub goal_peg: Option<usize>,
    /// Half the range of its uniform turn about the peg, rad.
    pub yaw_rad: f64,
    /// Half the range of its uniform shift in x and y, m.
    pub shift_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(rename = "task")]
    _task: TitleFile,
    episode: EpisodeFile,
    arm: Vec<ArmFile>,
    block: BlockShape,
    block_start: BlockStart,
    board: BoardShape,
    world: WorldConfig,
    camera: Vec<CameraConfig>,
    #[serde(default)]
    rendering: RenderingFile,
    success: SuccessConfig,
}

fn parse(source: &Source) -> Result<Parsed, ConfigError> {
    let file: File = source.parse()?;
    file.block.check(source, "block")?;
    file.board.check(source, "board")?;
    file.success.check(source)?;
    source.check_range("block_start.yaw_rad", file.block_start.yaw_rad, 0.0, PI)?;
    let last_peg = file.board.pegs_m.len() - 1;
    if let Some(peg) = file.block_start.goal_peg.filter(|&peg| peg > last_peg) {
        let allowed = format!("[0, {last_peg}]");
        return Err(source.out_of_range("block_start.goal_peg", &peg.to_string(), &allowed));
    }
    // The block hangs on its peg, it does not start in it.
    let room_m = file.block.hole_m - file.board.peg_radius_m;
    source.check_range(
        "block_start.shift_m",
        file.block_start.shift_m,
        0.0,
        0.6 * room_m,
    )?;
    let common = CommonFile {
        arm: file.arm,
        world: file.world,
        camera: file.camera,
        rendering: file.rendering,
        episode: file.episode,
    }
    .check(source, KIND.arms)?;
    let scene = BlockTransfer {
        block: file.block,
        start: file.block_start,
        board: file.board,
        success: file.success,
    };
    Ok((common, Box::new(scene)))
}

impl BlockTransfer {
    /// The pegs on which the block starts and where it belongs, in the episode `seed`.
    fn pegs(&self, seed: u64) -> [[f64; 2]; 2] {
        let mut rng = Rng::stream(seed, "pegs");
        let count = self.board.pegs_m.len();
        let another = |peg: usize, rng: &mut Rng| (peg + 1 + rng.below(count - 1)) % count;
        let [start, goal] = if let Some(goal) = self.start.goal_peg {
            [another(goal, &mut rng), goal]
        } else {
            let start = rng.below(count);
            [start, another(start, &mut rng)]
        };
        [start, goal].map(|peg| self.board.pegs_m[peg])
    }

    /// Upright, just above the board, about its peg: shifted in x and y, and turned, all uniformly.
    fn block_at_start(&self, seed: u64) -> Pose {
        let [[x, y], _] = self.pegs(seed);
        let mut rng = Rng::stream(seed, "block");
        let mut shift = || rng.range(-self.start.shift_m, self.start.shift_m);
        let (x, y) = (x + shift(), y + shift());
        let yaw = rng.range(-self.start.yaw_rad, self.start.yaw_rad);
        Pose::from_parts(
            Translation3::new(x, y, 0.5 * self.block.height_m + DROP_M),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        )
    }
}

impl TaskScene for BlockTransfer {
    fn scenery(&self, seed: u64) -> Scenery {
        let pieces = self.block.pieces().map(|ends| Collider {
            shape: Shape::Hull(ends.into_iter().flatten().collect()),
            meets: CollisionMask::Both,
        });
        let block = RigidBody {
            in_scene: self.block_at_start(seed),
            mass_kg: self.block.mass_kg,
            centre: Point3::origin(),
            inertia: self.block.inertia(),
            axes: UnitQuaternion::identity(),
            pieces: pieces.into(),
        };
        Scenery {
            things: vec![block],
            ground: Ground::Solids(self.board.solids()),
            flap: None,
        }
    }

    fn goal(&self, seed: u64) -> Option<Pose> {
        let [_, [x, y]] = self.pegs(seed);
        Some(Pose::translation(x, y, 0.0))
    }

    fn monitor(&self, seed: u64) -> Box<dyn Monitor> {
        let [_, goal] = self.pegs(seed);
        Box::new(SuccessMonitor::new(self, goal))
    }

    fn expert(&self, arms: &[ArmStart], seed: u64) -> Box<dyn AnyScript> {
        Box::new(Alone::new(Mover::new(self), arms, seed))
    }

    fn visuals(&self) -> Vec<Visual> {
        let mut visuals = vec![
            Visual::new(
                "board",
                self.board.mesh(),
                paint([0.26, 0.27, 0.28]),
                instance::ORGAN,
            ),
            Visual::new("block", self.block.mesh(), paint([0.02, 0.11, 0.48]), BLOCK),
            Visual::new(
                "goal peg",
                self.board.peg_mesh(),
                paint([0.85, 0.06, 0.30]),
                GOAL_PEG,
            ),
        ];
        visuals
            .extend((1..self.board.pegs_m.len()).map(|_| {
                Visual::new("peg", self.board.peg_mesh(), paint([0.62, 0.61, 0.56]), PEG)
            }));
        visuals
    }

    fn backdrop(&self) -> Backdrop {
        Backdrop::table(-self.board.thickness_m, [0.22, 0.23, 0.24])
    }

    fn visual_poses(&self, things: &[Pose], goal: &Pose) -> Vec<Pose> {
        let mut pegs = self.board.pegs_m.map(|[x, y]| Pose::translation(x, y, 0.0));
        let away = |peg: &Pose| (peg.translation.vector - goal.translation.vector).norm();
        pegs.sort_by(|a, b| away(a).total_cmp(&away(b)));
        [Pose::identity(), things[0]]
            .into_iter()
            .chain(pegs)
            .collect()
    }
}

/// A matt plastic.
const fn paint(base_colour: [f32; 3]) -> Material {
    Material {
        base_colour,
        metallic: 0.0,
        roughness: 0.38,
        wetness: 0.0,
        detail: 1.0,
        pattern: Pattern::Smooth,
    }
}

#[cfg(test)]
impl BlockTransfer {
    /// The scene as it ships.
    pub(crate) fn shipped() -> Self {
        let task = super::TaskConfig::shipped(NAME);
        task.scene::<Self>().unwrap().clone()
    }
}

#[cfg(test)]
mod tests;
