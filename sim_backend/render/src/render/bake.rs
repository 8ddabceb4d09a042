//! The patterns of a scene's surfaces, painted once on the device into images that all later frames
//! read.
//!
//! Painting costs as much as some frames, so the patterns may be as rich as they like; reading them
//! costs the same for every pattern, and their coarser levels keep what is finer than a pixel from
//! flickering.
//!
//! A layer has two images with 8 levels each: albedo in sRGB bytes with openness in alpha, and
//! relief, of which red and green are the slopes of the flesh along u and v and blue and alpha
//! those of the film, each stored as `0.5 + 0.5 * slope`. Four kinds of passes make it: one draws
//! the vessels (`vessel_pass`), `look` paints colours and heights, `slope` differentiates the heights,
//! `halve` makes each level from the one before.
//!
//! Surfaces with the same pattern, colour, place and size share a layer. Bind group 0 is the
//! paint's record, group 1 the two images that the step before has made.

use core::cell::OnceCell;
use std::collections::BTreeMap;

use hal::count::count_u32;
use hal::random::fnv_1a;
use wgpu::util::DeviceExt;

use super::textures::{cleared, texture};
use super::vessel_pass::{VESSELS_FORMAT, VesselPass};
use super::vessels::{Supply, grown};
use crate::visual::{Backdrop, Material, Pattern, Visual};

/// Side of the square that a pattern is painted in, m; beyond it the pattern is mirrored.
pub(super) const PATTERN_SIZE_M: f32 = 0.18;

/// The same of what is behind all things, which is large and out of focus.
pub(super) const BACKDROP_SIZE_M: f32 = 0.36;

/// Side of the painted images, texels.
const PATTERN_PX: u32 = 1024;

/// Levels down to 8 texels.
const LEVELS: u32 = 8;

/// Decoded by the sampler, so that levels and filtering are in linear light.
const ALBEDO_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
/// Eight bits a slope: steps of 0.008.
const RELIEF_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// Heights of flesh and film, mm; only while a layer is painted.
const HEIGHT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Float;

/// All painted patterns of a scene, a layer each.
pub(super) struct Paints {
    /// Read as binding 2 of the maps.
    albedo: wgpu::Texture,
    /// Read as binding 3 of the maps.
    relief: wgpu::Texture,
    /// What each layer shows, in their order.
    painted: Vec<Painted>,
}

/// A layer of the images.
struct Painted {
    key: Key,
    wanted: Wanted,
}

/// A square of a material's pattern.
#[derive(Clone, Copy)]
pub(super) struct Wanted {
    pattern: Pattern,
    /// Linear RGB, which the pattern varies about.
    base_colour: [f32; 3],
    /// Where its middle is, see [`Visual::pattern_at_mm`].
    at_mm: [f32; 2],
    /// Side of the square, m.
    size_m: f32,
}

impl Wanted {
    /// The one of a thing.
    pub(super) const fn of(visual: &Visual) -> Self {
        Self {
            at_mm: visual.pattern_at_mm,
            ..Self::middle(&visual.material, PATTERN_SIZE_M)
        }
    }

    /// The one of what is behind all things.
    pub(super) const fn behind(backdrop: &Backdrop) -> Self {
        Self::middle(&backdrop.material, BACKDROP_SIZE_M)
    }

    /// The square about the middle of a material's pattern.
    const fn middle(material: &Material, size_m: f32) -> Self {
        Self {
            pattern: material.pattern,
            base_colour: material.base_colour,
            at_mm: [0.0; 2],
            size_m,
        }
    }
}

/// What makes two surfaces the same layer: pattern, bits of its colour, of the middle and of the
/// side of its square.
type Key = (u32, [u32; 3], [u32; 2], u32);

