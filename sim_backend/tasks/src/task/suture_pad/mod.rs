//! Suture pad: one arm grasps a needle that lies on a pad and drives it through the hole in the pad's lip.

mod pad;
mod script;
mod success;

use core::f64::consts::PI;

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use trocar_render::visual::{Backdrop, Material, Pattern, Visual, instance};
use trocar_world::needle::NeedleShape;
use trocar_world::rng::Rng;
use trocar_world::{ArmStart, Ground, RigidBody, Scenery, WorldConfig};

pub use pad::PadShape;
use script::Driver;
pub use success::SuccessConfig;
use success::SuccessMonitor;

use super::common::{ArmFile, CommonFile, EpisodeFile, RenderingFile, TitleFile};
use super::visuals::NEEDLE_STEEL;
use super::{CameraConfig, Kind, Monitor, Parsed, TaskScene};
use crate::script::AnyScript;
use crate::script::alone::Alone;

/// The name by which scene files know this kind of scene.
pub const NAME: &str = "suture-pad";

pub(super) const KIND: Kind = Kind {
    name: NAME,
    arms: 1,
    parts: &[],
    parse,
};

/// How far above the pad the needle is let go, m: it must not start inside.
const DROP_M: f64 = 0.000_1;

/// Silicone of one colour.
const fn silicone(base_colour: [f32; 3], pattern: Pattern) -> Material {
    Material {
        base_colour,
        metallic: 0.0,
        roughness: 0.5,
        wetness: 0.12,
        detail: 0.9,
        pattern,
    }
}

/// The layers of the pad: skin, fat, muscle, and the ink that marks the hole.
const LAYERS: [(&str, Material); 4] = [
    ("skin", silicone([0.50, 0.24, 0.16], Pattern::Skin)),
    ("fat", silicone([0.60, 0.42, 0.12], Pattern::Smooth)),
    ("muscle", silicone([0.33, 0.035, 0.03], Pattern::Smooth)),
    ("ink", silicone([0.015, 0.02, 0.07], Pattern::Smooth)),
];

/// The scene of a suture pad.
#[derive(Clone, Debug)]
pub struct SuturePad {
    /// The needle.
    pub needle: NeedleShape,
    /// Where the needle may lie at the start.
    pub start: PadStart,
    /// The pad.
    pub pad: PadShape,
    /// What counts as success.
    pub success: SuccessConfig,
}

/// Where the needle may lie on the pad.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PadStart {
    /// Middle of the region in which the centre of the needle's arc lies, scene x and y, m.
    pub centre_m: [f64; 2],
    /// Half the size of the region along scene x and y, m.
    pub range_m: [f64; 2],
    /// Rotation of the needle, rad; at 0 its arc bulges towards +x.
    pub yaw_rad: f64,
    /// Half the range of a uniform error of the yaw, rad.
    pub yaw_jitter_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(rename = "task")]
    _task: TitleFile,
    episode: EpisodeFile,
    arm: Vec<ArmFile>,
    needle: NeedleShape,
    needle_start: PadStart,
    pad: PadShape,
    world: WorldConfig,
    camera: Vec<CameraConfig>,
    #[serde(default)]
    rendering: RenderingFile,
    success: SuccessConfig,
}

fn parse(source: &Source) -> Result<Parsed, ConfigError> {
    let file: File = source.parse()?;
    file.needle.check(source, "needle")?;
    // It is driven through the hole along its arc.
    for (index, uneven) in file.needle.uneven.into_iter().enumerate() {
        source.check_range(&format!("needle.uneven.{index}"), uneven, 0.0, 0.0)?;
    }
    file.needle_start.check(source, "needle_start")?;
    file.pad.check(source, "pad")?;
    file.success.check(source)?;
    let common = CommonFile {
        arm: file.arm,
        world: file.world,
        camera: file.camera,
        rendering: file.rendering,
        episode: file.episode,
    };
    let scene = SuturePad {
        needle: file.needle,
        start: file.needle_start,
        pad: file.pad,
        success: file.success,
    };
    Ok((common, Box::new(scene)))
}

impl PadStart {
    fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        for axis in 0..2 {
            let (centre, range) = (self.centre_m[axis], self.range_m[axis]);
            source.check_range(&format!("{key}.centre_m.{axis}"), centre, -0.05, 0.05)?;
            source.check_range(&format!("{key}.range_m.{axis}"), range, 0.0, 0.05)?;
        }
        source.check_range(&format!("{key}.yaw_rad"), self.yaw_rad, -PI, PI)?;
        let jitter = self.yaw_jitter_rad;
        source.check_range(&format!("{key}.yaw_jitter_rad"), jitter, 0.0, PI)
    }

    /// The needle's pose at the start of the episode `seed`, flat and just above the pad.
    fn draw(&self, seed: u64, needle: &NeedleShape) -> Pose {
        let mut rng = Rng::stream(seed, "needle");
        let mut about = |centre: f64, range: f64| centre + rng.range(-range, range);
        let x = about(self.centre_m[0], self.range_m[0]);
        let y = about(self.centre_m[1], self.range_m[1]);
        let yaw = about(self.yaw_rad, self.yaw_jitter_rad);
        Pose::from_parts(
            Translation3::new(x, y, needle.wire_radius_m + DROP_M),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        )
    }
}

impl TaskScene for SuturePad {
    fn scenery(&self, seed: u64) -> Scenery {
        let in_scene = self.start.draw(seed, &self.needle);
        Scenery {
            things: vec![RigidBody::bare_needle(&self.needle, in_scene)],
            ground: Ground::Solids(self.pad.solids()),
            flap: None,
        }
    }

    fn goal(&self, _seed: u64) -> Option<Pose> {
        Some(Pose::from_parts(
            self.pad.hole().into(),
            UnitQuaternion::identity(),
        ))
    }

    fn monitor(&self, _seed: u64) -> Box<dyn Monitor> {
        Box::new(SuccessMonitor::new(self))
    }

    fn expert(&self, arms: &[ArmStart], seed: u64) -> Box<dyn AnyScript> {
        Box::new(Alone::new(Driver::new(self), arms, seed))
    }

    fn visuals(&self) -> Vec<Visual> {
        let layers = LAYERS.into_iter().zip(self.pad.meshes());
        let needle = Visual::new("needle", self.needle.mesh(), NEEDLE_STEEL, instance::NEEDLE);
        layers
            .map(|((name, material), mesh)| {
                Visual::new(name, mesh, material, instance::ORGAN).still()
            })
            .chain([needle])
            .collect()
    }

    fn backdrop(&self) -> Backdrop {
        Backdrop::table(-self.pad.thickness_m, [0.30, 0.17, 0.13])
    }

    fn visual_poses(&self, things: &[Pose], _goal: &Pose) -> Vec<Pose> {
        let mut poses = vec![Pose::identity(); LAYERS.len()];
        poses.push(things[0]);
        poses
    }
}

#[cfg(test)]
impl SuturePad {
    /// The scene as it ships.
    pub(crate) fn shipped() -> Self {
        let task = super::TaskConfig::shipped(NAME);
        task.scene::<Self>().unwrap().clone()
    }
}

#[cfg(test)]
mod tests;
