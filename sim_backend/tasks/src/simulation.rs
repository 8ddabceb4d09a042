//! One episode of a simulated task: arms, things, cameras and the verdict.
//!
//! The driver reads and writes each arm as a [`hal::Arm`] and calls [`Simulation::step`] once a
//! control tick; the whole simulation is its first arm too. Same task, seed and commands give the
//! same bits. If no command comes any more an arm finishes alone the stop that came with the last
//! command.

mod nudge;

use hal::tail::TailPlayer;
use hal::{Arm, ArmCommand, ArmError, ArmState, CameraFrame, Pose, SafeTail, TICK_NS, TimeNs};
use trocar_world::World;
use trocar_world::plant::DriveSetpoint;
use trocar_world::tissue::{FlapSnapshot, TissueExtremes};

use crate::SimulationError;
use crate::cameras::SceneCameras;
use crate::scene::{ArmScene, SceneSnapshot, SceneState, THINGS_MAX};
use crate::task::{Criteria, Judge, MonitorInput, Outcome, TaskConfig, laying};
use hal::ARMS_MAX;
pub use nudge::Nudge;

/// Whether an episode can be looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rendering {
    /// Physics alone.
    Off,
    /// Physics and cameras.
    On,
}

/// An episode.
pub struct Simulation {
    world: World,
    judge: Judge,
    goal: Option<Pose>,
    bases: Vec<Pose>,
    tails: Vec<TailPlayer>,
    extremes: TissueExtremes,
    cameras: Option<SceneCameras>,
    nudge: Option<Nudge>,
    frames: u64,
    stamp: TimeNs,
    moment_ms: u32,
}

/// One arm of a simulation.
pub struct SimulatedArm<'a> {
    simulation: &'a mut Simulation,
    index: usize,
}

impl Simulation {
    /// The episode `seed` of `task`, the needle at rest.
    ///
    /// # Errors
    /// [`SimulationError::Render`] if there is no device to render with.
    pub fn new(
        task: &TaskConfig,
        seed: u64,
        rendering: Rendering,
    ) -> Result<Self, SimulationError> {
        let cameras = match rendering {
            Rendering::Off => None,
            Rendering::On => Some(SceneCameras::new(task)?),
        };
        Ok(Self::build(task, seed, cameras))
    }

    /// The episode `seed` of `task`, seen with the cameras of an earlier episode of the same task:
    /// opening a device takes far longer than an image.
    #[must_use]
    pub fn with_cameras(task: &TaskConfig, seed: u64, cameras: SceneCameras) -> Self {
        Self::build(task, seed, Some(cameras))
    }

    /// Gives the cameras back for the next episode.
    #[must_use]
    pub fn into_cameras(self) -> Option<SceneCameras> {
        self.cameras
    }

    fn build(task: &TaskConfig, seed: u64, mut cameras: Option<SceneCameras>) -> Self {
        if let Some(cameras) = &mut cameras {
            cameras.begin_episode(task, seed);
        }
        let scene = task.scene_of(seed);
        Self {
            world: laying::settled(task, &*scene, seed),
            judge: Judge::new(scene.monitor(seed), task.time_limit_s),
            goal: scene.goal(seed),
            bases: task.arms.iter().map(|arm| arm.scene_from_rcm).collect(),
            tails: vec![TailPlayer::new(TICK_NS); task.arms.len()],
            extremes: TissueExtremes::default(),
            cameras,
            nudge: None,
            frames: 0,
            stamp: TimeNs(0),
            moment_ms: 0,
        }
    }

    /// How many arms there are.
    #[must_use]
    pub const fn arm_count(&self) -> usize {
        self.bases.len()
    }

