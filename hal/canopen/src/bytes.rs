//! The bytes of one value of an object dictionary.

/// Most bytes of a value that is a text.
pub const TEXT_MAX: usize = 64;

/// Bytes of a value, up to [`TEXT_MAX`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes {
    bytes: [u8; TEXT_MAX],
    length: usize,
}

impl Bytes {
    /// The first of `bytes`, up to [`TEXT_MAX`].
    #[must_use]
    pub fn truncated(bytes: &[u8]) -> Self {
        let length = bytes.len().min(TEXT_MAX);
        let mut own = [0; TEXT_MAX];
        own[..length].copy_from_slice(&bytes[..length]);
        Self { bytes: own, length }
    }

    /// Adds `more` and tells whether there was room.
    pub fn extend(&mut self, more: &[u8]) -> bool {
        let end = self.length + more.len();
        if end > TEXT_MAX {
            return false;
        }
        self.bytes[self.length..end].copy_from_slice(more);
        self.length = end;
        true
    }

    /// The bytes.
    #[must_use]
    pub fn as_slice(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}
