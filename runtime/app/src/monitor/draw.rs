//! The screen: arms and joints above, filter and control loop below, keys in the last line. Lines
//! of `ratatui`, made anew each time from what the run last said; what does not fit is cut off.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};

use super::Screen;
use super::seen::{Arm, Axis, State};
use super::timing::draw_loop;
use super::tone::{BAD, GOOD, HEAD, QUIET, WARN};

/// Cells of a joint's range; an odd number, so that its middle has one.
const RANGE: usize = 17;

/// A correction that is older says nothing of now, s. Then it is grey, or not shown.
const FRESH_S: f64 = 0.3;

/// Draws all of it.
pub(super) fn screen(frame: &mut Frame<'_>, screen: &Screen) {
    let arms = screen.state.as_ref().map_or(0, |state| state.arms.len());
    let joints = arms * (1 + screen.facts.axes.len());
    let rows = [
        Constraint::Length(1),
        Constraint::Length(u16::try_from(joints).unwrap_or(u16::MAX)),
        Constraint::Min(5),
        Constraint::Length(1),
        Constraint::Length(1),
    ];
    let [title, above, below, answer, keys] = Layout::vertical(rows).areas(frame.area());
    frame.render_widget(title_line(screen), title);
    if let Some(state) = &screen.state {
        frame.render_widget(Paragraph::new(joint_lines(screen, state)), above);
        let halves = [Constraint::Percentage(50), Constraint::Percentage(50)];
        let [left, right] = Layout::horizontal(halves).spacing(1).areas(below);
        let lines = Paragraph::new(safety_lines(state)).wrap(Wrap { trim: false });
        frame.render_widget(lines, left);
        draw_loop(frame, right, (screen, state));
    } else {
        frame.render_widget(
            Line::styled("The control loop has not begun.", QUIET),
            above,
        );
    }
    let tone = if screen.answer.refused { BAD } else { HEAD };
    frame.render_widget(Line::styled(screen.answer.text.as_str(), tone), answer);
    frame.render_widget(key_line(screen.note().is_some()), keys);
}

/// Task or robot, policy, seed, time, speed, and that the control loop says nothing new, in red.
fn title_line(screen: &Screen) -> Line<'_> {
    let facts = &screen.facts;
    let mut spans = vec![
        Span::styled("Trocar ", HEAD),
        Span::raw(format!(
            "{}, policy {}, seed {}",
            facts.title, facts.policy, facts.seed
        )),
    ];
    if let Some(state) = &screen.state {
        let limit = facts.time_limit_s;
        let limit = limit.map_or(String::new(), |limit| format!(" of {limit} s"));
        spans.push(Span::styled(
            format!("  {:.2} s{limit}", state.seconds),
            HEAD,
        ));
        let speed = format!("  speed {} %", state.speed_percent);
        let style = if state.speed_percent < 100 {
            WARN
        } else {
            QUIET
        };
        spans.push(Span::styled(speed, style));
        if state.silent_s > FRESH_S {
            let silent = format!("  loop silent for {:.1} s", state.silent_s);
            spans.push(Span::styled(silent, BAD));
        }
    }
    Line::from(spans)
}

/// For each arm a line of its state and one for each axis. The filter's change of an axis stands
/// beside it only while it is fresh.
fn joint_lines<'a>(screen: &'a Screen, state: &'a State) -> Vec<Line<'a>> {
    let axes = &screen.facts.axes;
    let mut lines = Vec::new();
    for (index, arm) in state.arms.iter().enumerate() {
        lines.push(arm_line(arm));
        let fresh = state.filter.ago_s.is_some_and(|ago_s| ago_s < FRESH_S);
        for (place, axis) in axes.iter().enumerate() {
            let change = state.filter.change.get(index * axes.len() + place);
            let change = change.copied().filter(|_| fresh);
            lines.push(axis_line(axis, arm, place, change));
        }
    }
    lines
}

/// Operating state, homing, motion; a fault, or why nothing was measured, in red behind them.
fn arm_line(arm: &Arm) -> Line<'_> {
    let style = match arm.state.as_str() {
        "ENABLED" => GOOD,
        "FAULT" => BAD,
        "PAUSED" => WARN,
        _ => QUIET,
    };
    let homed = if arm.homed { "homed" } else { "not homed" };
    let moves = if arm.busy { "moving" } else { "at rest" };
    let follows = if arm.follows { ", follows a chunk" } else { "" };
    let mut spans = vec![
        Span::styled(format!("{} ", arm.name), HEAD),
        Span::styled(arm.state.as_str(), style),
        Span::styled(format!(" {homed}, {moves}{follows}"), QUIET),
    ];
    for trouble in [&arm.fault, &arm.error].into_iter().flatten() {
        spans.push(Span::styled(format!("  {trouble}"), BAD));
    }
    Line::from(spans)
}

