//! Which links of two arms keep apart, and the distances between them.

/// Links of the first and of the second arm that keep apart. Wrists and fingers of both may meet.
pub(super) const KINDS: [(usize, usize); 7] =
    [(0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (0, 2), (0, 3)];

/// One distance for each of [`KINDS`], m: what is left of the gap that they must keep.
pub(super) type Gaps = [f64; KINDS.len()];
