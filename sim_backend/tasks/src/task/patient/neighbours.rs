//! The organs around the one that is worked on: to be seen, not to be touched.

use hal::mesh::single;
use hal::{Mesh, Pose};
use nalgebra::{Point3, Vector3};
use trocar_anatomy::assets::Part;
use trocar_render::shapes::placed;
use trocar_render::visual::{Visual, instance};

use super::ceiling::Ceiling;
use super::looks::{is_wall, name, pattern_at_mm, tissue_material};
use super::rounding;

/// How far away one begins that is not drawn, m: cameras see no further.
const FAR_M: f64 = 0.20;
/// Edges are halved until they are shorter, m, at that distance and nearer, m, and not below that
/// height, m.
const EDGE_M: f64 = 0.012;
const NEAR_EDGE_M: f64 = 0.006;
const NEAR_M: f64 = 0.10;
const DEEP_M: f64 = -0.08;
/// How thick the layer below the ceiling is into which all that is higher is pressed, m.
const LAYER_M: f64 = 0.018;
/// Least share of its height that an organ keeps as far as its normals say: it still looks round.
const ROUND: f64 = 0.6;

/// What is seen of the other organs in the cavity of the belly; `organ` is the one that is worked
/// on, drawn as `drawn` in the scene frame.
pub(super) fn around(
    drawn: &Mesh,
    organ: &str,
    parts: &[Part],
    scene_from_scan: &Pose,
) -> Vec<Visual> {
    let ceiling = Ceiling::over(drawn);
    let others = parts
        .iter()
        .filter(|part| part.name != organ && !is_wall(part));
    let visual = |part: &Part| {
        let mesh = placed(part.mesh.clone(), scene_from_scan);
        is_near(&mesh).then(|| {
            let mesh = pressed(rounding::finer(mesh, edge_m), &ceiling);
            Visual::new(name(part), mesh, tissue_material(part), instance::NEIGHBOUR)
                .with_pattern_at(pattern_at_mm(part))
        })
    };
    others.filter_map(visual).collect()
}

/// Whether a camera can see some of it. It is drawn as a whole then, and stays closed: also what
/// hangs over a camera has an underside.
fn is_near(mesh: &Mesh) -> bool {
    let distance_m = |p: &[f32; 3]| f64::from(p[0].hypot(p[1]));
    mesh.positions.iter().any(|p| distance_m(p) <= FAR_M)
}

/// How long edges may be at `at`, m: coarse triangles are torn where the ceiling bends.
fn edge_m(at: &Point3<f64>) -> Option<f64> {
    let distance_m = at.x.hypot(at.y);
    let edge_m = if distance_m <= NEAR_M {
        NEAR_EDGE_M
    } else {
        EDGE_M
    };
    (distance_m <= FAR_M && at.z >= DEEP_M).then_some(edge_m)
}

/// The mesh pressed from above until all of it is below the ceiling. What was higher stays higher,
/// however little: no face turns round, organs do not cross, and what is closed stays closed.
fn pressed(mut mesh: Mesh, ceiling: &Ceiling) -> Mesh {
    for (position, normal) in mesh.positions.iter_mut().zip(&mut mesh.normals) {
        let mut at = Vector3::from(position.map(f64::from));
        let ceiling_m = ceiling.height_m(at.x, at.y);
        let above_m = at.z - (ceiling_m - LAYER_M);
        if above_m > 0.0 {
            let left = LAYER_M / (LAYER_M + above_m);
            let slope = ceiling.slope(at.x, at.y);
            let before = Vector3::from(normal.map(f64::from));
            at.z = ceiling_m - LAYER_M * left;
            *position = single(&at);
            *normal = single(&leaned(&before, left * left, slope));
        }
    }
    mesh
}

/// The normal of a surface of which a share of the height is kept over ground of a `slope`.
fn leaned(normal: &Vector3<f64>, kept: f64, [along_x, along_y]: [f64; 2]) -> Vector3<f64> {
    let kept = kept.max(ROUND);
    let lean = (1.0 - kept) * normal.z;
    let leaned = Vector3::new(
        kept * normal.x - lean * along_x,
        kept * normal.y - lean * along_y,
        normal.z,
    );
    leaned.normalize()
}
