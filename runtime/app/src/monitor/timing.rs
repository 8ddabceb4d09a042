//! The control loop: durations in numbers and as bars, and the buses.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::Line;
use ratatui::widgets::{Paragraph, Sparkline};

use super::Screen;
use super::seen::{Histogram, State};
use super::tone::{GOOD, WARN};
use crate::rig::can_traffic::Bus;

/// Draws it into `area`; bars only where there is room. What is computed in a tick, how late its
/// thread wakes, how old observations are when their chunk comes; then frames a second and errors
/// on the CAN interfaces.
pub(super) fn draw_loop(frame: &mut Frame<'_>, area: Rect, (screen, state): (&Screen, &State)) {
    let ends_us = &screen.facts.buckets_us;
    let buses = u16::try_from(screen.buses.all.len()).unwrap_or(u16::MAX);
    let bars = u16::from(area.height >= 7 + buses);
    let rows = [
        Constraint::Length(1),
        Constraint::Length(bars),
        Constraint::Length(1),
        Constraint::Length(bars),
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(buses),
        Constraint::Min(0),
    ];
    let [
        compute,
        compute_bars,
        wake,
        wake_bars,
        latency,
        overruns,
        can,
        _,
    ] = Layout::vertical(rows).areas(area);
    let timing = &state.timing;
    frame.render_widget(Line::raw(words("tick", &timing.compute, ends_us)), compute);
    draw_bars(frame, compute_bars, &timing.compute);
    frame.render_widget(Line::raw(words("wake-up", &timing.wake, ends_us)), wake);
    draw_bars(frame, wake_bars, &timing.wake);
    frame.render_widget(Line::raw(words("chunk", &state.latency, ends_us)), latency);
    let text = format!(
        "loop    {} ticks, {} overruns",
        state.counts.ticks, timing.overruns
    );
    let style = if timing.overruns > 0 {
        WARN
    } else {
        Style::new()
    };
    frame.render_widget(Line::styled(text, style), overruns);
    let lines: Vec<Line<'_>> = screen.buses.all.iter().map(bus_line).collect();
    frame.render_widget(Paragraph::new(lines), can);
}

fn bus_line(bus: &Bus) -> Line<'_> {
    let (name, rate, errors) = (&bus.name, bus.frames_per_s(), bus.errors);
    let style = if errors > 0 { WARN } else { Style::new() };
    let text = format!("{name:<7} {rate:.0} frames/s, {errors} errors and drops");
    Line::styled(text, style)
}

/// Durations of what `name` is in numbers. The median is a bucket's upper end, therefore `≤`; a
/// dash where none was counted.
fn words(name: &str, histogram: &Histogram, ends_us: &[u64]) -> String {
    let Some(median) = histogram.median_us(ends_us) else {
        return format!("{name:<7} –");
    };
    #[expect(clippy::cast_precision_loss, reason = "microseconds of a bucket")]
    let median = micro(median as f64);
    let max = micro(histogram.max_us);
    format!("{name:<7} p50 ≤ {median}, max {max}")
}

/// Milliseconds from 1000 us on.
fn micro(us: f64) -> String {
    if us >= 1000.0 {
        format!("{:.1} ms", us / 1000.0)
    } else {
        format!("{us:.0} µs")
    }
}

/// A bar a bucket; roots make the rare ones visible. From the shortest bucket on the left to what
/// is beyond all ends.
fn draw_bars(frame: &mut Frame<'_>, area: Rect, histogram: &Histogram) {
    let roots = histogram.counts.iter().map(|count| count.isqrt());
    frame.render_widget(Sparkline::default().data(roots).style(GOOD), area);
}
