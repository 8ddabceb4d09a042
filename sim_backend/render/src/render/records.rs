//! What one eye, a camera or the light, tells the device about a frame: one record of its own and
//! one of each object.
//!
//! Records are uniforms in WGSL's layout, written field by field in the order of the structs of
//! `scene.wgsl`: a `vec3f` begins at a multiple of 16 bytes and the scalar after it fills its
//! fourth place, matrices are four columns. Nothing checks that both sides agree but their sizes
//! and the tests' pictures. All positions are relative to the eye, computed in double precision
//! before they are rounded.
//!
//! Bind group 0: binding 0 is the frame's record, binding 1 the object's at a dynamic offset of
//! `index * OBJECT_STRIDE`; both in all stages.

use core::num::NonZero;

use hal::count::index;
use nalgebra::{Isometry3, Matrix4, Vector3};
use wgpu::util::DeviceExt;

use super::{Camera, Light};
use crate::visual::Backdrop;

/// Bytes of one object record: a matrix (64), colour and metallic (16), roughness, wetness, detail
/// and id (16), layer and tint (16), its number (4) and 12 of padding.
const OBJECT_BYTES: u64 = 128;

/// From one object record to the next, bytes: what every device can bind at.
pub(super) const OBJECT_STRIDE: u32 = 256;

/// Bytes of the frame record: two matrices (128), the light (48), the backdrop (48), the lens (16),
/// a matrix (64), exposure (4) and 12 of padding.
const FRAME_BYTES: usize = 320;

/// The buffers of one eye. One set a camera and one for the light, so that images of several
/// cameras can be under way together.
pub(super) struct Records {
    /// One record, see `FRAME_BYTES`.
    pub(super) frame: wgpu::Buffer,
    /// A record each `OBJECT_STRIDE` bytes, in the order of the visuals.
    pub(super) objects: wgpu::Buffer,
    /// Both, as group 0.
    group: wgpu::BindGroup,
}

impl Records {
    /// Binds the frame's record and that of the object `index`.
    pub(super) fn bind(&self, pass: &mut wgpu::RenderPass<'_>, index: u32) {
        pass.set_bind_group(0, &self.group, &[OBJECT_STRIDE * index]);
    }

    /// Binds the frame's record for a pass that knows no objects.
    pub(super) fn bind_frame(&self, pass: &mut wgpu::ComputePass<'_>) {
        pass.set_bind_group(0, &self.group, &[0]);
    }

    /// Room for `parts` objects.
    pub(super) fn new(device: &wgpu::Device, layout: &wgpu::BindGroupLayout, parts: usize) -> Self {
        let filled = |label, bytes: usize, usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents: &vec![0; bytes],
                usage: wgpu::BufferUsages::COPY_DST | usage,
            })
        };
        let frame = filled("frame", FRAME_BYTES, wgpu::BufferUsages::UNIFORM);
        // An empty buffer can't be bound.
        let object_bytes = index(u64::from(OBJECT_STRIDE)) * parts.max(1);
        let objects = filled("objects", object_bytes, wgpu::BufferUsages::UNIFORM);
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("records"),
            layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: frame.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer: &objects,
                        offset: 0,
                        size: NonZero::new(OBJECT_BYTES),
                    }),
                },
            ],
        });
        Self {
            frame,
            objects,
            group,
        }
    }
}

/// How records are bound.
pub(super) fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |binding, has_dynamic_offset| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset,
            min_binding_size: None,
        },
        count: None,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("records"),
        entries: &[entry(0, false), entry(1, true)],
    })
}

/// An eye that records are written for.
pub(super) struct Eye<'a> {
    /// Coordinates of the eye (z along the view) from those of the scene.
    pub(super) eye_from_scene: Isometry3<f64>,
    /// The light of the picture, or the eye itself.
    light: &'a Light,
    /// None of the light.
    view: Option<View<'a>>,
}

