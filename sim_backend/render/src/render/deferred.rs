//! Deferred shading of fine pictures: what is seen at each pixel's centre is drawn into a G-buffer
//! of two images, and a compute pass works its colour out, once a pixel. An H100 or H200 has many
//! times the processors for it that it has for fragments; a software rasteriser gains in most scenes
//! (`tests/benches/RESULTS.md`).
//!
//! Then the scene is drawn with several samples a pixel, each of which takes the colour of that
//! pixel around it that is most like its surface, so edges are smooth. What covers no pixel's centre
//! is not seen: a thread thinner than a pixel breaks up. Triangles smaller than a pixel are not
//! blended. Group 2: 0 and 1 the G-buffer, 2 what it is shaded into, 3 the same to read.

use hal::Intrinsics;

use super::Shading;
use super::pipelines::{
    BACKDROP, Shaders, Surfaces, VERTEX, constants, culled, unbiased, visibility,
};
use super::records::Records;
use super::scene::Scene;
use super::targets::depth_attachment;
use super::textures::{COLOUR_FORMAT, GBUFFER_FORMAT, cleared, texture, whole};

/// Pixels of a workgroup across and down, as in `deferred.wgsl`.
const GROUP_PX: u32 = 8;

/// Samples a pixel, at the standard places; the fragment shader runs once a pixel and triangle.
pub(super) const SAMPLES: u32 = 4;

/// The passes, for all cameras.
pub(super) struct Deferred {
    /// Those that draw the G-buffer.
    pub(super) surfaces: Surfaces,
    /// Group 2 of the pass that shades.
    gbuffer_layout: wgpu::BindGroupLayout,
    /// Group 2 of the pass that draws.
    shaded_layout: wgpu::BindGroupLayout,
    shade: wgpu::ComputePipeline,
    /// Of all surfaces.
    sample: wgpu::RenderPipeline,
    /// A triangle over the image.
    backdrop: wgpu::RenderPipeline,
}

/// What one camera's picture is shaded from.
pub(super) struct GBuffer {
    /// See `GBuffer` of `deferred.wgsl`.
    views: [wgpu::TextureView; 2],
    /// Of an image, pixels.
    size: [u32; 2],
    /// To shade.
    group: wgpu::BindGroup,
    /// To draw.
    shaded: wgpu::BindGroup,
}

impl Deferred {
    /// With the pipelines that draw the G-buffer.
    pub(super) fn new(device: &wgpu::Device, shaders: &Shaders, surfaces: Surfaces) -> Self {
        let [gbuffer_layout, shaded_layout] = layouts(device);
        let shade = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("shade"),
            layout: Some(&shaders.layout(device, Some(&gbuffer_layout))),
            module: &shaders.module,
            entry_point: Some("shade_gbuffer"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &constants(Shading::Fine),
                ..Default::default()
            },
            cache: None,
        });
        let layout = shaders.layout(device, Some(&shaded_layout));
        let sample = |vertex, fragment| {
            sample_pipeline(device, &shaders.module, &layout, [vertex, fragment])
        };
        Self {
            surfaces,
            gbuffer_layout,
            shaded_layout,
            shade,
            sample: sample("sampled_vertex", "sampled_fragment"),
            backdrop: sample(BACKDROP, "backdrop_sampled"),
        }
    }

    /// Works out the colours of what is in the G-buffer.
    pub(super) fn shade(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        camera: &Records,
        maps: &wgpu::BindGroup,
        gbuffer: &GBuffer,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shade"),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.shade);
        camera.bind_frame(&mut pass);
        pass.set_bind_group(1, maps, &[]);
        pass.set_bind_group(2, &gbuffer.group, &[]);
        let [across, down] = gbuffer.size.map(|size| size.div_ceil(GROUP_PX));
        pass.dispatch_workgroups(across, down, 1);
    }

    /// Draws a colour pass, whose group 1 is bound, with these colours.
    pub(super) fn draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        scene: &Scene,
        camera: &Records,
        gbuffer: &GBuffer,
    ) {
        pass.set_bind_group(2, &gbuffer.shaded, &[]);
        pass.set_pipeline(&self.sample);
        scene.draw(pass, camera, |_| None);
        pass.set_pipeline(&self.backdrop);
        camera.bind(pass, 0);
        pass.draw(0..3, 0..1);
    }
}