    /// The arm `index`, counted from 0; none if there are not so many.
    pub fn arm(&mut self, index: usize) -> Option<SimulatedArm<'_>> {
        (index < self.arm_count()).then_some(SimulatedArm {
            simulation: self,
            index,
        })
    }

    /// Advances by one control tick, 1 ms: each arm under the setpoint that was written since the
    /// last step or, if none was, under the next point of the last one's tail.
    pub fn step(&mut self) {
        self.play_tails();
        self.continue_nudge();
        self.moment_ms = self.moment_ms.wrapping_add(1);
        self.world.step();
        if let Some(tissue) = self.world.tissue() {
            self.extremes.observe(tissue.report());
        }
        self.judge.observe(&MonitorInput::of(&self.world));
    }

    /// Arms without a new setpoint play on their last one's tail.
    fn play_tails(&mut self) {
        for (arm, tail) in self.tails.iter_mut().enumerate() {
            if let Some(setpoint) = tail.next_period() {
                self.world.command(arm, &setpoint);
            }
        }
    }

    /// Advances by 1 ms before the episode begins, before all arms are commanded: nothing is
    /// judged, and the episode's time does not run.
    pub fn wait(&mut self) {
        self.play_tails();
        self.moment_ms = self.moment_ms.wrapping_add(1);
        self.world.step();
    }

    /// Gives the episode so much more time than its task allows, s.
    pub fn grant_s(&mut self, seconds: f64) {
        self.judge.grant_s(seconds);
    }

    /// How the episode stands.
    #[must_use]
    pub const fn outcome(&self) -> Outcome {
        self.judge.outcome()
    }

    /// What has not happened as long as there is no success, in words.
    #[must_use]
    pub fn missing(&self) -> &'static str {
        self.judge.missing()
    }

    /// What has to be so for success, and how it is now.
    #[must_use]
    pub fn criteria(&self) -> Criteria {
        self.judge.criteria(&MonitorInput::of(&self.world))
    }

    /// What the flap has gone through since the episode began, if there is one.
    #[must_use]
    pub fn tissue_extremes(&self) -> Option<TissueExtremes> {
        self.world.tissue().map(|_| self.extremes)
    }

    /// The true state of the scene.
    #[must_use]
    pub fn scene_state(&self) -> SceneState {
        SceneState {
            first: self.arm_scene(0),
            second: (self.arm_count() > 1).then(|| self.arm_scene(1)),
            goal_in_scene: self.goal,
        }
    }

    fn arm_scene(&self, arm: usize) -> ArmScene {
        let base = &self.bases[arm];
        ArmScene {
            tip_in_rcm: base.inv_mul(&self.world.tip_in_scene(arm)),
            thing_in_rcm: base.inv_mul(&self.world.subject_in_scene()),
            jaw: self.world.measured(arm, self.stamp).jaw_position,
            grasp: self.world.subject_grasp(arm),
        }
    }

    /// Where everything that moves is, for cameras in another thread.
    #[must_use]
    pub fn snapshot(&self) -> SceneSnapshot {
        let mut things = [Pose::identity(); THINGS_MAX];
        for (index, thing) in things.iter_mut().enumerate().take(self.world.thing_count()) {
            *thing = self.world.thing_in_scene(index);
        }
        let mut arms = [None; ARMS_MAX];
        for (index, arm) in arms.iter_mut().enumerate().take(self.arm_count()) {
            *arm = Some(self.world.body_poses(index));
        }
        SceneSnapshot {
            moment_ms: self.moment_ms,
            things,
            goal: self.goal.unwrap_or_else(Pose::identity),
            arms,
            flap: self.world.tissue().map(FlapSnapshot::of),
        }
    }

    /// The cameras, if the episode has any.
    ///
    /// # Errors
    /// [`SimulationError::RenderingOff`].
    pub fn cameras(&self) -> Result<&SceneCameras, SimulationError> {
        self.cameras.as_ref().ok_or(SimulationError::RenderingOff)
    }

    /// Takes one image, stamped with the newest time at which an arm was read.
    ///
    /// # Errors
    /// [`SimulationError`]; the frame's content is then unspecified.
    pub fn render(
        &mut self,
        camera: usize,
        frame: &mut CameraFrame,
    ) -> Result<(), SimulationError> {
        let snapshot = self.snapshot();
        let cameras = self.cameras.as_mut().ok_or(SimulationError::RenderingOff)?;
        cameras.render(camera, &snapshot, frame)?;
        self.frames += 1;
        frame.sequence = self.frames;
        frame.stamp = self.stamp;
        Ok(())
    }

    /// Takes an image from each of the cameras `which` into the frame at its place in `frames`, all
    /// of this instant.
    ///
    /// # Errors
    /// [`SimulationError`]; the content of all frames is then unspecified.
    pub fn render_all(
        &mut self,
        which: &[usize],
        frames: &mut [CameraFrame],
    ) -> Result<(), SimulationError> {
        let snapshot = self.snapshot();
        let cameras = self.cameras.as_mut().ok_or(SimulationError::RenderingOff)?;
        cameras.render_all(which, &snapshot, frames)?;
        self.frames += 1;
        for frame in frames {
            frame.sequence = self.frames;
            frame.stamp = self.stamp;
        }
        Ok(())
    }

    /// Digest of the whole physical state: equal after equal commands. The tail is what may come,
    /// so it is not in it.
    #[must_use]
    pub fn state_hash(&self) -> u64 {
        self.world.state_hash()
    }
}

impl SimulatedArm<'_> {
    /// Takes set-points of drives that are commanded one by one, each with its own torque, instead
    /// of a command for the arm. They hold until the next ones: such drives stop by themselves, so
    /// there is no tail.
    pub fn lead(&mut self, setpoint: &DriveSetpoint) {
        self.simulation.world.lead(self.index, setpoint);
    }
}

impl Arm for SimulatedArm<'_> {
    fn read(&mut self, now: TimeNs) -> Result<ArmState, ArmError> {
        self.simulation.stamp = now;
        Ok(self.simulation.world.measured(self.index, now))
    }

    fn write(&mut self, command: &ArmCommand, tail: &SafeTail) -> Result<(), ArmError> {
        // What is not finite would never leave the plant again.
        if command.is_finite() && tail.is_finite() {
            self.simulation.world.command(self.index, command);
            self.simulation.tails[self.index].write(command, tail);
        }
        Ok(())
    }
}

/// The first arm.
impl Arm for Simulation {
    fn read(&mut self, now: TimeNs) -> Result<ArmState, ArmError> {
        SimulatedArm {
            simulation: self,
            index: 0,
        }
        .read(now)
    }

    fn write(&mut self, command: &ArmCommand, tail: &SafeTail) -> Result<(), ArmError> {
        SimulatedArm {
            simulation: self,
            index: 0,
        }
        .write(command, tail)
    }
}

#[cfg(test)]
pub(crate) mod pictures;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod wrist;
