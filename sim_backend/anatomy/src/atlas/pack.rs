//! Charts side by side on shelves.
//!
//! Shelf packing, tallest first: simple and deterministic. The first square has the area of all
//! charts, or the side of the longest; each further one has a side 3 % longer. The report has the
//! share of the square that is used as `atlas_used`.

use nalgebra::{Point2, Vector2};

use super::chart::Chart;
use crate::number::real;

/// The gap between charts, in sides of the square: two texels of 1024.
const GUTTER: f64 = 2.0 / 1024.0;

/// Where a chart lies.
pub(super) struct Place {
    /// The lower corner of the chart's box, mm.
    low: Point2<f64>,
    /// Where that corner goes in the square, mm.
    at: Point2<f64>,
    /// The chart's height if it is turned by a quarter, so that it lies on its longer side.
    turned: Option<f64>,
}

impl Place {
    /// Where a point of the chart comes to lie.
    pub(super) fn of(&self, p: &Point2<f64>) -> Point2<f64> {
        let inside = p - self.low;
        let turned = self
            .turned
            .map_or(inside, |height| Vector2::new(height - inside.y, inside.x));
        self.at + turned
    }
}

/// Places for all charts in a square, and its side. The square is the smallest of some that
/// suffices.
///
/// In mm: the caller divides by the side. Gaps take a bounded share of a side, so a large enough
/// square is found.
pub(super) fn pack(charts: &[Chart]) -> (Vec<Place>, f64) {
    let area: f64 = charts.iter().map(|chart| chart.size().product()).sum();
    let longest = charts
        .iter()
        .map(|chart| chart.size().max())
        .fold(1e-6, f64::max);
    let mut side = area.sqrt().max(longest);
    loop {
        if let Some(places) = shelves(charts, side) {
            return (places, side);
        }
        side *= 1.03;
    }
}

/// Shelves of charts, the tallest first, in a square of `side`; none if they do not fit.
fn shelves(charts: &[Chart], side: f64) -> Option<Vec<Place>> {
    let gutter = (GUTTER * side).min(side / (4.0 * real(charts.len()).sqrt() + 4.0));
    let lying = |chart: &Chart| {
        let size = chart.size();
        [size.max(), size.min()]
    };
    let mut order: Vec<usize> = (0..charts.len()).collect();
    order.sort_by(|a, b| {
        lying(&charts[*b])[1]
            .total_cmp(&lying(&charts[*a])[1])
            .then(a.cmp(b))
    });
    let mut places: Vec<Option<Place>> = charts.iter().map(|_| None).collect();
    let (mut x, mut y, mut shelf) = (gutter, gutter, 0.0);
    for i in order {
        let [width, height] = lying(&charts[i]);
        if x + width + gutter > side {
            x = gutter;
            y += shelf + gutter;
            shelf = 0.0;
        }
        if x + width > side || y + height > side {
            return None;
        }
        shelf = f64::max(shelf, height);
        let size = charts[i].size();
        places[i] = Some(Place {
            low: charts[i].low(),
            at: Point2::new(x, y),
            turned: (size.y > size.x).then_some(size.y),
        });
        x += width + gutter;
    }
    places.into_iter().collect()
}
