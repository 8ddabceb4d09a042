//! glTF 2.0 in one binary file.
//!
//! Each group has a node, a mesh and a material below one root. The root is a half turn about the
//! axis (0, 1, 1): x to -x, y to z, z to y, which is from RAS to glTF's y up and z forward.
//! Positions stay RAS in metres, so our own reader (`read`) takes them without the rotation.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::gltf::Numbers;
use super::{Asset, FRAME};
use crate::number::{index, single};

/// A vertex with its own texture coordinates: a seam has several where the mesh has one.
///
/// The arrays run side by side but for `indices`; a vertex is a pair of the mesh's vertex and its
/// texture coordinates.
struct Split {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    uv: Vec<[f32; 2]>,
    indices: Vec<u32>,
}

/// Vertices in the order in which triangles name them.
fn split(asset: &Asset<'_>) -> Split {
    let mesh = asset.mesh;
    let metres: Vec<[f32; 3]> = asset.metres().collect();
    let mut known = BTreeMap::new();
    let mut split = Split {
        positions: Vec::new(),
        normals: Vec::new(),
        uv: Vec::new(),
        indices: Vec::with_capacity(3 * mesh.triangles.len()),
    };
    for (triangle, uv) in mesh.triangles.iter().zip(&mesh.uv) {
        for (v, uv) in triangle.iter().zip(uv) {
            let place = *known.entry((*v, uv.map(f32::to_bits))).or_insert_with(|| {
                split.positions.push(metres[*v as usize]);
                split.normals.push(mesh.normals[*v as usize]);
                // glTF's v runs downwards.
                split.uv.push([uv[0], 1.0 - uv[1]]);
                index(split.positions.len() - 1)
            });
            split.indices.push(place);
        }
    }
    split
}

/// What is being written.
#[derive(Default)]
struct Document {
    /// The binary chunk.
    numbers: Numbers,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    images: Vec<Value>,
    /// One a group; the root comes last.
    nodes: Vec<Value>,
}

impl Document {
    /// Adds the mesh, material, image and node of a group.
    fn asset(&mut self, asset: &Asset<'_>) {
        let split = split(asset);
        let position = self.numbers.vectors(&split.positions, true);
        let normal = self.numbers.vectors(&split.normals, false);
        let uv = self.numbers.vectors(&split.uv, false);
        let indices = self.numbers.indices(&split.indices);
        let group = asset.group;
        let mut material = material(asset);
        if let Some(png) = asset.texture {
            let view = self.numbers.image(png);
            let surface = &mut material["pbrMetallicRoughness"];
            surface["baseColorFactor"] = json!([1.0, 1.0, 1.0, 1.0]);
            surface["baseColorTexture"] = json!({"index": self.images.len()});
            // What is read of our files is the colour, not its texture.
            material["extras"] = json!({"colour": group.colour});
            let image = json!({"name": group.name, "mimeType": "image/png", "bufferView": view});
            self.images.push(image);
        }
        self.materials.push(material);
        self.meshes.push(json!({
            "name": group.name,
            "primitives": [{
                "attributes": {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv},
                "indices": indices,
                "material": self.materials.len() - 1,
            }],
        }));
        self.nodes.push(json!({
            "name": group.name,
            "mesh": self.meshes.len() - 1,
            "extras": {"class": group.name, "mass_kg": asset.mass_kg(), "density_kg_m3": group.density_kg_m3},
        }));
    }

    /// All but what `numbers` adds.
    fn json(&self) -> Value {
        let half = single(std::f64::consts::FRAC_1_SQRT_2);
        let children: Vec<usize> = (0..self.nodes.len()).collect();
        let mut nodes = self.nodes.clone();
        // From z upwards to y upwards.
        nodes.push(
            json!({"name": "patient", "rotation": [0.0, half, half, 0.0], "children": children}),
        );
        let mut document = json!({
            "asset": {"version": "2.0", "generator": "trocar anatomy", "extras": {"frame": FRAME}},
            "extensionsUsed": ["KHR_materials_clearcoat", "KHR_materials_transmission", "KHR_materials_volume"],
            "scene": 0,
            "scenes": [{"nodes": [nodes.len() - 1]}],
            "nodes": nodes,
            "meshes": self.meshes,
            "materials": self.materials,
        });
        if !self.images.is_empty() {
            let texture = |source| json!({"source": source, "sampler": 0});
            let textures: Vec<Value> = (0..self.images.len()).map(texture).collect();
            document["images"] = json!(self.images);
            document["textures"] = json!(textures);
            // Linear, with mipmaps, clamped to the edge.
            document["samplers"] =
                json!([{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}]);
        }
        document
    }
}

/// Share of the light that shines through thin tissue in renderers that know no scattering.
const THROUGH: f64 = 0.1;

/// Extensions are hints: a reader without them has the base colour and roughness.
fn material(asset: &Asset<'_>) -> Value {
    let group = asset.group;
    let [r, g, b] = group.colour;
    let mut material = json!({
        "name": group.name,
        "pbrMetallicRoughness": {"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": group.roughness},
        "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": group.wetness, "clearcoatRoughnessFactor": 0.15}},
    });
    if group.light_mm > 0.0 {
        let light_m = group.light_mm * 1e-3;
        // The index of refraction that glTF takes if nothing is said, 1.5, is near to wet tissue's
        // 1.4.
        material["extensions"]["KHR_materials_transmission"] =
            json!({"transmissionFactor": THROUGH});
        material["extensions"]["KHR_materials_volume"] = json!({"thicknessFactor": light_m, "attenuationDistance": light_m, "attenuationColor": [r, g, b]});
    }
    material
}

/// The bytes of a `.glb` with a node a group.
///
/// Vertices are split where texture coordinates have seams; `.usda` keeps each mesh in one piece.
///
/// # Panics
/// If the file would exceed 4 GiB.
#[must_use]
pub fn glb(assets: &[Asset<'_>]) -> Vec<u8> {
    let mut document = Document::default();
    for asset in assets {
        document.asset(asset);
    }
    let json = document.json();
    document.numbers.file(json)
}
