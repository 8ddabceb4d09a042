//! The verbs: arguments in, library calls, results out. `Ok(false)` means that the job failed.
//!
//! What takes more than a few lines has a module of its own beside this one (`eval`, `record`,
//! `train`, `replay` and others), whose functions have the same form; `main` calls each of them
//! once.

use std::path::Path;

use hal::config::Source;
use tch::Device;
use trocar::console::Console;
use trocar::doctor::{self, Probes};
use trocar::rt::{self, RtProfile};
use trocar::session::changes::{Change, Changes, ConfigFile};
use trocar::session::drives::DEFAULT_TOPICS;
use trocar::session::plan;
use trocar::session::realtime::{self, CanOptions, PolicyProcessOptions, RobotOptions, TopicArms};
use trocar::session::run::{RunResult, write_json};
use trocar::session::{Plan, PolicyChoice, Robot, SessionError, Setup, demo, operator, outputs};
use trocar_control::MeasuredClearance;
use trocar_data::dataset::VideoCodec;
use trocar_log::verify as verifying;
use trocar_nets::compute::{Arithmetic, Compute};
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::task::TaskConfig;

use crate::args::{
    Backend, ComputeArgs, ComputeDevice, DemoArgs, DoctorArgs, LogArgs, PolicyProcessArgs,
    Precision, RunArgs, VerifyArgs, Video,
};
use crate::black_box;
use crate::console;
use crate::drives::can_source;
use crate::run_report::{import_hint, last_words, nearest, report_run};
use crate::scene_args::Inputs;

/// How a verb ended: `Ok(true)` is exit code 0, `Ok(false)` 1. An error is said on standard error
/// and is 2 if `SessionError::is_bad_input`, else 1.
pub(crate) type Done = Result<bool, SessionError>;

/// The libtorch device of `--device`; CUDA is always the process' first one, which
/// `CUDA_VISIBLE_DEVICES` chooses.
///
/// # Errors
/// `BadArgument` for `cuda` where this libtorch has no CUDA or sees no device.
pub(crate) fn device(choice: ComputeDevice) -> Result<Device, SessionError> {
    match choice {
        ComputeDevice::Cpu => Ok(Device::Cpu),
        ComputeDevice::Cuda if tch::Cuda::is_available() => Ok(Device::Cuda(0)),
        ComputeDevice::Cuda => Err(SessionError::BadArgument(
            "--device cuda: this libtorch sees no CUDA device".to_owned(),
        )),
    }
}

/// Leaves a core to the control, if there are two. On a machine with one core the network has that
/// one.
///
/// # Errors
/// `BadArgument` for more threads than that, or a device that is not there.
pub(crate) fn compute(args: &ComputeArgs) -> Result<Compute, SessionError> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let most = cores.saturating_sub(1).max(1);
    if args.threads > most {
        return Err(SessionError::BadArgument(format!(
            "--threads {}: this machine has {cores} cores, of which the network can have 1 to {most}",
            args.threads
        )));
    }
    Ok(Compute {
        device: device(args.device)?,
        arithmetic: match args.precision {
            Precision::F32 => Arithmetic::F32,
            Precision::Bf16 => Arithmetic::Bf16,
        },
        threads: args.threads,
    })
}

/// The codec of `--video`, with which `ffmpeg` compresses a dataset's videos.
pub(crate) const fn codec(video: Video) -> VideoCodec {
    match video {
        Video::H264 => VideoCodec::H264,
        Video::Av1 => VideoCodec::Av1,
    }
}

/// The files that a task is configured by.
const TASK_FILES: [ConfigFile; 3] = [ConfigFile::Control, ConfigFile::Safety, ConfigFile::Scene];

/// `config/realtime.toml`, or `file` in its place, with `changes`. Changes to other files are left
/// alone: whoever calls this says which files may be changed.
///
/// # Errors
/// From reading the file, or of a change whose key it lacks.
pub(crate) fn realtime_source(
    file: Option<&Path>,
    changes: &Changes,
) -> Result<Source, SessionError> {
    let source = match file {
        Some(path) => Source::read(&path.display().to_string())?,
        None => RtProfile::shipped(),
    };
    Ok(changes.apply(ConfigFile::Realtime, source)?)
}

/// What is to be changed in a task's files.
///
/// # Errors
/// If one is of another file than the controller's, the limits or the scene.
pub(crate) fn task_changes(set: &[Change]) -> Result<Changes, SessionError> {
    let changes = Changes(set.to_owned());
    changes.only(&TASK_FILES)?;
    Ok(changes)
}

