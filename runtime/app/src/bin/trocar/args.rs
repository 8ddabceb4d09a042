//! The command line as it is typed; nothing is read or checked beyond its form.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use clap::builder::{
    PossibleValue, RangedI64ValueParser, RangedU64ValueParser, StringValueParser, TypedValueParser,
};
use clap::{Arg, Args, Command, Parser, Subcommand, ValueEnum};

use trocar::session::changes::Change;
use trocar::session::{HandsView, tasks};

use crate::about::{CompletionsArgs, ConfigVerb, ManArgs};
use crate::anatomy::AnatomyVerb;
use crate::cameras::CamerasArgs;
use crate::drives::DrivesArgs;
use crate::environment::EnvironmentArgs;
use crate::eval::EvalArgs;
use crate::export::ExportVerb;
use crate::import::ImportVerb;
use crate::operator::{MarkArgs, MonitorArgs, OperatorArgs, SpeedArgs};
use crate::page::{DeskArgs, FoxgloveArgs, HeadsetArgs, PageArgs};
use crate::policy::{ExternalArgs, PolicyArgs};
use crate::record::RecordArgs;
use crate::scene_args::SceneArgs;
use crate::sheet::SheetArgs;
use crate::simulator::SimulatorArgs;
use crate::study::{ReportArgs, StudyArgs};
use crate::train_args::TrainArgs;

/// A count that is not 0.
pub(crate) fn count() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..)
}

/// A number of threads.
pub(crate) fn threads() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..=1024)
}

/// A number from `low` to `high`.
pub(crate) fn between(text: &str, low: f64, high: f64) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if (low..=high).contains(&value) => Ok(value),
        _ => Err(format!("expected a number in [{low}, {high}]")),
    }
}

/// A number from 0 to 1.
pub(crate) fn share(text: &str) -> Result<f64, String> {
    between(text, 0.0, 1.0)
}

/// A delay in ms.
pub(crate) fn delay() -> RangedU64ValueParser<u64> {
    RangedU64ValueParser::new().range(0..=10_000)
}

/// A side of an image, pixels.
pub(crate) fn pixels() -> RangedI64ValueParser<u32> {
    RangedI64ValueParser::new().range(16..=2048)
}

/// A time-out in s.
pub(crate) fn within() -> RangedU64ValueParser<u64> {
    RangedU64ValueParser::new().range(1..=86_400)
}

/// A time in s.
fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.1..=86_400.0).contains(&seconds) => Ok(seconds),
        _ => Err("expected a number in [0.1, 86400]".to_owned()),
    }
}

/// A share that is not 0.
pub(crate) fn share_above_0(text: &str) -> Result<f64, String> {
    let share: Option<f64> = text.parse().ok();
    let share = share.filter(|share| *share > 0.0 && *share <= 1.0);
    share.ok_or_else(|| "a share is a number above 0, up to 1".to_owned())
}

