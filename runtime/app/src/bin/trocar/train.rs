//! `trocar train`: what is trained, and progress that a person or a log can follow.

use std::path::Path;

use indicatif::ProgressBar;
use trocar::rt::MonotonicClock;
use trocar::session::SessionError;
use trocar::session::run::write_json;
use trocar::session::training::evaluations::BEST;
use trocar::session::training::pace::TrainingStatus;
use trocar::session::training::{
    self, CameraChoice, NetworkChoice, TrainingEval, TrainingOptions, TrainingProgress,
    TrainingResult,
};
use trocar_nets::act::BackboneNorm;

use crate::commands::{Done, device};
use crate::console;
use crate::scene_args::Inputs;
use crate::train_args::{Backbone, Network, TrainArgs, TrainingRecipe};

/// `trocar train`: a new training, or with `--resume` the rest of one, whose options are in its
/// folder and not repeated here.
///
/// On SIGINT the training keeps its state in the folder and ends as an error; `--resume` goes on
/// from there.
///
/// # Errors
/// Missing or contradicting options, a dataset that can't be read or does not fit the network, a
/// loss that is no longer finite.
pub(crate) fn train(args: &TrainArgs) -> Done {
    Inputs::new([("--out", args.out.as_ref())])
        .and_each("--data", &args.data)
        .and_tasks(&args.eval_task)
        .check(&[("--json", args.json.as_deref())])?;
    let mut progress = Progress::new();
    let mut on_progress = |news: &TrainingProgress<'_>| progress.news(news);
    let (result, out) = match (&args.resume, &args.policy, &args.out) {
        (Some(folder), ..) => (training::resume(folder, &mut on_progress), folder),
        (None, Some(policy), Some(out)) => {
            let options = training_options(args, *policy, out)?;
            (training::train(&options, &mut on_progress), out)
        }
        // The parser asks for these before.
        _ => return Err(missing_options()),
    };
    progress.bar.finish_and_clear();
    let result = result?;
    report(&result, out);
    if let Some(path) = &args.json {
        write_json(path, &result)?;
    }
    Ok(true)
}

/// What came of it: the last loss, and the checkpoint with the best success rate if the training
/// evaluated any.
fn report(result: &TrainingResult, out: &Path) {
    console::result(&format!(
        "trained {} steps, final loss {:.5}, {}",
        result.steps,
        result.loss,
        out.display()
    ));
    if let Some(best) = &result.best {
        console::result(&format!(
            "best of {} evaluations: {} of {} trials after {} steps, {}",
            result.evaluations,
            best.successes,
            best.trials,
            best.step,
            out.join(BEST).display()
        ));
    }
}

fn missing_options() -> SessionError {
    SessionError::BadArgument("--policy, --data and --out are needed, or --resume".to_owned())
}

/// The library's options from those of the command line. Without `--preset` it is the network's
/// usual one: `small` of ACT, `paper` of DP3. The whole command line is kept with the checkpoint.
fn training_options(
    args: &TrainArgs,
    network: Network,
    out: &Path,
) -> Result<TrainingOptions, SessionError> {
    Ok(TrainingOptions {
        network: match network {
            Network::Act => NetworkChoice::Act,
            Network::ActPc => NetworkChoice::ActPc,
            Network::Dp3 => NetworkChoice::Dp3,
        },
        data: args.data.clone(),
        out: out.to_owned(),
        cameras: CameraChoice::of(&args.cameras),
        preset: args.preset.clone().unwrap_or_else(|| {
            match network {
                Network::Act | Network::ActPc => "small",
                Network::Dp3 => "paper",
            }
            .to_owned()
        }),
        published: args.recipe == Some(TrainingRecipe::Published),
        backbone: match args.backbone {
            Backbone::GroupNorm => BackboneNorm::GroupNorm,
            Backbone::FrozenBatchNorm => BackboneNorm::FrozenBatchNorm,
        },
        backbone_weights: args.backbone_weights.clone(),
        steps: args.steps,
        batch: args.batch,
        device: device(args.device)?,
        episodes: args.episodes,
        bf16: args.bf16,
        validation_share: args.validation_share,
        threads: args.threads,
        augment: args.augment,
        query_every: args.query_every,
        lr: args.lr,
        shift_px: args.shift_px,
        state_noise: args.state_noise,
        clouds: args.clouds.clone(),
        images_on_host: args.images_on_host,
        eager: args.eager,
        seed: args.seed,
        save_every: args.save_every,
        eval: args.eval_every.map(|every| TrainingEval {
            every,
            task: args.eval_task.clone(),
            trials: args.eval_trials,
            seed: args.eval_seed,
            jobs: args.eval_jobs,
            latency_ms: args.eval_latency_ms,
        }),
        command: std::env::args().skip(1).collect::<Vec<_>>().join(" "),
    })
}