/// Says what is waited for if the policy is in another process. One line for each of `jobs`, since
/// each waits on topics of its own. Other policies say nothing.
pub(crate) fn note_awaited(policy: &PolicyChoice, jobs: usize) {
    if let PolicyChoice::External(choice) = policy {
        for index in 0..jobs {
            let choice = choice.of_job(index, jobs);
            let (topics, within_s) = (choice.topics(), choice.within_s);
            console::note(&format!(
                "trocar: waits for an external policy on topics {topics:?}, for {within_s} s at most"
            ));
        }
    }
}

/// Says so if the policy does another task than that of its demonstrations: that may be meant, so
/// that it is no error.
pub(crate) fn warn_of_transfer(setup: &Setup) {
    if let Some(reason) = setup.transfer_note() {
        console::warning(&reason);
    }
}

/// `trocar run`. Most options are checked before anything is opened; then the console listens, so
/// that a page may wait for the arms; then the rest is checked and the arms are brought up.
///
/// A page that is open hears of the end in either case: of the verdict, or of the error.
///
/// # Errors
/// Bad options; whatever ends the run; and of a run that ended well, a log that could not be
/// written, if `--log` asked for it.
pub(crate) fn run(args: &RunArgs) -> Done {
    if (args.latency_ms.is_some() || args.latency_jitter_ms > 0) && !args.lockstep {
        return Err(SessionError::BadArgument(
            "--latency-ms and --latency-jitter-ms need --lockstep: in real time a chunk comes when it comes"
                .to_owned(),
        ));
    }
    let inputs = Inputs::new([
        ("--config", args.config.as_ref()),
        ("--scene", args.scene.scene.as_ref()),
        ("--can-config", args.can_config.as_ref()),
        ("--safety", args.safety.as_ref()),
        ("--realtime", args.realtime.as_ref()),
    ]);
    let inputs = inputs.and_tasks(&args.task).and_policy(&args.policy);
    inputs.check(&[
        ("--log", args.log.as_deref()),
        ("--json", args.json.as_deref()),
    ])?;
    let remote = remote_arms(args)?;
    let changes = Changes(args.set.clone());
    let real_time = RtProfile::load(&realtime_source(args.realtime.as_deref(), &changes)?)?;
    let policy = args.external.policy(&args.policy)?;
    check_teleop(args, &policy)?;
    check_stereo(args)?;
    note_awaited(&policy, 1);
    let page = args.page.open(args.viewers.foxglove)?;
    let page = args.desk.take_hands(page)?;
    let chosen = Chosen {
        policy,
        compute: compute(&args.compute)?,
        real_time,
        page: page.clone(),
    };
    if let Some(reason) = operator::check().filter(|_| !args.lockstep) {
        console::warning(&format!("no operator's verb will reach this run: {reason}"));
    }
    let result = match (&args.task, &args.safety) {
        (Some(task), _) => run_task(task, args, chosen, remote),
        (None, Some(safety)) => run_robot(safety, args, chosen, remote),
        (None, None) => {
            let reason = "run needs --task NAME, or for a robot without one --backend can or topics and --safety FILE";
            Err(SessionError::BadArgument(reason.to_owned()))
        }
    };
    if let Some(page) = &page {
        match &result {
            Ok(result) => page.close(result.summary.success, &last_words(args, &result.summary)),
            Err(error) => page.close(Some(false), &error.to_string()),
        }
    }
    let result = result?;
    report_run(&result.summary);
    if let Some(hint) = import_hint(args, &result.summary) {
        console::result(&format!("  {hint}"));
    }
    if let Some(path) = &args.json {
        write_json(path, &result.summary)?;
    }
    match result.log_failure {
        // One that nobody asked for costs no run its exit code; what failed has been said.
        Some(error) if args.log.is_some() => Err(error.into()),
        _ => Ok(result.ok),
    }
}

/// A second eye is drawn here, where there is a simulator.
fn check_stereo(args: &RunArgs) -> Result<(), SessionError> {
    if args.headset.stereo && (args.backend != Backend::Sim || args.topics.is_some()) {
        let reason = "--stereo needs --backend sim without --topics: this run draws no cameras of arms outside of it, nor beside others'";
        return Err(SessionError::BadArgument(reason.to_owned()));
    }
    Ok(())
}