/// Runs learned policies on a surgical robot arm, safely and in real time.
#[derive(Debug, Parser)]
#[command(
    name = "trocar",
    version,
    after_help = "Examples:\n  trocar run --task needle-lift --policy expert --lockstep\n  trocar eval --task needle-lift --policy config/policies/needle-lift/act-compact --trials 50"
)]
pub(crate) struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub(crate) verb: Verb,
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub(crate) enum Verb {
    /// Run one episode of a task, in real time or in lockstep, or a robot without one.
    #[command(
        after_help = "Example: trocar run --task needle-lift --policy expert --lockstep --seed 7 --log runs/a.mcap\n         trocar run --backend can --safety limits.toml --policy runs/act --topics cameras --seconds 30 --log runs/robot.mcap\n         trocar run --task needle-lift --policy random --console"
    )]
    Run(RunArgs),
    /// Run many seeded trials in lockstep and report the success rate.
    #[command(
        after_help = "Example: trocar eval --task needle-lift --policy expert --trials 50 --jobs 2\n         trocar eval --task needle-lift --policy runs/act --needle N3 --view view1 --json runs/eval.json\n         trocar eval --task needle-lift --policy runs/act --min-rate 0.95 --keep failures runs/lost\n\nCtrl-C (SIGINT), SIGTERM and SIGHUP abandon the trials in progress; what was done is written (\"interrupted\": true), and the exit code is 1. A second one ends the program at once. Otherwise the exit code is 0 once all trials are done, whatever the rate, unless --min-rate or --min-wilson asks for more."
    )]
    Eval(EvalArgs),
    /// Run a checkpoint in a process of its own, for sessions with `--policy external:NAME`.
    #[command(
        after_help = "Example: trocar policy --policy config/policies/needle-lift/act-compact --name lab\n         trocar run --task needle-lift --policy external:lab --set control.aggregation.mode=newest\n\nIt answers one session after another, in lockstep or in real time, those that began before it too. A run with --set control.policy.restarts=1 holds its arms when it ends, and goes on once it was started again. Ctrl-C ends it."
    )]
    Policy(PolicyArgs),
    /// Draw a task's cameras in a process of their own; `run` starts one itself unless its frames
    /// come from --topics.
    #[command(
        after_help = "Example: trocar cameras --task needle-lift --topics lab\n         trocar run --task needle-lift --policy config/policies/needle-lift/act-compact --topics lab\n\nWith --topics a run draws nothing: its policy sees what any process publishes there under its cameras' names. This one draws the run's own scene, of any seed, for one run after another; task, --scene, --needle, --view and --set must be the run's. A run with --set control.policy.restarts=1 holds its arms when the frames stop, and goes on when they come again. Ctrl-C ends it."
    )]
    Cameras(CamerasArgs),
    /// Record demonstrations as a LeRobot v3 dataset.
    #[command(
        after_help = "Example: trocar record --task needle-lift --episodes 50 --source expert --cameras multi --out runs/demos\n         trocar record --task needle-lift --episodes 50 --source simulated-operator --out runs/by-hand\n         trocar record --task needle-lift --episodes 200 --disturb 0.5 --vary needles,views,light --jobs 2 --out runs/varied\n         trocar record --task needle-lift --episodes 100 --source expert --cameras multi --out runs/demos --resume\n\nCtrl-C (SIGINT), SIGTERM and SIGHUP abandon the episodes in progress; what was recorded is a dataset, and the exit code is 1. A second one ends the program at once. The same command with --resume goes on, also after a crash or a full disk, and comes to the same dataset as without the break."
    )]
    Record(RecordArgs),
    /// Make a LeRobot v3 dataset of demonstrations of others: HDF5 of ACT or robomimic, LeRobot
    /// datasets, a dVRK's folders; or of run logs.
    #[command(
        subcommand,
        after_help = "Example: trocar import act FOLDER --fps 25 --task \"Lift the needle\" --out runs/demos\n         trocar import lerobot FOLDER --mapping open-h-dvrk --out runs/demos\n         trocar import log runs/a.mcap runs/b.mcap --task \"Lift the needle\" --out runs/demos\n\nAmbiguous input is refused: deltas as actions, another number of joints, joints outside of the arm's limits (degrees, a normalised gripper), poses out of its reach, non-finite numbers, frames that are missing."
    )]
    Import(ImportVerb),
    /// Write a dataset in another's form.
    #[command(
        subcommand,
        after_help = "Example: trocar export open-h runs/demos --out runs/open-h"
    )]
    Export(ExportVerb),
    /// Train a policy on a dataset.
    #[command(
        after_help = "Example: trocar train --policy act --data runs/demos --out runs/act --steps 10000 --device cuda\n         trocar train --policy act --data runs/demos --out runs/act --eval-every 1000 --eval-trials 20 --eval-jobs 4\n         tensorboard --logdir runs\n\nLosses are in loss.csv, loss.svg and TensorBoard's event files, all in OUT. Ctrl-C keeps the state and ends with exit code 1; --resume OUT goes on."
    )]
    Train(TrainArgs),
    /// Run a study: a grid of recordings, trainings and evaluations; completed cells are skipped.
    #[command(
        after_help = "Example: trocar study config/studies/sufia-bc.toml --dry-run\n         trocar study config/studies/sufia-bc.toml --out runs/sufia-bc\n         trocar study config/studies/sufia-bc.toml --out /shared/sufia-bc --shard 3/8\n\nIt can be cut off at any time: the same command goes on. What a cell's verb says is in its folder's log.txt. Exit code: 0 if all is done, 1 if a cell failed or it was interrupted, 2 for bad input, such as a result that was changed since it was made."
    )]
    Study(StudyArgs),
    /// Make one page of a study: every table beside the published figures, comparisons, curves,
    /// losses, times and hashes.
    #[command(
        after_help = "Example: trocar report runs/sufia-bc --out runs/sufia-bc.html\n         trocar report runs/shard-1 runs/shard-2 --out runs/sufia-bc.md --json runs/sufia-bc.json"
    )]
    Report(ReportArgs),
    /// Recompute every command of a log from its inputs; exit 0 only if all are bit-identical. It
    /// ends at the first gap, records that the logger dropped since its disk stood still, and names
    /// the tick. With --console it is shown with a time line, and so are all episodes of a dataset,
    /// whose folder is given in the log's place.
    #[command(
        after_help = "Example: trocar replay runs/a.mcap\n         trocar replay runs/a.mcap --console\n         trocar replay runs/demos --console"
    )]
    Replay(ReplayArgs),
    /// Check a log's commands against its limits, independently of the controller.
    #[command(
        after_help = "Example: trocar verify runs/a.mcap\n         trocar verify --part runs/long.mcap"
    )]
    Verify(VerifyArgs),
    /// Emulate seven CiA 402 drives an arm, on CAN interfaces such as vcan, coupled to the
    /// simulated arms of a task.
    #[command(
        after_help = "Example: trocar drives --task needle-lift --seed 7\n         trocar drives --config runs/can.toml --fault kind=pull,node=3,at=2s --json runs/drives.json"
    )]
    Drives(DrivesArgs),
    /// Simulate the arms of a task with their world and cameras in a process of its own, commanded
    /// over topics by `run --backend topics`.
    #[command(
        after_help = "Example: trocar simulator --task needle-lift --seed 7 --topics lab --cameras multi\n         trocar run --task needle-lift --seed 7 --policy expert --backend topics --topics lab"
    )]
    Simulator(SimulatorArgs),
    /// Show what this machine offers: scheduling, memory locking, CAN, GPU, shared memory.
    #[command(after_help = "Example: trocar doctor")]
    Doctor(DoctorArgs),
    /// Run the committed policy of a task and write its log and images.
    #[command(
        after_help = "Example: trocar demo --task needle-lift --out runs/demo\n\nThe policy is the committed one of the task: in config/policies/TASK/ of the repository, or as it was installed."
    )]
    Demo(DemoArgs),
    /// Draw what every camera of every task sees in the middle of an expert's episode, in colour,
    /// depth and ids, as one PNG.
    #[command(
        after_help = "Example: trocar sheet --out runs/tasks.png --seed 7 --width 192 --shading fine"
    )]
    Sheet(SheetArgs),
    /// Make a patient of meshes of a CT's labels, or a procedural CT with its labels.
    #[command(
        subcommand,
        after_help = "Example: trocar anatomy phantom --seed 7 --out runs/patient\n         trocar anatomy build runs/patient/labels.nii.gz --out runs/patient"
    )]
    Anatomy(AnatomyVerb),
    /// Show what the arms of a run in real time are doing: operating state, fault.
    #[command(
        after_help = "Example: trocar status\n         trocar status --json | jq .arms[0].state\n\nThis and enable, disable, pause, resume, home, clear, speed, mark and stop are commands to a run of this user in real time, over a local socket. Exit code 1 if the run refuses."
    )]
    Status(OperatorArgs),
    /// Show a run in real time in the terminal, for ssh: joints, filter, guard, gate, control loop
    /// and buses, with the operator's commands as keys.
    #[command(
        after_help = "Example: trocar monitor\n         ssh robot -t trocar monitor --run 4711"
    )]
    Monitor(MonitorArgs),
    /// Enable the simulated arms of a run again: from DISABLED to ENABLED. Arms of another process,
    /// and drives on CAN, are enabled by a new run alone.
    #[command(after_help = "Example: trocar enable")]
    Enable(OperatorArgs),
    /// Disable the arms of a run: they stop, and lose torque.
    #[command(after_help = "Example: trocar disable")]
    Disable(OperatorArgs),
    /// Pause the arms of a run: they stop and hold; the task's time goes on.
    #[command(after_help = "Example: trocar pause && sleep 2 && trocar resume")]
    Pause(OperatorArgs),
    /// Resume a run that was paused.
    #[command(after_help = "Example: trocar resume")]
    Resume(OperatorArgs),
    /// Say whether the arms of a run are homed; drives home during bring-up.
    #[command(after_help = "Example: trocar home")]
    Home(OperatorArgs),
    /// Clear a latched fault of simulated arms that hold with it (`fault.ends_run = false`): from
    /// FAULT to DISABLED. Any other fault, and always one of arms on CAN or of another process,
    /// ends its run, so that there is none to clear: start a new run.
    #[command(after_help = "Example: trocar clear")]
    Clear(OperatorArgs),
    /// Lower the speed limits of a run to a share of the configured ones, or raise them again.
    #[command(after_help = "Example: trocar speed 30")]
    Speed(SpeedArgs),
    /// Mark how a robot's run went, as often as one likes, and label it: its log keeps both, for
    /// `import log`. It moves nothing and ends nothing.
    #[command(
        after_help = "Example: trocar mark success\n         trocar mark discard --label 'camera fell' && trocar stop\n         trocar mark none"
    )]
    Mark(MarkArgs),
    /// End a run: the arms come to rest first. This is no emergency stop.
    #[command(after_help = "Example: trocar stop --run 4711")]
    Stop(OperatorArgs),
    /// Print the effective configuration of a command.
    #[command(subcommand)]
    Config(ConfigVerb),
    /// Print the completions of a shell for this command line.
    #[command(
        after_help = "Example: trocar completions bash > ~/.local/share/bash-completion/completions/trocar\n         trocar completions zsh > ~/.zfunc/_trocar\n         trocar completions fish > ~/.config/fish/completions/trocar.fish"
    )]
    Completions(CompletionsArgs),
    /// Write the man pages of this command and its verbs into a folder.
    #[command(after_help = "Example: trocar man runs/man && man runs/man/trocar-run.1")]
    Man(ManArgs),
    /// The policy's own process in a real-time run; started by `run`.
    #[command(hide = true)]
    PolicyProcess(PolicyProcessArgs),
    /// Episodes whose seeds come on standard input, in lockstep with an external policy; started by
    /// the Python package's environments.
    #[command(hide = true)]
    Environment(EnvironmentArgs),
}

