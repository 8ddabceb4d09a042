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
/// How thick the layer is into which all is pressed that lies beyond the diaphragm, m.
const DIAPHRAGM_M: f64 = 0.005;
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
    let diaphragm = Diaphragm::over(parts, scene_from_scan);
    let others = parts
        .iter()
        .filter(|part| part.name != organ && !is_wall(part));
    let visual = |part: &Part| {
        let mut mesh = placed(part.mesh.clone(), scene_from_scan);
        diaphragm.press(&mut mesh);
        is_near(&mesh).then(|| {
            let mesh = pressed(rounding::finer(mesh, edge_m), &ceiling);
            Visual::new(name(part), mesh, tissue_material(part), instance::NEIGHBOUR)
                .with_pattern_at(pattern_at_mm(part))
        })
    };
    others.filter_map(visual).collect()
}

/// Where the belly ends towards the head, which is where its liver does.
struct Diaphragm {
    /// Towards the head, scene frame.
    head: Vector3<f64>,
    /// How far that way the liver reaches from the origin, m; none without a liver.
    at_m: Option<f64>,
}

impl Diaphragm {
    fn over(parts: &[Part], scene_from_scan: &Pose) -> Self {
        let head = scene_from_scan.rotation * Vector3::z();
        let liver = parts.iter().find(|part| part.name == "liver");
        let reach_m = |part: &Part| {
            let liver = placed(part.mesh.clone(), scene_from_scan);
            let along = liver.positions.iter().map(|at| along_m(at, &head));
            along.reduce(f64::max)
        };
        Self {
            head,
            at_m: liver.and_then(reach_m),
        }
    }

    /// Presses into a thin layer what lies beyond: gullet and great vessels would stand in the
    /// cavity as posts. What was further stays further, so that what is closed stays closed.
    fn press(&self, mesh: &mut Mesh) {
        let Some(at_m) = self.at_m else { return };
        for position in &mut mesh.positions {
            let beyond_m = along_m(position, &self.head) - at_m;
            if beyond_m > 0.0 {
                let back_m = beyond_m - DIAPHRAGM_M * beyond_m / (DIAPHRAGM_M + beyond_m);
                *position = single(&(Vector3::from(position.map(f64::from)) - back_m * self.head));
            }
        }
    }
}

/// How far `at` lies along `direction`, m.
fn along_m(at: &[f32; 3], direction: &Vector3<f64>) -> f64 {
    Vector3::from(at.map(f64::from)).dot(direction)
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
