//! The scene on the device: all meshes in one set of buffers.
//!
//! Three vertex buffers run side by side, one entry a vertex: position and normal, the place on the
//! pattern, what is baked. Each visual is a range of the index buffer with a base vertex, so its
//! indices are its mesh's own. Uploaded once; only [`Scene::reshape`] and the baking write into
//! them later.
//!
//! Records are written anew for each eye and image, even where nothing has moved: 256 bytes an
//! object are little beside an image.

use hal::{Mesh, Pose};
use nalgebra::{Isometry3, Point3};
use wgpu::util::DeviceExt;

use super::RenderError;
use super::bake::{Paints, Wanted};
use super::occlusion::{self, Baked};
use super::records::{Eye, OBJECT_STRIDE, Records, put, put_matrix};
use crate::visual::{Material, Pattern, Visual};

/// Bytes of one vertex: position and normal.
pub(super) const VERTEX_BYTES: u64 = 24;

/// Bytes of one place on a surface, see `unrolled`.
pub(super) const UNROLLED_BYTES: u64 = 8;

/// Bytes of what is baked into a vertex, see [`Baked`].
pub(super) const BAKED_BYTES: u64 = 8;

/// One mesh inside the shared buffers.
struct Part {
    /// For error messages.
    name: &'static str,
    /// Its range of the index buffer.
    indices: core::ops::Range<u32>,
    /// What is added to its indices.
    base_vertex: i32,
    /// What a new mesh of it must have.
    vertex_count: usize,
    /// Middle of a ball around it, in its own frame, m; for the order of drawing.
    centre: Point3<f64>,
    /// Radius of that ball.
    radius_m: f64,
    material: Material,
    /// Its layer of the painted patterns; a number that the shader makes whole.
    layer: f32,
    /// Factors of its linear colour.
    tint: [f32; 3],
    instance: u8,
}

/// Geometry, and room to prepare a frame's records in.
pub(super) struct Scene {
    /// `VERTEX_BYTES` a vertex.
    vertices: wgpu::Buffer,
    /// `UNROLLED_BYTES` a vertex.
    unrolled: wgpu::Buffer,
    /// `BAKED_BYTES` a vertex; all in the open until `bake`.
    baked: wgpu::Buffer,
    /// Four bytes each.
    indices: wgpu::Buffer,
    /// What is to be baked once it is wanted.
    unbaked: Option<Vec<Visual>>,
    parts: Vec<Part>,
    /// Distance of the near side along the eye's z, m, and the part, of the last eye.
    order: Vec<(f64, u32)>,
    /// Scratch, kept for its room.
    bytes: Vec<u8>,
}