impl Verb {
    /// Where its result goes as JSON.
    pub(crate) fn json(&self) -> Option<&Path> {
        let json = match self {
            Self::Run(args) => &args.json,
            Self::Eval(args) => &args.json,
            Self::Record(args) => &args.json,
            Self::Import(verb) => verb.json(),
            Self::Export(verb) => verb.json(),
            Self::Anatomy(verb) => verb.json(),
            Self::Train(args) => &args.json,
            Self::Report(args) => &args.json,
            Self::Replay(args) => &args.log.json,
            Self::Verify(args) => &args.log.json,
            Self::Drives(args) => &args.json,
            Self::Simulator(args) => &args.json,
            Self::Doctor(args) => &args.json,
            Self::Status(_)
            | Self::Monitor(_)
            | Self::Enable(_)
            | Self::Disable(_)
            | Self::Pause(_)
            | Self::Resume(_)
            | Self::Home(_)
            | Self::Clear(_)
            | Self::Speed(_)
            | Self::Mark(_)
            | Self::Stop(_)
            | Self::Study(_)
            | Self::Demo(_)
            | Self::Sheet(_)
            | Self::Config(_)
            | Self::Completions(_)
            | Self::Man(_)
            | Self::Policy(_)
            | Self::Cameras(_)
            | Self::PolicyProcess(_)
            | Self::Environment(_) => &None,
        };
        json.as_deref()
    }
}

