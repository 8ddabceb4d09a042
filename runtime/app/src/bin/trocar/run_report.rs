//! How a run went, on the terminal. Every verb that runs something says it in these lines; scripts
//! read `--json` instead.

use trocar::session::summary::{CanArmSummary, CanBusSummary, RealTimeCounts, RunSummary};
use trocar::session::teleop::TeleopSummary;
use trocar_control::MeasuredClearance;
use trocar_log::RunMark;

use crate::args::RunArgs;
use crate::console;

/// Says how a run went, on the terminal. The lines of teleoperation, of real time and of each CAN
/// arm come only where the run had that. The command hash is last: two lockstep runs are the same
/// if theirs is.
pub(crate) fn report_run(summary: &RunSummary) {
    let verdict = match summary.success {
        Some(true) => format!("{}: success", summary.task),
        Some(false) => format!("{}: failure ({})", summary.task, summary.reason),
        None => summary.reason.clone(),
    };
    let said = summary.said.clause();
    console::result(&format!("{verdict} after {:.2} s{said}", summary.seconds));
    console::result(&format!(
        "  controller tick: p50 {:.1} us, p99 {:.1} us, max {:.1} us over {} ticks",
        summary.tick_us.p50, summary.tick_us.p99, summary.tick_us.max, summary.ticks
    ));
    console::result(&format!(
        "  safety QP: passed {}, solved {}, failed {}; guard interventions: {}",
        summary.qp.passed, summary.qp.solved, summary.qp.failed, summary.guard_interventions
    ));
    console::result(&format!("  {}", nearest(&summary.measured_clearance)));
    console::result(&format!(
        "  policy: {} queries, {} refused chunks, observation to chunk p50 {:.1} ms, p99 {:.1} ms, inference p50 {:.1} ms",
        summary.policy.queries,
        summary.policy.refused,
        summary.policy.latency_ms.p50,
        summary.policy.latency_ms.p99,
        summary.policy.inference_ms.p50,
    ));
    if let Some(teleop) = &summary.teleop {
        report_teleop(teleop);
    }
    if let Some(real_time) = &summary.real_time {
        report_real_time(real_time);
    }
    for arm in summary.can.iter().flat_map(|can| &can.arms) {
        report_can(arm);
    }
    console::result(&format!("  command hash: {}", summary.command_hash));
}

/// What the pages of a run are told last.
pub(crate) fn last_words(args: &RunArgs, summary: &RunSummary) -> String {
    let hint = import_hint(args, summary);
    let hint = hint.map_or_else(String::new, |hint| format!("; {hint}"));
    format!("{}{}{hint}", summary.reason, summary.said.clause())
}

/// Where the log of a robot's run is that was asked for, and what makes a dataset of it; only the
/// first of a log that makes none.
pub(crate) fn import_hint(args: &RunArgs, summary: &RunSummary) -> Option<String> {
    let log = args.log.as_ref().filter(|_| args.task.is_none())?;
    let shown = log.display();
    let is_whole = args.log_max_mb.is_none() && summary.said.mark != Some(RunMark::Discard);
    if !is_whole {
        return Some(format!("log: {shown}"));
    }
    let failed = summary.said.mark == Some(RunMark::Failure);
    let failures = if failed { " --failures" } else { "" };
    let has_spaces = log.to_string_lossy().contains(char::is_whitespace);
    let quote = if has_spaces { "'" } else { "" };
    Some(format!(
        "log: {shown}; if it has camera frames, `trocar import log {quote}{shown}{quote}{failures} --task TEXT --out DIR` makes a dataset of it"
    ))
}

/// Of one arm: how much of each bus' bit rate its schedule takes, in percent with one decimal, and
/// what was missed, late or rejected; then warnings of its buses and of itself.
fn report_can(arm: &CanArmSummary) {
    let buses: Vec<String> = arm
        .buses
        .iter()
        .map(|bus| {
            format!(
                "{} {}.{} %",
                bus.interface,
                bus.planned_per_mille / 10,
                bus.planned_per_mille % 10
            )
        })
        .collect();
    console::result(&format!(
        "  {} on {}: {} answers missed, {} late, {} rejected, {} commands refused",
        arm.arm,
        buses.join(", "),
        arm.answers_missed,
        arm.answers_late,
        arm.answers_rejected,
        arm.commands_refused
    ));
    for warning in arm.buses.iter().filter_map(CanBusSummary::warning) {
        console::warning(&format!("{} on {warning}", arm.arm));
    }
    if let Some(warning) = arm.warning() {
        console::warning(&warning);
    }
}

/// How often hands engaged and were made to let go, and both latencies as far as they were
/// measured.
fn report_teleop(teleop: &TeleopSummary) {
    let latency = teleop.hand_to_command_ms.map_or_else(
        || "no hand was followed".to_owned(),
        |ms| format!("hand to command p50 {:.1} ms, p99 {:.1} ms", ms.p50, ms.p99),
    );
    let pictures = teleop.camera_to_page_ms.map_or_else(String::new, |ms| {
        format!(
            ", camera to page p50 {:.1} ms, p99 {:.1} ms",
            ms.p50, ms.p99
        )
    });
    console::result(&format!(
        "  teleoperation: {} engagements, {} released by force, {latency}{pictures}",
        teleop.engagements, teleop.forced_releases
    ));
}

/// What the operating system did to the control thread: skipped periods, wake-up latency, and what
/// must be zero in a sound run, allocations and page faults.
fn report_real_time(real_time: &RealTimeCounts) {
    let (wake, thread) = (&real_time.wake_us, &real_time.thread);
    console::result(&format!(
        "  real time: {} skipped periods, wake-up p50 {:.0} us, p99 {:.0} us, max {:.0} us, {} log records dropped",
        real_time.overruns, wake.p50, wake.p99, wake.max, real_time.log_dropped
    ));
    console::result(&format!(
        "  control thread: {} allocations, {} page faults ({} from disk), {} involuntary context switches; {}",
        thread.allocations,
        thread.faults.minor + thread.faults.major,
        thread.faults.major,
        thread.faults.involuntary_switches,
        thread.granted
    ));
}

/// What the measured arms came nearest to, and how long they were beyond anything. Clearance is the
/// distance to a limit, m, negative beyond it; `total_cmp` puts a NaN last.
pub(crate) fn nearest(measured: &[MeasuredClearance]) -> String {
    let least = measured
        .iter()
        .min_by(|one, other| one.clearance_m.total_cmp(&other.clearance_m));
    let Some(least) = least else {
        return "measured clearance: no arm held torque".to_owned();
    };
    let beyond: Vec<String> = measured
        .iter()
        .filter(|nearest| nearest.ticks_beyond > 0)
        .map(|nearest| {
            let MeasuredClearance {
                arm,
                boundary,
                ticks_beyond,
                ..
            } = nearest;
            format!("; {arm} was beyond {boundary} in {ticks_beyond} ticks")
        })
        .collect();
    format!(
        "measured clearance: {:.2} mm at least, {} of {} ({}){}",
        1e3 * least.clearance_m,
        least.boundary,
        least.arm,
        least.part,
        beyond.concat()
    )
}
