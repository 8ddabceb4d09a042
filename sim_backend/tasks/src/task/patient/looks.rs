//! What tissue groups look like to the renderer.

use hal::mesh::single;
use hal::random::{SplitMix64, fnv_1a};
use nalgebra::Vector3;
use trocar_anatomy::assets::Part;
use trocar_render::visual::{Material, Pattern};

use crate::task::visuals::{LIVER, MUSCLE};

/// Share of an asset's colour that tissue has under the light of an endoscope, which is close.
const DIMMED: f32 = 0.5;

/// What is known of a group by its name: how the renderer calls it, its pattern, and whether it is
/// a wall of the belly or beyond one.
const KNOWN: [(&str, Pattern, bool); 17] = [
    ("liver", Pattern::Liver, false),
    ("gallbladder", Pattern::Membrane, false),
    ("spleen", Pattern::Liver, false),
    ("pancreas", Pattern::Fat, false),
    ("kidneys", Pattern::Liver, false),
    ("stomach", Pattern::Membrane, false),
    ("small-bowel", Pattern::Membrane, false),
    ("colon", Pattern::Membrane, false),
    ("bladder", Pattern::Membrane, false),
    ("lungs", Pattern::Membrane, true),
    ("heart", Pattern::Muscle, true),
    ("vessels", Pattern::Smooth, false),
    ("spine", Pattern::Smooth, true),
    ("ribs", Pattern::Smooth, true),
    ("hips", Pattern::Smooth, true),
    ("muscles", Pattern::Muscle, true),
    ("body", Pattern::Skin, true),
];

/// Any other group.
const OTHER: (&str, Pattern, bool) = ("tissue", Pattern::Skin, false);

fn known(part: &Part) -> (&'static str, Pattern, bool) {
    let found = KNOWN.iter().find(|(name, ..)| *name == part.name);
    found.copied().unwrap_or(OTHER)
}

/// What the renderer calls a group.
pub(super) fn name(part: &Part) -> &'static str {
    known(part).0
}

/// Whether a group holds the belly's organs or lies beyond the diaphragm: an endoscope in the belly
/// is within.
pub(super) fn is_wall(part: &Part) -> bool {
    known(part).2
}

/// How far from its middle parts of a pattern are taken, mm.
const PATTERN_MM: f64 = 2000.0;

/// Which part of its pattern an organ shows, mm: as the hash of its name and its vertices says, so
/// no two organs and no two patients look alike.
pub(super) fn pattern_at_mm(part: &Part) -> [f32; 2] {
    let vertices = part.mesh.positions.iter().flatten();
    let shape = vertices.flat_map(|along_m| along_m.to_le_bytes());
    let mut random = SplitMix64::new(fnv_1a(part.name.bytes().chain(shape)));
    let [x, y] = [(); 2].map(|()| PATTERN_MM * random.signed_unit());
    let [x, y, _] = single(&Vector3::new(x, y, 0.0));
    [x, y]
}

/// How the surface of a tissue group answers light: colour, roughness and film are the asset's, the
/// pattern goes by the name. Liver and muscle look as in the tasks without a patient.
#[must_use]
pub fn tissue_material(part: &Part) -> Material {
    match part.name.as_str() {
        "liver" => LIVER,
        "muscles" => MUSCLE,
        _ => Material {
            base_colour: part.colour.map(|channel| DIMMED * channel),
            metallic: 0.0,
            roughness: part.roughness,
            wetness: part.wetness,
            detail: 0.7,
            pattern: known(part).1,
        },
    }
}
