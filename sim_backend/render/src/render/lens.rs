//! The pass from the image of a pinhole to the picture of a lens and a sensor. A camera that has
//! neither distortion nor [`Optics`](super::Optics) goes without it.
//!
//! Colour, ids and range of a pinhole are drawn into a larger image, the window; for each pixel of
//! the picture the shader finds the ray that the lens sends there, by eight steps of Newton's
//! method on the Brown-Conrady model ([`hal::Distortion`]), and reads the window where that ray
//! falls: colour from four texels, or from 24 places where blood or condensate blurs it, ids and
//! range from the nearest texel. So ids are never mixed, and depth never lies between a thing and
//! what is behind it.
//!
//! Its bind group 0: 0 the lens' record, 1 colour, 2 ids, 3 range, all read by texel without a
//! sampler.

use hal::Intrinsics;

use super::records::{put, put_f64};
use super::textures::{COLOUR_FORMAT, INSTANCE_FORMAT, RANGE_FORMAT, texture, whole};
use super::{Camera, RenderError};

/// Bytes of a lens' record, see `lens.wgsl`: focal lengths and centre (16), distortion (16), margin
/// and size (16), two flags (8), seven numbers of the optics (28), seed and moment (8), padding
/// (4).
const RECORD_BYTES: u64 = 96;

/// The image of the pinhole that a lens' picture is made from: the same focal lengths, but as large
/// as the rays reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Window {
    /// The pinhole.
    pub(super) intrinsics: Intrinsics,
    /// What it shows to the left of the picture and above it, pixels.
    margin: [u32; 2],
}

impl Window {
    /// The window of `lens`, with a pixel more on each side for the colour's blending.
    ///
    /// # Errors
    /// A distortion under which two rays of the picture fall at one place, and one whose window is
    /// wider or higher than twice the picture or the device's limit.
    pub(super) fn of(lens: &Intrinsics, size_px_max: u32) -> Result<Self, RenderError> {
        if lens.distortion.is_none() {
            return Ok(Self {
                intrinsics: *lens,
                margin: [0; 2],
            });
        }
        let folded = "the distortion folds rays of the picture over each other";
        let [across, down] = lens.field().ok_or(RenderError::Camera(folded))?;
        let sides = [
            (across, lens.fx, lens.cx, lens.width),
            (down, lens.fy, lens.cy, lens.height),
        ];
        let mut spans = [[0; 2]; 2];
        for (span, ([least, greatest], focal, centre, size)) in spans.iter_mut().zip(sides) {
            let before = 1.0 - (focal * least + centre);
            let after = 1.0 + focal * greatest + centre - f64::from(size);
            *span = [before, after].map(pixels);
            let all = span
                .iter()
                .fold(size, |sum, side| sum.saturating_add(*side));
            if all > size_px_max.min(2 * size) {
                return Err(RenderError::Camera(
                    "the distortion needs an image of more than twice the picture's size",
                ));
            }
        }
        let [[left, right], [above, below]] = spans;
        Ok(Self {
            intrinsics: Intrinsics {
                width: lens.width + left + right,
                height: lens.height + above + below,
                cx: lens.cx + f64::from(left),
                cy: lens.cy + f64::from(above),
                ..lens.pinhole()
            },
            margin: [left, above],
        })
    }
}

/// Whole pixels, none below 0.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "within bounds"
)]
fn pixels(size: f64) -> u32 {
    size.ceil().clamp(0.0, 1e6) as u32
}

/// The pass itself, for all cameras.
pub(super) struct LensPass {
    /// Of bind group 0.
    layout: wgpu::BindGroupLayout,
    /// One triangle over the picture, with three targets.
    pipeline: wgpu::RenderPipeline,
}

/// What one camera's lens reads: the pinhole's image and its record.
pub(super) struct Lens {
    /// What the pinhole shows.
    pub(super) window: Window,
    /// Colour, ids and range.
    pub(super) seen: [wgpu::TextureView; 3],
    /// Written anew for each image.
    record: wgpu::Buffer,
    /// The record and the three images, bound.
    group: wgpu::BindGroup,
}

impl LensPass {
    /// Compiles the shader: made when a camera first has a lens, and kept.
    pub(super) fn new(device: &wgpu::Device) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("lens"),
            source: wgpu::ShaderSource::Wgsl(
                concat!(
                    include_str!("noise.wgsl"),
                    include_str!("tone.wgsl"),
                    include_str!("lens.wgsl")
                )
                .into(),
            ),
        });
        let layout = layout(device);
        let groups = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("lens"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("lens"),
            layout: Some(&groups),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("picture_vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("picture_fragment"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[COLOUR_FORMAT, INSTANCE_FORMAT, RANGE_FORMAT].map(whole),
            }),
            multiview_mask: None,
            cache: None,
        });
        Self { layout, pipeline }
    }

    /// Fills `pass`, whose targets are the planes of the picture.
    pub(super) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, lens: &Lens) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &lens.group, &[]);
        pass.draw(0..3, 0..1);
    }
}

