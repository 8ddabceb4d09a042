//! A patient under the instruments: `[scene] patient = "DIR", organ = "liver"` makes an organ of
//! what `trocar anatomy build` wrote into `DIR` the ground of a task.
//!
//! The patient is turned so that a patch on the organ's front on which the task can be done faces
//! the instruments, the widest, then the flattest, the head away from the viewer, and raised so
//! that the patch is where the task has its ground. Patches are tried in this order until a flap
//! lies on one, or a needle comes to rest there. The organ is rounded between its vertices, once
//! for physics and pictures alike: what is felt is a table of the heights that are drawn. Its
//! neighbours are scenery alone, pressed down where they would stand in the way. Which part of a
//! pattern an organ shows depends on its shape.

mod ceiling;
mod incision;
mod looks;
mod neighbours;
mod patch;
mod relief;
mod rounding;

use core::iter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hal::config::{ConfigError, Source};
use hal::{Mesh, Pose};
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_anatomy::assets::{self, Part};
use trocar_render::shapes::placed;
use trocar_render::visual::{Backdrop, Visual, instance};
use trocar_world::needle::NeedleShape;
use trocar_world::organ::{Organ, OrganShape};
use trocar_world::tissue::Ground;

use super::common::Common;
use super::needle_start::NeedleStart;

pub(super) use incision::Incision;
pub use looks::tissue_material;
use patch::Patch;
pub(super) use patch::WIDE;
use relief::Relief;

/// Distance of the points of the table of heights, m.
const SPACING_M: f64 = 0.000_5;

/// Mean height of the patch that a needle is lifted from, m: workspaces end 5 mm below z = 0, and
/// an organ falls off around the patch.
const RAISED_M: f64 = 0.005;

/// Height of the floor behind the organs, m: organs are higher than the slabs of the other scenes.
const FLOOR_M: f64 = -0.060;

/// `[scene]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneFile {
    /// The folder of the patient, or a `.glb`, `.usda` or `.usdz` of another program; a relative
    /// path is one from where the program was started.
    patient: String,
    /// The tissue group that is the ground.
    pub(super) organ: String,
    /// The needle of the scene that the patch has to suit, and that lies there, in a scene with a
    /// choice; the trained one if not given.
    pub(super) needle: Option<String>,
}

/// How a patient lies in the scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PatientPlacement {
    /// The patient's folder.
    pub patient: String,
    /// The organ under the instruments.
    pub organ: String,
    /// The middle of the patch that faces the instruments, in the scan's world (RAS), m.
    pub patch_in_scan_m: [f64; 3],
    /// The scene's x, y and z in the scan's world.
    pub axes_in_scan: [[f64; 3]; 3],
    /// How far the organ reaches around the middle of the patch, m.
    pub radius_m: f64,
    /// How far the patch is from flat, root of the mean square, m.
    pub roughness_m: f64,
}

/// A patient in the scene.
#[derive(Clone, Debug)]
pub struct Patient {
    /// How it lies there.
    pub lie: PatientPlacement,
    /// The organ as physics has it, scene frame.
    pub organ: Arc<Ground>,
    /// The organ first, then its neighbours, all standing still; scene frame.
    visuals: Vec<Visual>,
}

/// What a task needs of the organ.
pub(super) struct Site {
    /// Half the size of the rectangle about the origin over which it is felt, m.
    pub(super) half_m: [f64; 2],
    /// Where the middle of its patch lies, scene x and y, and the patch's mean height, m.
    pub(super) centre_m: [f64; 3],
    /// How far the organ has to reach around it, m, the wished one first.
    pub(super) radii_m: &'static [f64],
    /// Where it is cut.
    pub(super) incision: Option<Incision>,
}

impl Site {
    /// An organ with `patch` under the instruments, as it is drawn and as it is felt.
    fn lay(&self, mesh: Mesh, patch: &Patch) -> (Mesh, Ground) {
        let mut drawn = rounding::rounded(placed(mesh, &patch.scene_from_scan), self.half_m);
        if let Some(incision) = &self.incision {
            drawn = rounding::finer(drawn, |at| incision.edge_m(at));
            incision.cut(&mut drawn);
        }
        let table = Relief::of(&drawn, &Pose::identity(), self.half_m, SPACING_M).table();
        (drawn, table)
    }
}

