//! What bring-up is at, and what a node that is set up may not say meanwhile.

use core::fmt;

use super::super::fault::{Who, is_harmless};
use super::super::plan::ArmPlan;
use super::BringUpError;
use crate::cia301::emcy::ErrorCode;
use crate::cia301::{Cob, Emergency, NmtState};
use crate::{Frame, NodeId};

/// What bring-up is at. Nodes are set up and homed in the order of the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Nodes are reset and asked who they are.
    Finding,
    /// The node of this axis is set up.
    SettingUp(usize),
    /// The axis gets its reference.
    Homing(usize),
    /// All is done but the SYNC.
    Waiting,
}

impl Step {
    /// What is being done, for a line on a terminal.
    #[must_use]
    pub fn doing(self) -> String {
        match self {
            Self::Finding => "looking for its nodes".to_owned(),
            Self::SettingUp(axis) => format!("setting up axis {axis}"),
            Self::Homing(axis) => format!("homing axis {axis}"),
            Self::Waiting => "waiting for the first SYNC".to_owned(),
        }
    }

    /// Whether the node of `axis` has been told something that a reset would undo.
    const fn has_begun(self, axis: usize) -> bool {
        match self {
            Self::Finding => false,
            Self::SettingUp(at) => axis <= at,
            Self::Homing(_) | Self::Waiting => true,
        }
    }

    /// Whether the node of `axis` has been told all.
    const fn is_set_up(self, axis: usize) -> bool {
        match self {
            Self::Finding => false,
            Self::SettingUp(at) => axis < at,
            Self::Homing(_) | Self::Waiting => true,
        }
    }

    /// Why `frame`, which came on `line`, ends the bring-up, if it is what a node of `plan` may not say in this step.
    ///
    /// A reset undoes what a node was told, so from its first setting on it boots up no more. What it has to tell of the time
    /// before it was set up is its own: of the master that it lost by our reset, of a supply that was not there yet. That an
    /// error is gone is no error. But of two nodes with one number nothing that either says can be believed, whenever they tell.
    pub(super) fn upset(self, plan: &ArmPlan, line: u8, frame: &Frame) -> Option<BringUpError> {
        let axis = |node: NodeId| plan.axis_of(line, node);
        match Cob::of(frame.id) {
            Cob::Heartbeat(node) => {
                let axis = axis(node).filter(|axis| self.has_begun(*axis))?;
                let boots = NmtState::parse(frame.data()) == Ok(NmtState::BootUp);
                boots.then(|| self.rebooted(plan.who(axis)))
            }
            Cob::Emergency(node) => {
                let axis = axis(node)?;
                let code = Emergency::parse(frame.data()).ok()?.code;
                let counts = self.is_set_up(axis) || code == ErrorCode::ID_COLLISION;
                (counts && !is_harmless(code)).then(|| self.emergency(plan.who(axis), code))
            }
            Cob::Nmt
            | Cob::Sync
            | Cob::Time
            | Cob::TransmitPdo(..)
            | Cob::ReceivePdo(..)
            | Cob::SdoResponse(_)
            | Cob::SdoRequest(_)
            | Cob::Other(_) => None,
        }
    }

    const fn rebooted(self, who: Who) -> BringUpError {
        BringUpError::Rebooted { who, step: self }
    }

    const fn emergency(self, who: Who, code: ErrorCode) -> BringUpError {
        BringUpError::Emergency {
            who,
            code,
            step: self,
        }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Finding => f.write_str("while the nodes were looked for"),
            Self::SettingUp(axis) => write!(f, "while axis {axis} was set up"),
            Self::Homing(axis) => write!(f, "while axis {axis} was homed"),
            Self::Waiting => f.write_str("before the first SYNC"),
        }
    }
}
