//! What the renderer draws: triangle meshes with a material and an instance id, placed by poses.

use hal::{Mesh, Pose};

/// Instance ids that scenes of several kinds use; 0 is background. Those of one kind alone lie in
/// its module.
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// The id.
    pub instance: u8,
    /// The name.
    pub name: &'static str,
    /// A colour for pictures of ids, RGB.
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
#[derive(Clone, Copy, Debug)]
pub struct Material {
    /// Linear RGB.
    pub base_colour: [f32; 3],
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1.
    pub roughness: f32,
    /// Strength of a thin wet film, 0 to 1.
    pub wetness: f32,
    /// Amount of the pattern's relief, 0 to 1.
    pub detail: f32,
    /// What is painted on it.
    pub pattern: Pattern,
}

/// What is painted on a surface, and with which relief. It sticks to the surface as it was when it
/// was uploaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pattern {
    /// One even colour.
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
#[derive(Clone, Copy, Debug)]
pub struct Backdrop {
    /// Height of the floor in the scene frame, m.
    pub floor_m: f64,
    /// Surface of floor and wall, with a painted pattern.
    pub material: Material,
    /// How much of the light that falls on the wall it throws back, compared to the floor.
    pub walls: f32,
    /// Linear RGB of what metal mirrors from below: the colour that prevails in the scene.
    pub bounce: [f32; 3],
    /// By how much longer a camera that looks across the endoscope's light is exposed in pictures
    /// for people.
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
#[derive(Clone, Debug)]
pub struct Visual {
    /// What it is, for people.
    pub name: &'static str,
    /// Its shape.
    pub mesh: Mesh,
    /// Its surface.
    pub material: Material,
    /// Its id in segmentation images.
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

/// Poses of a scene's visuals in the scene frame, in the visuals' order.
pub type VisualPoses = Vec<Pose>;
