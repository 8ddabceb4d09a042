//! The passes: shadow map from the light, then ids and range, then colour from the camera, at once
//! or from a G-buffer that is shaded before (`deferred`).
//!
//! All scene shaders are one module of six files, joined as text; entry points choose the pass.
//! Shadow and labels bind group 0 alone and take one sample; colour binds the maps too. Front faces
//! are counter-clockwise; back faces are culled but in the shadow map, so that open sheets cast
//! shadows whichever side the light is on. Changing the shading makes new colour pipelines, for it
//! is in their constants and vertex layout.

use super::bake::{BACKDROP_SIZE_M, PATTERN_SIZE_M, Paints};
use super::camera::{SHADOW_FAR_M, SHADOW_NEAR_M};
use super::deferred::Deferred;
use super::records::{self, Records};
use super::scene::{BAKED_BYTES, Scene, UNROLLED_BYTES, VERTEX_BYTES};
use super::targets::{FAR, Targets, depth_attachment};
use super::textures::{
    COLOUR_FORMAT, DEPTH_FORMAT, GBUFFER_FORMAT, INSTANCE_FORMAT, RANGE_FORMAT, texture, whole,
};
use super::{RenderError, Shading, maps};
use crate::visual::Pattern;

/// Side of the square shadow map, texels.
pub(super) const SHADOW_MAP_PX: u32 = 1024;

/// Pipelines and what they bind.
pub(super) struct Pipelines {
    /// What they are made of.
    shaders: Shaders,
    /// Depth alone, from the light.
    shadow: wgpu::RenderPipeline,
    /// Ids and range, from a camera.
    label: wgpu::RenderPipeline,
    /// Colour, from a camera.
    colours: Colours,
    /// Group 1.
    maps: wgpu::BindGroup,
    /// The shadow map, to draw into.
    shadow_view: wgpu::TextureView,
}

/// The module of all shaders of the scene, and the layouts that they share.
pub(super) struct Shaders {
    /// See the files.
    pub(super) module: wgpu::ShaderModule,
    /// Of group 0.
    records: wgpu::BindGroupLayout,
    /// Of group 1.
    maps: wgpu::BindGroupLayout,
}

/// How surfaces get their colours.
enum Colours {
    /// Where they are drawn.
    AtOnce(Surfaces),
    /// In a pass of their own before, in fine shading.
    Deferred(Deferred),
}

/// The pipelines of a pass that looks at surfaces, not at their places alone.
pub(super) struct Surfaces {
    /// Of patterns that are painted into a layer.
    patterned: wgpu::RenderPipeline,
    /// Of [`Pattern::Smooth`].
    smooth: wgpu::RenderPipeline,
    /// Of [`Pattern::Brushed`].
    brushed: wgpu::RenderPipeline,
    /// A triangle over the image, without a mesh.
    backdrop: wgpu::RenderPipeline,
}

impl Shaders {
    /// Compiles all of them.
    fn new(device: &wgpu::Device) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("scene"),
            source: wgpu::ShaderSource::Wgsl(
                concat!(
                    include_str!("scene.wgsl"),
                    include_str!("noise.wgsl"),
                    include_str!("tone.wgsl"),
                    include_str!("light.wgsl"),
                    include_str!("surface.wgsl"),
                    include_str!("deferred.wgsl")
                )
                .into(),
            ),
        });
        Self {
            module,
            records: records::layout(device),
            maps: maps::layout(device),
        }
    }

    /// Groups 0 and 1, and 2 as `more` has it.
    pub(super) fn layout(
        &self,
        device: &wgpu::Device,
        more: Option<&wgpu::BindGroupLayout>,
    ) -> wgpu::PipelineLayout {
        let mut groups = vec![Some(&self.records), Some(&self.maps)];
        groups.extend(more.map(Some));
        layout(device, &groups)
    }
}

/// Of these groups.
fn layout(
    device: &wgpu::Device,
    groups: &[Option<&wgpu::BindGroupLayout>],
) -> wgpu::PipelineLayout {
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: groups,
        immediate_size: 0,
    })
}

impl Pipelines {
    /// Compiles all shaders of the scene and makes the shadow map.
    pub(super) fn new(device: &wgpu::Device, paints: &Paints, shading: Shading) -> Self {
        let shaders = Shaders::new(device);
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let shadow_view = texture(
            device,
            "shadow map",
            SHADOW_MAP_PX,
            SHADOW_MAP_PX,
            DEPTH_FORMAT,
            usage,
        )
        .create_view(&wgpu::TextureViewDescriptor::default());
        let records_alone = layout(device, &[Some(&shaders.records)]);
        Self {
            shadow: shadow_pipeline(device, &shaders.module, &records_alone),
            label: label_pipeline(device, &shaders.module, &records_alone),
            colours: Colours::new(device, &shaders, shading),
            maps: maps::group(device, &shaders.maps, &shadow_view, paints),
            shadow_view,
            shaders,
        }
    }

