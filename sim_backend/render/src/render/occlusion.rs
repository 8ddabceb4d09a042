//! How open surfaces are to the light from all around, and how much light comes through them: baked
//! by rays, a vertex at a time.
//!
//! Openness is the cosine-weighted share of the half sphere that is not hidden, where something at
//! the distance `d` hides `1 - d / REACH_M` of its ray (ambient obscurance). Rays are drawn from
//! the cosine's density, so their plain mean is that integral. What comes through is the mean of
//! `exp(-d / SEEPS_M)` over rays into the surface (Beer and Lambert), `d` being the distance to the
//! far side; rays that do not meet it within `6 SEEPS_M` count 0.
//!
//! No random numbers: directions are a Fibonacci spiral, the same at each vertex, so the same
//! meshes give the same bytes on however many processors.

use hal::Mesh;
use nalgebra::Vector3;

use super::rays::Rays;
use crate::visual::Visual;

type Vec3 = Vector3<f32>;

/// What is further away than this hides nothing, m; nearer things hide the more, the nearer they
/// are.
const REACH_M: f32 = 0.012;

/// Way in tissue on which red light falls to its e-th part, m.
const SEEPS_M: f32 = 0.002;

/// From where on rays look for what is in their way, m.
///
/// Beyond the rounding of single precision in a scene of decimetres, so that a ray does not meet
/// its own surface.
const START_M: f32 = 2e-5;

/// Outward rays per vertex, if there are not too many vertices.
const OUTWARDS: u16 = 64;
/// Fewest outward rays per vertex, however many vertices there are.
const LEAST: usize = 16;
/// Inward rays per vertex.
const INWARDS: u16 = 12;

/// Most outward rays of a scene, unless `LEAST` per vertex are more. Bounds the time of baking.
const RAYS_MAX: usize = 6_000_000;

/// What is baked into one vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Baked {
    /// Share of the light from all around that gets there, weighted by the cosine: 1 in the open.
    pub(super) open: f32,
    /// Share of red light that comes through from the far side; 0 where there is none.
    pub(super) through: f32,
}

impl Baked {
    /// Of a surface without anything about it.
    pub(super) const OPEN: Self = Self {
        open: 1.0,
        through: 0.0,
    };
}

/// Bakes all `visuals`, in their order and that of their vertices. Those that stand still hide each
/// other, all others only themselves.
pub(super) fn bake(visuals: &[Visual]) -> Vec<Baked> {
    let still = visuals.iter().filter(|visual| visual.is_still);
    let around = Rays::new(still.map(|visual| &visual.mesh));
    let vertices: usize = visuals
        .iter()
        .map(|visual| visual.mesh.positions.len())
        .sum();
    let fitting = RAYS_MAX / vertices.max(1);
    let rays = u16::try_from(fitting.clamp(LEAST, usize::from(OUTWARDS))).unwrap_or(OUTWARDS);
    let mut baked = Vec::with_capacity(vertices);
    for visual in visuals {
        let alone = Rays::new([&visual.mesh]);
        let around = if visual.is_still { &around } else { &alone };
        baked.extend(shared(&visual.mesh, &|from, normal| Baked {
            open: open(around, from, normal, rays),
            through: through(&alone, from, normal),
        }));
    }
    baked
}

/// `of` each vertex of `mesh`, on all processors.
///
/// Chunks of at least 256 vertices go to scoped threads; each writes its own part of the result.
fn shared(mesh: &Mesh, of: &(dyn Fn(&Vec3, &Vec3) -> Baked + Sync)) -> Vec<Baked> {
    let vertices: Vec<[Vec3; 2]> = mesh
        .positions
        .iter()
        .zip(&mesh.normals)
        .map(|(position, normal)| [Vec3::from(*position), Vec3::from(*normal)])
        .collect();
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let size = vertices.len().div_ceil(workers).max(256);
    let mut baked = vec![Baked::OPEN; vertices.len()];
    std::thread::scope(|scope| {
        for (vertices, baked) in vertices.chunks(size).zip(baked.chunks_mut(size)) {
            scope.spawn(move || {
                for ([position, normal], baked) in vertices.iter().zip(baked) {
                    *baked = of(position, normal);
                }
            });
        }
    });
    baked
}

/// The mean over rays about `normal`, as many where the light counts more.
fn open(around: &Rays, from: &Vec3, normal: &Vec3, rays: u16) -> f32 {
    let start = from + START_M * normal;
    let axes = across(normal);
    let hidden = (0..rays).map(|index| {
        let along = lobe(index, rays, 1.0, normal, &axes);
        let hit = around.nearest(&start, &along, REACH_M);
        hit.map_or(0.0, |distance_m| 1.0 - distance_m / REACH_M)
    });
    1.0 - hidden.sum::<f32>() / f32::from(rays)
}

/// The mean over rays into the surface, in a narrow cone.
fn through(alone: &Rays, from: &Vec3, normal: &Vec3) -> f32 {
    let inwards = -normal;
    let start = from + START_M * inwards;
    let axes = across(&inwards);
    let passed = (0..INWARDS).map(|index| {
        let along = lobe(index, INWARDS, 0.25, &inwards, &axes);
        let hit = alone.nearest(&start, &along, 6.0 * SEEPS_M);
        hit.map_or(0.0, |distance_m| (-distance_m / SEEPS_M).exp())
    });
    passed.sum::<f32>() / f32::from(INWARDS)
}

