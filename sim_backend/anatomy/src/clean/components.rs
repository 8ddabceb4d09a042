//! Pieces of each group that hang together by faces of voxels, found by runs along the first axis.
//!
//! Connected components with 6-neighbourhood, labelled by union-find over runs rather than voxels:
//! a volume of 150 million voxels has some million runs. The background is a group like the others
//! here, so that voids are its pieces.

use hal::count::count_u8;
use std::collections::BTreeMap;

use super::Cleaned;
use crate::number::index;
use crate::volume::Padded;

/// Voxels in a row with one group.
///
/// Padded coordinates; the row is known by where the run stands in `Runs::rows`.
struct Run {
    /// Its first voxel along x.
    start: u32,
    /// One past its last voxel.
    end: u32,
    /// The group of all its voxels.
    group: u8,
}

/// Runs of a volume and which of them hang together.
struct Runs {
    /// Row by row, and from left to right in each: together they cover the volume.
    runs: Vec<Run>,
    /// The first run of each row, and the end.
    ///
    /// Row `y + dims[1] * z`; one entry more than rows.
    rows: Vec<usize>,
    /// A forest of runs; a root stands for a piece.
    ///
    /// A root is its own parent, and the lowest run of its piece.
    parents: Vec<u32>,
}

/// What is known of a piece.
#[derive(Clone, Copy, Default)]
struct Piece {
    /// How many it has.
    voxels: u64,
    /// Whether it reaches the margin.
    ///
    /// Only the background does: it is the outside of the body, not a void.
    outside: bool,
}

impl Runs {
    /// One pass over the voxels; no two runs are joined yet.
    fn of(volume: &Padded) -> Self {
        let mut runs = Vec::new();
        let mut rows = vec![0];
        for row in volume.voxels.chunks_exact(volume.dims[0]) {
            let mut start = 0;
            for piece in row.chunk_by(|a, b| a == b) {
                let end = start + index(piece.len());
                let group = piece[0];
                runs.push(Run { start, end, group });
                start = end;
            }
            rows.push(runs.len());
        }
        let parents = (0..index(runs.len())).collect();
        Self {
            runs,
            rows,
            parents,
        }
    }

    /// Paths are halved on the way (Tarjan and van Leeuwen), which keeps them short.
    fn root(&mut self, mut run: u32) -> u32 {
        while self.parents[run as usize] != run {
            let above = self.parents[self.parents[run as usize] as usize];
            self.parents[run as usize] = above;
            run = above;
        }
        run
    }

    /// Gives `meet` each pair of runs that share faces, with how many, the earlier first.
    ///
    /// Contacts with the run before in the same row, with the row before and with the slice before:
    /// each shared face is met once. Runs of different groups are given as well as those of one.
    fn each_contact(&self, dims: [usize; 3], mut meet: impl FnMut(u32, u32, u32)) {
        for row in 0..self.rows.len() - 1 {
            for run in self.rows[row] + 1..self.rows[row + 1] {
                meet(index(run - 1), index(run), 1);
            }
            let before = [
                (row % dims[1] > 0).then(|| row - 1),
                row.checked_sub(dims[1]),
            ];
            for other in before.into_iter().flatten() {
                self.row_contacts(other, row, &mut meet);
            }
        }
    }

    /// Two rows that are neighbours are merged like sorted lists, O(runs of both).
    fn row_contacts(&self, a: usize, b: usize, meet: &mut impl FnMut(u32, u32, u32)) {
        let (mut i, mut j) = (self.rows[a], self.rows[b]);
        while i < self.rows[a + 1] && j < self.rows[b + 1] {
            let (left, right) = (&self.runs[i], &self.runs[j]);
            let shared = left
                .end
                .min(right.end)
                .saturating_sub(left.start.max(right.start));
            if shared > 0 {
                meet(index(i), index(j), shared);
            }
            // Whichever ends first has no more to share.
            if left.end <= right.end {
                i += 1;
            } else {
                j += 1;
            }
        }
    }

    /// Joins runs of one group that share faces.
    fn join(&mut self, dims: [usize; 3]) {
        let mut pairs = Vec::new();
        self.each_contact(dims, |a, b, _| {
            if self.runs[a as usize].group == self.runs[b as usize].group {
                pairs.push((a, b));
            }
        });
        for (a, b) in pairs {
            let (a, b) = (self.root(a), self.root(b));
            // The earlier run is the root, so that results do not depend on order.
            self.parents[a.max(b) as usize] = a.min(b);
        }
    }

    /// The root of every run.
    fn roots(&mut self) -> Vec<u32> {
        (0..index(self.runs.len()))
            .map(|run| self.root(run))
            .collect()
    }