impl Scene {
    /// All meshes of `visuals` in their order, with the layers that `paints` has for them.
    ///
    /// # Errors
    /// A mesh whose lists do not fit each other, or more vertices or indices than 32 bits count.
    pub(super) fn upload(
        device: &wgpu::Device,
        visuals: &[Visual],
        paints: &Paints,
    ) -> Result<Self, RenderError> {
        let (mut vertices, mut places, mut baked) = (Vec::new(), Vec::new(), Vec::new());
        let mut indices = Vec::new();
        let mut parts = Vec::with_capacity(visuals.len());
        let (mut vertex_count, mut index_count) = (0_u32, 0_u32);
        for visual in visuals {
            let (new_vertices, new_indices) = check(visual)?;
            let too_many = || RenderError::Mesh {
                name: visual.name,
                reason: "the scene has too many vertices",
            };
            let base_vertex = i32::try_from(vertex_count).map_err(|_| too_many())?;
            let end = index_count.checked_add(new_indices).ok_or_else(too_many)?;
            let layer = paints.layer(&Wanted::of(visual));
            parts.push(Part::new(visual, layer, index_count..end, base_vertex));
            index_count = end;
            vertex_count = vertex_count
                .checked_add(new_vertices)
                .ok_or_else(too_many)?;
            put_vertices(&mut vertices, &visual.mesh);
            for (position, normal) in visual.mesh.positions.iter().zip(&visual.mesh.normals) {
                put(&mut places, &unrolled(position, normal));
                put_baked(&mut baked, &Baked::OPEN);
            }
            indices.extend(
                visual
                    .mesh
                    .indices
                    .iter()
                    .flat_map(|index| index.to_ne_bytes()),
            );
        }
        // An empty buffer can't be bound.
        vertices.resize(vertices.len().max(64), 0);
        places.resize(places.len().max(64), 0);
        baked.resize(baked.len().max(64), 0);
        indices.resize(indices.len().max(64), 0);
        let filled = |label, contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents,
                usage,
            })
        };
        Ok(Self {
            vertices: filled(
                "vertices",
                &vertices,
                wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::VERTEX,
            ),
            unrolled: filled("unrolled", &places, wgpu::BufferUsages::VERTEX),
            baked: filled(
                "baked",
                &baked,
                wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::VERTEX,
            ),
            unbaked: Some(visuals.to_vec()),
            indices: filled("indices", &indices, wgpu::BufferUsages::INDEX),
            order: Vec::with_capacity(parts.len()),
            bytes: Vec::with_capacity(OBJECT_STRIDE as usize * parts.len().max(2)),
            parts,
        })
    }

    /// Bakes what is not baked yet into the vertices, as their meshes were when they were uploaded.
    ///
    /// Runs on all processors and blocks.
    pub(super) fn bake(&mut self, queue: &wgpu::Queue) {
        if let Some(visuals) = self.unbaked.take() {
            self.bytes.clear();
            for baked in occlusion::bake(&visuals) {
                put_baked(&mut self.bytes, &baked);
            }
            queue.write_buffer(&self.baked, 0, &self.bytes);
        }
    }

    /// Moves the vertices of the visual `index` to where `mesh` has them; the triangles stay.
    ///
    /// O(vertices of the mesh); its ball is found anew.
    pub(super) fn reshape(
        &mut self,
        queue: &wgpu::Queue,
        index: usize,
        mesh: &Mesh,
    ) -> Result<(), RenderError> {
        let expected = self.parts.len();
        let Some(part) = self.parts.get_mut(index) else {
            let got = index + 1;
            return Err(RenderError::PoseCount { expected, got });
        };
        if [mesh.positions.len(), mesh.normals.len()] != [part.vertex_count; 2] {
            return Err(RenderError::Mesh {
                name: part.name,
                reason: "as many vertices as before are needed",
            });
        }
        (part.centre, part.radius_m) = ball(mesh);
        self.bytes.clear();
        put_vertices(&mut self.bytes, mesh);
        let first = u64::from(part.base_vertex.unsigned_abs());
        queue.write_buffer(&self.vertices, first * VERTEX_BYTES, &self.bytes);
        Ok(())
    }

    /// Multiplies the colours of the visuals by `tints`, in their order; of those beyond the last
    /// tint by nothing.
    pub(super) fn tint(&mut self, tints: impl IntoIterator<Item = [f32; 3]>) {
        let tints = tints.into_iter().chain(core::iter::repeat([1.0; 3]));
        for (part, tint) in self.parts.iter_mut().zip(tints) {
            part.tint = tint;
        }
    }

    /// How many objects there are.
    pub(super) const fn part_count(&self) -> usize {
        self.parts.len()
    }

    /// Writes the records of one eye and decides its order of drawing: nearest first, so that what
    /// it hides is never shaded.
    ///
    /// Sorting is by the near side of the parts' balls, ties by index, so the order is the same for
    /// the same poses. It decides speed, and colour only where two surfaces are equally far.
    pub(super) fn place(
        &mut self,
        queue: &wgpu::Queue,
        records: &Records,
        poses: &[Pose],
        eye: &Eye<'_>,
    ) -> Result<(), RenderError> {
        if poses.len() != self.parts.len() {
            return Err(RenderError::PoseCount {
                expected: self.parts.len(),
                got: poses.len(),
            });
        }
        self.bytes.clear();
        self.order.clear();
        for (index, (part, pose)) in (0_u32..).zip(self.parts.iter().zip(poses)) {
            let eye_from_object = eye.eye_from_scene * pose;
            let end = self.bytes.len() + OBJECT_STRIDE as usize;
            part.write(&eye_from_object, index, &mut self.bytes);
            self.bytes.resize(end, 0);
            self.order
                .push(((eye_from_object * part.centre).z - part.radius_m, index));
        }
        self.order
            .sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        queue.write_buffer(&records.objects, 0, &self.bytes);
        self.bytes.clear();
        eye.write(&mut self.bytes);
        queue.write_buffer(&records.frame, 0, &self.bytes);
        Ok(())
    }

    /// Issues the draws in the order of the last [`Self::place`], each with its record of `records`
    /// and with the pipeline that `choose` names for its pattern; other bind groups, and the
    /// pipeline where it names none, are the caller's.
    pub(super) fn draw<'a>(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        records: &Records,
        choose: impl Fn(Pattern) -> Option<&'a wgpu::RenderPipeline>,
    ) {
        pass.set_vertex_buffer(0, self.vertices.slice(..));
        pass.set_vertex_buffer(1, self.unrolled.slice(..));
        pass.set_vertex_buffer(2, self.baked.slice(..));
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
        let drawn = self
            .order
            .iter()
            .filter_map(|&(_, index)| Some((index, self.parts.get(index as usize)?)));
        let mut current = None;
        for (index, part) in drawn.filter(|(_, part)| !part.indices.is_empty()) {
            let pipeline = choose(part.material.pattern);
            if let Some(pipeline) = pipeline
                && current != Some(pipeline)
            {
                pass.set_pipeline(pipeline);
                current = Some(pipeline);
            }
            records.bind(pass, index);
            pass.draw_indexed(part.indices.clone(), part.base_vertex, 0..1);
        }
    }
}

