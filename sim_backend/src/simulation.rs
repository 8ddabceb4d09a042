//! One episode of the simulated task: arm, needle, cameras and the verdict.
//!
//! The driver reads and writes it as a [`hal::Arm`] and calls [`Simulation::step`] once a control tick. Same task, seed
//! and commands give the same bits. If the driver falls silent the arm finishes alone the stop that came with the last
//! command.

use hal::tail::TailPlayer;
use hal::{Arm, ArmCommand, ArmError, ArmState, CameraFrame, Pose, SafeTail, TICK_NS, TimeNs};

use crate::cameras::{SceneCameras, SceneSnapshot};
use crate::render::RenderError;
use crate::task::{Outcome, SuccessMonitor, TaskConfig};
use crate::world::{Grasp, World};

/// Whether an episode can be looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rendering {
    /// Physics alone.
    Off,
    /// Physics and cameras.
    On,
}

/// Why there is no episode or no image of it.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The renderer can't be had or failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// An image was asked of an episode that runs without cameras.
    #[error("this simulation was made without rendering")]
    RenderingOff,
    /// There is no such camera.
    #[error("camera {index} of {count}")]
    NoSuchCamera {
        /// The one asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
}

/// The true state of the scene, which experts may see and policies may not.
#[derive(Clone, Copy, Debug)]
pub struct SceneState {
    /// Tip (control point) in the RCM frame.
    pub tip_in_rcm: Pose,
    /// Needle in the RCM frame.
    pub needle_in_rcm: Pose,
    /// Angle between the jaw fingers, rad.
    pub jaw: f64,
    /// How the fingers hold the needle.
    pub grasp: Grasp,
}

/// Time that the needle gets to come to rest before the episode begins, ms.
const SETTLE_STEPS: u32 = 250;

/// An episode.
pub struct Simulation {
    world: World,
    monitor: SuccessMonitor,
    scene_from_rcm: Pose,
    cameras: Option<SceneCameras>,
    frames: u64,
    stamp: TimeNs,
    tail: TailPlayer,
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

    /// The episode `seed` of `task`, seen with the cameras of an earlier episode of the same task: opening a device takes
    /// far longer than an image.
    #[must_use]
    pub fn with_cameras(task: &TaskConfig, seed: u64, cameras: SceneCameras) -> Self {
        Self::build(task, seed, Some(cameras))
    }

    /// Gives the cameras back for the next episode.
    #[must_use]
    pub fn into_cameras(self) -> Option<SceneCameras> {
        self.cameras
    }

    fn build(task: &TaskConfig, seed: u64, cameras: Option<SceneCameras>) -> Self {
        let needle_in_scene = task.needle_start.draw(seed, &task.needle, &task.organ);
        let mut world = World::new(
            &task.world,
            &task.needle,
            &task.organ,
            task.scene_from_rcm,
            task.joints0,
            task.jaw0,
            needle_in_scene,
        );
        for _ in 0..SETTLE_STEPS {
            world.step();
        }
        Self {
            world,
            monitor: SuccessMonitor::new(&task.success, &task.needle, &task.organ),
            scene_from_rcm: task.scene_from_rcm,
            cameras,
            frames: 0,
            stamp: TimeNs(0),
            tail: TailPlayer::new(TICK_NS),
        }
    }

    /// Advances by one control tick, 1 ms: under the setpoint that was written since the last step or, if none was, under
    /// the next point of the last one's tail.
    pub fn step(&mut self) {
        if let Some(setpoint) = self.tail.next_period() {
            self.world.command(&setpoint);
        }
        self.world.step();
        self.monitor
            .observe(&self.world.needle_in_scene(), &self.world.grasp());
    }

    /// How the episode stands.
    #[must_use]
    pub const fn outcome(&self) -> Outcome {
        self.monitor.outcome()
    }

    /// The true state of the scene.
    #[must_use]
    pub fn scene_state(&self) -> SceneState {
        SceneState {
            tip_in_rcm: self.scene_from_rcm.inv_mul(&self.world.tip_in_scene()),
            needle_in_rcm: self.scene_from_rcm.inv_mul(&self.world.needle_in_scene()),
            jaw: self.world.measured(self.stamp).jaw_position,
            grasp: self.world.grasp(),
        }
    }

    /// Where everything that moves is, for cameras in another thread.
    #[must_use]
    pub fn snapshot(&self) -> SceneSnapshot {
        SceneSnapshot {
            needle: self.world.needle_in_scene(),
            arm: self.world.body_poses(),
        }
    }

    /// The cameras, if the episode has any.
    ///
    /// # Errors
    /// [`SimulationError::RenderingOff`].
    pub fn cameras(&self) -> Result<&SceneCameras, SimulationError> {
        self.cameras.as_ref().ok_or(SimulationError::RenderingOff)
    }

    /// Takes one image, stamped with the newest time at which the arm was read.
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

    /// Digest of the whole physical state: equal after equal commands. The tail is what may come, so it is not in it.
    #[must_use]
    pub fn state_hash(&self) -> u64 {
        self.world.state_hash()
    }
}

impl Arm for Simulation {
    fn read(&mut self, now: TimeNs) -> Result<ArmState, ArmError> {
        self.stamp = now;
        Ok(self.world.measured(now))
    }

    fn write(&mut self, command: &ArmCommand, tail: &SafeTail) -> Result<(), ArmError> {
        self.world.command(command);
        self.tail.write(command, tail);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
