//! Tiles of Winograd's minimal filtering: their sides, and where each is in its picture.

use super::Size;

/// Outputs along a side of a tile.
pub(super) const OUTPUTS: usize = 4;

/// Inputs along a side of a tile.
pub(super) const INPUTS: usize = 6;

/// Values that a tile has of each channel.
pub(super) const VALUES: usize = INPUTS * INPUTS;

impl Size {
    pub(super) const fn tiles(self) -> usize {
        self.batch * self.height.div_ceil(OUTPUTS) * self.width.div_ceil(OUTPUTS)
    }

    /// Where the tile `index` is.
    pub(super) const fn place(self, index: usize) -> Place {
        let high = self.height.div_ceil(OUTPUTS);
        let wide = self.width.div_ceil(OUTPUTS);
        Place {
            image: index / (high * wide) * self.height * self.width,
            top: index / wide % high * OUTPUTS,
            left: index % wide * OUTPUTS,
            height: self.height,
            width: self.width,
        }
    }
}

/// Where a tile is.
pub(super) struct Place {
    /// Pixels before its picture.
    pub(super) image: usize,
    /// Its first row of outputs.
    pub(super) top: usize,
    /// Its first column of outputs.
    pub(super) left: usize,
    /// Of the picture.
    pub(super) height: usize,
    pub(super) width: usize,
}
