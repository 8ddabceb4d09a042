//! The cameras in a real-time run: snapshots in, frames rendered straight into shared memory, pictures and log.

use hal::{CameraFrame, SeenArm, TimeNs};
use trocar_render::Planes;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::scene::SceneSnapshot;
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, FrameHeader, FramePublisher, Publisher, TopicNode,
};

use super::policy_process::arm_names;
use super::signals::{EndsRun, Signals};
use crate::mailbox::MailboxReader;
use crate::rt;
use crate::session::pictures::Pictures;
use crate::session::views::Views;
use crate::session::{Plan, SessionError};
use hal::PerArm;
use trocar_log::{Level, SideLog};

/// Time between two looks for a snapshot, ns.
const POLL_NS: u64 = 1_000_000;

/// What the cameras need to know of one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Snapshot {
    pub(super) step: u64,
    pub(super) arms: PerArm<SeenArm>,
    pub(super) scene: SceneSnapshot,
}

/// The camera thread before it runs.
pub(super) struct CameraThread {
    cameras: SceneCameras,
    /// The cameras that are wanted, by index; publishers and frames are in their order.
    wanted: Vec<usize>,
    publishers: Vec<FramePublisher>,
    /// One an arm, if there is a policy process to read them.
    arms: Vec<Publisher<ArmReport>>,
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
            let stamp = snapshot.arms.first.state.stamp;
            self.views.show(stamp, &snapshot.scene, cameras)?;
        }
        self.views.draw(cameras)
    }
}

/// What it leaves behind.
pub(super) struct CameraEnd {
    pub(super) pictures: Option<Pictures>,
}

impl CameraThread {
    /// Opens the renderer for the cameras `seen` by the policy and those that `plan` asks for, and the topics if there is a
    /// policy process to see them; draws `start` once, since the first image takes far longer than the others.
    pub(super) fn new(
        plan: &Plan,
        seen: &[String],
        node: Option<&TopicNode>,
        (snapshots, console): (MailboxReader<Snapshot>, Option<ConsoleCameras>),
        start: &SceneSnapshot,
    ) -> Result<Self, SessionError> {
        let setup = &plan.setup;
        let mut cameras = SceneCameras::new(&setup.task)?;
        cameras.begin_episode(&setup.task, plan.seed);
        let names = setup.cameras_with(seen.to_vec());
        let wanted: Vec<usize> = names.iter().filter_map(|name| cameras.find(name)).collect();
        let mut publishers = Vec::new();
        let mut arms = Vec::new();
        if let Some(node) = node {
            for name in arm_names(setup.task.arms.len()) {
                arms.push(ArmStateTopic::publisher(node, name)?);
            }
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
            arms,
            log: None,
            snapshots,
            pictures: plan.pictures.then(Pictures::default),
            frames,
            console,
        })
    }

    /// Renders snapshots until the control thread has stopped.
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
                    rt::sleep_ns(POLL_NS);
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
            let stamp = snapshot.arms.first.state.stamp;
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
                // The reports go first, so that they are there when the frame arrives.
                if place == 0 {
                    publish_arms(&self.arms, snapshot)?;
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
        for arm in &self.arms {
            arm.keep_alive()?;
        }
        Ok(())
    }
}

fn publish_arms(to: &[Publisher<ArmReport>], snapshot: &Snapshot) -> Result<(), SessionError> {
    for (publisher, arm) in to.iter().zip(snapshot.arms.iter()) {
        publisher.publish(&ArmReport::new(snapshot.step, &arm.state, &arm.tip_in_rcm))?;
    }
    Ok(())
}
