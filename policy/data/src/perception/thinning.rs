//! Thinning: of the points in one cube of a grid, the first stays.

use hal::count::count_u32;

use super::Point;
use super::error::PerceptionError;

/// A place in the table that holds no point.
const FREE: u32 = u32::MAX;

/// The first point of every cube of a grid with sides of `side_m` through the origin, in the order
/// of `points`.
///
/// Published code keeps a random point of each cube in training; the first one needs no seed and is
/// the same every time. Coordinates of 2^31 cubes and more count as one cube. O(points), with an
/// open-addressing table.
///
/// # Errors
/// [`PerceptionError::Voxel`] if `side_m` is no length.
pub fn thin(points: &[Point], side_m: f32) -> Result<Vec<Point>, PerceptionError> {
    if !(side_m.is_finite() && side_m > 0.0) {
        return Err(PerceptionError::Voxel { side_m });
    }
    // Twice as many places as points, so that the search for a free one stays short. What comes out
    // does not depend on where anything lies in the table.
    let mut table = vec![FREE; (2 * points.len()).next_power_of_two()];
    let mut kept: Vec<Point> = Vec::new();
    let mut cubes: Vec<[i32; 3]> = Vec::new();
    let mut last = None;
    for point in points {
        let cube = point.map(|x| cell(x, side_m));
        // Neighbours in a row of pixels mostly share their cube.
        if last == Some(cube) {
            continue;
        }
        last = Some(cube);
        if let Some(place) = free_place(&table, &cubes, cube) {
            table[place] = count_u32(cubes.len());
            cubes.push(cube);
            kept.push(*point);
        }
    }
    Ok(kept)
}

/// Where in the hash table `cube`, which is not in it, belongs; `None` if it is. The table's length
/// is a power of two.
fn free_place(table: &[u32], cubes: &[[i32; 3]], cube: [i32; 3]) -> Option<usize> {
    let mask = table.len() - 1;
    let mut place = scatter(cube) & mask;
    loop {
        let entry = table[place];
        if entry == FREE {
            return Some(place);
        }
        if cubes[entry as usize] == cube {
            return None;
        }
        place = (place + 1) & mask;
    }
}

/// `floor(coordinate / side_m)`, which saturates at the ends of `i32`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "saturates, as documented; a whole number that came from single precision goes back into it"
)]
fn cell(coordinate: f32, side_m: f32) -> i32 {
    let sides = coordinate / side_m;
    let whole = sides as i32;
    // Towards minus infinity, not zero.
    if (whole as f32) > sides {
        whole.saturating_sub(1)
    } else {
        whole
    }
}

/// Spreads cubes evenly over the table.
#[expect(
    clippy::cast_sign_loss,
    clippy::cast_possible_truncation,
    reason = "any bits will do"
)]
const fn scatter(cube: [i32; 3]) -> usize {
    let mut hash = 0_u64;
    let mut axis = 0;
    while axis < 3 {
        hash = (hash ^ cube[axis] as u32 as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        hash ^= hash >> 32;
        axis += 1;
    }
    hash as usize
}
