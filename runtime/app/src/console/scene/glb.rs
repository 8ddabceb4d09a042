//! Meshes and cameras as a binary glTF 2.0 file: one JSON chunk and one of numbers. glTF 2.0,
//! section 4 (GLB). Nodes are added in the order in which `scene::message` says their poses.

use hal::{Intrinsics, Mesh, Pose};
use serde_json::{Value, json};
use trocar_anatomy::assets::Numbers;
use trocar_render::visual::Material;

/// A primitive of lines between pairs of vertices.
const LINES: u32 = 1;

/// A file that grows.
#[derive(Debug, Default)]
pub(super) struct Writer {
    nodes: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    cameras: Vec<Value>,
    numbers: Numbers,
}

/// How something is drawn that is no thing: a limit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Glass {
    /// Linear RGB and how much it hides.
    pub(super) colour: [f32; 4],
}

impl Writer {
    /// Adds a node with a mesh (m).
    pub(super) fn mesh(&mut self, name: &str, mesh: &Mesh, material: &Material, pose: &Pose) {
        let [r, g, b] = material.base_colour;
        let pbr = json!({
            "baseColorFactor": [r, g, b, 1.0],
            "metallicFactor": material.metallic,
            "roughnessFactor": material.roughness,
        });
        let material = push(
            &mut self.materials,
            json!({"name": name, "pbrMetallicRoughness": pbr}),
        );
        self.node_with_mesh(name, mesh, material, pose, Value::Null);
    }

    /// Adds a node of `kind` that one sees through.
    pub(super) fn glass(&mut self, (kind, name): (&str, &str), mesh: &Mesh, glass: Glass) {
        let material = self.glass_material(name, glass);
        let extras = json!({"kind": kind});
        self.node_with_mesh(name, mesh, material, &Pose::identity(), extras);
    }

    /// Adds a node of `kind` with lines between pairs of points, m.
    pub(super) fn lines(
        &mut self,
        (kind, name): (&str, &str),
        points_m: &[[f32; 3]],
        glass: Glass,
    ) {
        let material = self.glass_material(name, glass);
        let position = self.numbers.vectors(points_m, true);
        let primitive =
            json!({"attributes": {"POSITION": position}, "material": material, "mode": LINES});
        let mesh = push(
            &mut self.meshes,
            json!({"name": name, "primitives": [primitive]}),
        );
        self.nodes
            .push(json!({"name": name, "mesh": mesh, "extras": {"kind": kind}}));
    }

    /// Adds a node with a camera. Ours look along z with y down, glTF's along -z with y up; the
    /// node's frame is ours, its child's is glTF's.
    pub(super) fn camera(&mut self, name: &str, lens: &Intrinsics, pose: &Pose) {
        let (width, height) = (f64::from(lens.width), f64::from(lens.height));
        let perspective = json!({
            "yfov": 2.0 * (0.5 * height / lens.fy).atan(),
            "aspectRatio": width * lens.fy / (height * lens.fx),
            "znear": 0.005,
            "zfar": 1.0,
        });
        let camera = push(
            &mut self.cameras,
            json!({"name": name, "type": "perspective", "perspective": perspective}),
        );
        let mut node = placed(name, pose);
        node["extras"] = json!({"kind": "camera", "camera": camera});
        self.nodes.push(node);
    }

    /// Whether nothing was added.
    pub(super) const fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The file.
    pub(super) fn finish(mut self) -> Vec<u8> {
        // glTF's cameras look along -z with y up.
        let cameras: Vec<_> = self
            .nodes
            .iter()
            .enumerate()
            .filter_map(|(index, node)| Some((index, node["extras"]["camera"].as_u64()?)))
            .collect();
        let roots: Vec<usize> = (0..self.nodes.len()).collect();
        for (parent, camera) in cameras {
            let child = push(
                &mut self.nodes,
                json!({"camera": camera, "rotation": [1.0, 0.0, 0.0, 0.0]}),
            );
            self.nodes[parent]["children"] = json!([child]);
        }
        // Ours has z up, glTF has y up.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let root = push(
            &mut self.nodes,
            json!({"name": "scene frame", "rotation": [-half, 0.0, 0.0, half], "children": roots}),
        );
        let mut file = json!({
            "asset": {"version": "2.0", "generator": "trocar"},
            "scene": 0,
            "scenes": [{"name": "scene", "nodes": [root]}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
        });
        if !self.cameras.is_empty() {
            file["cameras"] = json!(self.cameras);
        }
        self.numbers.file(file)
    }

    /// `extras` is null for a visual, or says the `kind` of what is drawn beside them.
    fn node_with_mesh(
        &mut self,
        name: &str,
        mesh: &Mesh,
        material: usize,
        pose: &Pose,
        extras: Value,
    ) {
        let position = self.numbers.vectors(&mesh.positions, true);
        let normal = self.numbers.vectors(&mesh.normals, false);
        let indices = self.numbers.indices(&mesh.indices);
        let attributes = json!({"POSITION": position, "NORMAL": normal});
        let primitive = json!({"attributes": attributes, "indices": indices, "material": material});
        let mesh = push(
            &mut self.meshes,
            json!({"name": name, "primitives": [primitive]}),
        );
        let mut node = placed(name, pose);
        node["mesh"] = json!(mesh);
        if !extras.is_null() {
            node["extras"] = extras;
        }
        self.nodes.push(node);
    }

    fn glass_material(&mut self, name: &str, glass: Glass) -> usize {
        let pbr = json!({"baseColorFactor": glass.colour, "metallicFactor": 0.0});
        let material = json!({"name": name, "pbrMetallicRoughness": pbr, "alphaMode": "BLEND", "doubleSided": true});
        push(&mut self.materials, material)
    }
}

/// A node at `pose`; glTF's quaternions are x, y, z, w.
fn placed(name: &str, pose: &Pose) -> Value {
    let (at, turned) = (pose.translation.vector, pose.rotation.coords);
    json!({
        "name": name,
        "translation": at.as_slice(),
        "rotation": [turned.x, turned.y, turned.z, turned.w],
    })
}

/// Adds `value`; its index.
fn push(to: &mut Vec<Value>, value: Value) -> usize {
    to.push(value);
    to.len() - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use trocar_render::shapes::cuboid;

    #[test]
    fn the_container_is_whole_and_aligned() {
        let mut writer = Writer::default();
        let glass = Glass {
            colour: [1.0, 0.0, 0.0, 0.2],
        };
        writer.glass(("region", "box"), &cuboid(Vector3::repeat(0.01)), glass);
        writer.lines(("workspace", "psm1"), &[[0.0; 3], [0.1; 3]], glass);
        let file = writer.finish();
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(&file[..4], b"glTF");
        assert_eq!((word(4), word(8)), (2, file.len()));
        let text = word(12);
        assert_eq!((text % 4, &file[16..20]), (0, &b"JSON"[..]));
        let json: Value = serde_json::from_slice(&file[20..20 + text]).unwrap();
        assert_eq!(&file[24 + text..28 + text], b"BIN\0");
        assert_eq!(20 + text + 8 + word(20 + text), file.len());
        let bytes = json["buffers"][0]["byteLength"].as_u64().unwrap();
        let views = json["bufferViews"].as_array().unwrap();
        let ends = views.iter().map(|view| {
            view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap()
        });
        assert_eq!(ends.max(), Some(bytes));
        assert_eq!(json["nodes"][1]["extras"]["kind"], "workspace");
        let low = &json["accessors"][0]["min"];
        assert!((low[2].as_f64().unwrap() + 0.01).abs() < 1e-6, "{low}");
    }
}