/// What a camera needs besides.
pub(super) struct View<'a> {
    /// The pinhole that is drawn, not the lens.
    pub(super) camera: &'a Camera,
    /// What is seen where nothing is.
    pub(super) backdrop: &'a Backdrop,
    /// Its layer of the patterns.
    pub(super) backdrop_layer: f32,
    /// Side of the shadow map, texels.
    pub(super) shadow_map_px: u32,
    /// Factor of the light.
    pub(super) exposure: f64,
}

impl<'a> Eye<'a> {
    /// The light, which sees what it does not put into shadow.
    pub(super) fn light(light: &'a Light) -> Self {
        Self {
            eye_from_scene: light.guide_in_scene.inverse(),
            light,
            view: None,
        }
    }

    /// A camera in that light.
    pub(super) fn camera(light: &'a Light, view: View<'a>) -> Self {
        Self {
            eye_from_scene: view.camera.camera_in_scene.inverse(),
            light,
            view: Some(view),
        }
    }

    /// Appends the frame record; the light's has only its projection.
    pub(super) fn write(&self, bytes: &mut Vec<u8>) {
        let end = bytes.len() + FRAME_BYTES;
        match &self.view {
            None => put_matrix(bytes, &self.light.clip_from_light()),
            Some(view) => {
                put_matrix(bytes, &view.camera.clip_from_camera());
                self.write_light(view.shadow_map_px, bytes);
                view.write(&self.eye_from_scene, self.light, bytes);
            }
        }
        bytes.resize(end, 0);
    }

    /// The part of the frame record from `light_clip_from_camera` to `shadow_texel_tan`.
    fn write_light(&self, shadow_map_px: u32, bytes: &mut Vec<u8>) {
        let light = self.light;
        let eye_from_light = self.eye_from_scene * light.guide_in_scene;
        let light_from_eye = eye_from_light.inverse().to_homogeneous();
        put_matrix(bytes, &(light.clip_from_light() * light_from_eye));
        let place = eye_from_light.translation.vector;
        let power = light.intensity * light.reference_distance_m * light.reference_distance_m;
        put_f64(bytes, &[place.x, place.y, place.z, power]);
        let axis = eye_from_light * Vector3::z();
        let (outer, inner) = (light.cone_half_angle_rad, 0.5 * light.cone_half_angle_rad);
        put_f64(bytes, &[axis.x, axis.y, axis.z, outer.cos()]);
        let window = light.window_tan();
        let texel = 2.0 * window / f64::from(shadow_map_px);
        put_f64(bytes, &[inner.cos(), light.ambient, window, texel]);
    }
}

impl View<'_> {
    /// The part of the frame record from `up` to `exposure`.
    fn write(&self, camera_from_scene: &Isometry3<f64>, light: &Light, bytes: &mut Vec<u8>) {
        let (lens, behind) = (&self.camera.intrinsics, &self.backdrop.material);
        let up = camera_from_scene * Vector3::z();
        put_f64(bytes, &[up.x, up.y, up.z, self.backdrop.floor_m]);
        put(bytes, &self.backdrop.bounce);
        put(bytes, &[self.backdrop_layer, behind.roughness]);
        put(bytes, &[behind.wetness, self.backdrop.walls]);
        put_f64(bytes, &[light.warmth]);
        put_f64(bytes, &[lens.cx, lens.cy, 1.0 / lens.fx, 1.0 / lens.fy]);
        put_matrix(bytes, &self.camera.camera_in_scene.to_homogeneous());
        put_f64(bytes, &[self.exposure]);
    }
}

/// Appends numbers as the device reads them: single precision in the machine's byte order.
pub(super) fn put(bytes: &mut Vec<u8>, values: &[f32]) {
    bytes.extend(values.iter().flat_map(|value| value.to_ne_bytes()));
}

/// The same, rounded.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the device computes in single precision"
)]
pub(super) fn put_f64(bytes: &mut Vec<u8>, values: &[f64]) {
    bytes.extend(
        values
            .iter()
            .flat_map(|value| (*value as f32).to_ne_bytes()),
    );
}

/// Appends a matrix, column by column.
pub(super) fn put_matrix(bytes: &mut Vec<u8>, matrix: &Matrix4<f64>) {
    put_f64(bytes, matrix.as_slice());
}