/// Name, range with measured and commanded position, both in numbers, commanded velocity, and what
/// the filter changed of it, in limits. The range is yellow within 3 % of an end, the velocity
/// above 97 % of its limit.
fn axis_line(axis: &Axis, arm: &Arm, place: usize, change: Option<f64>) -> Line<'static> {
    let measured = arm.measured.as_ref().and_then(|all| all.get(place));
    let commanded = arm.commanded.get(place).copied().unwrap_or_default();
    let velocity = arm
        .commanded_velocity
        .get(place)
        .copied()
        .unwrap_or_default();
    let share = velocity / axis.velocity;
    let near = (commanded - axis.low).min(axis.high - commanded) < 0.03 * (axis.high - axis.low);
    let change = match change {
        Some(change) if change.abs() >= 0.005 => format!("filter {:+.0} %", 100.0 * change),
        Some(_) | None => String::new(),
    };
    Line::from(vec![
        Span::raw(format!("  {:<12}", axis.name.replace('_', " "))),
        Span::styled(
            range(axis, measured.copied(), commanded),
            if near { WARN } else { QUIET },
        ),
        Span::raw(format!(
            " {:>10}",
            measured.map_or_else(|| "not known".to_owned(), |at| number(axis, *at))
        )),
        Span::styled(format!(" → {:>10}", number(axis, commanded)), QUIET),
        Span::styled(
            // Without the sign of a zero.
            format!("  v {:>4.0} %", (100.0 * share).round() + 0.0),
            if share.abs() > 0.97 { WARN } else { QUIET },
        ),
        Span::styled(format!(" {change}"), WARN),
    ])
}

/// A joint's limits as brackets, where it is (`●`) and where it is commanded to be (`|`) between
/// them. A value beyond the limits stands at the bracket; the measured one covers the commanded
/// one.
fn range(axis: &Axis, measured: Option<f64>, commanded: f64) -> String {
    let mut cells = vec!['·'; RANGE];
    let mut put = |value: f64, mark: char| {
        let share = ((value - axis.low) / (axis.high - axis.low)).clamp(0.0, 1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a cell of a few"
        )]
        let cell = (share * (RANGE - 1) as f64).round() as usize;
        if let Some(place) = cells.get_mut(cell) {
            *place = mark;
        }
    };
    put(commanded, '|');
    if let Some(measured) = measured {
        put(measured, '●');
    }
    let cells: String = cells.into_iter().collect();
    format!("[{cells}]")
}

/// In mm or degrees with two decimals: people read these, configuration has m and rad.
fn number(axis: &Axis, value: f64) -> String {
    if axis.unit == "m" {
        format!("{:.2} mm", 1000.0 * value)
    } else {
        format!("{:.2}°", value.to_degrees())
    }
}

/// Counts since the run began of filter, guard and gate, the last refusal's reason, what the task
/// still lacks, and the run's mark. Failures, interventions and refusals are green while there are
/// none, then failures red and the others yellow.
fn safety_lines(state: &State) -> Vec<Line<'_>> {
    let counts = &state.counts;
    let tone = |count: u64, style| if count > 0 { style } else { GOOD };
    let guard = counts
        .guard_ago_s
        .map_or(String::new(), |ago_s| format!(", last {ago_s:.1} s ago"));
    let refusal = match &counts.last_refused {
        Some(reason) => format!("{} refused, {reason}", counts.refused),
        None => "none refused".to_owned(),
    };
    let mut lines = vec![
        Line::from(vec![
            Span::raw(format!("filter  {} passed, ", counts.passed)),
            Span::raw(format!("QP {}, ", counts.solved)),
            Span::styled(
                format!("failed {}", counts.failed),
                tone(counts.failed, BAD),
            ),
        ]),
        Line::from(vec![
            Span::raw("guard   "),
            Span::styled(format!("{}{guard}", counts.guard), tone(counts.guard, WARN)),
        ]),
        Line::from(vec![
            Span::raw(format!("gate    {} chunks, ", counts.chunks)),
            Span::styled(refusal, tone(counts.refused, WARN)),
        ]),
        rows_line(state),
    ];
    if let Some(task) = &state.task {
        lines.push(Line::raw(format!("task    {task}")));
    }
    if let Some(said) = &state.said {
        lines.push(Line::raw(format!("run     {said}")));
    }
    lines
}

/// The rows that held the filter's last correction.
fn rows_line(state: &State) -> Line<'_> {
    let filter = &state.filter;
    let Some(ago_s) = filter.ago_s else {
        return Line::styled("rows    none yet", QUIET);
    };
    let more = match filter.more {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let style = if ago_s < FRESH_S { WARN } else { QUIET };
    let rows = filter.rows.join(", ");
    Line::styled(format!("rows    {rows}{more} ({ago_s:.1} s ago)"), style)
}

/// The keys and what they do; `monitor`'s `wish` is what they really do. Where the run takes a mark,
/// the marks stand in place of `enable` and `clear`: such a run refuses both.
fn key_line(takes_mark: bool) -> Line<'static> {
    const FIRST: [(&str, &str); 2] = [("p", "pause"), ("r", "resume")];
    const STATES: [(&str, &str); 3] = [("e", "enable"), ("d", "disable"), ("c", "clear")];
    const MARKS: [(&str, &str); 4] = [
        ("d", "disable"),
        ("y", "success"),
        ("z", "failure"),
        ("x", "discard"),
    ];
    const LAST: [(&str, &str); 3] = [
        ("-+", "speed"),
        ("q", "quit"),
        ("s", "stop (no emergency stop)"),
    ];
    let between = if takes_mark { &MARKS[..] } else { &STATES };
    let keys = FIRST.iter().chain(between).chain(&LAST);
    let key = |&(key, does): &(&'static str, &'static str)| {
        let key = Span::styled(key, Style::new().add_modifier(Modifier::REVERSED));
        [key, Span::raw(format!(" {does} "))]
    };
    Line::from_iter(keys.flat_map(key))
}