/// An operator's hands come over the console or from devices, in real time; those of devices may
/// take over from any policy.
///
/// # Errors
/// `BadArgument` with the option that can't be meant so: hands in virtual time, hands that come
/// from nowhere, or a robot of which it is not said in whose axes hands move.
fn check_teleop(args: &RunArgs, policy: &PolicyChoice) -> Result<(), SessionError> {
    let (teleop, at_desk) = (*policy == PolicyChoice::Teleop, args.desk.is_given());
    let hands = args.page.console.is_some() || at_desk;
    let option = if teleop { "--policy teleop" } else { "--hands" };
    let reason = if args.lockstep && (teleop || at_desk) {
        "--lockstep has virtual time, and a person moves in real time: leave it out"
    } else if teleop && !hands {
        "the operator's hands come over --console, or from --hands"
    } else if !teleop && at_desk && args.safety.is_some() && args.hands_view.is_empty() {
        "of a robot without a task it needs --hands-view ARM=X,Y,Z, the axes in which hands move each arm"
    } else {
        return Ok(());
    };
    Err(SessionError::BadArgument(format!("{option}: {reason}")))
}

/// What is read and checked of a run's arguments before its arms.
///
/// Both kinds of run, of a task and of a robot, have it.
struct Chosen {
    policy: PolicyChoice,
    compute: Compute,
    real_time: RtProfile,
    page: Option<Console>,
}

/// The plan of a run with the arms of `setup`. A log that nobody asked for (`black_box`) is
/// bounded, and has no frames of simulated cameras. A topics name of simulated arms is where
/// others' cameras are awaited; elsewhere it names the arms.
fn planned<S>(args: &RunArgs, setup: S, chosen: Chosen) -> Plan<S> {
    let log = black_box::log_of(args);
    Plan {
        seed: args.seed,
        log: log.path,
        log_bytes_max: log.bytes_max,
        log_opened: log.opened,
        cameras_on: args.topics.clone().filter(|_| args.backend == Backend::Sim),
        log_frames: args.log.is_some() || args.backend != Backend::Sim,
        latency_ms: args.latency_ms,
        latency_jitter_ms: args.latency_jitter_ms,
        compute: chosen.compute,
        real_time: chosen.real_time,
        console: chosen.page,
        warn: console::warning,
        ..Plan::new(setup, chosen.policy)
    }
}

/// A run of a task: in lockstep, or in real time with simulated arms or those of `remote`.
///
/// A person who teleoperates has longer than the task says, but not where the world is elsewhere:
/// that one ends the episode itself.
fn run_task(
    task: &str,
    args: &RunArgs,
    chosen: Chosen,
    remote: Option<RemoteArms>,
) -> Result<RunResult, SessionError> {
    let changes = Changes(args.set.clone());
    if args.lockstep {
        changes.only(&TASK_FILES)?;
    } else if !matches!(remote, Some(RemoteArms::Can(..))) {
        changes.only(&[
            ConfigFile::Control,
            ConfigFile::Safety,
            ConfigFile::Scene,
            ConfigFile::Realtime,
        ])?;
    }
    let scene = args.scene.options(args.cameras.as_deref());
    let config = args.config.as_deref();
    let setup = Setup::load_with(task, config, &chosen.policy, &scene, changes)?;
    let mut setup = args.headset.eyes(setup)?;
    warn_of_transfer(&setup);
    // A world elsewhere has its own time limit.
    if remote.is_none() {
        setup.task.time_limit_s *= chosen.policy.time_factor();
    }
    let backend = match remote {
        Some(RemoteArms::Can(can, text)) => {
            setup.robot.texts.can = Some(text);
            plan::Backend::Can(can)
        }
        Some(RemoteArms::Topics(arms)) => plan::Backend::Topics(arms),
        None if args.lockstep => {
            rt::catch_interrupts().map_err(SessionError::signals)?;
            plan::Backend::Lockstep
        }
        None => plan::Backend::RealTime,
    };
    planned(args, setup, chosen).run(&backend, &console::note)
}

