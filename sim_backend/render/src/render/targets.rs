//! The images on the device and the way they come back: one staging buffer, mapped once a frame.
//!
//! Ids and range are drawn first, with one sample a pixel and no blending. Colour follows in a pass
//! of its own: with one sample on the first pass's depth, or smoothed over the pixel by several,
//! which take colours that were shaded before (`deferred`). Where there is a lens these are images
//! of its own, and a last pass makes the picture of them.
//!
//! Rows in the staging buffer begin at multiples of 256 bytes, as copies demand; unpacking leaves
//! the padding and colour's fourth byte out. The device's byte order is the machine's.

use hal::Intrinsics;
use hal::count::index;

use super::Planes;
use super::RenderError;
use super::Shading;
use super::deferred::{Deferred, GBuffer, SAMPLES};
use super::gpu::Gpu;
use super::lens::{Lens, LensPass, Window};
use super::textures::{
    COLOUR_FORMAT, DEPTH_FORMAT, INSTANCE_FORMAT, RANGE_FORMAT, sampled, texture,
};

/// One image to read back: where it is drawn and where its rows lie in the staging buffer.
struct Plane {
    /// What is copied from.
    texture: wgpu::Texture,
    /// What is drawn into.
    view: wgpu::TextureView,
    /// Its first row in the staging buffer, bytes.
    offset: u64,
    /// Bytes of a row's pixels.
    row_bytes: u32,
    /// From one row to the next, bytes.
    pitch_bytes: u32,
}

/// What a picture with smooth edges takes besides.
struct Smoothed {
    /// Colour and depth of all samples.
    samples: [wgpu::TextureView; 2],
    /// What is shaded before colour is drawn.
    gbuffer: GBuffer,
}

/// Everything of one image size, and of one distortion.
pub(super) struct Targets {
    /// Of the picture that it was made for.
    intrinsics: Intrinsics,
    /// Of the pictures that are taken here.
    shading: Shading,
    /// What the picture is seen through, if not by a clean pinhole.
    pub(super) lens: Option<Lens>,
    /// The picture's colour.
    colour: Plane,
    /// The picture's ids.
    instance: Plane,
    /// The picture's depth, m.
    range: Plane,
    /// Visibility of the labels; what takes one sample is drawn on it.
    depth: wgpu::TextureView,
    /// In fine shading.
    smoothed: Option<Smoothed>,
    /// All three planes, one after the other; mapped once an image.
    staging: wgpu::Buffer,
}

impl Targets {
    /// For pictures of `intrinsics`, with the pass of a lens that shows `lens` of the scene if
    /// there is one, and with what `deferred` reads if shading is deferred.
    pub(super) fn new(
        device: &wgpu::Device,
        intrinsics: &Intrinsics,
        shading: Shading,
        lens: Option<(&LensPass, Window)>,
        deferred: Option<&Deferred>,
    ) -> Self {
        let (width, height) = (intrinsics.width, intrinsics.height);
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
        let lens = lens.map(|(pass, window)| Lens::new(device, pass, window));
        let image = lens
            .as_ref()
            .map_or(*intrinsics, |lens| lens.window.intrinsics);
        let drawn = |label, format, samples| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
            sampled(
                device,
                label,
                [image.width, image.height, samples],
                format,
                usage,
            )
            .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let depth = drawn("depth", DEPTH_FORMAT, 1);
        let smoothed = deferred.map(|deferred| Smoothed {
            samples: [
                drawn("colour samples", COLOUR_FORMAT, SAMPLES),
                drawn("depth samples", DEPTH_FORMAT, SAMPLES),
            ],
            gbuffer: GBuffer::new(device, deferred, &image),
        });
        let staging = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read-back"),
            size: end,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Self {
            intrinsics: *intrinsics,
            shading,
            lens,
            colour,
            instance,
            range,
            depth,
            smoothed,
            staging,
        }
    }

    /// Whether pictures of `intrinsics` can be taken here, with a lens or not.
    ///
    /// Without distortion only the size counts, for intrinsics are in the record; a window was made
    /// for one distortion.
    pub(super) fn fits(&self, intrinsics: &Intrinsics, shading: Shading, has_lens: bool) -> bool {
        let size = |of: &Intrinsics| (of.width, of.height);
        let straight = |of: &Intrinsics| of.distortion.is_none();
        self.shading == shading
            && self.lens.is_some() == has_lens
            && size(&self.intrinsics) == size(intrinsics)
            && (self.intrinsics == *intrinsics
                || (straight(&self.intrinsics) && straight(intrinsics)))
    }

    /// Colour, ids and range as they are drawn: the picture's, or what the lens sees.
    fn drawn(&self) -> [&wgpu::TextureView; 3] {
        match &self.lens {
            Some(lens) => lens.seen.each_ref(),
            None => self.picture(),
        }
    }