/// Where a point lies on its surface, m: its x and y, continued over edges as if the surface were
/// bent flat there.
///
/// On flat ground it is (x, y). On a slope the height times the normal is taken off, so that the
/// pattern is not stretched over steep sides.
fn unrolled(position: &[f32; 3], normal: &[f32; 3]) -> [f32; 2] {
    [0, 1].map(|axis| position[axis] - normal[axis] * position[2])
}

impl Part {
    fn new(visual: &Visual, layer: f32, indices: core::ops::Range<u32>, base_vertex: i32) -> Self {
        let (centre, radius_m) = ball(&visual.mesh);
        Self {
            name: visual.name,
            indices,
            base_vertex,
            vertex_count: visual.mesh.positions.len(),
            centre,
            radius_m,
            material: visual.material,
            layer,
            tint: [1.0; 3],
            instance: visual.instance,
        }
    }

    /// Appends its object record but for the padding, see `records`.
    ///
    /// Parts are numbered from 1 by their `index`. Beyond 65535 they share a number, and an edge
    /// between two of them is found by its normals or its step (`deferred.wgsl`).
    fn write(&self, eye_from_object: &Isometry3<f64>, index: u32, bytes: &mut Vec<u8>) {
        put_matrix(bytes, &eye_from_object.to_homogeneous());
        let surface = &self.material;
        put(bytes, &surface.base_colour);
        put(
            bytes,
            &[
                surface.metallic,
                surface.roughness,
                surface.wetness,
                surface.detail,
                f32::from(self.instance),
                self.layer,
            ],
        );
        put(bytes, &self.tint);
        let number = u16::try_from(index + 1).unwrap_or(u16::MAX);
        put(bytes, &[f32::from(number)]);
    }
}

/// A ball around a mesh, m.
///
/// The middle of the box, and the farthest vertex from it; not the smallest ball.
fn ball(mesh: &Mesh) -> (Point3<f64>, f64) {
    let points = || {
        mesh.positions
            .iter()
            .map(|p| Point3::from(p.map(f64::from)))
    };
    let (low, high) = points().fold(
        (Point3::from([f64::MAX; 3]), Point3::from([f64::MIN; 3])),
        |(low, high), p| (low.inf(&p), high.sup(&p)),
    );
    let centre = if mesh.positions.is_empty() {
        Point3::origin()
    } else {
        nalgebra::center(&low, &high)
    };
    let radius_m = points().map(|p| (p - centre).norm()).fold(0.0, f64::max);
    (centre, radius_m)
}

/// Appends positions and normals, alternating.
fn put_vertices(bytes: &mut Vec<u8>, mesh: &Mesh) {
    for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        put(bytes, position);
        put(bytes, normal);
    }
}

/// Appends what is baked into one vertex.
fn put_baked(bytes: &mut Vec<u8>, baked: &Baked) {
    put(bytes, &[baked.open, baked.through]);
}

/// Vertex and index counts of a mesh that is safe to draw.
///
/// Normals need not be of length 1: shaders normalise them.
fn check(visual: &Visual) -> Result<(u32, u32), RenderError> {
    let mesh = &visual.mesh;
    let fault = |reason| RenderError::Mesh {
        name: visual.name,
        reason,
    };
    let vertices = u32::try_from(mesh.positions.len()).map_err(|_| fault("too many vertices"))?;
    let indices = u32::try_from(mesh.indices.len()).map_err(|_| fault("too many indices"))?;
    if mesh.normals.len() != mesh.positions.len() {
        return Err(fault("as many normals as positions are needed"));
    }
    if indices % 3 != 0 {
        return Err(fault("the index count is not a multiple of three"));
    }
    if mesh.indices.iter().any(|&index| index >= vertices) {
        return Err(fault("an index points past the last vertex"));
    }
    Ok((vertices, indices))
}