/// A task: the name of a built-in one or the path of a folder. Which of them there are is seen when
/// one is loaded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TaskParser;

impl TypedValueParser for TaskParser {
    type Value = String;

    fn parse_ref(
        &self,
        command: &Command,
        option: Option<&Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        StringValueParser::new().parse_ref(command, option, value)
    }

    /// For the help and for shells.
    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let folder = PossibleValue::new("FOLDER").help("a folder with scene.toml and safety.toml");
        Some(Box::new(
            tasks::names().map(PossibleValue::new).chain([folder]),
        ))
    }
}

/// Which arm is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Backend {
    /// The simulated arm.
    Sim,
    /// Drives on CAN, such as those of `trocar drives`.
    Can,
    /// Arms that another process leads, over topics: `trocar simulator`, a process of yours in
    /// Python or Rust.
    Topics,
}

/// Where a network computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ComputeDevice {
    /// The processor.
    Cpu,
    /// The first CUDA device.
    Cuda,
}

/// Options of `run`.
#[derive(Args, Debug)]
pub(crate) struct RunArgs {
    /// The task: a built-in one by name, or the path of a folder with scene.toml and safety.toml.
    #[arg(long, value_parser = TaskParser)]
    pub(crate) task: Option<String>,
    /// With --backend can or topics: a robot without a task, within the limits of this file, which
    /// has the form of a task's safety.toml. There is no simulator, no scene and no verdict;
    /// cameras are those on the topics --topics. Ends with --seconds, a signal or a fault.
    #[arg(long, value_name = "FILE")]
    #[arg(conflicts_with_all = ["task", "lockstep", "scene", "needle", "view", "latency_ms", "latency_jitter_ms"])]
    pub(crate) safety: Option<PathBuf>,
    /// With --safety: after how long the run ends, s, up to 86400; if not given, only a signal or a
    /// fault ends it.
    #[arg(long, value_name = "S", requires = "safety", conflicts_with = "task", value_parser = seconds)]
    pub(crate) seconds: Option<f64>,
    /// With --safety: the axes in which an operator's hands move an arm, once an arm: how the view
    /// (x to the right, y up, z towards the viewer) is turned in the arm's RCM frame, degrees about
    /// its x, then y, then z. --policy teleop needs it, and so does whoever is to take over from a
    /// policy on the --console or by --hands.
    #[arg(
        long,
        value_name = "ARM=X,Y,Z",
        requires = "safety",
        conflicts_with = "task",
        allow_hyphen_values = true
    )]
    pub(crate) hands_view: Vec<HandsView>,
    /// `expert`, `noop`, `random`, `teleop` (an operator's hands, over --console or from --hands),
    /// `simulated-operator` (with --lockstep), a checkpoint's directory, or `external`: a process
    /// of yours on the topics `external`, or on others with `external:NAME`, such as one of the
    /// Python package in policy/python.
    #[arg(long)]
    pub(crate) policy: String,
    /// How an external policy is awaited.
    #[command(flatten)]
    pub(crate) external: ExternalArgs,
    /// The arm.
    #[arg(long, value_enum, default_value = "sim")]
    pub(crate) backend: Backend,
    /// Lockstep: virtual time, as fast as it goes, bit-reproducible.
    #[arg(long, conflicts_with_all = ["console", "foxglove", "topics"])]
    pub(crate) lockstep: bool,
    /// Random seed: the same seed gives the same run.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// The scene.
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    /// Controller configuration instead of the built-in config/control.toml.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Override one configuration value: FILE.KEY=VALUE, where FILE is control, safety, scene, can
    /// or realtime. May be given several times.
    #[arg(long, value_name = "FILE.KEY=VALUE")]
    pub(crate) set: Vec<Change>,
    /// What the control thread asks of the operating system (scheduling, core, locked memory),
    /// instead of the built-in config/realtime.toml.
    #[arg(long, value_name = "FILE", conflicts_with = "lockstep")]
    pub(crate) realtime: Option<PathBuf>,
    /// With --backend can: nodes and interfaces instead of the built-in config/can.toml.
    #[arg(long, value_name = "FILE")]
    pub(crate) can_config: Option<PathBuf>,
    /// The name of the topics that cameras publish on, and with --backend topics the arms: with
    /// --backend can or topics those of the simulated scene, or with --safety of the robot,
    /// `drives` if not given. With --backend sim the policy then sees others' frames, of `trocar
    /// cameras` or anyone, and this run draws none.
    #[arg(long, value_name = "NAME")]
    pub(crate) topics: Option<String>,
    /// Write the run's log; parent folders are made.
    #[arg(long, value_name = "FILE.mcap")]
    pub(crate) log: Option<PathBuf>,
    /// Keep no log. Without this and --log the last 256 MB of a run in real time are kept in
    /// ~/.local/state/trocar/black-box (of a service, in its state folder), as simulation.mcap or,
    /// with --backend can or topics, TOPICS.mcap (.2.mcap of a second run at the same time), and
    /// the run before it beside it, as .before.mcap.
    #[arg(long, conflicts_with = "log")]
    pub(crate) no_log: bool,
    /// What the log takes at most, MB: it keeps the last part, in FILE.mcap and, from before it,
    /// FILE.earlier.mcap, which `replay` and `verify` take one by one.
    #[arg(long, value_name = "MB", requires = "log", value_parser = clap::value_parser!(u64).range(16..=1_000_000))]
    pub(crate) log_max_mb: Option<u64>,
    /// Cameras whose frames the log keeps besides those that the policy sees: `single` (the one
    /// that the paper gives the task's policies), `multi` (that one and the wrists), or names with
    /// commas between them. If there is neither: endoscope. With --safety: names of cameras on the
    /// topics, none if not given.
    #[arg(long, value_name = "single|multi|NAMES", requires = "log")]
    pub(crate) cameras: Option<String>,
    /// Write the result as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
    /// Where it is shown.
    #[command(flatten)]
    pub(crate) page: PageArgs,
    /// Where it is shown in Foxglove.
    #[command(flatten)]
    pub(crate) viewers: FoxgloveArgs,
    /// How it is seen in a headset.
    #[command(flatten)]
    pub(crate) headset: HeadsetArgs,
    /// What moves the arms besides.
    #[command(flatten)]
    pub(crate) desk: DeskArgs,
    /// Delay from observation to chunk in lockstep, ms, up to 10000.
    #[arg(long, value_name = "MS", value_parser = delay())]
    pub(crate) latency_ms: Option<u64>,
    /// Uniform latency jitter, 0 to this, drawn for each chunk from the seed, ms, up to 10000.
    #[arg(long, value_name = "MS", default_value_t = 0, value_parser = delay())]
    pub(crate) latency_jitter_ms: u64,
    /// Where and how the network computes.
    #[command(flatten)]
    pub(crate) compute: ComputeArgs,
}

