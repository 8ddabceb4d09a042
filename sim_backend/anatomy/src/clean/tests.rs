//! Segmentations with islands, holes and touching voxels.

use hal::random::SplitMix64;

use super::touching::is_touching;
use super::{remove_islands, separate_touching};
use crate::grid::Grid;
use crate::nifti::LabelVolume;
use crate::volume::Padded;

/// A volume whose group at x, y, z `group` says.
fn volume(side: usize, group: impl Fn(usize, usize, usize) -> u8) -> Padded {
    let grid = Grid::centred([side; 3], [1.0; 3]);
    let at = |i: usize| group(i % side, i / side % side, i / side / side);
    let voxels = (0..side * side * side).map(at).collect();
    Padded::new(LabelVolume { grid, voxels })
}

fn within(low: usize, high: usize, x: usize, y: usize, z: usize) -> bool {
    [x, y, z].iter().all(|c| (low..high).contains(c))
}

#[test]
fn islands_go_to_their_surroundings_and_holes_are_filled() {
    // A ball of group 2 in a block of group 1, with a void inside of each, an island of 1 in the
    // air and one of 2 in the block.
    let mut dirty = volume(20, |x, y, z| {
        if within(9, 10, x, y, z) || (x, y, z) == (3, 3, 3) {
            0
        } else if within(6, 13, x, y, z) || (x, y, z) == (15, 15, 15) {
            2
        } else {
            u8::from(within(2, 17, x, y, z) || (x, y, z) == (18, 18, 18))
        }
    });
    let cleaned = remove_islands(&mut dirty, 8);
    assert_eq!((cleaned.islands, cleaned.holes), (2, 2));
    assert_eq!((cleaned.island_voxels, cleaned.hole_voxels), (2, 2));
    let clean = volume(20, |x, y, z| {
        if within(6, 13, x, y, z) {
            2
        } else {
            u8::from(within(2, 17, x, y, z))
        }
    });
    assert!(dirty.voxels == clean.voxels);
}

#[test]
fn the_only_piece_of_a_group_stays_however_small() {
    let mut small = volume(6, |x, y, z| u8::from((x, y, z) == (3, 3, 3)));
    assert_eq!(remove_islands(&mut small, 1000).islands, 0);
    assert_eq!(small.counts()[1], 1);
}

#[test]
fn a_void_between_two_groups_stays_if_it_is_large() {
    let with_void = |x: usize, y: usize, z: usize| {
        if within(5, 10, x, y, z) {
            0
        } else {
            u8::from(within(2, 14, x, y, z)) * if x < 7 { 1 } else { 2 }
        }
    };
    let mut volume = volume(16, with_void);
    let before = volume.counts();
    assert_eq!(remove_islands(&mut volume, 100).holes, 0);
    assert_eq!(volume.counts(), before);
}

#[test]
fn random_volumes_come_to_touch_nowhere() {
    let ranks = [u32::MAX, 3, 1, 2];
    for seed in 0..20 {
        let mut random = SplitMix64::new(seed);
        let values: Vec<u8> = (0..1000)
            .map(|_| u8::try_from(random.below(4)).expect("small"))
            .collect();
        let mut noise = volume(10, |x, y, z| values[x + 10 * y + 100 * z]);
        assert!(is_touching(&noise));
        assert!(separate_touching(&mut noise, &ranks) > 0);
        assert!(!is_touching(&noise), "seed {seed}");
    }
}

#[test]
fn solids_are_left_as_they_are() {
    let ball = |x: usize, y: usize, z: usize| {
        let r2 = [x, y, z]
            .iter()
            .map(|&c| (c as i64 - 10).pow(2))
            .sum::<i64>();
        u8::from(r2 < 60)
    };
    let mut volume = volume(21, ball);
    let before = volume.voxels.clone();
    assert_eq!(separate_touching(&mut volume, &[u32::MAX, 1]), 0);
    assert!(volume.voxels == before);
}
