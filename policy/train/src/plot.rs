//! The curve of a training as a picture: a small vector graphic, losses over steps on a logarithmic
//! scale.
//!
//! Plain text without a library; the same curve gives the same bytes.

use core::fmt::Write as _;

use super::curve::{CurveRow, LossCurve};

/// Size of the picture and of its margins, px.
const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 480.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 150.0;
const TOP: f64 = 20.0;
const BOTTOM: f64 = 50.0;

/// Least value that is drawn, for what may be zero.
const LEAST: f64 = 1e-9;

/// One line of the picture.
struct Series {
    /// In the legend.
    name: &'static str,
    colour: &'static str,
    /// The value in a row, if it has one.
    of: fn(&CurveRow) -> Option<f64>,
}

/// The curves, in the order of the legend.
const SERIES: [Series; 4] = [
    Series {
        name: "loss",
        colour: "#1f4e8c",
        of: |row| Some(row.loss),
    },
    Series {
        name: "l1",
        colour: "#2a9d5c",
        of: |row| Some(row.l1),
    },
    Series {
        name: "kl",
        colour: "#b5651d",
        of: |row| Some(row.kl),
    },
    Series {
        name: "validation l1",
        colour: "#c0392b",
        of: |row| row.validation_l1,
    },
];

/// Where a step and a value are in the picture.
struct Axes {
    /// The last step, at the right end.
    steps: f64,
    /// Decimal logarithms of the least and the greatest value.
    decades: [f64; 2],
}

impl Axes {
    /// The axes that show all of `curve`.
    #[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
    fn of(curve: &LossCurve) -> Self {
        let values = SERIES.iter().flat_map(|series| points(curve, series));
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (_, value) in values {
            low = low.min(value.log10());
            high = high.max(value.log10());
        }
        if !(low.is_finite() && high.is_finite()) {
            (low, high) = (-1.0, 1.0);
        }
        let last = curve.last().map_or(1, |row| row.step.max(1));
        Self {
            steps: last as f64,
            decades: [low.floor(), high.ceil().max(low.floor() + 1.0)],
        }
    }

    /// Where a step is, px from the left.
    fn x(&self, step: f64) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * step / self.steps
    }

    /// Where a loss is, px from the top; the scale is logarithmic.
    fn y(&self, value: f64) -> f64 {
        let [low, high] = self.decades;
        let share = (value.log10() - low) / (high - low);
        HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share
    }
}

/// Steps and values of a line; nothing of one that is zero throughout.
#[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
fn points(curve: &LossCurve, series: &Series) -> Vec<(f64, f64)> {
    let points: Vec<(f64, f64)> = curve
        .rows
        .iter()
        .filter_map(|row| Some((row.step as f64, (series.of)(row)?)))
        .collect();
    if points.iter().all(|(_, value)| *value <= LEAST) {
        return Vec::new();
    }
    let drawn = points.into_iter();
    drawn
        .map(|(step, value)| (step, value.max(LEAST)))
        .collect()
}

impl LossCurve {
    /// The curve as a picture in SVG: losses over steps, the losses on a logarithmic scale.
    #[must_use]
    pub fn to_svg(&self) -> String {
        let axes = Axes::of(self);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{HEIGHT}\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" \
             font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        );
        draw_grid(&mut svg, &axes);
        let mut place = TOP + 15.0;
        for series in &SERIES {
            let points = points(self, series);
            if points.is_empty() {
                continue;
            }
            let Series { name, colour, .. } = series;
            let line: Vec<String> = points
                .iter()
                .map(|(step, value)| format!("{:.1},{:.1}", axes.x(*step), axes.y(*value)))
                .collect();
            let x = WIDTH - RIGHT + 15.0;
            // Writing to a string cannot fail.
            let _ = writeln!(
                svg,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\n\
                 <text x=\"{x}\" y=\"{place}\" fill=\"{colour}\">{name}</text>",
                line.join(" ")
            );
            place += 18.0;
        }
        svg.push_str("</svg>\n");
        svg
    }
}

/// A line for every decade, and five steps along the bottom.
fn draw_grid(svg: &mut String, axes: &Axes) {
    let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
    let [low, high] = axes.decades;
    let mut decade = low;
    while decade <= high {
        let y = axes.y(10.0_f64.powf(decade));
        let _ = writeln!(
            svg,
            "<line x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{right}\" y2=\"{y:.1}\" stroke=\"#ddd\"/>\n\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">1e{decade}</text>",
            LEFT - 6.0,
            y + 4.0
        );
        decade += 1.0;
    }
    for part in 0..=4 {
        let step = (axes.steps * f64::from(part) / 4.0).round();
        let x = axes.x(step);
        let _ = writeln!(
            svg,
            "<line x1=\"{x:.1}\" y1=\"{TOP}\" x2=\"{x:.1}\" y2=\"{bottom}\" stroke=\"#eee\"/>\n\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{step}</text>",
            bottom + 18.0
        );
    }
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">steps</text>",
        0.5 * (LEFT + right),
        bottom + 38.0
    );
}

#[cfg(test)]
mod tests {
    use super::{CurveRow, LossCurve};

    fn row(step: u64, loss: f64, kl: f64, validation_l1: Option<f64>) -> CurveRow {
        CurveRow {
            step,
            loss,
            l1: loss,
            kl,
            gradient_norm: 1.0,
            lr: 1e-4,
            validation_l1,
        }
    }

    /// Places of a line's corners.
    fn line(svg: &str, colour: &str) -> Vec<(f64, f64)> {
        let end = svg.find(&format!("stroke=\"{colour}\"")).unwrap();
        let line = svg[..end].rsplit("points=\"").next().unwrap();
        let line = line.split('"').next().unwrap();
        line.split(' ')
            .map(|corner| {
                let (x, y) = corner.split_once(',').unwrap();
                (x.parse().unwrap(), y.parse().unwrap())
            })
            .collect()
    }

    #[test]
    fn the_plot_is_logarithmic_and_skips_missing_values() {
        let rows = vec![
            row(50, 100.0, 0.0, Some(7.0)),
            row(100, 10.0, 0.0, None),
            row(200, 1.0, 0.0, Some(2.0)),
        ];
        let svg = LossCurve { rows }.to_svg();
        let loss = line(&svg, "#1f4e8c");
        // Two decades over 410 pixels from y = 20, 200 steps over 640 from x = 70.
        assert_eq!(loss, [(230.0, 20.0), (390.0, 225.0), (710.0, 430.0)]);
        assert_eq!(line(&svg, "#c0392b").len(), 2);
        assert!(!svg.contains(">kl<"), "all of it is zero");
        assert!(svg.contains(">validation l1<") && svg.contains(">1e2<"));
        assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"));
    }

    #[test]
    fn a_curve_without_rows_is_a_picture_too() {
        let svg = LossCurve::default().to_svg();
        assert!(svg.ends_with("</svg>\n") && !svg.contains("polyline"));
    }
}