/// A run of a robot without a task, whose limits are the file `safety`: it has no scene, no verdict
/// and no simulator, so that its arms are always `remote`. It ends by an operator, after
/// `--seconds`, or by a fault.
///
/// # Errors
/// `BadArgument` without arms, for the cameras of a task, or for hands that nothing moves.
fn run_robot(
    safety: &Path,
    args: &RunArgs,
    chosen: Chosen,
    remote: Option<RemoteArms>,
) -> Result<RunResult, SessionError> {
    let Some(remote) = remote else {
        let reason = "--safety needs --backend can or topics: the simulator runs tasks";
        return Err(SessionError::BadArgument(reason.to_owned()));
    };
    if let Some(word @ ("single" | "multi")) = args.cameras.as_deref() {
        return Err(SessionError::BadArgument(format!(
            "--cameras {word} is of a task's cameras; with --safety name those on the topics"
        )));
    }
    let changes = Changes(args.set.clone());
    let mut files = vec![ConfigFile::Control, ConfigFile::Safety];
    if matches!(remote, RemoteArms::Can(..)) {
        files.push(ConfigFile::Can);
    }
    files.push(ConfigFile::Realtime);
    changes.only(&files)?;
    let mut robot = Robot::load(safety, args.config.as_deref(), &chosen.policy, &changes)?;
    if !args.hands_view.is_empty() {
        if chosen.page.is_none() {
            let reason =
                "--hands-view needs --console, or --hands: there are no hands to move the arms";
            return Err(SessionError::BadArgument(reason.to_owned()));
        }
        robot = robot.moved_in(&args.hands_view)?;
    }
    let cameras = args.cameras.iter().flat_map(|names| names.split(','));
    let asked = RobotOptions {
        seconds: args.seconds,
        cameras: cameras.map(str::to_owned).collect(),
    };
    match remote {
        RemoteArms::Can(can, text) => {
            robot.texts.can = Some(text);
            let plan = planned(args, robot, chosen);
            realtime::run_robot_on_can(&plan, &asked, &can, &console::note)
        }
        RemoteArms::Topics(arms) => {
            let plan = planned(args, robot, chosen);
            realtime::run_robot_on_topics(&plan, &asked, &arms, &console::note)
        }
    }
}

/// Arms outside of this process.
enum RemoteArms {
    /// On CAN, with the text that says where they are.
    Can(CanOptions, String),
    /// On topics.
    Topics(TopicArms),
}

/// Where the arms are, if they are not simulated here.
///
/// # Errors
/// `BadArgument` if the backend does not go with `--lockstep` or `--can-config`; what is wrong with
/// the CAN configuration.
fn remote_arms(args: &RunArgs) -> Result<Option<RemoteArms>, SessionError> {
    let wrong = |reason: &str| Err(SessionError::BadArgument(reason.to_owned()));
    let topics = args.topics.as_deref().unwrap_or(DEFAULT_TOPICS);
    match args.backend {
        Backend::Sim | Backend::Topics if args.can_config.is_some() => {
            wrong("--can-config needs --backend can")
        }
        Backend::Can if args.lockstep => {
            wrong("--lockstep needs --backend sim: drives on a bus have a time of their own")
        }
        Backend::Topics if args.lockstep => wrong(
            "--lockstep needs --backend sim: arms of another process have a time of their own",
        ),
        Backend::Sim => Ok(None),
        Backend::Can => {
            let source = can_source(args.can_config.as_ref())?;
            let source = Changes(args.set.clone()).apply(ConfigFile::Can, source)?;
            let (can, text) = CanOptions::load(&source, topics)?;
            Ok(Some(RemoteArms::Can(can, text)))
        }
        Backend::Topics => Ok(Some(RemoteArms::Topics(TopicArms {
            topics: topics.to_owned(),
        }))),
    }
}

/// `trocar verify`: checks every logged command against the limits, by the code of `trocar-verify`,
/// which shares none with the controller.
///
/// At most ten violations are printed; the JSON has all. A log whose bound left ticks out is
/// `partial`: that fails unless `--part` says that a part will do.
///
/// # Errors
/// A log that can't be read, or one that was cut off, unless `--part` takes what there is of it.
pub(crate) fn verify(VerifyArgs { log: args, part }: &VerifyArgs) -> Done {
    check_result(args)?;
    forget_result(args)?;
    let result = verifying::verify_file::<SessionError>(&args.file)?;
    let sound = result.bounded && result.violation_count == 0;
    let part = *part && sound;
    let verdict = match (result.ok, part, sound) {
        (true, ..) => "ok",
        (false, true, _) => "ok, as far as the log's bound kept it",
        (false, false, true) => "partial, no violations",
        (false, false, false) => "not ok",
    };
    console::result(&format!(
        "{verdict}: {} ticks, {} violations",
        result.ticks, result.violation_count
    ));
    let measured = result.measured.iter().map(|nearest| MeasuredClearance {
        arm: nearest.arm.clone(),
        boundary: nearest.boundary.clone(),
        part: nearest.part.clone(),
        clearance_m: nearest.clearance_m,
        ticks_beyond: nearest.ticks_beyond,
    });
    console::result(&format!("  {}", nearest(&measured.collect::<Vec<_>>())));
    for violation in result.violations.iter().take(10) {
        console::result(&format!("  {violation}"));
    }
    if let Some(path) = &args.json {
        write_json(path, &result)?;
    }
    if !part {
        refuse_cut(result.cut.as_deref(), args)?;
    }
    Ok(result.ok || part)
}

