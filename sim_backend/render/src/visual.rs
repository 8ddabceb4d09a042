//! What the renderer draws: triangle meshes with a material and an instance id, placed by poses.
//!
//! Everything is given once, when a renderer is made; afterwards only poses, vertices
//! ([`crate::Renderer::reshape`]) and tints change. Colours are linear RGB with the primaries of
//! sRGB; the shader encodes them at the very end.

use hal::{Mesh, Pose};

/// Instance ids that scenes of several kinds use; 0 is background. Those of one kind alone lie in
/// its module.
///
/// They are the values of the id plane, one byte a pixel, and of recorded segmentation: so a number
/// keeps its meaning from recording to recording.
pub mod instance {
    /// The organ or board that the task happens on.
    pub const ORGAN: u8 = 1;
    /// The needle.
    pub const NEEDLE: u8 = 2;
    /// Instrument shaft of the first arm.
    pub const SHAFT: u8 = 3;
    /// Wrist of the first arm.
    pub const WRIST: u8 = 4;
    /// Jaw fingers of the first arm.
    pub const JAW: u8 = 5;
    /// Instrument shaft of the second arm.
    pub const SECOND_SHAFT: u8 = 6;
    /// Wrist of the second arm.
    pub const SECOND_WRIST: u8 = 7;
    /// Jaw fingers of the second arm.
    pub const SECOND_JAW: u8 = 8;
    /// The soft flap.
    pub const TISSUE: u8 = 12;
    /// The mark on it.
    pub const MARK: u8 = 13;
    /// Organs of a patient around the one that the task happens on.
    pub const NEIGHBOUR: u8 = 14;
}

/// What an instance id means to people.
///
/// For legends and for pictures of the id plane; the renderer does not use it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// The id.
    pub instance: u8,
    /// The name.
    pub name: &'static str,
    /// A colour for pictures of ids, sRGB bytes.
    pub colour: [u8; 3],
}

impl Part {
    /// The part with the id `instance`, called `name`, in the colour `colour`.
    #[must_use]
    pub const fn new(instance: u8, name: &'static str, colour: [u8; 3]) -> Self {
        Self {
            instance,
            name,
            colour,
        }
    }
}

/// The parts of [`instance`].
pub const PARTS: [Part; 11] = [
    Part::new(instance::ORGAN, "ground", [128, 70, 60]),
    Part::new(instance::NEEDLE, "needle", [255, 225, 25]),
    Part::new(instance::SHAFT, "shaft", [130, 130, 140]),
    Part::new(instance::WRIST, "wrist", [70, 200, 240]),
    Part::new(instance::JAW, "jaw", [245, 120, 30]),
    Part::new(instance::SECOND_SHAFT, "2nd shaft", [110, 80, 200]),
    Part::new(instance::SECOND_WRIST, "2nd wrist", [60, 180, 75]),
    Part::new(instance::SECOND_JAW, "2nd jaw", [230, 40, 60]),
    Part::new(instance::TISSUE, "flap", [0, 150, 60]),
    Part::new(instance::MARK, "mark", [210, 0, 210]),
    Part::new(instance::NEIGHBOUR, "neighbour", [170, 255, 195]),
];

/// How a surface answers light.
///
/// The model is the metallic-roughness one of glTF with a clear film: diffuse light that wraps
/// around tissue, a GGX lobe of the body, a second one of the film. `light.wgsl` has the equations.
/// Values outside of the ranges are not refused.
#[derive(Clone, Copy, Debug)]
pub struct Material {
    /// Linear RGB, 0 to 1: the diffuse albedo of a dielectric, the reflectance of a metal seen
    /// straight on. Patterns are painted about it.
    pub base_colour: [f32; 3],
    /// 0 dielectric (4 % at normal incidence), 1 metal. Patterned surfaces are dielectrics whatever
    /// stands here.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1; its square is GGX's alpha. Full shading takes 0.08 at least.
    pub roughness: f32,
    /// Strength of a thin wet film, 0 to 1. On patterned surfaces it also says how much they are
    /// flesh, which light gets under: all of it from 0.5 on.
    pub wetness: f32,
    /// Amount of the pattern's relief, 0 to 1: a factor of its slopes. Without relief in plain
    /// shading. Of smooth dielectrics without a film it is how worn they are in fine shading:
    /// smudged and scratched. Wear moves with the object, and does not follow a mesh that bends.
    pub detail: f32,
    /// What is painted on it.
    pub pattern: Pattern,
}

