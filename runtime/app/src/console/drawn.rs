//! Planes of the cameras, as they were drawn.

use hal::TimeNs;
use serde::Deserialize;

/// Most cameras with streams.
const CAMERAS_MAX: u8 = 21;

/// What of a frame is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Plane {
    /// As it looks.
    Colour,
    /// How far away it is, in false colour.
    Depth,
    /// What it is, in false colour.
    Ids,
}

impl Plane {
    pub(crate) const ALL: [Self; 3] = [Self::Colour, Self::Depth, Self::Ids];
}

/// One plane of one camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(from = "(u8, Plane)")]
pub(crate) struct Stream {
    /// The camera, in the order in which the page was told of them.
    pub(crate) camera: u8,
    /// Of it.
    pub(crate) plane: Plane,
}

impl From<(u8, Plane)> for Stream {
    fn from((camera, plane): (u8, Plane)) -> Self {
        Self { camera, plane }
    }
}

impl Stream {
    /// Where everything in the scene is, which is no picture.
    pub(crate) const SCENE: Self = Self {
        camera: u8::MAX,
        plane: Plane::Colour,
    };

    /// Its bit among those that are wanted.
    pub(super) const fn bit(self) -> u64 {
        if self.camera < CAMERAS_MAX {
            1 << (3 * self.camera + self.plane as u8)
        } else if self.camera == Self::SCENE.camera && matches!(self.plane, Plane::Colour) {
            1 << 63
        } else {
            0
        }
    }
}

/// Pixels of one plane.
#[derive(Clone, Debug)]
pub(super) enum Pixels {
    /// sRGB bytes, 3 a pixel.
    Colour(Vec<u8>),
    /// Metres.
    Depth(Vec<f32>),
    /// Instance ids.
    Ids(Vec<u8>),
}

/// A plane as it was drawn.
#[derive(Clone, Debug)]
pub(super) struct Drawn {
    pub(super) stream: Stream,
    pub(super) stamp: TimeNs,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) pixels: Pixels,
}
