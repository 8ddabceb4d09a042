//! Draws the vessels of a painted square: a quadrangle for each stretch, see `vessels.wgsl`.

use hal::count::count_u32;
use wgpu::util::DeviceExt;

use super::records::put_f64;
use super::textures::cleared;
use super::vessels::Stretch;

/// How much of each vessel is seen; only while a layer is painted.
pub(super) const VESSELS_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Bytes of a stretch: eight floats.
const STRETCH_BYTES: wgpu::BufferAddress = 32;

/// The pass; where vessels cross, the one that is seen best counts.
pub(super) struct VesselPass {
    pipeline: wgpu::RenderPipeline,
}

impl VesselPass {
    /// `module` holds `bake.wgsl` and `vessels.wgsl`, group 0 of the `paint_layout` the paint's
    /// record.
    pub(super) fn new(
        device: &wgpu::Device,
        module: &wgpu::ShaderModule,
        paint_layout: &wgpu::BindGroupLayout,
    ) -> Self {
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("vessels"),
            bind_group_layouts: &[Some(paint_layout)],
            immediate_size: 0,
        });
        let most = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::One,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::Max,
        };
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("vessels"),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module,
                entry_point: Some("vessel_vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[Some(wgpu::VertexBufferLayout {
                    array_stride: STRETCH_BYTES,
                    step_mode: wgpu::VertexStepMode::Instance,
                    attributes: &wgpu::vertex_attr_array![0 => Float32x4, 1 => Float32x4],
                })],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some("vessel_fragment"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState {
                    format: VESSELS_FORMAT,
                    blend: Some(wgpu::BlendState {
                        color: most,
                        alpha: most,
                    }),
                    write_mask: wgpu::ColorWrites::ALL,
                })],
            }),
            multiview_mask: None,
            cache: None,
        });
        Self { pipeline }
    }

    /// Draws `stretches` into `to`, with the paint's record as group 0.
    pub(super) fn draw(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        paint: &wgpu::BindGroup,
        stretches: &[Stretch],
        to: &wgpu::TextureView,
    ) {
        let mut contents = Vec::new();
        for stretch in stretches {
            put_stretch(&mut contents, stretch);
        }
        let buffer = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("vessels"),
            contents: &contents,
            usage: wgpu::BufferUsages::VERTEX,
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("vessels"),
            color_attachments: &[cleared(to)],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, paint, &[]);
        pass.set_vertex_buffer(0, buffer.slice(..));
        pass.draw(0..6, 0..count_u32(stretches.len()));
    }
}

/// Both ends, the radius, the shares at the ends, and 1 for an artery's.
fn put_stretch(bytes: &mut Vec<u8>, stretch: &Stretch) {
    put_f64(bytes, stretch.ends_mm.as_flattened());
    let [first, last] = stretch.shares;
    let is_artery = f64::from(u8::from(stretch.is_artery));
    put_f64(bytes, &[stretch.radius_mm, first, last, is_artery]);
}
