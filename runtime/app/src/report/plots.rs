//! Plots as SVG whose text and axes have the colour of the page around them. Two kinds: success
//! rates from 0 to 1 with intervals, and losses over a logarithmic axis. plotters draws them; its
//! black becomes `currentColor`, so that a page in dark mode shows them too.

use std::fmt::Display;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::prelude::{
    ChartBuilder, Circle, DrawingArea, IntoDrawingArea, IntoLogRange, LineSeries, PathElement,
    RGBColor, SVGBackend, SeriesLabelPosition, ShapeStyle,
};
use plotters::style::{BLACK, Color, TRANSPARENT};

/// A line of a plot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// What it is.
    pub name: String,
    /// Which of the colours it has; series of one colour are named once.
    pub colour: usize,
    /// Its points. They are joined in this order. Non-finite ones don't widen the axes.
    pub points: Vec<(f64, f64)>,
    /// The interval around each point; none for a plain line.
    pub intervals: Vec<[f64; 2]>,
}

/// A plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// Its heading.
    pub title: String,
    /// What runs to the right.
    pub x: String,
    /// What runs up.
    pub y: String,
    /// Whether it runs up by powers of ten.
    pub logarithmic: bool,
    /// The lines.
    pub series: Vec<Series>,
}

/// Seen on white and on black, and told apart by most eyes.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0x2b, 0x7b, 0xba),
    RGBColor(0xd2, 0x6a, 0x0c),
    RGBColor(0x2a, 0x93, 0x57),
    RGBColor(0x9b, 0x5f, 0xc0),
    RGBColor(0xd1, 0x49, 0x5b),
    RGBColor(0x17, 0x8f, 0x99),
    RGBColor(0x9c, 0x6b, 0x30),
    RGBColor(0x7d, 0x83, 0x8c),
];

/// Width and height, pixels; a page scales it down to its own width.
const SIZE: (u32, u32) = (500, 320);

/// Beyond eight series colours repeat.
fn colour(series: &Series) -> RGBColor {
    COLOURS[series.colour % COLOURS.len()]
}

impl Plot {
    /// The plot as SVG; none without a point, and if it can't be drawn.
    #[must_use]
    pub fn svg(&self) -> Option<String> {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let x = range(points().map(|point| point.0))?;
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
            let drawn = if self.logarithmic {
                let y = decades(points().map(|point| point.1))?;
                self.draw_logarithmic(&area, x, y)
            } else {
                self.draw_rates(&area, x)
            };
            drawn.ok()?;
            area.present().ok()?;
        }
        Some(themed(&svg))
    }

    /// Different places to the right.
    fn places(&self) -> usize {
        let points = self.series.iter().flat_map(|series| &series.points);
        let mut places: Vec<f64> = points.map(|point| point.0).collect();
        places.sort_by(f64::total_cmp);
        places.dedup_by(|a, b| a.total_cmp(b).is_eq());
        places.len()
    }

    /// Rates from 0 to 1, with intervals.
    fn draw_rates(
        &self,
        area: &DrawingArea<SVGBackend<'_>, Shift>,
        x: Range<f64>,
    ) -> Result<(), Box<dyn std::error::Error>> {
        let margin = 0.04 * (x.end - x.start);
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .caption(&self.title, ("sans-serif", 16))
            .x_label_area_size(40)
            .y_label_area_size(48)
            .build_cartesian_2d(x.start - margin..x.end + margin, -0.02..1.02)?;
        chart
            .configure_mesh()
            .x_desc(self.x.as_str())
            .y_desc(self.y.as_str())
            .y_labels(6)
            .x_labels(self.places().clamp(2, 10))
            .y_label_formatter(&|value: &f64| format!("{value:.1}"))
            .x_label_formatter(&|value: &f64| short(*value))
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(128, 128, 128).mix(0.35))
            .label_style(("sans-serif", 13))
            .draw()?;
        for (index, series) in self.series.iter().enumerate() {
            let style = ShapeStyle::from(&colour(series)).stroke_width(2);
            // Beside each other, so that none hides another's interval.
            let aside = 0.15 * margin * (index_offset(index, self.series.len()));
            let points: Vec<(f64, f64)> =
                series.points.iter().map(|(x, y)| (x + aside, *y)).collect();
            let line = chart.draw_series(LineSeries::new(points.iter().copied(), style))?;
            line.label(series.name.as_str())
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], style));
            chart.draw_series(
                points
                    .iter()
                    .map(|point| Circle::new(*point, 3, style.filled())),
            )?;
            let bars = points.iter().zip(&series.intervals);
            let thin = style.stroke_width(1);
            chart.draw_series(bars.map(|((x, _), [low, high])| {
                PathElement::new(vec![(*x, *low), (*x, *high)], thin)
            }))?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .label_font(("sans-serif", 13))
            .border_style(TRANSPARENT)
            .draw()?;
        Ok(())
    }

    /// Losses as thin lines without marks. Of several lines of one colour the first names it.
    fn draw_logarithmic(
        &self,
        area: &DrawingArea<SVGBackend<'_>, Shift>,
        x: Range<f64>,
        y: Range<f64>,
    ) -> Result<(), Box<dyn std::error::Error>> {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .caption(&self.title, ("sans-serif", 16))
            .x_label_area_size(40)
            .y_label_area_size(58)
            .build_cartesian_2d(x, y.log_scale())?;
        chart
            .configure_mesh()
            .x_desc(self.x.as_str())
            .y_desc(self.y.as_str())
            .x_labels(6)
            .y_labels(5)
            .y_label_formatter(&|value: &f64| short(*value))
            .x_label_formatter(&|value: &f64| short(*value))
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(128, 128, 128).mix(0.35))
            .label_style(("sans-serif", 13))
            .draw()?;
        let mut named = Vec::new();
        for series in &self.series {
            let style = ShapeStyle::from(&colour(series)).stroke_width(1);
            // A line of one point is none.
            if series.points.len() == 1 {
                let points = series.points.iter();
                chart.draw_series(points.map(|point| Circle::new(*point, 3, style.filled())))?;
            }
            let line = chart.draw_series(LineSeries::new(series.points.iter().copied(), style))?;
            if !named.contains(&series.colour) {
                named.push(series.colour);
                line.label(series.name.as_str()).legend(move |(x, y)| {
                    PathElement::new(vec![(x, y), (x + 16, y)], style.stroke_width(2))
                });
            }
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .label_font(("sans-serif", 13))
            .border_style(TRANSPARENT)
            .draw()?;
        Ok(())
    }
}

