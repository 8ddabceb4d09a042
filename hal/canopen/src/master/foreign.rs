//! Who else leads our drives: what is for one master alone to say.

use super::plan::ArmPlan;
use crate::cia301::{Cob, NmtTarget, nmt};
use crate::{Frame, NodeId};

/// Whether only the master of `plan` may say `frame`, which another node has sent on `line`: its
/// SYNC, its heartbeat, network management and set-points for its nodes, and what is written to
/// their dictionaries. Reading these is anybody's.
pub(super) fn leads(plan: &ArmPlan, line: u8, frame: &Frame) -> bool {
    let ours = |node: NodeId| plan.axis_of(line, node).is_some();
    match Cob::of(frame.id) {
        _ if frame.id == plan.sync_id => true,
        Cob::Nmt => match nmt::NmtView(frame.data()).target() {
            Ok(NmtTarget::Node(node)) => ours(node),
            Ok(NmtTarget::All) => true,
            Err(_) => false,
        },
        Cob::ReceivePdo(_, node) => ours(node),
        Cob::Heartbeat(node) => node == plan.master,
        // Whoever writes changes what the drives do behind our back.
        Cob::SdoRequest(node) => ours(node) && is_download(frame.data()),
        Cob::Sync
        | Cob::Time
        | Cob::Emergency(_)
        | Cob::TransmitPdo(..)
        | Cob::SdoResponse(_)
        | Cob::Other(_) => false,
    }
}

/// Whether an SDO client begins or continues to write: its command specifier (CiA 301, 7.2.4.3) is
/// that of a download segment, of a download's beginning, or of a block download.
fn is_download(data: &[u8]) -> bool {
    data.first()
        .is_some_and(|command| matches!(command >> 5, 0 | 1 | 6))
}