impl Paints {
    /// Paints each of `squares` once.
    pub(super) fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        squares: impl IntoIterator<Item = Wanted>,
    ) -> Self {
        let mut painted: Vec<Painted> = Vec::new();
        for wanted in squares {
            if let Some(key) = key(&wanted)
                && !painted.iter().any(|known| known.key == key)
            {
                painted.push(Painted { key, wanted });
            }
        }
        let layers = count_u32(painted.len());
        let paints = Self {
            albedo: layered(device, "albedo", ALBEDO_FORMAT, layers),
            relief: layered(device, "relief", RELIEF_FORMAT, layers),
            painted,
        };
        paints.paint(device, queue);
        paints
    }

    /// One submission for all layers; the pipeline of a pattern is compiled at its first layer.
    fn paint(&self, device: &wgpu::Device, queue: &wgpu::Queue) {
        let painter = Painter::new(device);
        let mut looks: BTreeMap<u32, wgpu::RenderPipeline> = BTreeMap::new();
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (layer, painted) in (0_u32..).zip(&self.painted) {
            let (pattern, ..) = painted.key;
            let look = looks
                .entry(pattern)
                .or_insert_with(|| painter.look(pattern));
            let images = [&self.albedo, &self.relief];
            painter.paint(&mut encoder, (look, painted), images, layer);
        }
        queue.submit([encoder.finish()]);
    }

    /// Colours and hollows, and slopes, of all layers.
    pub(super) fn views(&self) -> [wgpu::TextureView; 2] {
        [&self.albedo, &self.relief].map(|texture| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..Default::default()
            })
        })
    }

    /// The layer in which `wanted` was painted; 0 if it has no pattern.
    ///
    /// A float, as all of the object record. Panics if `wanted` was not painted, which is a bug of
    /// the renderer.
    #[expect(
        clippy::cast_precision_loss,
        reason = "a scene has a handful of layers"
    )]
    pub(super) fn layer(&self, wanted: &Wanted) -> f32 {
        let Some(wanted) = key(wanted) else {
            return 0.0;
        };
        let found = self.painted.iter().position(|known| known.key == wanted);
        assert!(found.is_some(), "a material of the scene was not painted");
        found.map_or(0.0, |layer| layer as f32)
    }
}

/// What says where the vessels of a square run: its pattern, its place and its size, not its
/// colour.
fn seed(&(pattern, _, at, size): &Key) -> u64 {
    let numbers = [pattern, at[0], at[1], size];
    fnv_1a(numbers.into_iter().flat_map(u32::to_le_bytes))
}

/// With the pattern's number of `bake.wgsl`; none if nothing is painted.
fn key(wanted: &Wanted) -> Option<Key> {
    let pattern = match wanted.pattern {
        Pattern::Smooth | Pattern::Brushed => return None,
        Pattern::Muscle => 1,
        Pattern::Liver => 2,
        Pattern::Fat => 3,
        Pattern::Skin => 4,
        Pattern::Cloth => 5,
        Pattern::Membrane => 6,
    };
    let colour = wanted.base_colour.map(f32::to_bits);
    let at = wanted.at_mm.map(f32::to_bits);
    Some((pattern, colour, at, wanted.size_m.to_bits()))
}

/// An array with one layer per pattern, at least one.
fn layered(
    device: &wgpu::Device,
    label: &str,
    format: wgpu::TextureFormat,
    layers: u32,
) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d {
            width: PATTERN_PX,
            height: PATTERN_PX,
            depth_or_array_layers: layers.max(1),
        },
        mip_level_count: LEVELS,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    })
}

/// The passes that paint one layer.
struct Painter<'a> {
    device: &'a wgpu::Device,
    /// Noise and patterns.
    module: wgpu::ShaderModule,
    /// Of group 0.
    paint_layout: wgpu::BindGroupLayout,
    /// Of group 1.
    source_layout: wgpu::BindGroupLayout,
    /// Draws vessels; compiled for the first pattern that has any.
    vessels: OnceCell<VesselPass>,
    /// From heights to slopes.
    slope: wgpu::RenderPipeline,
    /// From a level to the next.
    halve: wgpu::RenderPipeline,
}