impl GBuffer {
    /// For images of the size of `image`.
    pub(super) fn new(device: &wgpu::Device, deferred: &Deferred, image: &Intrinsics) -> Self {
        let size = [image.width, image.height];
        let view = |label, format, written| {
            let usage = wgpu::TextureUsages::TEXTURE_BINDING | written;
            texture(device, label, image.width, image.height, format, usage)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let views = ["look", "shape"].map(|label| view(label, GBUFFER_FORMAT, drawn));
        let shaded = view(
            "shaded",
            COLOUR_FORMAT,
            wgpu::TextureUsages::STORAGE_BINDING,
        );
        let [look, shape] = &views;
        let group = |layout, entries: &[(u32, &wgpu::TextureView)]| {
            let entries: Vec<_> = entries
                .iter()
                .map(|&(binding, view)| wgpu::BindGroupEntry {
                    binding,
                    resource: wgpu::BindingResource::TextureView(view),
                })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("G-buffer"),
                layout,
                entries: &entries,
            })
        };
        Self {
            group: group(
                &deferred.gbuffer_layout,
                &[(0, look), (1, shape), (2, &shaded)],
            ),
            shaded: group(&deferred.shaded_layout, &[(1, shape), (3, &shaded)]),
            views,
            size,
        }
    }

    /// Starts the pass that draws them, on the depth of the labels.
    pub(super) fn begin<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
        depth: &wgpu::TextureView,
    ) -> wgpu::RenderPass<'pass> {
        let seen = depth_attachment(depth, wgpu::LoadOp::Load, wgpu::StoreOp::Discard);
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("G-buffer"),
            color_attachments: &self.views.each_ref().map(cleared),
            depth_stencil_attachment: Some(seen),
            ..Default::default()
        })
    }
}

/// Of group 2: to shade, and to draw.
fn layouts(device: &wgpu::Device) -> [wgpu::BindGroupLayout; 2] {
    let read = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let entry = |binding, visibility, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty,
        count: None,
    };
    let written = wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format: COLOUR_FORMAT,
        view_dimension: wgpu::TextureViewDimension::D2,
    };
    let compute = wgpu::ShaderStages::COMPUTE;
    let gbuffer = [
        entry(0, compute, read(wgpu::TextureSampleType::Uint)),
        entry(1, compute, read(wgpu::TextureSampleType::Uint)),
        entry(2, compute, written),
    ];
    let unfiltered = read(wgpu::TextureSampleType::Float { filterable: false });
    let fragment = wgpu::ShaderStages::FRAGMENT;
    let shaded = [
        entry(1, fragment, read(wgpu::TextureSampleType::Uint)),
        entry(3, fragment, unfiltered),
    ];
    [&gbuffer[..], &shaded[..]].map(|entries| {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("G-buffer"),
            entries,
        })
    })
}

/// Several samples a pixel, each with a colour that is there already.
fn sample_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
    [vertex, fragment]: [&'static str; 2],
) -> wgpu::RenderPipeline {
    let behind = vertex == BACKDROP;
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some(vertex),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: if behind { &[] } else { &[Some(VERTEX)] },
        },
        primitive: culled(),
        depth_stencil: Some(wgpu::DepthStencilState {
            depth_write_enabled: Some(!behind),
            depth_compare: Some(wgpu::CompareFunction::LessEqual),
            ..visibility(unbiased())
        }),
        multisample: wgpu::MultisampleState {
            count: SAMPLES,
            ..Default::default()
        },
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[whole(COLOUR_FORMAT)],
        }),
        multiview_mask: None,
        cache: None,
    })
}