/// The result must not take the place of the log.
///
/// # Errors
/// `BadArgument` if `--json` names the log itself, also by another path, or can't be written.
pub(crate) fn check_result(args: &LogArgs) -> Result<(), SessionError> {
    let log = ("the log", Some(args.file.as_path()));
    outputs::check(&[("--json", args.json.as_deref())], &[log])
}

/// A result of before must not be taken for that of a log that can't be read.
///
/// # Errors
/// `BadArgument` if the file can't be removed. One that is not there is no error.
pub(crate) fn forget_result(args: &LogArgs) -> Result<(), SessionError> {
    let Some(path) = args.json.as_deref().filter(|path| path.is_file()) else {
        return Ok(());
    };
    let gone = std::fs::remove_file(path);
    gone.map_err(|error| SessionError::BadArgument(format!("--json {}: {error}", path.display())))
}

/// An incomplete log is bad input, even though what is there was used. `cut` says where it ends and
/// why; `None` passes.
pub(crate) fn refuse_cut(cut: Option<&str>, args: &LogArgs) -> Result<(), SessionError> {
    let Some(reason) = cut else {
        return Ok(());
    };
    Err(SessionError::CutLog {
        path: args.file.display().to_string(),
        reason: reason.to_owned(),
    })
}

/// The device that the renderer really opens. It makes the cameras of a small task for that, since
/// a device may be listed and still refuse.
fn graphics() -> Result<String, String> {
    let task = TaskConfig::built_in("needle-lift").map_err(|error| error.to_string())?;
    let cameras = SceneCameras::new(&task).map_err(|error| error.to_string())?;
    Ok(cameras.adapter_name().to_owned())
}

/// The network library that this program is linked with, and its accelerators.
#[expect(
    clippy::unnecessary_wraps,
    reason = "a probe may fail; this one can't be here if it did"
)]
fn networks() -> Result<String, String> {
    let version = trocar::session::run::LIBTORCH_VERSION;
    Ok(format!(
        "libtorch {version}, {} CUDA devices",
        tch::Cuda::device_count()
    ))
}

/// `trocar doctor`: what the machine offers. The renderer and the network library are asked by
/// probes, which the module `doctor` calls. The exit code is 0 whatever is found.
pub(crate) fn doctor(args: &DoctorArgs) -> Done {
    let findings = doctor::examine(&Probes {
        graphics: &graphics,
        networks: &networks,
    });
    console::result(doctor::table(&findings).trim_end());
    if let Some(path) = &args.json {
        write_json(path, &findings)?;
    }
    Ok(true)
}

/// `trocar demo`: one task in lockstep and in real time, both replayed and verified, with images of
/// the first.
pub(crate) fn demo(args: &DemoArgs) -> Done {
    let plan = demo::plan(&args.task, args.policy.as_deref(), args.seed)?;
    let result = demo::run(&plan, &args.out, &mut |line| console::note(line))?;
    for (name, shown) in [
        ("lockstep", &result.lockstep),
        ("real time", &result.real_time),
    ] {
        console::result(&format!("\n{name}:"));
        report_run(&shown.summary);
        console::result(&format!(
            "  log: replay {}, verify found {} violations in {} ticks",
            if shown.replayed.identical {
                "identical"
            } else {
                "differs"
            },
            shown.verified.violations.len(),
            shown.verified.ticks
        ));
    }
    console::result("");
    for file in &result.files {
        console::result(&format!("wrote {}", file.display()));
    }
    // The real-time run depends on the machine and is reported as it went; the lockstep run must
    // succeed.
    let sound = [&result.lockstep, &result.real_time]
        .iter()
        .all(|shown| shown.replayed.identical && shown.verified.ok);
    Ok(result.lockstep.summary.success == Some(true) && sound)
}

/// The hidden verb of a run in real time's own child, which holds the network: see
/// `session/realtime`. It ends when its parent does.
pub(crate) fn policy_process(args: &PolicyProcessArgs) -> Done {
    realtime::serve_policy(&PolicyProcessOptions {
        run_id: args.run_id.clone(),
        policy: args.policy.clone(),
        compute: compute(&args.compute)?,
        frames_within_ms: args.frames_within_ms,
        parent: args.parent_pid,
    })?;
    Ok(true)
}
