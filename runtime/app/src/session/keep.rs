//! Log and pictures of trials of an evaluation, for those who want to see why they were lost.

use std::fs;
use std::path::{Path, PathBuf};

use hal::{CameraFrame, Chunk, TimeNs};
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::task::Outcome;

use super::ended::Ended;
use super::episode::{EpisodeEnd, EpisodeObserver, StepView};
use super::pictures::{STEP_MS, Thumbnails};
use super::{Plan, SessionError, scene_record};
use trocar_log::{Recorder, TickRecord};

/// Which trials are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeepChoice {
    /// Those that did not succeed.
    Failures,
    /// All of them.
    All,
}

/// Which trials are kept, and where.
#[derive(Clone, Debug)]
pub struct Keep {
    /// Which.
    pub choice: KeepChoice,
    /// The folder; a new or an empty one.
    pub folder: PathBuf,
}

impl Keep {
    const fn wants(&self, outcome: &Outcome) -> bool {
        match self.choice {
            KeepChoice::All => true,
            KeepChoice::Failures => !matches!(outcome, Outcome::Success),
        }
    }

    /// The file of the trial `seed` with that extension.
    #[must_use]
    pub fn file(&self, seed: u64, extension: &str) -> PathBuf {
        self.folder.join(format!("seed-{seed}.{extension}"))
    }
}

/// What was kept of a trial.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    pub(super) log: PathBuf,
    pub(super) pictures: PathBuf,
}

/// Writes the log of a trial while it runs. Its frames are drawn at the end, and only of a trial
/// that is kept: drawing takes far longer than the rest.
pub(super) struct Keeper<'a> {
    keep: &'a Keep,
    seed: u64,
    recorder: Recorder,
    /// Where everything was at each policy step.
    steps: Vec<(TimeNs, SceneSnapshot)>,
    /// The unfinished log.
    part: PartFile,
}

impl<'a> Keeper<'a> {
    /// Begins the log of the trial `seed` of `plan`.
    pub(super) fn begin(keep: &'a Keep, plan: &Plan, seed: u64) -> Result<Self, SessionError> {
        let part = PartFile(keep.file(seed, "mcap.part"));
        let trial = Plan {
            seed,
            log: Some(part.0.clone()),
            ..plan.clone()
        };
        let recorder = trial.open_log(true)?;
        let recorder =
            recorder.ok_or_else(|| SessionError::output(&part.0, "there is no log to write to"))?;
        Ok(Self {
            keep,
            seed,
            recorder,
            steps: Vec::new(),
            part,
        })
    }

    /// Ends the log; keeps it, with pictures by `cameras` of those called `names`, if the trial is
    /// one to be kept; where there are none yet, `make_cameras` makes them.
    pub(super) fn finish(
        self,
        end: &EpisodeEnd,
        names: &[String],
        cameras: &mut Option<SceneCameras>,
        make_cameras: &dyn Fn() -> Result<SceneCameras, SessionError>,
    ) -> Result<Option<Kept>, SessionError> {
        let Self {
            keep,
            seed,
            mut recorder,
            steps,
            part,
        } = self;
        if !keep.wants(&end.outcome) {
            recorder.finish(None)?;
            return Ok(None);
        }
        let cameras = match cameras {
            Some(cameras) => cameras,
            None => cameras.insert(make_cameras()?),
        };
        let pictures = draw(&steps, names, cameras, &mut recorder)?;
        Ended::episode(end).close(recorder, &end.tally)?;
        let kept = Kept {
            log: keep.file(seed, "mcap"),
            pictures: keep.file(seed, "gif"),
        };
        pictures.write_gif(&kept.pictures, STEP_MS)?;
        part.rename(&kept.log)?;
        Ok(Some(kept))
    }
}

/// Draws every step into the log, and into pictures what the first camera sees.
fn draw(
    steps: &[(TimeNs, SceneSnapshot)],
    names: &[String],
    cameras: &mut SceneCameras,
    recorder: &mut Recorder,
) -> Result<Thumbnails, SessionError> {
    let which: Vec<usize> = names.iter().filter_map(|name| cameras.find(name)).collect();
    let blank = which.iter().map(|&index| cameras.blank_frame(index));
    let mut frames: Vec<CameraFrame> = blank.collect::<Result<_, _>>()?;
    let mut pictures = Thumbnails::default();
    for (sequence, (stamp, snapshot)) in (0..).zip(steps) {
        cameras.render_all(&which, snapshot, &mut frames)?;
        for (name, frame) in names.iter().zip(&mut frames) {
            (frame.stamp, frame.sequence) = (*stamp, sequence);
            recorder.frame(name, frame);
        }
        if let Some(first) = frames.first() {
            pictures.push(first);
        }
    }
    Ok(pictures)
}

impl EpisodeObserver for Keeper<'_> {
    fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
        scene_record::keep(&mut self.recorder, view);
        let stamp = view.arms.first.state.stamp;
        self.steps.push((stamp, *view.snapshot));
        Ok(())
    }

    fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        self.recorder.chunk(arm, chunk);
    }

    fn tick(&mut self, record: &TickRecord) {
        self.recorder.tick(record);
    }
}

/// A file that is there only while it is being written.
struct PartFile(PathBuf);

impl PartFile {
    fn rename(self, to: &Path) -> Result<(), SessionError> {
        fs::rename(&self.0, to).map_err(|error| SessionError::output(to, error))
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        let _renamed = fs::remove_file(&self.0);
    }
}