impl Lens {
    /// Room for the image that `window` shows.
    pub(super) fn new(device: &wgpu::Device, pass: &LensPass, window: Window) -> Self {
        let Intrinsics { width, height, .. } = window.intrinsics;
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let seen = [COLOUR_FORMAT, INSTANCE_FORMAT, RANGE_FORMAT].map(|format| {
            texture(device, "pinhole", width, height, format, usage)
                .create_view(&wgpu::TextureViewDescriptor::default())
        });
        let record = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("lens"),
            size: RECORD_BYTES,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::UNIFORM,
            mapped_at_creation: false,
        });
        let views = seen.iter().map(wgpu::BindingResource::TextureView);
        let resources = core::iter::once(record.as_entire_binding()).chain(views);
        let entries: Vec<_> = (0_u32..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("lens"),
            layout: &pass.layout,
            entries: &entries,
        });
        Self {
            window,
            seen,
            record,
            group,
        }
    }

    /// The pinhole whose image makes a picture of `intrinsics`, which fit.
    pub(super) fn pinhole(&self, intrinsics: &Intrinsics) -> Intrinsics {
        if intrinsics.distortion.is_none() {
            *intrinsics
        } else {
            self.window.intrinsics
        }
    }

    /// Writes the record of one image of `camera`; its optics only where colour is to show them.
    pub(super) fn place(&self, queue: &wgpu::Queue, camera: &Camera, shows_optics: bool) {
        let (lens, optics) = (&camera.intrinsics, &camera.optics);
        let bytes = &mut Vec::new();
        put_f64(bytes, &[lens.fx, lens.fy, lens.cx, lens.cy]);
        put_f64(bytes, &lens.distortion.coefficients());
        let margin = self.window.margin.map(f64::from);
        let size = [lens.width, lens.height].map(f64::from);
        put_f64(bytes, &[margin, size].concat());
        let is_bent = !lens.distortion.is_none();
        let is_dim = shows_optics && optics.takes_pass();
        put_u32(bytes, &[is_bent, is_dim].map(u32::from));
        put_f64(bytes, &[optics.vignette, optics.exposure]);
        put_f64(bytes, &[optics.shot_noise, optics.read_noise]);
        put_f64(bytes, &[optics.smoke_per_m, optics.blood, optics.fog]);
        put_u32(bytes, &[optics.seed, optics.moment]);
        put(bytes, &[0.0]);
        queue.write_buffer(&self.record, 0, bytes);
    }
}

/// Appends whole numbers as the device reads them.
fn put_u32(bytes: &mut Vec<u8>, values: &[u32]) {
    bytes.extend(values.iter().flat_map(|value| value.to_ne_bytes()));
}

/// How a lens' record and what it reads are bound.
fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty,
        count: None,
    };
    let image = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let record = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let unfiltered = wgpu::TextureSampleType::Float { filterable: false };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("lens"),
        entries: &[
            entry(0, record),
            entry(1, image(unfiltered)),
            entry(2, image(wgpu::TextureSampleType::Uint)),
            entry(3, image(unfiltered)),
        ],
    })
}

#[cfg(test)]
mod tests {
    use hal::Distortion;

    use super::*;

    #[test]
    fn a_window_holds_every_ray_of_the_picture() {
        let plain = Intrinsics::from_vertical_fov(80, 60, 0.9);
        assert_eq!(Window::of(&plain, 4096).unwrap().margin, [0; 2]);
        for coefficients in [[-0.3, 0.1, 0.002, -0.002], [0.2, 0.0, 0.0, 0.0]] {
            let lens = Intrinsics {
                distortion: Distortion::new(coefficients),
                ..plain
            };
            let window = Window::of(&lens, 4096).unwrap();
            let seen = &window.intrinsics;
            assert!(seen.distortion.is_none());
            for pixel in 0..80 * 60_u32 {
                let place = [pixel % 80, pixel / 80].map(|it| f64::from(it) + 0.5);
                let [u, v] = seen.pixel(lens.ray(place).unwrap());
                assert!(u >= 1.0 && u <= f64::from(seen.width) - 1.0, "{u}");
                assert!(v >= 1.0 && v <= f64::from(seen.height) - 1.0, "{v}");
            }
        }
    }

    #[test]
    fn what_no_window_holds_is_refused() {
        let refused = |k1: f64, fov_rad: f64, most: u32| {
            let lens = Intrinsics {
                distortion: Distortion::new([k1, 0.0, 0.0, 0.0]),
                ..Intrinsics::from_vertical_fov(80, 60, fov_rad)
            };
            let refused = Window::of(&lens, most).unwrap_err();
            refused.to_string()
        };
        assert!(refused(-1.5, 0.9, 4096).contains("folds rays"));
        assert!(refused(-0.15, 0.9, 81).contains("twice the picture's size"));
    }
}
