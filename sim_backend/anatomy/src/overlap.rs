//! How well two label volumes agree.
//!
//! It compares voxels by index, so both volumes must be on one lattice; [`crate::measure`] compares
//! a mesh with voxels.

use crate::number::real;

/// Dice of each group 1 to `groups` between two volumes of group numbers: twice what both have by
/// what each has; none for a group that neither has.
///
/// `2 |A and B| / (|A| + |B|)`, 1 where they are the same. Groups above `groups` and the background
/// count only against the others. One pass over both volumes.
///
/// # Panics
/// If they have different numbers of voxels.
#[must_use]
pub fn dice(one: &[u8], other: &[u8], groups: usize) -> Vec<Option<f64>> {
    assert_eq!(one.len(), other.len(), "the same voxels");
    let mut both = [0; 256];
    let mut either = [0; 256];
    for (&one, &other) in one.iter().zip(other) {
        either[usize::from(one)] += 1;
        either[usize::from(other)] += 1;
        both[usize::from(one)] += usize::from(one == other);
    }
    (1..=groups)
        .map(|group| (either[group] > 0).then(|| 2.0 * real(both[group]) / real(either[group])))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::dice;

    #[test]
    fn dice_is_twice_the_common_part_of_the_sum() {
        let found = dice(&[1, 1, 1, 0, 2, 0], &[1, 1, 0, 1, 3, 0], 4);
        assert_eq!(found, [Some(4.0 / 6.0), Some(0.0), Some(0.0), None]);
        assert_eq!(dice(&[7; 9], &[7; 9], 7)[6], Some(1.0));
    }
}
