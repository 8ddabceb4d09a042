//! The two passes: shadow map from the light, then colour, id and range from the camera.

use super::scene::{Scene, VERTEX_BYTES};
use super::targets::{
    COLOUR_FORMAT, DEPTH_FORMAT, INSTANCE_FORMAT, RANGE_FORMAT, depth_attachment, texture,
};

/// Side of the square shadow map, texels.
const SHADOW_MAP_PX: u32 = 768;

/// Pipelines and what they bind.
pub(super) struct Pipelines {
    shadow: wgpu::RenderPipeline,
    shadowed: wgpu::RenderPipeline,
    unshadowed: wgpu::RenderPipeline,
    records: wgpu::BindGroup,
    shadow_map: wgpu::BindGroup,
    shadow_view: wgpu::TextureView,
}

impl Pipelines {
    pub(super) fn new(device: &wgpu::Device, scene: &Scene) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("scene"),
            source: wgpu::ShaderSource::Wgsl(
                concat!(include_str!("scene.wgsl"), include_str!("surface.wgsl")).into(),
            ),
        });
        let (records_layout, records) = records(device, scene);
        let (shadow_layout, shadow_map, shadow_view) = shadow_map(device);
        let layout = |groups: &[Option<&wgpu::BindGroupLayout>]| {
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: None,
                bind_group_layouts: groups,
                immediate_size: 0,
            })
        };
        let scene_layout = layout(&[Some(&records_layout), Some(&shadow_layout)]);
        Self {
            shadow: shadow_pipeline(device, &module, &layout(&[Some(&records_layout)])),
            shadowed: scene_pipeline(device, &module, &scene_layout, 1.0),
            unshadowed: scene_pipeline(device, &module, &scene_layout, 0.0),
            records,
            shadow_map,
            shadow_view,
        }
    }

    /// Draws the scene as the light sees it.
    pub(super) fn draw_shadow_map(&self, encoder: &mut wgpu::CommandEncoder, scene: &Scene) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow map"),
            depth_stencil_attachment: Some(depth_attachment(
                &self.shadow_view,
                wgpu::StoreOp::Store,
            )),
            ..Default::default()
        });
        pass.set_pipeline(&self.shadow);
        pass.set_bind_group(0, &self.records, &[]);
        scene.draw(&mut pass);
    }

    /// Draws the scene as the camera sees it.
    pub(super) fn draw_scene(&self, pass: &mut wgpu::RenderPass<'_>, scene: &Scene, shadows: bool) {
        pass.set_pipeline(if shadows {
            &self.shadowed
        } else {
            &self.unshadowed
        });
        pass.set_bind_group(0, &self.records, &[]);
        pass.set_bind_group(1, &self.shadow_map, &[]);
        scene.draw(pass);
    }
}

fn records(device: &wgpu::Device, scene: &Scene) -> (wgpu::BindGroupLayout, wgpu::BindGroup) {
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
        ty: wgpu::BindingType::Buffer {
            ty,
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };
    let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("records"),
        entries: &[
            entry(0, wgpu::BufferBindingType::Uniform),
            entry(1, wgpu::BufferBindingType::Storage { read_only: true }),
        ],
    });
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("records"),
        layout: &layout,
        entries: &[
            wgpu::BindGroupEntry {
                binding: 0,
                resource: scene.frame.as_entire_binding(),
            },
            wgpu::BindGroupEntry {
                binding: 1,
                resource: scene.objects.as_entire_binding(),
            },
        ],
    });
    (layout, group)
}

fn shadow_map(
    device: &wgpu::Device,
) -> (wgpu::BindGroupLayout, wgpu::BindGroup, wgpu::TextureView) {
    let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
    let view = texture(
        device,
        "shadow map",
        SHADOW_MAP_PX,
        SHADOW_MAP_PX,
        DEPTH_FORMAT,
        usage,
    )
    .create_view(&wgpu::TextureViewDescriptor::default());
    let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("shadow"),
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        compare: Some(wgpu::CompareFunction::LessEqual),
        ..Default::default()
    });
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty,
        count: None,
    };
    let depth = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Depth,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("shadow map"),
        entries: &[
            entry(0, depth),
            entry(
                1,
                wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Comparison),
            ),
        ],
    });
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("shadow map"),
        layout: &layout,
        entries: &[
            wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&view),
            },
            wgpu::BindGroupEntry {
                binding: 1,
                resource: wgpu::BindingResource::Sampler(&sampler),
            },
        ],
    });
    (layout, group, view)
}

const VERTEX: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: VERTEX_BYTES,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3],
};

const fn visibility(bias: wgpu::DepthBiasState) -> wgpu::DepthStencilState {
    wgpu::DepthStencilState {
        format: DEPTH_FORMAT,
        depth_write_enabled: Some(true),
        depth_compare: Some(wgpu::CompareFunction::Less),
        stencil: wgpu::StencilState {
            front: wgpu::StencilFaceState::IGNORE,
            back: wgpu::StencilFaceState::IGNORE,
            read_mask: 0,
            write_mask: 0,
        },
        bias,
    }
}

fn shadow_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
) -> wgpu::RenderPipeline {
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("shadow map"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("shadow_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(VERTEX)],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(visibility(wgpu::DepthBiasState {
            constant: 0,
            slope_scale: 1.5,
            clamp: 0.0,
        })),
        multisample: wgpu::MultisampleState::default(),
        fragment: None,
        multiview_mask: None,
        cache: None,
    })
}

fn scene_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
    shadows: f64,
) -> wgpu::RenderPipeline {
    let target = |format| {
        Some(wgpu::ColorTargetState {
            format,
            blend: None,
            write_mask: wgpu::ColorWrites::ALL,
        })
    };
    let texels = f64::from(SHADOW_MAP_PX);
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("scene"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("scene_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(VERTEX)],
        },
        primitive: wgpu::PrimitiveState {
            cull_mode: Some(wgpu::Face::Back),
            ..Default::default()
        },
        depth_stencil: Some(visibility(wgpu::DepthBiasState::default())),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("scene_fragment"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &[("SHADOWS", shadows), ("SHADOW_MAP_PX", texels)],
                ..Default::default()
            },
            targets: &[
                target(COLOUR_FORMAT),
                target(INSTANCE_FORMAT),
                target(RANGE_FORMAT),
            ],
        }),
        multiview_mask: None,
        cache: None,
    })
}
