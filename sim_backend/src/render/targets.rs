//! The images on the device and the way they come back: one staging buffer, mapped once a frame.

use hal::Intrinsics;

use super::Planes;
use super::RenderError;
use super::gpu::Gpu;

/// Colour as the frame holds it, with a fourth byte.
pub(super) const COLOUR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
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

/// Everything of one image size.
pub(super) struct Targets {
    pub(super) width: u32,
    pub(super) height: u32,
    colour: Plane,
    instance: Plane,
    range: Plane,
    depth: wgpu::TextureView,
    staging: wgpu::Buffer,
}

impl Targets {
    pub(super) fn new(device: &wgpu::Device, lens: &Intrinsics) -> Self {
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
        let depth = texture(
            device,
            "depth",
            width,
            height,
            DEPTH_FORMAT,
            wgpu::TextureUsages::RENDER_ATTACHMENT,
        )
        .create_view(&wgpu::TextureViewDescriptor::default());
        let staging = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read-back"),
            size: end,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Self {
            width,
            height,
            colour,
            instance,
            range,
            depth,
            staging,
        }
    }

    pub(super) fn fits(&self, lens: &Intrinsics) -> bool {
        (self.width, self.height) == (lens.width, lens.height)
    }

    /// Starts the pass that draws all images at once, on a dark background without depth and id.
    pub(super) fn begin<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
    ) -> wgpu::RenderPass<'pass> {
        let background = wgpu::Color {
            r: 0.010,
            g: 0.004,
            b: 0.004,
            a: 1.0,
        };
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("scene"),
            color_attachments: &[
                Some(attachment(&self.colour.view, background)),
                Some(attachment(&self.instance.view, wgpu::Color::TRANSPARENT)),
                Some(attachment(&self.range.view, wgpu::Color::TRANSPARENT)),
            ],
            depth_stencil_attachment: Some(depth_attachment(&self.depth, wgpu::StoreOp::Discard)),
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

    /// Waits for the device and unpacks its images into `planes`, which fit.
    pub(super) fn read(&self, gpu: &Gpu, planes: &mut Planes<'_>) -> Result<(), RenderError> {
        // A failure shows as an error of `get_mapped_range`.
        self.staging.map_async(wgpu::MapMode::Read, .., |_| ());
        gpu.wait()?;
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
        let start = usize::try_from(self.offset).unwrap_or(usize::MAX);
        let row_bytes = self.row_bytes as usize;
        let plane = mapped.get(start..).unwrap_or_default();
        plane
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
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

fn attachment(view: &wgpu::TextureView, clear: wgpu::Color) -> wgpu::RenderPassColorAttachment<'_> {
    wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations {
            load: wgpu::LoadOp::Clear(clear),
            store: wgpu::StoreOp::Store,
        },
    }
}

/// A depth attachment that starts at the far plane.
pub(super) const fn depth_attachment(
    view: &wgpu::TextureView,
    store: wgpu::StoreOp,
) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations {
            load: wgpu::LoadOp::Clear(1.0),
            store,
        }),
        stencil_ops: None,
    }
}
