//! The images on the device and the way they come back: one staging buffer, mapped once a frame.
//!
//! Ids and range are drawn first, with one sample a pixel and no blending. Colour follows in a pass of its own: smoothed
//! over the pixel by several samples, or with one sample on the first pass's depth.

use hal::Intrinsics;
use hal::count::index;

use super::Planes;
use super::RenderError;
use super::Shading;
use super::gpu::Gpu;

/// Colour as the frame holds it, encoded by the shader, with a fourth byte.
pub(super) const COLOUR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// Instance id.
pub(super) const INSTANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R8Uint;
/// Metres along the camera's z.
pub(super) const RANGE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Visibility.
pub(super) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// One image to read back: where it is drawn and where its rows lie in the staging buffer.
struct Plane {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    offset: u64,
    row_bytes: u32,
    pitch_bytes: u32,
}

/// Samples a pixel of the colour.
pub(super) const fn colour_samples(shading: Shading) -> u32 {
    match shading {
        Shading::Fine => 4,
        Shading::Full | Shading::Plain => 1,
    }
}

/// Everything of one image size.
pub(super) struct Targets {
    width: u32,
    height: u32,
    shading: Shading,
    colour: Plane,
    instance: Plane,
    range: Plane,
    depth: wgpu::TextureView,
    /// Colour and depth of all samples.
    samples: Option<[wgpu::TextureView; 2]>,
    staging: wgpu::Buffer,
}