    /// By root; entries of runs that are no roots stay empty.
    fn pieces(&self, roots: &[u32], dims: [usize; 3]) -> Vec<Piece> {
        let mut pieces = vec![Piece::default(); self.runs.len()];
        for row in 0..self.rows.len() - 1 {
            let (y, z) = (row % dims[1], row / dims[1]);
            let rim = y == 0 || z == 0 || y == dims[1] - 1 || z == dims[2] - 1;
            for run in self.rows[row]..self.rows[row + 1] {
                let Run { start, end, .. } = self.runs[run];
                let piece = &mut pieces[roots[run] as usize];
                piece.voxels += u64::from(end - start);
                piece.outside |= rim || start == 0 || end as usize == dims[0];
            }
        }
        pieces
    }
}

/// Voxels of the largest piece of each group.
///
/// By group number, 256 entries.
fn largest(runs: &Runs, pieces: &[Piece]) -> Vec<u64> {
    let mut largest = vec![0; 256];
    for (run, piece) in runs.runs.iter().zip(pieces) {
        let most = &mut largest[usize::from(run.group)];
        *most = piece.voxels.max(*most);
    }
    largest
}

/// Faces by group around each piece that may have to go.
///
/// By the root of the piece; 32 is the background and the most groups.
type Contacts = BTreeMap<u32, [u32; 32]>;

/// What a doubtful piece becomes, if it does not stay: the group with which it shares most faces.
///
/// None if it stays. Of groups with equally many faces the lowest number gets it, the background
/// first.
fn verdict(group: u8, piece: &Piece, contacts: &[u32; 32], least: u64) -> Option<u8> {
    let enclosed = contacts.iter().filter(|&&faces| faces > 0).count() == 1;
    let goes = piece.voxels < least || group == 0 && enclosed;
    let most = (0..32).max_by_key(|&group| (contacts[group], 32 - group))?;
    goes.then(|| count_u8(most))
}

/// Gives pieces of less than `least` voxels, but for each group's largest, to the neighbour with
/// which they share most faces; fills voids as small, and voids of any size inside of a single
/// group.
///
/// All verdicts are on the volume as it was: an island beside another one takes the group that the
/// other had before. `least` is in voxels. The margin stays background, since the piece that
/// reaches it never goes. Runs, roots and pieces take some 40 bytes a run for the time being.
pub fn remove_islands(volume: &mut Padded, least: u64) -> Cleaned {
    let dims = volume.dims;
    let mut runs = Runs::of(volume);
    runs.join(dims);
    let roots = runs.roots();
    let pieces = runs.pieces(&roots, dims);
    let largest = largest(&runs, &pieces);
    let is_doubtful = |root: u32| {
        let piece = &pieces[root as usize];
        match runs.runs[root as usize].group {
            0 => !piece.outside,
            group => piece.voxels < least && piece.voxels < largest[usize::from(group)],
        }
    };
    let mut contacts = Contacts::new();
    runs.each_contact(dims, |a, b, faces| {
        let (a, b) = (roots[a as usize], roots[b as usize]);
        for (of, with) in [(a, b), (b, a)] {
            if a != b && is_doubtful(of) {
                let group = usize::from(runs.runs[with as usize].group);
                contacts.entry(of).or_insert([0; 32])[group] += faces;
            }
        }
    });
    let verdicts: BTreeMap<u32, u8> = contacts
        .iter()
        .filter_map(|(&root, contacts)| {
            let group = runs.runs[root as usize].group;
            Some((
                root,
                verdict(group, &pieces[root as usize], contacts, least)?,
            ))
        })
        .collect();
    repaint(volume, &runs, &roots, &verdicts);
    summary(&runs, &pieces, &verdicts)
}

/// Writes the verdicts into the voxels, whole runs at a time.
fn repaint(volume: &mut Padded, runs: &Runs, roots: &[u32], verdicts: &BTreeMap<u32, u8>) {
    if verdicts.is_empty() {
        return;
    }
    for (row, voxels) in volume.voxels.chunks_exact_mut(volume.dims[0]).enumerate() {
        let range = runs.rows[row]..runs.rows[row + 1];
        for (run, root) in runs.runs[range.clone()].iter().zip(&roots[range]) {
            if let Some(&group) = verdicts.get(root) {
                let Run { start, end, .. } = *run;
                voxels[start as usize..end as usize].fill(group);
            }
        }
    }
}

/// What was changed, voids of the background apart from islands of groups.
fn summary(runs: &Runs, pieces: &[Piece], verdicts: &BTreeMap<u32, u8>) -> Cleaned {
    let mut cleaned = Cleaned::default();
    for &root in verdicts.keys() {
        let voxels = pieces[root as usize].voxels;
        if runs.runs[root as usize].group == 0 {
            cleaned.holes += 1;
            cleaned.hole_voxels += voxels;
        } else {
            cleaned.islands += 1;
            cleaned.island_voxels += voxels;
        }
    }
    cleaned
}
