//! Tissue retraction: one arm grasps a flap of skin on a liver at a red mark near its free edge,
//! lifts it and holds it up.
//!
//! On a patient the flap was dissected off an organ: it looks as that does, and before it the
//! surface is cut away.
//!
//! Drawn for each episode: where along the middle of the free edge the mark is; the flap always
//! lies the same. There is no thing: what the task is about is the mark. There is no goal pose
//! either.

mod liver;
mod script;
mod success;

use core::iter;
use std::sync::Arc;

use hal::Pose;
use hal::config::{ConfigError, Source};
use serde::Deserialize;
use trocar_render::visual::{Backdrop, Material, Pattern, Visual, instance};
use trocar_world::organ::Organ;
use trocar_world::tissue::{self, NODES_MAX, Patch, RetractionConfig, Tissue, TissueConfig};
use trocar_world::{ArmStart, Flap, Ground, Scenery, WorldConfig};

pub use liver::LiverShape;
use script::Retractor;
use success::SuccessMonitor;

use super::common::{ArmFile, CommonFile, EpisodeFile, RenderingFile, TitleFile};
use super::patient::{self, Incision, Patient, SceneFile, Site, WIDE};
use super::visuals::{LIVER, MUSCLE};
use super::{CameraConfig, Kind, Monitor, Outcome, Parsed, TaskScene};
use crate::script::AnyScript;
use crate::script::alone::Alone;

/// The name by which scene files know this kind of scene.
pub const NAME: &str = "tissue-retraction";

pub(super) const KIND: Kind = Kind {
    name: NAME,
    arms: 1,
    parts: &[],
    parse,
};

/// A sheet of peritoneum, moist.
const SHEET: Material = Material {
    base_colour: [0.50, 0.19, 0.135],
    metallic: 0.0,
    roughness: 0.5,
    wetness: 0.6,
    detail: 0.6,
    pattern: Pattern::Membrane,
};
/// How many visuals show what the flap lies on without a patient.
const MADE_UP: usize = 2;
/// Stretch of a flap at rest on a patient's organ, at most.
const REST_STRETCH_MAX: f64 = 0.2;
/// How far before and behind the plateau a patient's organ is felt, m.
const WAY_M: f64 = 0.040;
/// Ink.
const RED: Material = Material {
    base_colour: [0.72, 0.012, 0.012],
    metallic: 0.0,
    roughness: 0.6,
    wetness: 0.0,
    detail: 0.0,
    pattern: Pattern::Smooth,
};

/// The scene of a tissue retraction.
#[derive(Clone, Debug)]
pub struct TissueRetraction {
    /// The flap and its mark.
    pub tissue: TissueConfig,
    /// Radius of the mark as it is drawn, m.
    pub mark_radius_m: f64,
    /// What the flap lies on.
    pub liver: LiverShape,
    /// Whose organ it lies on instead, if it is a patient's.
    pub patient: Option<Arc<Patient>>,
    /// What counts as success.
    pub success: RetractionConfig,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(rename = "task")]
    _task: TitleFile,
    scene: Option<SceneFile>,
    episode: EpisodeFile,
    arm: Vec<ArmFile>,
    liver: LiverShape,
    tissue: TissueConfig,
    look: Look,
    world: WorldConfig,
    camera: Vec<CameraConfig>,
    #[serde(default)]
    rendering: RenderingFile,
    success: RetractionConfig,
}

/// `[look]`. It changes pictures alone: how near to the mark a grasp has to be is `[success]`'s.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Look {
    mark_radius_m: f64,
}

fn parse(source: &Source) -> Result<Parsed, ConfigError> {
    let file: File = source.parse()?;
    file.liver.check(source, "liver")?;
    file.tissue.check(source, "tissue")?;
    let [columns, rows] = file.tissue.cells.map(|cells| cells + 1);
    if columns * rows > NODES_MAX {
        let found = format!("{columns} x {rows} nodes");
        let allowed = format!("cells of at most {NODES_MAX} nodes");
        return Err(source.out_of_range("tissue.cells", &found, &allowed));
    }
    source.check_range("look.mark_radius_m", file.look.mark_radius_m, 0.000_2, 0.01)?;
    file.success.check(source, "success")?;
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
        let site = site(&file.liver, &file.tissue);
        Ok(Arc::new(scene.load(source, &site, |organ| {
            check_lies(source, &file.tissue, organ)?;
            check_rests(source, &file.tissue, organ, |scenery| {
                common.ends_at_once(scenery, &mut SuccessMonitor::new(&file.success))
            })
        })?))
    });
    let scene = TissueRetraction {
        patient: patient.transpose()?,
        tissue: file.tissue,
        mark_radius_m: file.look.mark_radius_m,
        liver: file.liver,
        success: file.success,
    };
    Ok((common, Box::new(scene)))
}