    /// Colour, ids and range that are copied to the caller.
    const fn picture(&self) -> [&wgpu::TextureView; 3] {
        [&self.colour.view, &self.instance.view, &self.range.view]
    }

    /// Starts the pass that makes the picture of what the lens sees, after [`Self::begin_colour`].
    pub(super) fn begin_picture<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
    ) -> wgpu::RenderPass<'pass> {
        let nothing = wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT);
        let planes = self.picture().map(|view| Some(attachment(view, nothing)));
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("picture"),
            color_attachments: &planes,
            ..Default::default()
        })
    }

    /// Starts the pass that draws ids and range, 0 where nothing is.
    pub(super) fn begin_labels<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
    ) -> wgpu::RenderPass<'pass> {
        let nothing = wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT);
        let [_, instance, range] = self.drawn();
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("labels"),
            color_attachments: &[
                Some(attachment(instance, nothing)),
                Some(attachment(range, nothing)),
            ],
            depth_stencil_attachment: Some(depth_attachment(
                &self.depth,
                FAR,
                wgpu::StoreOp::Store,
            )),
            ..Default::default()
        })
    }

    /// What is shaded after [`Self::begin_labels`] and before [`Self::begin_colour`], and the depth
    /// of the labels.
    pub(super) fn gbuffer(&self) -> Option<(&GBuffer, &wgpu::TextureView)> {
        let smoothed = self.smoothed.as_ref()?;
        Some((&smoothed.gbuffer, &self.depth))
    }

    /// Starts the pass that draws colour, after [`Self::begin_labels`].
    pub(super) fn begin_colour<'pass>(
        &self,
        encoder: &'pass mut wgpu::CommandEncoder,
    ) -> wgpu::RenderPass<'pass> {
        let black = wgpu::LoadOp::Clear(wgpu::Color::BLACK);
        let [image, ..] = self.drawn();
        let (colour, depth) = match self.smoothed.as_ref().map(|smoothed| &smoothed.samples) {
            Some([colour, depth]) => {
                let mut smoothed = attachment(colour, black);
                smoothed.resolve_target = Some(image);
                smoothed.ops.store = wgpu::StoreOp::Discard;
                (smoothed, (depth, FAR))
            }
            None => (attachment(image, black), (&self.depth, wgpu::LoadOp::Load)),
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

    /// Waits for the images that `submission` draws and [`Self::ask`] asked for, and unpacks them
    /// into `planes`, which fit.
    ///
    /// It is here that the thread of the caller waits for an image.
    ///
    /// # Errors
    /// What the device reports, or a buffer that could not be mapped.
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
        let width = self.intrinsics.width as usize;
        for (row, out) in self
            .colour
            .rows(&mapped)
            .zip(planes.colour.chunks_exact_mut(3 * width))
        {
            without_fourths(row, out);
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

/// Copies texels of four bytes without their fourth, four texels at a time: whole texels, each over
/// the fourth byte of the one before.
fn without_fourths(texels: &[u8], rgb: &mut [u8]) {
    let (fours, rest) = texels.as_chunks::<16>();
    let (packed, last) = rgb.as_chunks_mut::<12>();
    for (four, packed) in fours.iter().zip(packed) {
        packed[0..4].copy_from_slice(&four[0..4]);
        packed[3..7].copy_from_slice(&four[4..8]);
        packed[6..10].copy_from_slice(&four[8..12]);
        packed[9..12].copy_from_slice(&four[12..15]);
    }
    for (texel, rgb) in rest.chunks_exact(4).zip(last.chunks_exact_mut(3)) {
        rgb.copy_from_slice(&texel[..3]);
    }
}

impl Plane {
    /// Its rows in the mapped buffer, without the padding.
    fn rows<'a>(&self, mapped: &'a [u8]) -> impl Iterator<Item = &'a [u8]> {
        let row_bytes = self.row_bytes as usize;
        mapped[index(self.offset)..]
            .chunks_exact(self.pitch_bytes as usize)
            .map(move |row| &row[..row_bytes])
    }
}

/// A depth attachment starts at the far plane.
pub(super) const FAR: wgpu::LoadOp<f32> = wgpu::LoadOp::Clear(1.0);

/// A colour target that is kept after the pass.
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

/// `store` is `Discard` where no later pass looks at the depth.
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

#[cfg(test)]
mod tests {
    use super::without_fourths;

    #[test]
    fn every_fourth_byte_is_left_out() {
        for width in 0..13_u8 {
            let texels: Vec<u8> = (0..4 * width).collect();
            let mut rgb = vec![0; 3 * usize::from(width)];
            without_fourths(&texels, &mut rgb);
            let kept: Vec<u8> = (0..4 * width).filter(|byte| byte % 4 != 3).collect();
            assert_eq!(rgb, kept);
        }
    }
}
