//! What a person says of a run that no task judges: how it went, and a label. It moves nothing and
//! ends nothing.

use trocar_log::{RunMark, RunNote};

use super::demonstration::EpisodeCommand;
use super::hands::Hands;
use super::message::{HandsMessageError, label};

impl Hands {
    /// From now on a person may say how the run went; nothing is said yet.
    pub(crate) fn ask_for_mark(&self) {
        let mut inner = self.lock();
        (inner.said, inner.marked) = (Some(RunNote::default()), None);
    }

    /// The run went so, or that is not said any more.
    ///
    /// # Errors
    /// [`HandsMessageError::NoMark`] if the run does not ask for it.
    pub(crate) fn mark(&self, mark: Option<RunMark>) -> Result<(), HandsMessageError> {
        self.say(mark, None)
    }

    /// The run went so, or that is not said any more; it is called `text` from now on, if that is
    /// given.
    ///
    /// # Errors
    /// [`HandsMessageError::NoMark`] if the run does not ask for it, [`HandsMessageError::Label`]
    /// if `text` is none; nothing is marked then.
    pub(crate) fn say(
        &self,
        mark: Option<RunMark>,
        text: Option<&str>,
    ) -> Result<(), HandsMessageError> {
        let mut inner = self.lock();
        let said = inner.said.as_mut().ok_or(HandsMessageError::NoMark)?;
        if let Some(text) = text {
            label(text)?.clone_into(&mut said.label);
        }
        if said.mark != mark {
            said.mark = mark;
            inner.marked = Some(mark);
        }
        Ok(())
    }

    /// Marks the run as a device at the robot's computer does that keeps or discards a
    /// demonstration; whether it asks for a mark.
    pub(super) fn mark_by(&self, wish: EpisodeCommand) -> bool {
        let mark = match wish {
            EpisodeCommand::Keep => RunMark::Success,
            EpisodeCommand::Discard => RunMark::Discard,
            EpisodeCommand::Start | EpisodeCommand::Redo => return false,
        };
        self.mark(Some(mark)).is_ok()
    }

    /// What is said of the run; none of one that does not ask.
    pub(crate) fn said(&self) -> Option<RunNote> {
        self.lock().said.clone()
    }

    /// What was said of the run, which asks no more.
    pub(crate) fn take_said(&self) -> Option<RunNote> {
        self.lock().said.take()
    }

    /// The newest mark, if it is another than this was asked for last.
    pub(crate) fn take_mark(&self) -> Option<Option<RunMark>> {
        self.lock().marked.take()
    }
}
