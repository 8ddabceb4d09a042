//! The cameras in a real-time run: snapshots in, frames rendered straight into shared memory, pictures and log.

use std::thread;

use hal::{CameraFrame, TimeNs};
use trocar_render::Planes;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::scene::SceneSnapshot;
use trocar_topics::{CameraTopic, FrameHeader, FramePublisher, TopicNode};

use super::arm_states::IDLE;
use super::signals::{EndsRun, Signals};
use crate::mailbox::MailboxReader;
use crate::session::pictures::Pictures;
use crate::session::views::Views;
use crate::session::{Plan, SessionError};
use trocar_log::{Level, SideLog};

/// What the cameras need to know of one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Snapshot {
    pub(super) step: u64,
    /// The instant of the arms' measurement in this step.
    pub(super) stamp: TimeNs,
    pub(super) scene: SceneSnapshot,
}

/// The camera thread before it runs.
pub(super) struct CameraThread {
    cameras: SceneCameras,
    /// The cameras that are wanted, by index; publishers and frames are in their order.
    wanted: Vec<usize>,
    publishers: Vec<FramePublisher>,
    log: Option<SideLog>,
    snapshots: MailboxReader<Snapshot>,
    /// Kept only if they will be looked at.
    pictures: Option<Pictures>,
    frames: Vec<CameraFrame>,
    console: Option<ConsoleCameras>,
}

/// What pages of the console look at. They have snapshots of their own, so that none for the policy or the log is replaced.
pub(super) struct ConsoleCameras {
    views: Views,
    snapshots: MailboxReader<Snapshot>,
}

impl ConsoleCameras {
    pub(super) const fn new(views: Views, snapshots: MailboxReader<Snapshot>) -> Self {
        Self { views, snapshots }
    }

    /// Draws one camera of those that pages look at; whether there was one.
    fn draw(&mut self, cameras: &mut SceneCameras) -> Result<bool, SessionError> {
        if self.views.are_drawn()
            && let Some(snapshot) = self.snapshots.take()
        {
            self.views.show(snapshot.stamp, &snapshot.scene, cameras)?;
        }
        self.views.draw(cameras)
    }
}

/// What it leaves behind.
pub(super) struct CameraEnd {
    pub(super) pictures: Option<Pictures>,
}

impl CameraThread {
    /// Opens the renderer for the cameras `wanted` by name, and the topics if there is a policy process to see them; draws `start`
    /// once, since the first image takes far longer than the others.
    pub(super) fn new(
        plan: &Plan,
        wanted: &[String],
        node: Option<&TopicNode>,
        (snapshots, console): (MailboxReader<Snapshot>, Option<ConsoleCameras>),
        start: &SceneSnapshot,
    ) -> Result<Self, SessionError> {
        let setup = &plan.setup;
        let mut cameras = SceneCameras::new(&setup.task)?;
        cameras.begin_episode(&setup.task, plan.seed);
        let wanted = wanted.iter().filter_map(|name| cameras.find(name));
        let wanted: Vec<usize> = wanted.collect();
        let mut publishers = Vec::new();
        if let Some(node) = node {
            for &camera in &wanted {
                let pixels = cameras.intrinsics(camera)?.pixel_count();
                publishers.push(CameraTopic::publisher(node, cameras.name(camera)?, pixels)?);
            }
        }
        let mut frames = wanted
            .iter()
            .map(|&camera| cameras.blank_frame(camera))
            .collect::<Result<Vec<_>, _>>()?;
        for (&camera, frame) in wanted.iter().zip(&mut frames) {
            cameras.render(camera, start, frame)?;
        }
        Ok(Self {
            cameras,
            wanted,
            publishers,
            log: None,
            snapshots,
            pictures: plan.pictures.then(Pictures::default),
            frames,
            console,
        })
    }

    /// Renders snapshots until the control thread has stopped. Whoever puts in one wakes this thread.
    pub(super) fn run(
        mut self,
        log: Option<SideLog>,
        signals: &Signals,
    ) -> Result<CameraEnd, SessionError> {
        let _ends = EndsRun(signals);
        self.log = log;
        while !signals.stopped() {
            signals.write_told(self.log.as_mut());
            if let Some(snapshot) = self.snapshots.take() {
                self.take(&snapshot)?;
            } else {
                self.keep_alive()?;
                if !self.draw_for_console(signals) {
                    thread::park_timeout(IDLE);
                }
            }
        }
        signals.write_told(self.log.as_mut());
        Ok(CameraEnd {
            pictures: self.pictures,
        })
    }

    /// Draws what the console waits for, if anything; one that can't be drawn for ends with a word, the run goes on.
    fn draw_for_console(&mut self, signals: &Signals) -> bool {
        let Some(console) = &mut self.console else {
            return false;
        };
        match console.draw(&mut self.cameras) {
            Ok(drew) => drew,
            Err(error) => {
                let at = console.views.stamp().unwrap_or(TimeNs(0));
                let text = format!("the console is shown no more cameras: {error}");
                signals.tell(at, Level::Warning, &text);
                self.console = None;
                false
            }
        }
    }

    fn take(&mut self, snapshot: &Snapshot) -> Result<(), SessionError> {
        for (place, &camera) in self.wanted.iter().enumerate() {
            let stamp = snapshot.stamp;
            let kept = self.log.is_some() || (place == 0 && self.pictures.is_some());
            let frame = &mut self.frames[place];
            if let Some(publisher) = self.publishers.get_mut(place) {
                let pose = self.cameras.pose(camera, &snapshot.scene)?;
                let header = FrameHeader::new(
                    stamp,
                    snapshot.step,
                    self.cameras.intrinsics(camera)?,
                    &pose,
                );
                let mut loan = publisher.loan(&header)?;
                let (colour, depth_m, instance) = loan.planes();
                let planes = Planes {
                    colour,
                    depth_m,
                    instance,
                };
                self.cameras.render_into(camera, &snapshot.scene, planes)?;
                if kept {
                    frame.colour.copy_from_slice(loan.planes().0);
                    frame.camera_in_scene = pose;
                }
                loan.send()?;
            } else {
                self.cameras.render(camera, &snapshot.scene, frame)?;
            }
            frame.stamp = stamp;
            frame.sequence = snapshot.step;
            if let Some(log) = &mut self.log {
                log.frame(self.cameras.name(camera)?, frame);
            }
            if let (Some(pictures), 0) = (&mut self.pictures, place) {
                pictures.push(frame);
            }
        }
        Ok(())
    }

    /// Lets a policy process that has just come connect.
    fn keep_alive(&self) -> Result<(), SessionError> {
        for publisher in &self.publishers {
            publisher.keep_alive()?;
        }
        Ok(())
    }
}
