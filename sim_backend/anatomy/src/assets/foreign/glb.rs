//! The meshes of a `.glb` that another program made, as tissue groups: a part a node of the scene
//! that has a mesh.
//!
//! glTF has metres, y upwards and z forward: upwards is taken for the patient's head, forward for
//! the front. Textures are not read, a part has its material's colour.

use std::collections::{BTreeSet, VecDeque};

use gltf_json::accessor::{Accessor, ComponentType, Type};
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::scene::Node;
use gltf_json::validation::{Checked, USize64};
use gltf_json::{Index, Root};
use hal::count::count_u32;
use nalgebra::{Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::{Collection, Looks, RAS, Welded};
use crate::assets::gltf::chunks;
use crate::assets::part::Part;

/// Most nodes of a scene, and most vertices and corners of triangles of all its meshes.
const NODES_MAX: usize = 4096;
const NUMBERS_MAX: usize = 1 << 24;

/// What a file may ask for: it changes looks alone, which are the material's colour here.
const HARMLESS: [&str; 2] = ["KHR_materials_", "KHR_texture_"];

/// The parts in the bytes of a file, or what is wrong with them.
pub(in crate::assets) fn of_glb(file: &[u8]) -> Result<Vec<Part>, String> {
    let [json, numbers] = chunks(file)?;
    let root: Root = gltf_json::deserialize::from_slice(json).map_err(|error| error.to_string())?;
    let harmful = |name: &&String| !HARMLESS.iter().any(|start| name.starts_with(start));
    if let Some(name) = root.extensions_required.iter().find(harmful) {
        return Err(format!("it asks for {name}, which is not read"));
    }
    let shown = root.scene.and_then(|scene| root.get(scene));
    let shown = shown.or_else(|| root.scenes.first());
    let shown = shown.ok_or("it has no scene")?;
    let ras = Matrix4::from_column_slice(&RAS);
    let mut waiting: VecDeque<_> = shown.nodes.iter().map(|node| (*node, ras)).collect();
    let mut seen = BTreeSet::new();
    let mut reader = Reader {
        root: &root,
        numbers,
        left: NUMBERS_MAX,
        parts: Collection::default(),
    };
    while let Some((index, parent)) = waiting.pop_front() {
        let node = root.get(index);
        let node = node.ok_or_else(|| format!("there is no node {index}"))?;
        if !seen.insert(index.value()) || seen.len() > NODES_MAX {
            return Err(format!(
                "node {index} is twice in the scene, or there are more than {NODES_MAX}"
            ));
        }
        let place = parent * placed(node);
        reader.node(node, &place)?;
        let children = node.children.iter().flatten();
        waiting.extend(children.map(|child| (*child, place)));
    }
    reader.parts.whole()
}

/// Where a node is in its parent.
fn placed(node: &Node) -> Matrix4<f32> {
    if let Some(matrix) = &node.matrix {
        return Matrix4::from_column_slice(matrix);
    }
    let [x, y, z, w] = node.rotation.unwrap_or_default().0;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let shift = Translation3::from(node.translation.unwrap_or_default());
    let scale = Vector3::from(node.scale.unwrap_or([1.0; 3]));
    shift.to_homogeneous() * turn.to_homogeneous() * Matrix4::new_nonuniform_scaling(&scale)
}

/// What has been read so far.
struct Reader<'a> {
    root: &'a Root,
    numbers: &'a [u8],
    /// Vertices and corners that may still come.
    left: usize,
    parts: Collection,
}

impl<'a> Reader<'a> {
    /// Adds the mesh of `node`, which has this place, if it has one of triangles.
    fn node(&mut self, node: &Node, place: &Matrix4<f32>) -> Result<(), String> {
        let Some(index) = node.mesh else {
            return Ok(());
        };
        let shape = self.root.get(index);
        let shape = shape.ok_or_else(|| format!("there is no mesh {index}"))?;
        let name = node.name.as_ref().or(shape.name.as_ref());
        let name = name.map_or_else(|| format!("mesh-{index}"), Clone::clone);
        let mut welded = Welded::default();
        let mut looks = None;
        if node.skin.is_some() {
            return Err(format!("{name}: it has a skin, which is not read"));
        }
        for primitive in &shape.primitives {
            match primitive.mode {
                Checked::Valid(Mode::Triangles) => {}
                Checked::Valid(Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) => {
                    continue;
                }
                Checked::Valid(Mode::TriangleStrip | Mode::TriangleFan) | Checked::Invalid => {
                    return Err(format!("{name}: triangle strips and fans are not read"));
                }
            }
            let material = primitive.material.and_then(|it| self.root.get(it));
            let base = material.map(|material| &material.pbr_metallic_roughness);
            let own = base.map(|base| Looks {
                colour: base.base_color_factor.0[..3].try_into().unwrap_or_default(),
                roughness: base.roughness_factor.0,
                ..Looks::default()
            });
            looks.get_or_insert(own.unwrap_or_default());
            self.primitive(primitive, place, &mut welded)
                .map_err(|reason| format!("{name}: {reason}"))?;
        }
        let Some(looks) = looks else {
            return Ok(());
        };
        let pushed = self.parts.push(&name, welded, looks, "glTF has metres");
        pushed.map_err(|reason| format!("{name}: {reason}"))
    }