impl Targets {
    pub(super) fn new(device: &wgpu::Device, lens: &Intrinsics, shading: Shading) -> Self {
        let (width, height) = (lens.width, lens.height);
        let mut end = 0;
        let mut plane = |label, format, pixel_bytes: u32| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
            let texture = texture(device, label, width, height, format, usage);
            let row_bytes = pixel_bytes * width;
            let pitch_bytes = row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
            let offset = end;
            end += u64::from(pitch_bytes) * u64::from(height);
            let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
            Plane {
                texture,
                view,
                offset,
                row_bytes,
                pitch_bytes,
            }
        };
        let colour = plane("colour", COLOUR_FORMAT, 4);
        let instance = plane("instance", INSTANCE_FORMAT, 1);
        let range = plane("range", RANGE_FORMAT, 4);
        let drawn = |label, format, samples| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
            sampled(device, label, [width, height, samples], format, usage)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let depth = drawn("depth", DEPTH_FORMAT, 1);
        let per_pixel = colour_samples(shading);
        let samples = (per_pixel > 1).then(|| {
            [
                drawn("colour samples", COLOUR_FORMAT, per_pixel),
                drawn("depth samples", DEPTH_FORMAT, per_pixel),
            ]
        });
        let staging = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read-back"),
            size: end,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Self {
            width,
            height,
            shading,
            colour,
            instance,
            range,
            depth,
            samples,
            staging,
        }
    }

    pub(super) fn fits(&self, lens: &Intrinsics, shading: Shading) -> bool {
        (self.width, self.height, self.shading) == (lens.width, lens.height, shading)
    }

    /// Starts the pass that draws ids and range, 0 where nothing is.
    pub(super) fn begin_labels<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
    ) -> wgpu::RenderPass<'pass> {
        let nothing = wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT);
        let store = match self.samples {
            Some(_) => wgpu::StoreOp::Discard,
            None => wgpu::StoreOp::Store,
        };
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("labels"),
            color_attachments: &[
                Some(attachment(&self.instance.view, nothing)),
                Some(attachment(&self.range.view, nothing)),
            ],
            depth_stencil_attachment: Some(depth_attachment(&self.depth, FAR, store)),
            ..Default::default()
        })
    }

    /// Starts the pass that draws colour, after [`Self::begin_labels`].
    pub(super) fn begin_colour<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
    ) -> wgpu::RenderPass<'pass> {
        let black = wgpu::LoadOp::Clear(wgpu::Color::BLACK);
        let (colour, depth) = match &self.samples {
            Some([colour, depth]) => {
                let mut smoothed = attachment(colour, black);
                smoothed.resolve_target = Some(&self.colour.view);
                smoothed.ops.store = wgpu::StoreOp::Discard;
                (smoothed, (depth, FAR))
            }
            None => (
                attachment(&self.colour.view, black),
                (&self.depth, wgpu::LoadOp::Load),
            ),
        };
        let (depth, load) = depth;
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("colour"),
            color_attachments: &[Some(colour)],
            depth_stencil_attachment: Some(depth_attachment(depth, load, wgpu::StoreOp::Discard)),
            ..Default::default()
        })
    }

    /// Records the copies into the staging buffer.
    pub(super) fn copy(&self, encoder: &mut wgpu::CommandEncoder) {
        for plane in [&self.colour, &self.instance, &self.range] {
            encoder.copy_texture_to_buffer(
                plane.texture.as_image_copy(),
                wgpu::TexelCopyBufferInfo {
                    buffer: &self.staging,
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: plane.offset,
                        bytes_per_row: Some(plane.pitch_bytes),
                        rows_per_image: None,
                    },
                },
                plane.texture.size(),
            );
        }
    }

    /// Asks for the images of the last submission that drew them.
    pub(super) fn ask(&self) {
        // A failure shows as an error of `get_mapped_range`.
        self.staging.map_async(wgpu::MapMode::Read, .., |_| ());
    }

    /// Waits for the images that `submission` draws and [`Self::ask`] asked for, and unpacks them into `planes`, which
    /// fit.
    pub(super) fn read(
        &self,
        gpu: &Gpu,
        submission: wgpu::SubmissionIndex,
        planes: &mut Planes<'_>,
    ) -> Result<(), RenderError> {
        gpu.wait(submission)?;
        let mapped = self
            .staging
            .get_mapped_range(..)
            .map_err(|error| RenderError::Gpu(error.to_string()))?;
        let width = self.width as usize;
        for (row, out) in self
            .colour
            .rows(&mapped)
            .zip(planes.colour.chunks_exact_mut(3 * width))
        {
            for (texel, rgb) in row.chunks_exact(4).zip(out.chunks_exact_mut(3)) {
                rgb.copy_from_slice(&texel[..3]);
            }
        }
        for (row, out) in self
            .instance
            .rows(&mapped)
            .zip(planes.instance.chunks_exact_mut(width))
        {
            out.copy_from_slice(row);
        }
        for (row, out) in self
            .range
            .rows(&mapped)
            .zip(planes.depth_m.chunks_exact_mut(width))
        {
            for (texel, depth) in row.as_chunks::<4>().0.iter().zip(out) {
                *depth = f32::from_ne_bytes(*texel);
            }
        }
        drop(mapped);
        self.staging.unmap();
        Ok(())
    }
}

impl Plane {
    fn rows<'a>(&self, mapped: &'a [u8]) -> impl Iterator<Item = &'a [u8]> {
        let row_bytes = self.row_bytes as usize;
        mapped[index(self.offset)..]
            .chunks_exact(self.pitch_bytes as usize)
            .map(move |row| &row[..row_bytes])
    }
}

/// A single-sample texture.
pub(super) fn texture(
    device: &wgpu::Device,
    label: &str,
    width: u32,
    height: u32,
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    sampled(device, label, [width, height, 1], format, usage)
}

fn sampled(
    device: &wgpu::Device,
    label: &str,
    [width, height, samples]: [u32; 3],
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: samples,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

/// A depth attachment starts at the far plane.
pub(super) const FAR: wgpu::LoadOp<f32> = wgpu::LoadOp::Clear(1.0);

const fn attachment(
    view: &wgpu::TextureView,
    load: wgpu::LoadOp<wgpu::Color>,
) -> wgpu::RenderPassColorAttachment<'_> {
    wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations {
            load,
            store: wgpu::StoreOp::Store,
        },
    }
}

pub(super) const fn depth_attachment(
    view: &wgpu::TextureView,
    load: wgpu::LoadOp<f32>,
    store: wgpu::StoreOp,
) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load, store }),
        stencil_ops: None,
    }
}