impl SceneFile {
    /// Reads the patient and lays it under the instruments: of the widest patches of the organ the
    /// flattest that `fits`.
    ///
    /// # Errors
    /// [`ConfigError::Refused`] if there is no patient in the folder, its file is damaged, or no
    /// patch of the organ is fit to work on; [`ConfigError::OutOfRange`] if it has no such organ;
    /// what is wrong with the first patch, and which that is, where none fits.
    pub(super) fn load(
        &self,
        source: &Source,
        site: &Site,
        fits: impl Fn(&Organ) -> Result<(), ConfigError>,
    ) -> Result<Patient, ConfigError> {
        let parts = assets::read(Path::new(&self.patient));
        let parts = parts
            .map_err(|error| source.refused("scene.patient", &self.patient, &error.to_string()))?;
        let Some(organ) = parts.iter().find(|part| part.name == self.organ) else {
            let names: Vec<&str> = parts.iter().map(|part| part.name.as_str()).collect();
            return Err(source.out_of_range("scene.organ", &self.organ, &names.join(", ")));
        };
        let patches = Patch::choose(&organ.mesh, site)
            .map_err(|reason| source.refused("scene.organ", &self.organ, &reason))?;
        let mut misfits = Vec::new();
        for patch in patches {
            let (drawn, table) = site.lay(organ.mesh.clone(), &patch);
            let table = Arc::new(table);
            match fits(&Organ::Measured(Arc::clone(&table))) {
                Ok(()) => {
                    return Ok(Patient {
                        lie: self.lie(&patch, site),
                        organ: table,
                        visuals: self.visuals(&parts, drawn, &patch.scene_from_scan),
                    });
                }
                Err(error) => misfits.push((patch, error)),
            }
        }
        let count = misfits.len();
        let Some((patch, mut error)) = misfits.into_iter().next() else {
            return Err(source.refused("scene.organ", &self.organ, "no patch"));
        };
        if let ConfigError::Refused { reason, .. } = &mut error {
            let tried = self.tried(count, &self.lie(&patch, site));
            reason.push_str(&tried);
        }
        Err(error)
    }

    /// How many patches were tried in vain, and where the `first` is.
    fn tried(&self, count: usize, first: &PatientPlacement) -> String {
        let [flat_mm, radius_mm] = [first.roughness_m, first.radius_m].map(|size_m| 1e3 * size_m);
        let at = patch::in_scan(first.patch_in_scan_m);
        let tried = match count {
            1 => "one patch was tried".to_owned(),
            _ => format!("{count} patches were tried"),
        };
        format!(
            "; {tried} on the patient's {}, the first {flat_mm:.1} mm from flat (root mean square) within {radius_mm:.0} mm of {at}",
            self.organ
        )
    }

    /// The organ as it is `drawn`, which physics feels too, and what is around it.
    fn visuals(&self, parts: &[Part], drawn: Mesh, scene_from_scan: &Pose) -> Vec<Visual> {
        let around = neighbours::around(&drawn, &self.organ, parts, scene_from_scan);
        let own = parts.iter().filter(|part| part.name == self.organ);
        let organ = own.take(1).map(|part| {
            let material = tissue_material(part);
            Visual::new(looks::name(part), drawn.clone(), material, instance::ORGAN)
                .with_pattern_at(looks::pattern_at_mm(part))
        });
        organ.chain(around).map(Visual::still).collect()
    }

    /// What is reported of the placement: the inverse of how the scan is moved.
    fn lie(&self, patch: &Patch, site: &Site) -> PatientPlacement {
        let scan_from_scene = patch.scene_from_scan.inverse();
        let middle = scan_from_scene * Point3::from(site.centre_m);
        let turn = scan_from_scene.rotation.to_rotation_matrix();
        PatientPlacement {
            patient: self.patient.clone(),
            organ: self.organ.clone(),
            patch_in_scan_m: middle.into(),
            axes_in_scan: turn.into_inner().into(),
            radius_m: patch.radius_m,
            roughness_m: patch.roughness_m,
        }
    }
}