/// Steps of 2, with the middle of all series at 0.
#[expect(clippy::cast_precision_loss, reason = "there are few series")]
fn index_offset(index: usize, count: usize) -> f64 {
    2.0 * index as f64 - (count as f64 - 1.0)
}

/// From the least to the greatest; wider if they are the same.
fn range(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    let finite = values.filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low > high {
        return None;
    }
    Some(if high > low {
        low..high
    } else {
        low - 0.5..high + 0.5
    })
}

/// Whole decades, at least one, around the values above 0; others have no logarithm. None without
/// such a value.
fn decades(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    let Range { start, end } = range(values.filter(|value| *value > 0.0).map(f64::log10))?;
    let (low, high) = (start.floor(), end.ceil());
    Some(10_f64.powf(low)..10_f64.powf(high.max(low + 1.0)))
}

/// A number on an axis.
fn short(value: f64) -> String {
    if value >= 10_000.0 {
        return format!("{}k", trimmed(value / 1000.0));
    }
    if value > 0.0 && value < 0.001 {
        format!("{value:.0e}")
    } else {
        trimmed(value)
    }
}

/// Up to three decimals, without zeros at the end.
fn trimmed(value: impl Display) -> String {
    let text = format!("{value:.3}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Black becomes the colour of the text around the plot.
fn themed(svg: &str) -> String {
    let black = format!("#{:02X}{:02X}{:02X}", BLACK.0, BLACK.1, BLACK.2);
    svg.replace(&format!("\"{black}\""), "\"currentColor\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(logarithmic: bool) -> Plot {
        Plot {
            title: "a < b".to_owned(),
            x: "demonstrations".to_owned(),
            y: "success rate".to_owned(),
            logarithmic,
            series: vec![Series {
                name: "act & co".to_owned(),
                colour: 9,
                points: vec![(10.0, 0.3), (20.0, 0.9)],
                intervals: vec![[0.1, 0.5], [0.7, 0.97]],
            }],
        }
    }

    #[test]
    fn a_plot_takes_the_colours_of_its_page_and_is_well_formed() {
        for logarithmic in [false, true] {
            let svg = plot(logarithmic).svg().unwrap();
            assert!(
                svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"),
                "{svg}"
            );
            assert!(
                svg.contains("currentColor") && !svg.contains("#000000"),
                "{svg}"
            );
            assert!(
                svg.contains("act &amp; co") && svg.contains("a &lt; b"),
                "{svg}"
            );
            assert!(svg.contains("#D26A0C"), "{svg}");
        }
        let empty = Plot {
            series: Vec::new(),
            ..plot(false)
        };
        assert_eq!(empty.svg(), None);
    }

    #[test]
    fn numbers_on_axes_are_short() {
        let numbers = [0.0, 0.25, 50.0, 1500.0, 20_000.0, 0.0001];
        assert_eq!(
            numbers.map(short),
            ["0", "0.25", "50", "1500", "20k", "1e-4"]
        );
        assert_eq!(decades([0.02, 3.0].into_iter()), Some(0.01..10.0));
        assert_eq!(range([f64::NAN].into_iter()), None);
    }
}