impl<'a> Painter<'a> {
    fn new(device: &'a wgpu::Device) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("bake"),
            source: wgpu::ShaderSource::Wgsl(
                concat!(
                    include_str!("noise.wgsl"),
                    include_str!("bake.wgsl"),
                    include_str!("vessels.wgsl"),
                )
                .into(),
            ),
        });
        let paint_layout = layout(
            device,
            &[(
                0,
                wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
            )],
        );
        let image = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: false },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let source_layout = layout(device, &[(0, image), (1, image)]);
        let pipeline = |entry| {
            let layouts = [Some(&paint_layout), Some(&source_layout)];
            pipeline(device, &module, &layouts, (entry, &[]), RELIEF_FORMAT)
        };
        Self {
            device,
            vessels: OnceCell::new(),
            slope: pipeline("slope"),
            halve: pipeline("halve"),
            module,
            paint_layout,
            source_layout,
        }
    }

    /// What paints colours and heights of one pattern: all in one take a software rasteriser
    /// seconds to compile.
    fn look(&self, pattern: u32) -> wgpu::RenderPipeline {
        let layouts = [Some(&self.paint_layout), Some(&self.source_layout)];
        let constants = [("PATTERN", f64::from(pattern))];
        let entry = ("look", &constants[..]);
        pipeline(self.device, &self.module, &layouts, entry, HEIGHT_FORMAT)
    }

    fn paint(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        (look, painted): (&wgpu::RenderPipeline, &Painted),
        images: [&wgpu::Texture; 2],
        layer: u32,
    ) {
        let paint = self.paint_record(painted);
        let scratch = |label, format| {
            let usage =
                wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
            texture(self.device, label, PATTERN_PX, PATTERN_PX, format, usage)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        // There are no heights yet, and images that nothing is drawn into are empty.
        let sources = [
            scratch("vessels", VESSELS_FORMAT),
            scratch("no heights", HEIGHT_FORMAT),
        ];
        if let Some(supply) = Supply::of(painted.wanted.pattern) {
            let side_mm = 1e3 * f64::from(painted.wanted.size_m);
            let stretches = grown(&supply, side_mm, seed(&painted.key));
            self.vessels
                .get_or_init(|| VesselPass::new(self.device, &self.module, &self.paint_layout))
                .draw(self.device, encoder, &paint, &stretches, &sources[0]);
        }
        let looks = [
            scratch("albedo", ALBEDO_FORMAT),
            scratch("heights", HEIGHT_FORMAT),
        ];
        self.pass(encoder, look, &paint, &sources, &looks);
        let mut finer = images.map(|image| level_of(image, layer, 0));
        self.pass(encoder, &self.slope, &paint, &looks, &finer);
        for level in 1..LEVELS {
            let coarser = images.map(|image| level_of(image, layer, level));
            self.pass(encoder, &self.halve, &paint, &finer, &coarser);
            finer = coarser;
        }
    }

    /// 32 bytes: colour and a 1, side in texels and in mm, middle in mm; see `Paint` in
    /// `bake.wgsl`.
    fn paint_record(&self, painted: &Painted) -> wgpu::BindGroup {
        let wanted = &painted.wanted;
        let colour = wanted.base_colour.iter();
        let mut bytes: Vec<u8> = colour.flat_map(|c| c.to_ne_bytes()).collect();
        bytes.extend(1_i32.to_ne_bytes());
        #[expect(clippy::cast_precision_loss, reason = "a power of two")]
        let sizes = [PATTERN_PX as f32, wanted.size_m * 1e3];
        let numbers = sizes.iter().chain(&wanted.at_mm);
        bytes.extend(numbers.flat_map(|number| number.to_ne_bytes()));
        let buffer = self
            .device
            .create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("paint"),
                contents: &bytes,
                usage: wgpu::BufferUsages::UNIFORM,
            });
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("paint"),
            layout: &self.paint_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: buffer.as_entire_binding(),
            }],
        })
    }

    /// Draws one triangle over `to` with `from` to read.
    fn pass(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        pipeline: &wgpu::RenderPipeline,
        paint: &wgpu::BindGroup,
        from: &[wgpu::TextureView; 2],
        to: &[wgpu::TextureView; 2],
    ) {
        let source = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("paint's source"),
            layout: &self.source_layout,
            entries: &[0, 1].map(|index: u32| wgpu::BindGroupEntry {
                binding: index,
                resource: wgpu::BindingResource::TextureView(&from[index as usize]),
            }),
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("paint"),
            color_attachments: &[cleared(&to[0]), cleared(&to[1])],
            ..Default::default()
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, paint, &[]);
        pass.set_bind_group(1, &source, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// One level of one layer, to draw into or read.
fn level_of(image: &wgpu::Texture, layer: u32, level: u32) -> wgpu::TextureView {
    image.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2),
        base_mip_level: level,
        mip_level_count: Some(1),
        base_array_layer: layer,
        array_layer_count: Some(1),
        ..Default::default()
    })
}

/// Bindings for both stages.
fn layout(device: &wgpu::Device, bindings: &[(u32, wgpu::BindingType)]) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = bindings
        .iter()
        .map(|&(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
            ty,
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("paint"),
        entries: &entries,
    })
}

/// A pass without a mesh that writes albedo and one image more, of the format `relief`.
fn pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    layouts: &[Option<&wgpu::BindGroupLayout>],
    (entry, constants): (&str, &[(&str, f64)]),
    relief: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("paint"),
        bind_group_layouts: layouts,
        immediate_size: 0,
    });
    let target = |format| {
        Some(wgpu::ColorTargetState {
            format,
            blend: None,
            write_mask: wgpu::ColorWrites::ALL,
        })
    };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(entry),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("cover"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                ..Default::default()
            },
            targets: &[target(ALBEDO_FORMAT), target(relief)],
        }),
        multiview_mask: None,
        cache: None,
    })
}