/// The part of a scene file that says whose organ is the ground.
#[derive(Deserialize)]
struct Heading {
    scene: SceneFile,
}

/// The patient's file that a scene file names, if it names one.
#[must_use]
pub fn patient_file(scene: &Source) -> Option<PathBuf> {
    let heading = scene.parse::<Heading>().ok()?;
    Some(assets::file_of(Path::new(&heading.scene.patient)))
}

/// Refuses a needle that `scene` names in a scene without a choice of needles.
///
/// # Errors
/// [`ConfigError::Refused`].
pub(super) fn without_choice(
    source: &Source,
    scene: Option<&SceneFile>,
) -> Result<(), ConfigError> {
    let named = scene.and_then(|scene| scene.needle.as_deref());
    let Some(name) = named else {
        return Ok(());
    };
    let reason = "this kind of scene has no choice of needles";
    Err(source.refused("scene.needle", name, reason))
}

/// What `needle` lies on from its `start` in a scene whose file says `shape`, and `scene` if it has
/// that table.
///
/// # Errors
/// Those of the shape's ranges, of the patient, and of a needle that lies on none of its patches.
pub(super) fn ground(
    source: &Source,
    common: &Common,
    shape: OrganShape,
    scene: Option<&SceneFile>,
    start: &NeedleStart,
    needle: &NeedleShape,
) -> Result<(Organ, Option<Arc<Patient>>), ConfigError> {
    shape.check(source, "organ")?;
    let Some(scene) = scene else {
        return Ok((Organ::Rolling(shape), None));
    };
    let site = Site {
        half_m: [0.5 * shape.length_m, 0.5 * shape.width_m],
        centre_m: [0.0, 0.0, RAISED_M],
        radii_m: patch::NARROW_TOO,
        incision: None,
    };
    let patient = scene.load(source, &site, |organ| {
        start.check_on(source, needle, organ)?;
        let scenery = |seed| start.scenery(seed, needle, organ);
        common.check_rests(source, &scene.organ, scenery)
    })?;
    let organ = Organ::Measured(Arc::clone(&patient.organ));
    Ok((organ, Some(Arc::new(patient))))
}

impl Patient {
    /// What there is to see of it, the organ first, all in the scene frame.
    pub(super) fn visuals_in_scene(&self) -> Vec<Visual> {
        self.visuals.clone()
    }

    /// A part of the organ of its own: what is called `name` has the surface of the organ.
    pub(super) fn of_its_tissue(&self, name: &'static str, mesh: Mesh, instance: u8) -> Visual {
        let organ = &self.visuals[0];
        Visual::new(name, mesh, organ.material, instance).with_pattern_at(organ.pattern_at_mm)
    }
}

/// What there is to see of the ground, the organ first, all in the scene frame: the patient's, or
/// what `made_up` draws.
pub(super) fn visuals(
    organ: &Organ,
    patient: Option<&Patient>,
    made_up: impl Fn(&OrganShape) -> Visual,
) -> Vec<Visual> {
    match (patient, organ) {
        (Some(patient), _) => patient.visuals_in_scene(),
        (None, Organ::Rolling(shape)) => vec![made_up(shape)],
        (None, Organ::Measured(_)) => Vec::new(),
    }
}

/// Poses of these visuals, and of the one thing that lies on the organ.
pub(super) fn poses(patient: Option<&Patient>, thing: Pose) -> Vec<Pose> {
    iter::repeat_n(Pose::identity(), count(patient, 1))
        .chain([thing])
        .collect()
}

/// How many visuals show the patient, or `made_up` without one.
pub(super) fn count(patient: Option<&Patient>, made_up: usize) -> usize {
    patient.map_or(made_up, |patient| patient.visuals.len())
}

/// What is behind a patient, or else `made_up`.
pub(super) fn backdrop(patient: Option<&Patient>, made_up: Backdrop) -> Backdrop {
    let floor_m = patient.map_or(made_up.floor_m, |_| FLOOR_M);
    Backdrop { floor_m, ..made_up }
}

#[cfg(test)]
mod tests;