    /// Prepares for another kind of shading.
    pub(super) fn set_shading(&mut self, device: &wgpu::Device, shading: Shading) {
        self.colours = Colours::new(device, &self.shaders, shading);
    }

    /// Layout of group 0, for whoever makes records.
    pub(super) const fn records(&self) -> &wgpu::BindGroupLayout {
        &self.shaders.records
    }

    /// What shades fine pictures, for whoever makes targets.
    pub(super) const fn deferred(&self) -> Option<&Deferred> {
        match &self.colours {
            Colours::AtOnce(_) => None,
            Colours::Deferred(deferred) => Some(deferred),
        }
    }

    /// Draws the scene as the light sees it.
    pub(super) fn draw_shadow_map(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &Scene,
        light: &Records,
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow map"),
            depth_stencil_attachment: Some(depth_attachment(
                &self.shadow_view,
                FAR,
                wgpu::StoreOp::Store,
            )),
            ..Default::default()
        });
        pass.set_pipeline(&self.shadow);
        scene.draw(&mut pass, light, |_| None);
    }

    /// Draws what is where.
    pub(super) fn draw_labels(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        scene: &Scene,
        camera: &Records,
    ) {
        pass.set_pipeline(&self.label);
        scene.draw(pass, camera, |_| None);
    }

    /// Draws the scene as the camera sees it, after [`Self::draw_labels`].
    ///
    /// # Errors
    /// Targets that were made for another shading.
    pub(super) fn draw_colour(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        scene: &Scene,
        camera: &Records,
    ) -> Result<(), RenderError> {
        match (&self.colours, targets.gbuffer()) {
            (Colours::Deferred(deferred), Some((gbuffer, depth))) => {
                let mut pass = gbuffer.begin(encoder, depth);
                pass.set_bind_group(1, &self.maps, &[]);
                deferred.surfaces.draw(&mut pass, scene, camera);
                drop(pass);
                deferred.shade(encoder, camera, &self.maps, gbuffer);
                let mut pass = targets.begin_colour(encoder);
                pass.set_bind_group(1, &self.maps, &[]);
                deferred.draw(&mut pass, scene, camera, gbuffer);
            }
            (Colours::Deferred(_), None) => {
                return Err(RenderError::Gpu("targets without a G-buffer".to_owned()));
            }
            (Colours::AtOnce(surfaces), _) => {
                let mut pass = targets.begin_colour(encoder);
                pass.set_bind_group(1, &self.maps, &[]);
                surfaces.draw(&mut pass, scene, camera);
            }
        }
        Ok(())
    }
}

impl Colours {
    fn new(device: &wgpu::Device, shaders: &Shaders, shading: Shading) -> Self {
        let surfaces = Surfaces::new(device, shaders, shading);
        match shading {
            Shading::Fine => Self::Deferred(Deferred::new(device, shaders, surfaces)),
            Shading::Full | Shading::Plain => Self::AtOnce(surfaces),
        }
    }
}

impl Surfaces {
    /// Those that make colours, or a G-buffer in fine shading.
    fn new(device: &wgpu::Device, shaders: &Shaders, shading: Shading) -> Self {
        let layout = shaders.layout(device, None);
        let pipeline = |vertex, fragment| {
            surface_pipeline(
                device,
                &shaders.module,
                &layout,
                shading,
                [vertex, fragment],
            )
        };
        let (vertex, [patterned, smooth, brushed, backdrop]) = match shading {
            Shading::Fine => (
                "baked_vertex",
                [
                    "patterned_gbuffer",
                    "smooth_gbuffer",
                    "brushed_gbuffer",
                    "backdrop_gbuffer",
                ],
            ),
            Shading::Full | Shading::Plain => (
                "scene_vertex",
                [
                    "patterned_fragment",
                    "smooth_fragment",
                    "brushed_fragment",
                    "backdrop_fragment",
                ],
            ),
        };
        Self {
            patterned: pipeline(vertex, patterned),
            smooth: pipeline(vertex, smooth),
            brushed: pipeline(vertex, brushed),
            backdrop: pipeline(BACKDROP, backdrop),
        }
    }

    /// Draws all surfaces, what is behind them last; group 1 is bound.
    fn draw(&self, pass: &mut wgpu::RenderPass<'_>, scene: &Scene, camera: &Records) {
        scene.draw(pass, camera, |pattern| Some(self.of(pattern)));
        pass.set_pipeline(&self.backdrop);
        camera.bind(pass, 0);
        pass.draw(0..3, 0..1);
    }

