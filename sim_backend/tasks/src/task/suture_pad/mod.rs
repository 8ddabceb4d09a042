//! Suture pad: one arm grasps a needle that lies on a pad and drives it through the hole in the
//! pad's lip.
//!
//! On a patient the lip is a fold of an organ, on which the needle lies.
//!
//! Drawn for each episode: where the needle lies before the lip, by [`PadStart`]. The goal is the
//! middle of the hole, unturned: the needle goes through along the scene's y.

mod cast;
mod fold;
mod pad;
mod script;
mod success;

use core::f64::consts::PI;
use core::iter;
use std::sync::Arc;

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use trocar_render::visual::{Backdrop, Material, Pattern, Visual, instance};
use trocar_world::needle::NeedleShape;
use trocar_world::organ::Organ;
use trocar_world::rng::Rng;
use trocar_world::{ArmStart, Ground, RigidBody, Scenery, SoftOrgan, Surface, WorldConfig};

use fold::{Fold, ROOT_M};
pub use pad::PadShape;
use script::Driver;
pub use success::SuccessConfig;
use success::SuccessMonitor;

use super::common::{ArmFile, CommonFile, EpisodeFile, RenderingFile, TitleFile};
use super::needle_start::NeedleStart;
use super::patient::{self, Patient, SceneFile, Site, WIDE};
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

/// Mean height of a patient's patch, m: the workspace ends 3 mm below z = 0, and the lip's hole is
/// from 7 mm on.
const RAISED_M: f64 = 0.003;

/// How far before and behind a fold's hole the organ must be below it, m.
const WAY_M: f64 = 0.010;

/// Contact with a patient's organ, of each of the needle's balls and of each sample point of the
/// instrument, as in the needle lift.
const ON_ORGAN: Surface = Surface {
    stiffness_n_m: 150.0,
    damping_n_s_m: 0.3,
    friction: 0.5,
    patch_m: 0.0,
};
/// The same of what presses on it: each sample point of the instrument.
const PRESSED_ORGAN: Surface = Surface {
    stiffness_n_m: 800.0,
    damping_n_s_m: 4.0,
    friction: 0.3,
    patch_m: 0.0,
};

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

/// How many visuals a fold of a patient's organ has: itself and the ink.
const FOLD_VISUALS: usize = 2;

/// The scene of a suture pad.
#[derive(Clone, Debug)]
pub struct SuturePad {
    /// The needle.
    pub needle: NeedleShape,
    /// Where the needle may lie at the start.
    pub start: PadStart,
    /// The pad.
    pub pad: PadShape,
    /// Whose organ has a fold in the place of its lip, if it is a patient's.
    pub patient: Option<Arc<Patient>>,
    /// What counts as success.
    pub success: SuccessConfig,
}

/// Where the needle may lie on the pad. Unlike in [`NeedleStart`] the region is of the arc's
/// centre, not of the wire's middle.
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
    scene: Option<SceneFile>,
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
    }
    .check(source, KIND.arms)?;
    patient::without_choice(source, file.scene.as_ref())?;
    let patient = file.scene.as_ref().map(|scene| {
        let site = site(&file.pad, &file.needle_start, &file.needle);
        let start = file.needle_start.on_organ(&file.needle);
        let fits = |organ: &Organ| {
            start.check_on(source, &file.needle, organ)?;
            check_fold(source, &file.pad, organ)?;
            let scenery = |seed| before_fold(&file.pad, &start, &file.needle, organ, seed);
            common.check_rests(source, &scene.organ, scenery)
        };
        Ok(Arc::new(scene.load(source, &site, fits)?))
    });
    let patient = patient.transpose()?;
    let scene = SuturePad {
        patient,
        needle: file.needle,
        start: file.needle_start,
        pad: file.pad,
        success: file.success,
    };
    Ok((common, Box::new(scene)))
}

/// What the scene needs of a patient's organ: what the pad covers, the flattest between needles and
/// fold.
fn site(pad: &PadShape, start: &PadStart, needle: &NeedleShape) -> Site {
    let arc = start.on_organ(needle);
    let y = 0.5 * (pad.lip_front_m + arc.centre_m[1]);
    Site {
        half_m: [0.5 * pad.length_m, 0.5 * pad.width_m],
        centre_m: [arc.centre_m[0], y, RAISED_M],
        radii_m: WIDE,
        incision: None,
    }
}