/// Time between two lines where there is no terminal, s.
const LINE_EVERY_S: f64 = 5.0;

/// Says how far a training is: a bar on a terminal, elsewhere a line every few seconds. The bar
/// counts frames while images are decoded, then steps.
struct Progress {
    bar: ProgressBar,
    clock: MonotonicClock,
    /// When the last line was written, s.
    line_s: Option<f64>,
}

impl Progress {
    fn new() -> Self {
        Self {
            bar: console::bar("frames decoded"),
            clock: MonotonicClock::new(),
            line_s: None,
        }
    }

    /// Where there is no terminal each report is a line: they come seldom enough.
    fn reading(&mut self, frames: usize, of: usize, seconds: f64) {
        if self.bar.is_hidden() {
            let line = format!("{frames} of {of} frames decoded; {seconds:.0} s");
            console::note(&line);
        }
        self.at(frames as u64, of as u64);
    }

    /// Dispatches one report of the training's thread. Notes and warnings suspend the bar, so that
    /// it is not drawn into them.
    fn news(&mut self, news: &TrainingProgress<'_>) {
        match *news {
            TrainingProgress::Note(line) => self.bar.suspend(|| console::note(line)),
            TrainingProgress::Warning(line) => self.bar.suspend(|| console::warning(line)),
            TrainingProgress::Reading {
                frames,
                of,
                seconds,
            } => self.reading(frames, of, seconds),
            TrainingProgress::Status(standing) => self.standing(standing),
            TrainingProgress::Evaluating {
                step,
                trials,
                of,
                score,
            } => {
                let rate = score.rate();
                self.bar.set_message(format!(
                    "evaluating step {step}, trial {trials} of {of}, rate {rate:.2}"
                ));
            }
        }
    }

    /// The loss, samples a second and the time that is left; elsewhere than on a terminal a line is
    /// due every `LINE_EVERY_S`, and at the last step's row of `loss.csv`.
    fn standing(&mut self, standing: &TrainingStatus) {
        if self.bar.is_hidden() {
            let now = self.clock.now().seconds();
            let due = self.line_s.is_none_or(|last| now - last >= LINE_EVERY_S);
            let ends = standing.row.is_some() && standing.step == standing.steps;
            if due || ends {
                self.line_s = Some(now);
                console::note(&standing.to_string());
            }
            return;
        }
        let rate = standing
            .samples_per_second
            .map_or_else(String::new, |rate| format!(", {rate:.1} samples/s"));
        let left = standing.seconds_left.map_or_else(String::new, |left| {
            format!(", {} left", console::duration(left))
        });
        self.bar
            .set_message(format!("loss {:.4}{rate}{left}", standing.loss));
        self.at(standing.step, standing.steps);
    }

    /// Where the bar stands; its length may change, since frames and steps share it.
    fn at(&self, position: u64, length: u64) {
        self.bar.set_length(length);
        self.bar.set_position(position);
    }
}
