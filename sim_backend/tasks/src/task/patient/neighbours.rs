//! The organs around the one that is worked on: to be seen, not to be touched.

use hal::mesh::single;
use hal::{Mesh, Pose};
use nalgebra::Point3;
use trocar_anatomy::assets::Part;
use trocar_render::shapes::placed;
use trocar_render::visual::{Visual, instance};

use super::looks::{is_wall, name, tissue_material};
use super::relief::Relief;

/// How far away they are still drawn, m: cameras see no further.
const FAR_M: f32 = 0.20;
/// How far the organ's own height is looked up, and at which distances, m.
const HALF_M: f64 = 0.20;
const SPACING_M: f64 = 0.004;
/// Radius of the place of work, m; height up to which neighbours stand there, m, and how much higher for each metre beyond: gas and the
/// assistant hold away what is higher.
const WORK_M: f64 = 0.040;
const LEVEL_M: f64 = -0.004;
const RISE: f64 = 0.7;
/// Faces whose normal's height is less look down and are hidden.
const DOWN: f32 = -0.5;
/// How far below the organ's surface they are where they would lie on it at work, m.
const UNDER_M: f64 = 0.008;

/// What is seen of the other organs in the cavity of the belly; `organ` is the one that is worked on, drawn as `drawn` in the scene frame.
pub(super) fn around(
    drawn: &Mesh,
    organ: &str,
    parts: &[Part],
    scene_from_scan: &Pose,
) -> Vec<Visual> {
    let relief = Relief::of(drawn, &Pose::identity(), [HALF_M; 2], SPACING_M);
    let others = parts
        .iter()
        .filter(|part| part.name != organ && !is_wall(part));
    let visual = |part: &Part| {
        let mesh = placed(part.mesh.clone(), scene_from_scan);
        let mesh = seen(pressed(mesh, &relief));
        Visual::new(name(part), mesh, tissue_material(part), instance::NEIGHBOUR)
    };
    let visuals = others.map(visual);
    visuals
        .filter(|visual| !visual.mesh.indices.is_empty())
        .collect()
}

/// The mesh with nothing above the level of the work or, at work, over the organ; normals stay, so it still looks round.
fn pressed(mut mesh: Mesh, relief: &Relief) -> Mesh {
    for position in &mut mesh.positions {
        let mut at = Point3::from(position.map(f64::from));
        let beyond_m = at.x.hypot(at.y) - WORK_M;
        let organ_m = relief.near_m(at.x, at.y).filter(|_| beyond_m < 0.0);
        let level_m = LEVEL_M + RISE * beyond_m.max(0.0);
        let most_m = organ_m.map_or(level_m, |height_m| level_m.min(height_m - UNDER_M));
        if at.z > most_m {
            at.z = most_m;
            *position = single(&at.coords);
        }
    }
    mesh
}

/// The faces that a camera above or beside can see.
fn seen(mut mesh: Mesh) -> Mesh {
    let at = |index: u32| Point3::from(mesh.positions[index as usize]);
    let shown = |face: &&[u32; 3]| {
        let [a, b, c] = face.map(at);
        let near = [a, b, c].iter().any(|p| p.x.hypot(p.y) <= FAR_M);
        let normal = (b - a).cross(&(c - a));
        near && normal.z > DOWN * normal.norm()
    };
    let faces = mesh.indices.as_chunks::<3>().0;
    mesh.indices = faces.iter().filter(shown).flatten().copied().collect();
    mesh
}
