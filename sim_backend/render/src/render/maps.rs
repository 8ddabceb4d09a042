//! The images that passes which look at surfaces read: shadow map and painted patterns.
//!
//! Bind group 1 of these passes: 0 shadow map (depth), 1 sampler that compares, 2 albedo and 3
//! relief (arrays with one layer per pattern), 4 sampler that filters. Made once per renderer; the
//! patterns do not change, the shadow map is drawn anew for each call.

use super::bake::Paints;

/// How they are bound; fragments and deferred shading read them.
pub(super) fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT | wgpu::ShaderStages::COMPUTE,
        ty,
        count: None,
    };
    let depth = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Depth,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let painted = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: true },
        view_dimension: wgpu::TextureViewDimension::D2Array,
        multisampled: false,
    };
    let comparing = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Comparison);
    let filtering = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("maps"),
        entries: &[
            entry(0, depth),
            entry(1, comparing),
            entry(2, painted),
            entry(3, painted),
            entry(4, filtering),
        ],
    })
}

/// The shadow map and the patterns, bound.
///
/// The shadow sampler blends four comparisons (percentage-closer filtering) and clamps at the rim;
/// the patterns' is trilinear and mirrors beyond the painted square.
pub(super) fn group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    shadow_map: &wgpu::TextureView,
    paints: &Paints,
) -> wgpu::BindGroup {
    let comparing = device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("shadow"),
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        compare: Some(wgpu::CompareFunction::LessEqual),
        ..Default::default()
    });
    let mirrored = wgpu::AddressMode::MirrorRepeat;
    let filtering = device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("patterns"),
        address_mode_u: mirrored,
        address_mode_v: mirrored,
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        mipmap_filter: wgpu::MipmapFilterMode::Linear,
        ..Default::default()
    });
    let view = wgpu::BindingResource::TextureView;
    let [albedo, relief] = paints.views();
    let resources = [
        view(shadow_map),
        wgpu::BindingResource::Sampler(&comparing),
        view(&albedo),
        view(&relief),
        wgpu::BindingResource::Sampler(&filtering),
    ];
    let entries: Vec<_> = (0_u32..)
        .zip(resources)
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("maps"),
        layout,
        entries: &entries,
    })
}
