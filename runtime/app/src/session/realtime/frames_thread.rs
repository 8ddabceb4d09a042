//! The frames of our cameras' process in a real-time run: into the log, the pictures and the
//! console; and the process itself, looked after.

use hal::{CameraFrame, Intrinsics};
use trocar_log::{Level, SideLog};
use trocar_topics::{CameraTopic, FrameSubscriber, FrameView, TopicNode};

use super::cameras_child::CamerasChild;
use super::cameras_process::for_console;
use super::remote_arms::Camera;
use super::signals::{EndRunOnDrop, HoldCause, Signals};
use super::supervisor::Supervisor;
use crate::console::{FramePlanes, FrameTap};
use crate::rt::{self, MonotonicClock};
use crate::session::external::LOOK_NS;
use crate::session::pictures::Thumbnails;
use crate::session::{Plan, SessionError};

/// The thread before it runs.
pub(super) struct FramesThread {
    child: Option<CamerasChild>,
    /// What the policy lacks without the process, if it looks through one of its cameras.
    lacking: Option<HoldCause>,
    /// For the log and the pictures, whose camera is the first.
    cameras: Vec<Camera>,
    /// Kept only if they will be looked at.
    pictures: Option<Thumbnails>,
    frame: CameraFrame,
    pages: Option<Pages>,
}

/// The console, and what it is shown of each camera of the task.
struct Pages {
    to: FrameTap,
    topics: Vec<FrameSubscriber>,
}

/// What it leaves behind.
#[derive(Default)]
pub(super) struct FramesEnd {
    pub(super) pictures: Option<Thumbnails>,
    /// Why the run was ended from here, if it was: the cameras were gone for good.
    pub(super) ended_by: Option<String>,
}

impl FramesThread {
    /// Reads the frames of the cameras `wanted` that `child` shows, of which `plan` keeps some; a
    /// policy looks through some of them if they are `needed`.
    pub(super) fn open(
        plan: &Plan,
        child: CamerasChild,
        node: &TopicNode,
        (wanted, needed): (&[String], bool),
    ) -> Result<Self, SessionError> {
        let keeps = plan.log.is_some() || plan.pictures;
        let kept = wanted.iter().filter(|_| keeps).map(|name| {
            let topic = CameraTopic::subscriber(node, name)?;
            Ok((name.clone(), topic))
        });
        let pages = plan.console.as_ref().map(|console| {
            let names = plan.setup.camera_names().into_iter();
            let topics = names.map(|name| CameraTopic::subscriber(node, &for_console(&name)));
            Ok::<_, SessionError>(Pages {
                to: console.frames(),
                topics: topics.collect::<Result<_, _>>()?,
            })
        });
        Ok(Self {
            child: Some(child),
            lacking: needed.then_some(HoldCause::Frames),
            cameras: kept.collect::<Result<_, SessionError>>()?,
            pictures: plan.pictures.then(Thumbnails::default),
            frame: CameraFrame::blank(Intrinsics::default()),
            pages: pages.transpose()?,
        })
    }

    /// Takes frames until the control thread has stopped; ends the run if the policy's cameras are
    /// gone for good.
    pub(super) fn run(
        mut self,
        plan: &Plan,
        clock: MonotonicClock,
        mut log: Option<SideLog>,
        signals: &Signals,
    ) -> Result<FramesEnd, SessionError> {
        let _ends = EndRunOnDrop(signals);
        let rules = (plan.setup.robot.control.supervision, plan.warn);
        let mut supervisor = Supervisor::new(self.lacking, clock, rules);
        let mut ended_by = None;
        while !signals.stopped() {
            signals.write_told(log.as_mut());
            self.keep(clock, log.as_mut())?;
            self.show(clock)?;
            if !signals.done() {
                ended_by = self.look_after(&mut supervisor, signals)?;
                if ended_by.is_some() {
                    signals.end_run();
                }
            }
            match &self.child {
                Some(child) => child.wait(LOOK_NS),
                None => rt::sleep_ns(LOOK_NS),
            }
        }
        signals.write_told(log.as_mut());
        Ok(FramesEnd {
            pictures: self.pictures,
            ended_by,
        })
    }

    /// Starts the process again when it is time to; why the run ends with it, if so. A run whose
    /// policy needs none goes on without frames.
    fn look_after(
        &mut self,
        supervisor: &mut Supervisor,
        signals: &Signals,
    ) -> Result<Option<String>, SessionError> {
        let Some(child) = &mut self.child else {
            return Ok(None);
        };
        let Some(reason) = supervisor.look_after(child, signals)? else {
            return Ok(None);
        };
        if self.lacking.is_some() {
            return Ok(Some(reason));
        }
        let text = format!("{reason}; the run goes on without its frames");
        supervisor.tell(signals, Level::Warning, &text);
        self.child = None;
        Ok(None)
    }

    /// Keeps what has come.
    fn keep(
        &mut self,
        clock: MonotonicClock,
        mut log: Option<&mut SideLog>,
    ) -> Result<(), SessionError> {
        for (place, (name, topic)) in self.cameras.iter_mut().enumerate() {
            let Some(view) = topic.newest()? else {
                continue;
            };
            view.to_frame(&mut self.frame);
            self.frame.stamp = clock.from_system(self.frame.stamp);
            if let Some(log) = &mut log {
                log.frame(name, &self.frame);
            }
            if let (Some(pictures), 0) = (&mut self.pictures, place) {
                pictures.push(&self.frame);
            }
        }
        Ok(())
    }

    /// Shows pages what was drawn for them.
    fn show(&mut self, clock: MonotonicClock) -> Result<(), SessionError> {
        let Some(pages) = &mut self.pages else {
            return Ok(());
        };
        for (camera, topic) in pages.topics.iter_mut().enumerate() {
            if let Some(view) = topic.newest()? {
                show_view(&pages.to, camera, &view, clock);
            }
        }
        Ok(())
    }
}

/// Shows pages what they want of `view`, the newest frame of the task's camera of this index, by
/// the run's `clock`.
pub(super) fn show_view(to: &FrameTap, camera: usize, view: &FrameView, clock: MonotonicClock) {
    let header = view.header();
    let planes = FramePlanes {
        colour: view.colour(),
        depth_m: view.depth_m(),
        instance: view.instance(),
    };
    let seen_from = (&header.intrinsics, &header.camera_in_scene());
    let stamp = clock.from_system(header.stamp);
    to.show(camera, stamp, seen_from, &planes);
}