/// What is painted on a surface, and with which relief. It sticks to the surface as it was when it
/// was uploaded.
///
/// Smooth and brushed surfaces are computed for each pixel. All others are painted once into a
/// square of 0.18 m, a layer each, and mirrored beyond it (`bake.wgsl`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pattern {
    /// One even colour, but for wear in fine shading ([`Material::detail`]).
    #[default]
    Smooth,
    /// Fine grooves around the object's z axis, of machined metal.
    Brushed,
    /// Pink, mottled, with vessels and faint fibres under serosa: muscle, and the wall of a hollow
    /// organ.
    Muscle,
    /// A smooth capsule over faint lobules.
    Liver,
    /// Yellow lobules of several sizes with vessels between.
    Fat,
    /// Even and matt: skin, and silicone that stands for it.
    Skin,
    /// A woven drape in soft folds.
    Cloth,
    /// A thin sheet of tissue with the vessels that run in it.
    Membrane,
}

/// What is behind all things: a floor and, around it, the wall of a cavity. It has no instance id
/// and no depth.
///
/// The wall is an ellipsoid of 0.26 x 0.24 x 0.20 m half axes about (0, 0, 0.03) m of the scene,
/// found by formula for each pixel that nothing else covers. It casts no shadow, but takes those of
/// the scene.
#[derive(Clone, Copy, Debug)]
pub struct Backdrop {
    /// Height of the floor in the scene frame, m.
    pub floor_m: f64,
    /// Surface of floor and wall, with a painted pattern.
    pub material: Material,
    /// Factor of the wall's colour, the floor having 1; the square of it is the factor of its film.
    pub walls: f32,
    /// Linear RGB of what metal mirrors from below: the colour that prevails in the scene.
    pub bounce: [f32; 3],
    /// By how much longer a camera that looks across the endoscope's light is exposed in pictures
    /// for people. The renderer does not read it: whoever places such a camera puts it into
    /// [`crate::Optics::exposure`].
    pub across: f64,
}

impl Backdrop {
    /// The inside of a body: fat on the floor, a wall that loses itself in the dark.
    pub const CAVITY: Self = Self {
        floor_m: -0.022,
        material: Material {
            base_colour: [0.55, 0.30, 0.09],
            metallic: 0.0,
            roughness: 0.5,
            wetness: 0.7,
            detail: 0.8,
            pattern: Pattern::Fat,
        },
        walls: 0.35,
        bounce: [0.42, 0.10, 0.075],
        across: 1.7,
    };

    /// A table under a drape, `floor_m` high, in a dark room.
    #[must_use]
    pub const fn table(floor_m: f64, bounce: [f32; 3]) -> Self {
        Self {
            floor_m,
            material: Material {
                base_colour: [0.012, 0.115, 0.125],
                metallic: 0.0,
                roughness: 0.8,
                wetness: 0.0,
                detail: 0.8,
                pattern: Pattern::Cloth,
            },
            walls: 0.25,
            bounce,
            across: 1.0,
        }
    }
}

/// One thing to draw.
///
/// Two visuals may share an id; each is still placed by a pose of its own. Meshes are copied to the
/// device, and kept here until fine shading has baked them.
#[derive(Clone, Debug)]
pub struct Visual {
    /// What it is, for people.
    pub name: &'static str,
    /// Its shape, m, in its own frame; triangles are seen from their counter-clockwise side only.
    /// The renderer refuses lists of normals and indices that do not fit.
    pub mesh: Mesh,
    /// Its surface.
    pub material: Material,
    /// Its id in segmentation images, see [`instance`]; 0 would make it background.
    pub instance: u8,
    /// Whether it stands where its mesh has it, in one frame with all others that do, in every
    /// picture. Finely shaded, these keep the light from all around off each other.
    pub is_still: bool,
    /// Where on the endless pattern of its material the middle of what is painted on it lies, mm:
    /// surfaces of one material with different places don't look alike.
    pub pattern_at_mm: [f32; 2],
}

impl Visual {
    /// What has this shape and surface, and may move.
    #[must_use]
    pub const fn new(name: &'static str, mesh: Mesh, material: Material, instance: u8) -> Self {
        Self {
            name,
            mesh,
            material,
            instance,
            is_still: false,
            pattern_at_mm: [0.0; 2],
        }
    }

    /// The same with another part of its material's pattern; see [`Self::pattern_at_mm`].
    #[must_use]
    pub const fn with_pattern_at(mut self, at_mm: [f32; 2]) -> Self {
        self.pattern_at_mm = at_mm;
        self
    }

    /// The same where it never moves; see [`Self::is_still`].
    #[must_use]
    pub const fn still(mut self) -> Self {
        self.is_still = true;
        self
    }
}

/// Poses of a scene's visuals in the scene frame, m, in the visuals' order, one each.
pub type VisualPoses = Vec<Pose>;
