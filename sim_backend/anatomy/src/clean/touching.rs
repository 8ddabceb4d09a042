//! Voxels of a group that touch at an edge or a corner only would make its surface touch itself
//! there: the volume is made well-composed (Latecki, Eckhardt and Rosenfeld 1995), for all groups
//! at once.
//!
//! In three dimensions two configurations are critical (L. Latecki, "3D well-composed pictures",
//! 1997): four voxels around an edge of which two diagonal ones are in the set and two are not, and
//! eight around a corner of which two opposite ones are in it alone, or out of it alone. Without
//! them the faces around the set are a manifold.
//!
//! It is a greedy repair, not the smallest one.

use rayon::prelude::*;

use crate::volume::Padded;

/// Whether voxels of a block of 2 x 2 x 2, a bit each, touch the others of them at an edge or a
/// corner only; bit x + 2 y + 4 z.
///
/// Both configurations are the same for a set and its complement, so a group and all that is not it
/// are judged at once.
const fn is_critical(mask: u8) -> bool {
    // Faces of the block in circular order.
    let faces = [
        [0, 1, 3, 2],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 3, 7, 5],
    ];
    let mut face = 0;
    while face < 6 {
        let [a, b, c, d] = faces[face];
        let [a, b, c, d] = [mask >> a & 1, mask >> b & 1, mask >> c & 1, mask >> d & 1];
        if a == c && b == d && a != b {
            return true;
        }
        face += 1;
    }
    // Two opposite corners alone, or all but two.
    matches!(mask, 0x81 | 0x42 | 0x24 | 0x18 | 0x7e | 0xbd | 0xdb | 0xe7)
}

/// `is_critical` of every mask, computed by the compiler.
const CRITICAL: [bool; 256] = {
    let mut table = [false; 256];
    let mut mask = 0;
    while mask < 256 {
        #[expect(clippy::cast_possible_truncation, reason = "below 256")]
        let bits = mask as u8;
        table[mask] = is_critical(bits);
        mask += 1;
    }
    table
};

/// Groups of the block whose lowest voxel has the index `at`.
///
/// In the order of the bits of a mask: entry x + 2 y + 4 z.
fn block(voxels: &[u8], strides: [usize; 3], at: usize) -> [u8; 8] {
    let [_, y, z] = strides;
    let pair = |at: usize| [voxels[at], voxels[at + 1]];
    let ([a, b], [c, d]) = (pair(at), pair(at + y));
    let ([e, f], [g, h]) = (pair(at + z), pair(at + y + z));
    [a, b, c, d, e, f, g, h]
}

/// How many groups of a block are in a critical place.
///
/// At most four, since each has two voxels of the block or more.
fn criticals(block: [u8; 8]) -> usize {
    let is_first = |i: usize| !block[..i].contains(&block[i]);
    let mask = |group: u8| (0..8).fold(0, |mask, i| mask | u8::from(block[i] == group) << i);
    (0..8)
        .filter(|&i| is_first(i) && CRITICAL[usize::from(mask(block[i]))])
        .count()
}

/// Indices of critical blocks between the slices `z` and `z + 1`.
fn critical_in_slice(volume: &Padded, z: usize) -> Vec<usize> {
    let strides = volume.strides();
    let mut found = Vec::new();
    for y in 0..volume.dims[1] - 1 {
        let row = volume.index(0, y, z);
        for at in row..row + volume.dims[0] - 1 {
            let block = block(&volume.voxels, strides, at);
            // Most blocks are of one group.
            if block != [block[0]; 8] && criticals(block) > 0 {
                found.push(at);
            }
        }
    }
    found
}

/// Indices of the blocks that the voxel with the index `voxel` is in.
///
/// The eight whose lowest voxel is this one or before it. The voxel must not be in the margin, or
/// an index would fall below 0.
fn blocks_of(voxel: usize, strides: [usize; 3]) -> impl Iterator<Item = usize> {
    (0..8).map(move |corner| {
        (0..3)
            .filter(|axis| corner >> axis & 1 == 1)
            .fold(voxel, |at, axis| at - strides[axis])
    })
}

/// Critical groups in all blocks around a voxel.
fn criticals_around(voxels: &[u8], strides: [usize; 3], voxel: usize) -> usize {
    blocks_of(voxel, strides)
        .map(|at| criticals(block(voxels, strides, at)))
        .sum()
}

/// The change of one voxel in the block at `at`, to a group of lower rank in it, that leaves the
/// fewest critical places around.
///
/// 28 trials at most, each of eight blocks. None if no voxel of the block may change.
fn best_change(volume: &mut Padded, ranks: &[u32], at: usize) -> Option<(usize, u8)> {
    let strides = volume.strides();
    let groups = block(&volume.voxels, strides, at);
    let mut best: Option<(usize, usize, u8)> = None;
    for (corner, from) in groups.into_iter().enumerate() {
        let voxel = (0..3)
            .filter(|axis| corner >> axis & 1 == 1)
            .fold(at, |at, axis| at + strides[axis]);
        if is_margin(volume, voxel) {
            continue;
        }
        for to in groups {
            if ranks[usize::from(to)] >= ranks[usize::from(from)] {
                continue;
            }
            volume.voxels[voxel] = to;
            let left = criticals_around(&volume.voxels, strides, voxel);
            volume.voxels[voxel] = from;
            if best.is_none_or(|(fewest, ..)| left < fewest) {
                best = Some((left, voxel, to));
            }
        }
    }
    best.map(|(_, voxel, to)| (voxel, to))
}

/// Whether a voxel lies in the outermost layer, which must stay background.
fn is_margin(volume: &Padded, voxel: usize) -> bool {
    let [width, height, depth] = volume.dims;
    let [x, y, z] = [
        voxel % width,
        voxel / width % height,
        voxel / width / height,
    ];
    x == 0 || y == 0 || z == 0 || x == width - 1 || y == height - 1 || z == depth - 1
}

/// Changes voxels until no group touches itself at an edge or a corner only; how many changes that
/// took.
///
/// A voxel only ever goes to a group of lower rank (`ranks` by group number, all different), so
/// this ends.
///
/// The search for critical blocks runs in parallel by slices, the changes one after the other, last
/// found first; so the result depends on the volume alone. `ranks` comes from
/// [`crate::groups::Groups::ranks`] and needs an entry for every group in the volume.
pub fn separate_touching(volume: &mut Padded, ranks: &[u32]) -> u64 {
    let slices = 0..volume.dims[2] - 1;
    let mut waiting: Vec<usize> = slices
        .into_par_iter()
        .flat_map_iter(|z| critical_in_slice(volume, z))
        .collect();
    let strides = volume.strides();
    let mut changes = 0;
    while let Some(at) = waiting.pop() {
        if criticals(block(&volume.voxels, strides, at)) == 0 {
            continue;
        }
        if let Some((voxel, to)) = best_change(volume, ranks, at) {
            volume.voxels[voxel] = to;
            changes += 1;
            waiting.push(at);
            waiting.extend(blocks_of(voxel, strides));
        }
    }
    changes
}

/// Whether some group touches itself at an edge or a corner only.
#[cfg(test)]
pub(super) fn is_touching(volume: &Padded) -> bool {
    (0..volume.dims[2] - 1).any(|z| !critical_in_slice(volume, z).is_empty())
}