    /// One pipeline each for the ways in which a surface gets its colour, not for each pattern.
    const fn of(&self, pattern: Pattern) -> &wgpu::RenderPipeline {
        match pattern {
            Pattern::Smooth => &self.smooth,
            Pattern::Brushed => &self.brushed,
            Pattern::Muscle
            | Pattern::Liver
            | Pattern::Fat
            | Pattern::Skin
            | Pattern::Cloth
            | Pattern::Membrane => &self.patterned,
        }
    }
}

/// Slot 0: position (location 0) and normal (1), m, in the object's frame.
pub(super) const VERTEX: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: VERTEX_BYTES,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3],
};

/// Slot 1: where the pattern is read (location 2), m.
const UNROLLED: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: UNROLLED_BYTES,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &wgpu::vertex_attr_array![2 => Float32x2],
};

/// Slot 2, in fine shading: openness and what comes through (location 3).
const BAKED: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: BAKED_BYTES,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &wgpu::vertex_attr_array![3 => Float32x2],
};

/// The vertex function that needs no mesh.
pub(super) const BACKDROP: &str = "backdrop_vertex";

/// Nearer wins; no stencil.
pub(super) const fn visibility(bias: wgpu::DepthBiasState) -> wgpu::DepthStencilState {
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

/// No depth bias.
pub(super) const fn unbiased() -> wgpu::DepthBiasState {
    wgpu::DepthBiasState {
        constant: 0,
        slope_scale: 0.0,
        clamp: 0.0,
    }
}

/// Depth is pushed back by 1.5 times the slope, against surfaces that shadow themselves; the shader
/// moves the point it asks about off the surface as well.
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
            slope_scale: 1.5,
            ..unbiased()
        })),
        multisample: wgpu::MultisampleState::default(),
        fragment: None,
        multiview_mask: None,
        cache: None,
    })
}

/// The only source of ids and range, so no shading can change them.
fn label_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
) -> wgpu::RenderPipeline {
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("labels"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("label_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(VERTEX)],
        },
        primitive: culled(),
        depth_stencil: Some(visibility(unbiased())),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("label_fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[whole(INSTANCE_FORMAT), whole(RANGE_FORMAT)],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// `FULL` and `FINE` are constants, so what a shading leaves out is not in its code.
pub(super) fn constants(shading: Shading) -> [(&'static str, f64); 6] {
    let full = shading != Shading::Plain;
    [
        ("FULL", f64::from(u8::from(full))),
        ("FINE", f64::from(u8::from(shading == Shading::Fine))),
        ("PATTERN_SIZE_M", f64::from(PATTERN_SIZE_M)),
        ("BACKDROP_SIZE_M", f64::from(BACKDROP_SIZE_M)),
        ("SHADOW_NEAR_M", SHADOW_NEAR_M),
        ("SHADOW_FAR_M", SHADOW_FAR_M),
    ]
}

/// Depth is compared by less or equal with the labels' and not written: only what is seen is looked
/// at, and what is behind everything where nothing else is. Both passes compute the same positions
/// bit by bit (`@invariant`).
fn surface_pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
    shading: Shading,
    [vertex, fragment]: [&'static str; 2],
) -> wgpu::RenderPipeline {
    let targets = match shading {
        Shading::Fine => &[whole(GBUFFER_FORMAT), whole(GBUFFER_FORMAT)][..],
        Shading::Full | Shading::Plain => &[whole(COLOUR_FORMAT)][..],
    };
    let constants = constants(shading);
    let behind = vertex == BACKDROP;
    let compilation_options = wgpu::PipelineCompilationOptions {
        constants: &constants,
        ..Default::default()
    };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some(vertex),
            compilation_options: compilation_options.clone(),
            buffers: match (behind, shading) {
                (true, _) => &[],
                (false, Shading::Fine) => &[Some(VERTEX), Some(UNROLLED), Some(BAKED)],
                (false, Shading::Full | Shading::Plain) => &[Some(VERTEX), Some(UNROLLED)],
            },
        },
        primitive: culled(),
        depth_stencil: Some(wgpu::DepthStencilState {
            depth_write_enabled: Some(false),
            depth_compare: Some(wgpu::CompareFunction::LessEqual),
            ..visibility(unbiased())
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options,
            targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// Triangle lists, back faces left out.
pub(super) fn culled() -> wgpu::PrimitiveState {
    wgpu::PrimitiveState {
        cull_mode: Some(wgpu::Face::Back),
        ..Default::default()
    }
}