/// Where and how a network computes.
#[derive(Args, Clone, Copy, Debug)]
pub(crate) struct ComputeArgs {
    /// Where the network computes.
    #[arg(long, value_enum, default_value = "cpu")]
    pub(crate) device: ComputeDevice,
    /// Numeric precision: bf16 is faster and less exact, on CUDA only.
    #[arg(long, value_enum, default_value = "f32")]
    pub(crate) precision: Precision,
    /// Threads of the network on the CPU, at most one fewer than there are cores: one is the
    /// control's. Another number may give other bits.
    #[arg(long, default_value_t = 1, value_parser = threads())]
    pub(crate) threads: usize,
}

/// In which numbers a network computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Precision {
    /// Single precision.
    F32,
    /// 8 significant bits.
    Bf16,
}

/// How video is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Video {
    /// H.264, which encodes fast.
    H264,
    /// AV1, which is smaller; LeRobot's choice.
    Av1,
}

/// Options of the verbs that read a log.
#[derive(Args, Debug)]
pub(crate) struct LogArgs {
    /// The log.
    #[arg(value_name = "FILE.mcap")]
    pub(crate) file: PathBuf,
    /// Write the result as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

/// Options of `verify`.
#[derive(Args, Debug)]
pub(crate) struct VerifyArgs {
    /// The log, and where the result goes.
    #[command(flatten)]
    pub(crate) log: LogArgs,
    /// What `run --log-max-mb` kept is enough: exit 0 if that part is whole and breaks no limit,
    /// though it does not show the run's other ticks. The result's `ok` stays false.
    #[arg(long)]
    pub(crate) part: bool,
}

/// Options of `replay`.
#[derive(Args, Debug)]
pub(crate) struct ReplayArgs {
    /// The log, or a dataset's folder, and where the result goes.
    #[command(flatten)]
    pub(crate) log: LogArgs,
    /// Where it is shown afterwards, with a time line, until Ctrl-C.
    #[command(flatten)]
    pub(crate) page: PageArgs,
    /// Where it is played to Foxglove.
    #[command(flatten)]
    pub(crate) viewers: FoxgloveArgs,
}

/// Options of `doctor`.
#[derive(Args, Debug)]
pub(crate) struct DoctorArgs {
    /// Write the findings as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

/// Options of `demo`.
#[derive(Args, Debug)]
pub(crate) struct DemoArgs {
    /// The task: a built-in one by name, or the path of a folder with scene.toml and safety.toml.
    #[arg(long, value_parser = TaskParser, default_value = "needle-lift")]
    pub(crate) task: String,
    /// Where the log and the images go.
    #[arg(long, default_value = "runs/demo")]
    pub(crate) out: PathBuf,
    /// The policy; by default the committed one of the task.
    #[arg(long)]
    pub(crate) policy: Option<String>,
    /// Random seed: the same seed gives the same run.
    #[arg(long, default_value_t = 1_000_000)]
    pub(crate) seed: u64,
}

/// Options of the hidden policy process.
#[derive(Args, Debug)]
pub(crate) struct PolicyProcessArgs {
    /// Names the run's topics.
    #[arg(long)]
    pub(crate) run_id: String,
    /// The process that started this one; this one goes when that one is gone.
    #[arg(long)]
    pub(crate) parent_pid: u32,
    /// How far a frame may be from the instant of an observation, ms.
    #[arg(long, default_value_t = 0)]
    pub(crate) frames_within_ms: u64,
    /// The checkpoint's directory.
    #[arg(long)]
    pub(crate) policy: PathBuf,
    /// Where and how the network computes.
    #[command(flatten)]
    pub(crate) compute: ComputeArgs,
}
