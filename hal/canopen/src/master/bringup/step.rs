//! What bring-up is at, and what a node that is set up may not say meanwhile.

use core::fmt;

use super::super::fault::is_harmless;
use super::super::plan::{ArmPlan, AxisNode};
use super::BringUpError;
use crate::cia301::emcy::ErrorCode;
use crate::cia301::{Cob, Emergency, NmtState};
use crate::{Frame, NodeId};
use hal::tail::TAIL_AXES;

/// What bring-up is at. All nodes are set up at the same time, and so are axes homed that do not
/// move for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Nodes are reset and asked who they are.
    Finding,
    /// Settings are written to all nodes and read back.
    SettingUp,
    /// Every axis whose encoder is absolute gets its reference where it stands.
    Homing,
    /// The drive of this axis moves it to find its reference.
    Moving(usize),
    /// All is done but the SYNC.
    Waiting,
}

impl Step {
    /// What is being done, for a line on a terminal.
    #[must_use]
    pub fn doing(self) -> String {
        match self {
            Self::Finding => "looking for its nodes".to_owned(),
            Self::SettingUp => "setting them up".to_owned(),
            Self::Homing => "homing them where they stand".to_owned(),
            Self::Moving(axis) => format!("homing axis {axis}, which moves"),
            Self::Waiting => "waiting for the first SYNC".to_owned(),
        }
    }

    /// Whether nodes have settings that a reset would undo.
    const fn has_begun(self) -> bool {
        match self {
            Self::Finding => false,
            Self::SettingUp | Self::Homing | Self::Moving(_) | Self::Waiting => true,
        }
    }

    /// Why `frame`, which came on `line`, ends the bring-up, if it is what a node of `plan` may not
    /// say in this step.
    ///
    /// A reset undoes settings, so from the first one on no node boots up any more. Emergencies of
    /// the time before a node was `set_up` are its own: of the master that it lost by our reset, of
    /// a supply that was not there yet. That an error is gone is no error. But of two nodes with
    /// one number nothing that either sends can be believed, whenever it comes.
    pub(super) fn upset(
        self,
        plan: &ArmPlan,
        set_up: &[bool; TAIL_AXES],
        line: u8,
        frame: &Frame,
    ) -> Option<BringUpError> {
        let axis = |node: NodeId| plan.axis_of(line, node);
        match Cob::of(frame.id) {
            Cob::Heartbeat(node) => {
                let axis = axis(node).filter(|_| self.has_begun())?;
                let boots = NmtState::parse(frame.data()) == Ok(NmtState::BootUp);
                boots.then(|| self.rebooted(plan.who(axis)))
            }
            Cob::Emergency(node) => {
                let axis = axis(node)?;
                let code = Emergency::parse(frame.data()).ok()?.code;
                let counts = set_up[axis] || code == ErrorCode::ID_COLLISION;
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

    const fn rebooted(self, who: AxisNode) -> BringUpError {
        BringUpError::Rebooted { who, step: self }
    }

    const fn emergency(self, who: AxisNode, code: ErrorCode) -> BringUpError {
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
            Self::SettingUp => f.write_str("while the nodes were set up"),
            Self::Homing => f.write_str("while the axes were homed"),
            Self::Moving(axis) => write!(f, "while axis {axis} moved for its homing"),
            Self::Waiting => f.write_str("before the first SYNC"),
        }
    }
}