    fn primitive(
        &mut self,
        primitive: &Primitive,
        place: &Matrix4<f32>,
        welded: &mut Welded,
    ) -> Result<(), String> {
        let positions = primitive
            .attributes
            .get(&Checked::Valid(Semantic::Positions));
        let positions = positions.ok_or("a primitive has no positions")?;
        let places = self.places(*positions)?;
        let own: Vec<u32> = places
            .map(|p| welded.vertex(place.transform_point(&p)))
            .collect();
        let corners = match primitive.indices {
            Some(indices) => self.corners(indices)?,
            None => (0..count_u32(own.len())).collect(),
        };
        let mirrored = place.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        for corner in corners.as_chunks::<3>().0 {
            let [a, b, c] = corner.map(|index| own.get(index as usize).copied());
            let (Some(a), Some(b), Some(c)) = (a, b, c) else {
                return Err("a triangle has a corner that is not there".to_owned());
            };
            welded.triangle(if mirrored { [a, c, b] } else { [a, b, c] });
        }
        Ok(())
    }

    fn places(
        &mut self,
        index: Index<Accessor>,
    ) -> Result<impl Iterator<Item = Point3<f32>> + use<'a>, String> {
        let (kind, items) = self.items(index, Type::Vec3)?;
        if kind != ComponentType::F32 {
            return Err(format!("accessor {index} has another type"));
        }
        let number = |bytes: &[u8], at: usize| {
            let word = bytes.get(at..at + 4).and_then(|word| word.try_into().ok());
            word.map_or(f32::NAN, f32::from_le_bytes)
        };
        Ok(items.map(move |item| Point3::from([0, 4, 8].map(|at| number(item, at)))))
    }

    fn corners(&mut self, index: Index<Accessor>) -> Result<Vec<u32>, String> {
        let (kind, items) = self.items(index, Type::Scalar)?;
        let whole = [ComponentType::U8, ComponentType::U16, ComponentType::U32];
        if !whole.contains(&kind) {
            return Err(format!("accessor {index} has another type"));
        }
        let number = |bytes: &[u8]| {
            let mut word = [0; 4];
            word[..bytes.len()].copy_from_slice(bytes);
            u32::from_le_bytes(word)
        };
        Ok(items.map(number).collect())
    }

    /// The bytes of each item of an accessor of this shape, which must all lie in the file, and
    /// what its numbers are.
    fn items(
        &mut self,
        index: Index<Accessor>,
        shape: Type,
    ) -> Result<(ComponentType, impl Iterator<Item = &'a [u8]> + use<'a>), String> {
        let accessor = self.root.get(index);
        let accessor = accessor.ok_or_else(|| format!("there is no accessor {index}"))?;
        let (Checked::Valid(kind), true) = (
            accessor.component_type,
            accessor.type_ == Checked::Valid(shape),
        ) else {
            return Err(format!("accessor {index} has another type"));
        };
        if accessor.sparse.is_some() {
            return Err(format!("accessor {index} is sparse, which is not read"));
        }
        let size = kind.0.size() * shape.multiplicity();
        let numbers = self.numbers;
        let place = self.place(accessor, size);
        let (bytes, stride, count) =
            place.ok_or_else(|| format!("accessor {index} has no place among the numbers"))?;
        let rest = self.left.checked_sub(count);
        self.left = rest.ok_or_else(|| {
            format!("its meshes have more than {NUMBERS_MAX} vertices and corners")
        })?;
        let items = (0..count).map(move |n| &numbers[bytes + n * stride..][..size]);
        Ok((kind.0, items))
    }

    /// Where an accessor's first item of `size` bytes is among the numbers, the bytes from one to
    /// the next, and how many there are; none if not all are there.
    fn place(&self, accessor: &Accessor, size: usize) -> Option<(usize, usize, usize)> {
        let bytes = |number: USize64| usize::try_from(number.0).ok();
        let view = self.root.get(accessor.buffer_view?)?;
        let first = self.root.buffers.first()?;
        if view.buffer.value() != 0 || first.uri.is_some() {
            return None;
        }
        let offset = bytes(view.byte_offset.unwrap_or_default())?;
        let end = offset.checked_add(bytes(view.byte_length)?)?;
        let first = offset.checked_add(bytes(accessor.byte_offset.unwrap_or_default())?)?;
        let stride = view.byte_stride.map_or(size, |stride| stride.0);
        let count = bytes(accessor.count)?;
        let last = first.checked_add(count.checked_sub(1)?.checked_mul(stride)?)?;
        let within = last.checked_add(size)? <= end && end <= self.numbers.len();
        (within && stride >= size).then_some((first, stride, count))
    }
}
