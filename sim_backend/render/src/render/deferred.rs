//! Deferred shading of fine pictures: what is seen in the middle of each pixel is kept in two images
//! (a G-buffer), and a compute pass works its colour out. An accelerator has many times the
//! processors for it that it has for fragments; a software rasteriser, which has the same for both,
//! draws colour at once.
//!
//! Pixels that an edge crosses are not shaded so: the colour pass, which takes several samples a
//! pixel, finds the others filled with a depth nearer than anything, and shades only these. Group
//! 2: 0 and 1 the two images, 2 what they are shaded into; to fill, 3 the same to read.

use hal::Intrinsics;

use super::Shading;
use super::pipelines::{Shaders, Surfaces};
use super::records::Records;
use super::targets::colour_samples;
use super::targets::depth_attachment;
use super::textures::{COLOUR_FORMAT, DEPTH_FORMAT, KEPT_FORMAT, cleared, texture, whole};

/// Pixels of a workgroup across and down, as in `deferred.wgsl`.
const GROUP_PX: u32 = 8;

/// The passes, for all cameras.
pub(super) struct Deferred {
    /// Those that keep.
    pub(super) surfaces: Surfaces,
    /// Group 2 of the pass that shades.
    kept_layout: wgpu::BindGroupLayout,
    /// Group 2 of what fills.
    shaded_layout: wgpu::BindGroupLayout,
    shade: wgpu::ComputePipeline,
    /// A triangle over the image.
    fill: wgpu::RenderPipeline,
}

/// What one camera keeps.
pub(super) struct Kept {
    /// See `Kept` of `deferred.wgsl`.
    views: [wgpu::TextureView; 2],
    /// Of an image, pixels.
    size: [u32; 2],
    /// To shade.
    group: wgpu::BindGroup,
    /// To fill.
    shaded: wgpu::BindGroup,
}

impl Deferred {
    /// With the pipelines that keep, and with the constants of the shading.
    pub(super) fn new(
        device: &wgpu::Device,
        shaders: &Shaders,
        surfaces: Surfaces,
        constants: &[(&str, f64)],
    ) -> Self {
        let [kept_layout, shaded_layout] = layouts(device);
        let shade = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("shade"),
            layout: Some(&shaders.layout(device, Some(&kept_layout))),
            module: &shaders.module,
            entry_point: Some("shade_kept"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                ..Default::default()
            },
            cache: None,
        });
        let fill = fill_pipeline(device, shaders, &shaded_layout);
        Self {
            surfaces,
            kept_layout,
            shaded_layout,
            shade,
            fill,
        }
    }

    /// Works out the colours of what is kept but where an edge is.
    pub(super) fn shade(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        camera: &Records,
        maps: &wgpu::BindGroup,
        kept: &Kept,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shade"),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.shade);
        camera.bind_frame(&mut pass);
        pass.set_bind_group(1, maps, &[]);
        pass.set_bind_group(2, &kept.group, &[]);
        let [across, down] = kept.size.map(|size| size.div_ceil(GROUP_PX));
        pass.dispatch_workgroups(across, down, 1);
    }

    /// Fills a colour pass, whose groups 0 and 1 are bound, with these colours.
    pub(super) fn fill(&self, pass: &mut wgpu::RenderPass<'_>, kept: &Kept) {
        pass.set_pipeline(&self.fill);
        pass.set_bind_group(2, &kept.shaded, &[]);
        pass.draw(0..3, 0..1);
    }
}

impl Kept {
    /// For images of the size of `image`.
    pub(super) fn new(device: &wgpu::Device, deferred: &Deferred, image: &Intrinsics) -> Self {
        let size = [image.width, image.height];
        let view = |label, format, written| {
            let usage = wgpu::TextureUsages::TEXTURE_BINDING | written;
            texture(device, label, image.width, image.height, format, usage)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let views = ["looks", "shape"].map(|label| view(label, KEPT_FORMAT, drawn));
        let shaded = view(
            "shaded",
            COLOUR_FORMAT,
            wgpu::TextureUsages::STORAGE_BINDING,
        );
        let [looks, shape] = &views;
        let group = |layout, entries: &[(u32, &wgpu::TextureView)]| {
            let entries: Vec<_> = entries
                .iter()
                .map(|&(binding, view)| wgpu::BindGroupEntry {
                    binding,
                    resource: wgpu::BindingResource::TextureView(view),
                })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("kept"),
                layout,
                entries: &entries,
            })
        };
        Self {
            group: group(
                &deferred.kept_layout,
                &[(0, looks), (1, shape), (2, &shaded)],
            ),
            shaded: group(&deferred.shaded_layout, &[(3, &shaded)]),
            views,
            size,
        }
    }

    /// Starts the pass that keeps, on the depth of the labels.
    pub(super) fn begin<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
        depth: &wgpu::TextureView,
    ) -> wgpu::RenderPass<'pass> {
        let seen = depth_attachment(depth, wgpu::LoadOp::Load, wgpu::StoreOp::Discard);
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("keep"),
            color_attachments: &self.views.each_ref().map(cleared),
            depth_stencil_attachment: Some(seen),
            ..Default::default()
        })
    }
}

/// Of group 2: to shade, and to fill.
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
    let kept = [
        entry(0, compute, read(wgpu::TextureSampleType::Uint)),
        entry(1, compute, read(wgpu::TextureSampleType::Uint)),
        entry(2, compute, written),
    ];
    let unfiltered = read(wgpu::TextureSampleType::Float { filterable: false });
    let shaded = [entry(3, wgpu::ShaderStages::FRAGMENT, unfiltered)];
    [&kept[..], &shaded[..]].map(|entries| {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("kept"),
            entries,
        })
    })
}

/// A triangle that is nearer than anything, whose pixels without a colour are left out.
fn fill_pipeline(
    device: &wgpu::Device,
    shaders: &Shaders,
    shaded: &wgpu::BindGroupLayout,
) -> wgpu::RenderPipeline {
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("fill"),
        layout: Some(&shaders.layout(device, Some(shaded))),
        vertex: wgpu::VertexState {
            module: &shaders.module,
            entry_point: Some("shaded_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Always),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState {
            count: colour_samples(Shading::Fine),
            ..Default::default()
        },
        fragment: Some(wgpu::FragmentState {
            module: &shaders.module,
            entry_point: Some("shaded_fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[whole(COLOUR_FORMAT)],
        }),
        multiview_mask: None,
        cache: None,
    })
}
