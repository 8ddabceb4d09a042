//! The formats of images on the device, and textures for them.

/// Colour as the frame holds it, encoded to sRGB by the shader, with a fourth byte that is 255 and
/// left out on the way back. As the format is linear for the device, samples of a pixel are
/// averaged in encoded values.
pub(super) const COLOUR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// Instance id; integers are never blended or filtered.
pub(super) const INSTANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R8Uint;
/// Metres along the camera's z, interpolated in perspective from the vertices.
pub(super) const RANGE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Visibility: clip depth, 0 at the near plane and 1 at the far one. It is not read back.
pub(super) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Each of the two images of a G-buffer, see `deferred.wgsl`.
pub(super) const GBUFFER_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;

/// A colour target that takes what is drawn as it is: no blending, all channels.
pub(super) const fn whole(format: wgpu::TextureFormat) -> Option<wgpu::ColorTargetState> {
    Some(wgpu::ColorTargetState {
        format,
        blend: None,
        write_mask: wgpu::ColorWrites::ALL,
    })
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

/// A texture of `size`: width, height and samples a pixel.
pub(super) fn sampled(
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

/// An image that is drawn into from nothing.
pub(super) const fn cleared(
    view: &wgpu::TextureView,
) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    Some(wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations {
            load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
            store: wgpu::StoreOp::Store,
        },
    })
}
