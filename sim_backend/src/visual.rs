//! What the renderer draws: triangle meshes with a material and an instance id, placed by poses.

use hal::Pose;

/// Instance ids that every task uses; 0 is background.
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
    /// The training block.
    pub const BLOCK: u8 = 9;
    /// Pegs of a board.
    pub const PEG: u8 = 10;
    /// The peg that the block belongs on.
    pub const GOAL_PEG: u8 = 11;
    /// The soft flap.
    pub const TISSUE: u8 = 12;
    /// The mark on it.
    pub const MARK: u8 = 13;
}

/// A triangle mesh in its own frame, metres; counter-clockwise triangles face outwards.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Unit vertex normals.
    pub normals: Vec<[f32; 3]>,
    /// Three indices a triangle.
    pub indices: Vec<u32>,
}

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
    /// Amount of procedural colour and normal detail, 0 to 1.
    pub detail: f32,
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
}

/// Poses of a scene's visuals in the scene frame, in the visuals' order.
pub type VisualPoses = Vec<Pose>;