/// Checks that the middle of a fold's hole is above `organ`, from where a needle comes to where it
/// goes, and that its foot is in it along the fold's middle line.
fn check_fold(source: &Source, pad: &PadShape, organ: &Organ) -> Result<(), ConfigError> {
    let refused = |key: &str, value_m: f64, reason: String| {
        Err(source.refused(&format!("pad.{key}"), &format!("{value_m}"), &reason))
    };
    let (hole, begins_m) = (pad.hole(), pad.hole_height_m - pad.hole_half_m);
    let ways_m = [-WAY_M, 0.0, WAY_M].map(|way_m| organ.height_m(0.0, hole.y + way_m));
    let highest_m = ways_m.into_iter().fold(f64::NEG_INFINITY, f64::max);
    if highest_m > begins_m {
        let [organ, hole] = [highest_m, begins_m].map(|height_m| 1e3 * height_m);
        let reason =
            format!("the organ reaches up to {organ:.1} mm, the hole begins at {hole:.1} mm");
        return refused("hole_height_m", pad.hole_height_m, reason);
    }
    let end_m = 0.5 * pad.lip_length_m;
    let along_m = [-1.0, -0.75, -0.5, 0.5, 0.75, 1.0].map(|share| share * end_m);
    if along_m
        .into_iter()
        .any(|x| organ.height_m(x, hole.y) < -ROOT_M)
    {
        let reason = "the foot of a fold of this length is not in the organ everywhere";
        return refused("lip_length_m", pad.lip_length_m, reason.to_owned());
    }
    Ok(())
}

/// A needle on a patient's `organ`, before the fold that is there in the place of the lip of `pad`,
/// at the start of the episode `seed`.
fn before_fold(
    pad: &PadShape,
    start: &NeedleStart,
    needle: &NeedleShape,
    organ: &Organ,
    seed: u64,
) -> Scenery {
    let in_scene = start.draw(seed, needle, organ);
    let soft = SoftOrgan {
        organ: organ.clone(),
        ground: ON_ORGAN,
        press: PRESSED_ORGAN,
    };
    Scenery {
        things: vec![RigidBody::needle_on_any_ground(needle, in_scene)],
        ground: Ground::OrganWithSolids(soft, Fold::of(pad).solids()),
        flap: None,
    }
}

/// A patient's organ as things meet it.
fn organ_of(patient: &Patient) -> Organ {
    Organ::Measured(Arc::clone(&patient.organ))
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

    /// The same region for the middle of the arc, from which needles on organs are drawn.
    fn on_organ(&self, needle: &NeedleShape) -> NeedleStart {
        let (sin, cos) = self.yaw_rad.sin_cos();
        let bulge_m = [cos, sin].map(|along| needle.arc_radius_m * along);
        NeedleStart {
            centre_m: [0, 1].map(|axis| self.centre_m[axis] + bulge_m[axis]),
            range_m: self.range_m,
            yaw_rad: self.yaw_rad,
            yaw_jitter_rad: self.yaw_jitter_rad,
        }
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
        if let Some(organ) = self.organ() {
            let start = self.start.on_organ(&self.needle);
            return before_fold(&self.pad, &start, &self.needle, &organ, seed);
        }
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

    fn patient(&self) -> Option<&Patient> {
        self.patient.as_deref()
    }

    fn visuals(&self) -> Vec<Visual> {
        let still =
            |name, mesh, material| Visual::new(name, mesh, material, instance::ORGAN).still();
        let mut visuals = if let Some(patient) = &self.patient {
            let [.., (ink, blue)] = LAYERS;
            let mut visuals = patient.visuals_in_scene();
            let fold = Fold::of(&self.pad).mesh();
            visuals.extend([
                patient.of_its_tissue("fold", fold, instance::ORGAN).still(),
                still(ink, self.pad.ink(), blue),
            ]);
            visuals
        } else {
            let layers = LAYERS.into_iter().zip(self.pad.meshes());
            layers
                .map(|((name, material), mesh)| still(name, mesh, material))
                .collect()
        };
        let needle = self.needle.mesh();
        visuals.push(Visual::new(
            "needle",
            needle,
            NEEDLE_STEEL,
            instance::NEEDLE,
        ));
        visuals
    }

    fn backdrop(&self) -> Backdrop {
        let table = Backdrop::table(-self.pad.thickness_m, [0.30, 0.17, 0.13]);
        let made_up = if self.patient.is_some() {
            Backdrop::CAVITY
        } else {
            table
        };
        patient::backdrop(self.patient(), made_up)
    }

    fn visual_poses(&self, things: &[Pose], _goal: &Pose) -> Vec<Pose> {
        let still = match self.patient() {
            Some(patient) => patient::count(Some(patient), 0) + FOLD_VISUALS,
            None => LAYERS.len(),
        };
        iter::repeat_n(Pose::identity(), still)
            .chain([things[0]])
            .collect()
    }
}

impl SuturePad {
    /// The organ that the needle lies on, if it is a patient's.
    fn organ(&self) -> Option<Organ> {
        self.patient.as_deref().map(organ_of)
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
