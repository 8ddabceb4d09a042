//! The meshes that another program made, as tissue groups: [`glb`]'s, and OpenUSD's ([`usd`]).
//!
//! Vertices at the same place are one, with the mean of its triangles' normals, whatever normals
//! the file has.

mod glb;
mod usd;

use std::collections::BTreeMap;

use hal::Mesh;
use hal::count::count_u32;
use nalgebra::{Point3, Vector3};

use super::part::{PARTS_MAX, Part, fault};

pub(super) use glb::of_glb;
pub(super) use usd::{is_usd, of_usd};

/// The scan's world of a place in a world whose y is up and whose z is forward: right is -x, the
/// front z, the head y. By columns.
const RAS: [f32; 16] = [
    -1.0, 0.0, 0.0, 0.0, //
    0.0, 0.0, 1.0, 0.0, //
    0.0, 1.0, 0.0, 0.0, //
    0.0, 0.0, 0.0, 1.0,
];

/// How a part looks.
#[derive(Clone, Copy)]
struct Looks {
    colour: [f32; 3],
    roughness: f32,
    wetness: f32,
}

impl Default for Looks {
    /// Of a mesh without a material, and with the clear film of tissue.
    fn default() -> Self {
        Self {
            colour: [1.0; 3],
            roughness: 1.0,
            wetness: 0.5,
        }
    }
}

/// The parts of a file so far.
#[derive(Default)]
struct Collection(Vec<Part>);

impl Collection {
    /// Adds a part called `name`, or with a number if there is one already. `unit` says of what
    /// unit the file's lengths are.
    fn push(&mut self, name: &str, mesh: Welded, looks: Looks, unit: &str) -> Result<(), String> {
        let mesh = mesh.mesh();
        if let Some(reason) = fault(&mesh) {
            return Err(format!("{reason}; {unit}"));
        }
        if self.0.len() == PARTS_MAX {
            return Err(format!("it has more than {PARTS_MAX} meshes"));
        }
        let name = plain(name);
        let taken = |name: &String| self.0.iter().any(|part| part.name == *name);
        let mut numbered = (2..).map(|number| format!("{name}-{number}"));
        let name = if taken(&name) {
            numbered.find(|name| !taken(name)).unwrap_or(name)
        } else {
            name
        };
        self.0.push(Part {
            name,
            mesh,
            colour: looks.colour.map(|channel| channel.clamp(0.0, 1.0)),
            roughness: looks.roughness.clamp(0.0, 1.0),
            wetness: looks.wetness.clamp(0.0, 1.0),
        });
        Ok(())
    }

    /// All parts, of which there must be one.
    fn whole(self) -> Result<Vec<Part>, String> {
        if self.0.is_empty() {
            return Err(format!("it has 0 meshes, of 1 to {PARTS_MAX}"));
        }
        Ok(self.0)
    }
}

/// A name as the groups have it.
fn plain(name: &str) -> String {
    name.trim().to_lowercase().replace([' ', '_'], "-")
}

/// A mesh whose vertices at the same place are one.
#[derive(Default)]
struct Welded {
    known: BTreeMap<[u32; 3], u32>,
    positions: Vec<Point3<f32>>,
    indices: Vec<u32>,
}

impl Welded {
    fn vertex(&mut self, place: Point3<f32>) -> u32 {
        let bits = [place.x, place.y, place.z].map(f32::to_bits);
        *self.known.entry(bits).or_insert_with(|| {
            self.positions.push(place);
            count_u32(self.positions.len() - 1)
        })
    }

    /// Takes a triangle that has an area.
    fn triangle(&mut self, [a, b, c]: [u32; 3]) {
        if a != b && b != c && c != a {
            self.indices.extend([a, b, c]);
        }
    }

    /// The mesh with normals; vertices of no triangle point upwards.
    fn mesh(self) -> Mesh {
        let mut normals = vec![Vector3::zeros(); self.positions.len()];
        for triangle in self.indices.as_chunks::<3>().0 {
            let [a, b, c] = triangle.map(|index| self.positions[index as usize]);
            let area = (b - a).cross(&(c - a));
            for index in triangle {
                normals[*index as usize] += area;
            }
        }
        let unit = |normal: &Vector3<f32>| normal.try_normalize(0.0).unwrap_or_else(Vector3::z);
        Mesh {
            positions: self.positions.iter().map(|p| (*p).into()).collect(),
            normals: normals.iter().map(|normal| unit(normal).into()).collect(),
            indices: self.indices,
        }
    }
}
