//! The scene on the device: all meshes in one pair of buffers, one record an object, one record a frame.

use hal::Pose;
use nalgebra::{Isometry3, Matrix4, Point3};
use wgpu::util::DeviceExt;

use super::{Camera, Light, RenderError};
use crate::visual::{Material, Mesh, Visual};

/// Bytes of one vertex: position and normal.
pub(super) const VERTEX_BYTES: u64 = 24;

/// Bytes of one object record, see `scene.wgsl`.
const OBJECT_BYTES: usize = 96;

/// Bytes of the frame record, see `scene.wgsl`.
const FRAME_BYTES: usize = 176;

/// One mesh inside the shared buffers.
struct Part {
    name: &'static str,
    indices: core::ops::Range<u32>,
    base_vertex: i32,
    vertex_count: usize,
    centre: Point3<f64>,
    radius_m: f64,
    material: Material,
    instance: u8,
}

/// Geometry and per-frame records.
pub(super) struct Scene {
    pub(super) vertices: wgpu::Buffer,
    pub(super) indices: wgpu::Buffer,
    pub(super) frame: wgpu::Buffer,
    pub(super) objects: wgpu::Buffer,
    parts: Vec<Part>,
    order: Vec<(f64, u32)>,
    bytes: Vec<u8>,
}

impl Scene {
    pub(super) fn upload(device: &wgpu::Device, visuals: &[Visual]) -> Result<Self, RenderError> {
        let mut vertices = Vec::new();
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
            parts.push(Part::new(visual, index_count..end, base_vertex));
            index_count = end;
            vertex_count = vertex_count
                .checked_add(new_vertices)
                .ok_or_else(too_many)?;
            put_vertices(&mut vertices, &visual.mesh);
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
        indices.resize(indices.len().max(64), 0);
        let filled = |label, contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents,
                usage,
            })
        };
        let record = wgpu::BufferUsages::COPY_DST;
        Ok(Self {
            vertices: filled("vertices", &vertices, record | wgpu::BufferUsages::VERTEX),
            indices: filled("indices", &indices, wgpu::BufferUsages::INDEX),
            frame: filled(
                "frame",
                &[0; FRAME_BYTES],
                record | wgpu::BufferUsages::UNIFORM,
            ),
            objects: filled(
                "objects",
                &vec![0; OBJECT_BYTES * parts.len().max(1)],
                record | wgpu::BufferUsages::STORAGE,
            ),
            order: Vec::with_capacity(parts.len()),
            bytes: Vec::with_capacity(OBJECT_BYTES * parts.len().max(2)),
            parts,
        })
    }

    /// Moves the vertices of the visual `index` to where `mesh` has them; the triangles stay.
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

    /// Writes the records of one frame and decides the order of drawing: nearest first, so that what it hides is
    /// never shaded.
    pub(super) fn place(
        &mut self,
        queue: &wgpu::Queue,
        poses: &[Pose],
        camera: &Camera,
        light: &Light,
    ) -> Result<(), RenderError> {
        if poses.len() != self.parts.len() {
            return Err(RenderError::PoseCount {
                expected: self.parts.len(),
                got: poses.len(),
            });
        }
        let camera_from_scene = camera.camera_in_scene.inverse();
        self.bytes.clear();
        self.order.clear();
        for (index, (part, pose)) in (0_u32..).zip(self.parts.iter().zip(poses)) {
            let camera_from_object = camera_from_scene * pose;
            part.write(&camera_from_object, &mut self.bytes);
            self.order
                .push(((camera_from_object * part.centre).z - part.radius_m, index));
        }
        self.order
            .sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        queue.write_buffer(&self.objects, 0, &self.bytes);
        self.bytes.clear();
        write_frame(camera, light, &mut self.bytes);
        queue.write_buffer(&self.frame, 0, &self.bytes);
        Ok(())
    }

    /// Issues the draws; pipeline and bind groups are the caller's.
    pub(super) fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_vertex_buffer(0, self.vertices.slice(..));
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
        let drawn = self
            .order
            .iter()
            .filter_map(|&(_, index)| Some((index, self.parts.get(index as usize)?)));
        for (index, part) in drawn.filter(|(_, part)| !part.indices.is_empty()) {
            pass.draw_indexed(part.indices.clone(), part.base_vertex, index..index + 1);
        }
    }
}

impl Part {
    fn new(visual: &Visual, indices: core::ops::Range<u32>, base_vertex: i32) -> Self {
        let (centre, radius_m) = ball(&visual.mesh);
        Self {
            name: visual.name,
            indices,
            base_vertex,
            vertex_count: visual.mesh.positions.len(),
            centre,
            radius_m,
            material: visual.material,
            instance: visual.instance,
        }
    }

    fn write(&self, camera_from_object: &Isometry3<f64>, bytes: &mut Vec<u8>) {
        put_matrix(bytes, &camera_from_object.to_homogeneous());
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
            ],
        );
    }
}

/// A ball around a mesh, m.
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

fn put_vertices(bytes: &mut Vec<u8>, mesh: &Mesh) {
    for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        put(bytes, position);
        put(bytes, normal);
    }
}

/// Vertex and index counts of a mesh that is safe to draw.
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

fn write_frame(camera: &Camera, light: &Light, bytes: &mut Vec<u8>) {
    put_matrix(bytes, &camera.clip_from_camera());
    put_matrix(bytes, &light.clip_from_camera(camera));
    let [x, y, z] = light.position_in_camera_m;
    put_f64(
        bytes,
        &[
            x,
            y,
            z,
            light.intensity * light.reference_distance_m * light.reference_distance_m,
        ],
    );
    let outer = light.cone_half_angle_rad;
    put_f64(
        bytes,
        &[
            outer.cos(),
            (0.55 * outer).cos(),
            light.ambient,
            light.window_tan(camera),
        ],
    );
    let up = camera.camera_in_scene.rotation.inverse() * nalgebra::Vector3::z();
    put_f64(bytes, &[up.x, up.y, up.z, 0.0]);
}

fn put(bytes: &mut Vec<u8>, values: &[f32]) {
    bytes.extend(values.iter().flat_map(|value| value.to_ne_bytes()));
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the device computes in single precision"
)]
fn put_f64(bytes: &mut Vec<u8>, values: &[f64]) {
    bytes.extend(
        values
            .iter()
            .flat_map(|value| (*value as f32).to_ne_bytes()),
    );
}

fn put_matrix(bytes: &mut Vec<u8>, matrix: &Matrix4<f64>) {
    put_f64(bytes, matrix.as_slice());
}
