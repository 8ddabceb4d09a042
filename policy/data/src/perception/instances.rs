//! Sets of instance ids: what a cloud may show.

/// A set of instance ids.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstanceSet {
    members: [bool; 256],
}

impl InstanceSet {
    /// Every id, the background too.
    pub const ALL: Self = Self {
        members: [true; 256],
    };

    /// Only `ids`.
    #[must_use]
    pub fn only(ids: &[u8]) -> Self {
        let mut members = [false; 256];
        for &id in ids {
            members[usize::from(id)] = true;
        }
        Self { members }
    }

    /// All but `ids`.
    #[must_use]
    pub fn without(ids: &[u8]) -> Self {
        let mut members = [true; 256];
        for &id in ids {
            members[usize::from(id)] = false;
        }
        Self { members }
    }

    /// Whether `id` is in it.
    #[must_use]
    pub fn contains(&self, id: u8) -> bool {
        self.members[usize::from(id)]
    }
}