/// Checks that the flap comes to rest on `organ` without being stretched by more than
/// [`REST_STRETCH_MAX`].
fn check_lies(source: &Source, tissue: &TissueConfig, organ: &Organ) -> Result<(), ConfigError> {
    let Organ::Measured(ground) = organ else {
        return Ok(());
    };
    let rests = Tissue::new(tissue, (**ground).clone(), 0, &[]);
    let stretch = rests.sheet().stretch_max();
    if stretch <= REST_STRETCH_MAX {
        return Ok(());
    }
    let [length_mm, depth_mm] = [tissue.length_m, tissue.depth_m].map(|size_m| 1e3 * size_m);
    let [percent, most] = [stretch, REST_STRETCH_MAX].map(|stretch| 1e2 * stretch);
    let reason = format!(
        "a flap of {length_mm:.0} mm x {depth_mm:.0} mm would be stretched by {percent:.0} % on the flattest place of the organ ({most:.0} % at most), and does not lie elsewhere"
    );
    let at = format!("{:?}", tissue.edge_m);
    Err(source.refused("tissue.edge_m", &at, &reason))
}

/// Checks that an episode of the flap on `organ` does not end, by `end`, before an arm moves: on an
/// organ of many folds a flap that is hardly stretched may still be flung off.
fn check_rests(
    source: &Source,
    tissue: &TissueConfig,
    organ: &Organ,
    end: impl FnOnce(&Scenery) -> Option<Outcome>,
) -> Result<(), ConfigError> {
    let Organ::Measured(ground) = organ else {
        return Ok(());
    };
    let Some(outcome) = end(&flap_on((**ground).clone(), tissue, 0)) else {
        return Ok(());
    };
    let reason = format!(
        "the flap does not come to rest on the flattest place of the organ ({outcome}), and does not lie elsewhere"
    );
    let at = format!("{:?}", tissue.edge_m);
    Err(source.refused("tissue.edge_m", &at, &reason))
}

/// A flap alone on `ground`, with the mark of the episode `seed`.
fn flap_on(ground: tissue::Ground, tissue: &TissueConfig, seed: u64) -> Scenery {
    Scenery {
        things: Vec::new(),
        ground: Ground::Bed(ground),
        flap: Some(Flap {
            config: tissue.clone(),
            seed,
        }),
    }
}

/// What the scene needs of a patient's organ: what the plateau covers and the way to it, cut away
/// before the plateau's near side.
fn site(liver: &LiverShape, tissue: &TissueConfig) -> Site {
    let half_m = [0, 1].map(|axis| liver.low_m[axis].abs().max(liver.high_m[axis].abs()));
    Site {
        half_m: [half_m[0], half_m[1] + WAY_M],
        centre_m: [0.0; 3],
        radii_m: WIDE,
        incision: Some(Incision {
            front_m: liver.low_m[1],
            middle_m: tissue.edge_m[0],
            half_m: 0.5 * tissue.length_m,
        }),
    }
}

impl TaskScene for TissueRetraction {
    fn scenery(&self, seed: u64) -> Scenery {
        let ground = match &self.patient {
            Some(patient) => (*patient.organ).clone(),
            None => self.liver.ground(),
        };
        flap_on(ground, &self.tissue, seed)
    }

    fn goal(&self, _seed: u64) -> Option<Pose> {
        None
    }

    fn monitor(&self, _seed: u64) -> Box<dyn Monitor> {
        Box::new(SuccessMonitor::new(&self.success))
    }

    fn expert(&self, arms: &[ArmStart], seed: u64) -> Box<dyn AnyScript> {
        Box::new(Alone::new(Retractor::new(self), arms, seed))
    }

    fn visuals(&self) -> Vec<Visual> {
        let flap = self.tissue.surface();
        let mark = Patch::new(&flap, [0.0; 2], self.mark_radius_m);
        let sheet = flap.mesh().clone();
        let (mut visuals, flap) = match &self.patient {
            Some(patient) => (
                patient.visuals_in_scene(),
                patient.of_its_tissue("flap", sheet, instance::TISSUE),
            ),
            None => (
                self.made_up(),
                Visual::new("flap", sheet, SHEET, instance::TISSUE),
            ),
        };
        visuals.extend([
            flap,
            Visual::new("mark", mark.mesh().clone(), RED, instance::MARK),
        ]);
        visuals
    }

    fn patient(&self) -> Option<&Patient> {
        self.patient.as_deref()
    }

    fn backdrop(&self) -> Backdrop {
        let over_liver = Backdrop {
            bounce: [0.20, 0.045, 0.03],
            ..Backdrop::CAVITY
        };
        patient::backdrop(self.patient(), over_liver)
    }

    fn visual_poses(&self, _things: &[Pose], _goal: &Pose) -> Vec<Pose> {
        // The flap's vertices are in the scene frame.
        let still = patient::count(self.patient(), MADE_UP);
        iter::repeat_n(Pose::identity(), still + 2).collect()
    }

    fn flap(&self) -> Option<(&TissueConfig, f64)> {
        Some((&self.tissue, self.mark_radius_m))
    }
}

impl TissueRetraction {
    /// What the flap lies on without a patient.
    fn made_up(&self) -> Vec<Visual> {
        let organ = |name, mesh, material| Visual::new(name, mesh, material, instance::ORGAN);
        let visuals: [Visual; MADE_UP] = [
            organ("liver", self.liver.mesh(), LIVER),
            organ("body", self.liver.floor(), MUSCLE),
        ];
        visuals.map(Visual::still).into()
    }
}

#[cfg(test)]
impl TissueRetraction {
    /// The scene as it ships.
    pub(crate) fn shipped() -> Self {
        let task = super::TaskConfig::shipped(NAME);
        task.scene::<Self>().unwrap().clone()
    }
}

#[cfg(test)]
mod tests;