/// Two unit vectors across `axis` and each other (Duff et al., 2017).
///
/// Without a branch on the direction and without a square root; right for every unit vector, -z
/// too.
fn across(axis: &Vec3) -> [Vec3; 2] {
    let sign = 1.0_f32.copysign(axis.z);
    let a = -1.0 / (sign + axis.z);
    let b = axis.x * axis.y * a;
    [
        Vec3::new(1.0 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x),
        Vec3::new(b, sign + axis.y * axis.y * a, -axis.y),
    ]
}

/// Ray `index` of `count` about `axis`: a spiral over the disc of `radius` below the half sphere,
/// so that each stands for the same share of a cosine's light.
///
/// By Malley's method: even points of the disc, lifted to the half sphere, have the cosine's
/// density. 2.4 rad, the golden angle, is the turn from one to the next. `radius` below 1 makes a
/// cone of the same kind.
fn lobe(index: u16, count: u16, radius: f32, axis: &Vec3, [u, v]: &[Vec3; 2]) -> Vec3 {
    let share = (f32::from(index) + 0.5) / f32::from(count);
    let (sin, cos) = (2.399_963_2 * f32::from(index)).sin_cos();
    let out = radius * share.sqrt();
    u * (out * cos) + v * (out * sin) + axis * (1.0 - out * out).sqrt()
}

#[cfg(test)]
mod tests {
    use hal::Mesh;
    use nalgebra::Point3;

    use super::*;
    use crate::shapes::{cuboid, height_field, sphere};
    use crate::visual::{Material, Pattern};

    const GREY: Material = Material {
        base_colour: [0.5; 3],
        metallic: 0.0,
        roughness: 0.5,
        wetness: 0.5,
        detail: 0.0,
        pattern: Pattern::Smooth,
    };

    fn visual(mesh: Mesh) -> Visual {
        Visual::new("thing", mesh, GREY, 1)
    }

    #[test]
    fn what_stands_alone_is_open() {
        let things = [
            visual(height_field(0.05, 0.05, 8, |_, _| 0.0)),
            visual(sphere(0.01, 24)),
        ];
        let baked = bake(&things);
        assert_eq!(
            baked.len(),
            things
                .iter()
                .map(|it| it.mesh.positions.len())
                .sum::<usize>()
        );
        assert!(baked.iter().all(|it| it.open > 0.999), "{baked:?}");
    }

    /// Between two long walls one sees the cosine of their angle of the light; they begin right
    /// there, so nothing falls off.
    #[test]
    fn grooves_are_as_dark_as_they_are_steep() {
        for slope in [0.0_f64, 0.5, 1.0, 2.0] {
            let mesh = height_field(0.03, 0.03, 60, |x, _| slope * x.abs());
            let middle = |p: &[f32; 3]| p[0].abs() < 1e-6 && p[1].abs() < 1e-6;
            let index = mesh.positions.iter().position(middle).unwrap();
            let found = f64::from(bake(&[visual(mesh)])[index].open);
            assert!(
                (found - slope.atan().cos()).abs() < 0.05,
                "{slope}: {found}"
            );
        }
    }

    #[test]
    fn only_what_stands_still_hides_others() {
        let floor = || height_field(0.05, 0.05, 20, |_, _| 0.0);
        let above =
            crate::shapes::placed(sphere(0.004, 24), &hal::Pose::translation(0.0, 0.0, 0.005));
        let middle = |baked: &[Baked]| baked[21 * 10 + 10].open;
        let apart = bake(&[visual(floor()), visual(above.clone())]);
        let still = |mesh| Visual {
            is_still: true,
            ..visual(mesh)
        };
        let together = bake(&[still(floor()), still(above)]);
        assert!(middle(&apart) > 0.999, "{}", middle(&apart));
        assert!(middle(&together) < 0.6, "{}", middle(&together));
    }

    /// Through a plate goes what its thickness lets through, through a thick one and through what
    /// has no far side nothing.
    #[test]
    fn light_comes_through_what_is_thin() {
        let passed = |half_m: f64| {
            let mesh = cuboid(nalgebra::Vector3::new(0.05, 0.05, half_m));
            let top = Point3::new(0.001, 0.002, half_m);
            let from = Vec3::from(hal::mesh::single(&top.coords));
            f64::from(through(&Rays::new([&mesh]), &from, &Vec3::z()))
        };
        for thickness_m in [0.001, 0.003] {
            let straight = (-thickness_m / f64::from(SEEPS_M)).exp();
            let share = passed(0.5 * thickness_m) / straight;
            assert!((0.93..1.05).contains(&share), "{thickness_m}: {share}");
        }
        assert!(passed(0.02).abs() < 1e-12);
        let open = bake(&[visual(height_field(0.05, 0.05, 4, |_, _| 0.0))]);
        assert!(open.iter().all(|it| it.through.to_bits() == 0));
    }
}
