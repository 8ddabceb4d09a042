//! Why an arm did not come up, with the node and the object.

use super::super::fault::Fault;
use super::super::plan::AxisNode;
use super::Step;
use crate::bus_load::Overload;
use crate::cia301::emcy::{ErrorCode, ErrorRegister};
use crate::cia301::{AbortCode, Address};
use crate::cia402::Mode;
use crate::{Frame, NodeId};

/// Why an arm did not come up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BringUpError {
    /// The plan is more than a bus can carry.
    #[error("{0}")]
    Overload(#[from] Overload),
    /// The send queue stays full.
    #[error("bus {line}: no room in the send queue")]
    CannotSend {
        /// The bus.
        line: u8,
    },
    /// Our controller left the bus, even if it is back, or the interface is down.
    #[error("bus {line}: bus-off or down")]
    Off {
        /// The bus.
        line: u8,
    },
    /// Frames were lost between the bus and us since we have said something: what they said is not
    /// known.
    #[error("bus {line}: {count} frames were lost before they were read, {step}")]
    FramesLost {
        /// The bus.
        line: u8,
        /// How many, by the first report.
        count: u32,
        /// When it was reported.
        step: Step,
    },
    /// A second master commands these nodes.
    #[error("bus {line}: another master sends {frame}")]
    ForeignMaster {
        /// The bus.
        line: u8,
        /// What was heard.
        frame: Frame,
    },
    /// A node does not boot up when it is reset.
    #[error("{0}: does not answer to a reset")]
    Missing(AxisNode),
    /// A node does not answer a transfer.
    #[error("node {node}: no answer about {address}")]
    NoAnswer {
        /// The node.
        node: NodeId,
        /// The object.
        address: Address,
    },
    /// A node answers something else than was asked.
    #[error("node {node}: invalid SDO response about {address}")]
    Confused {
        /// The node.
        node: NodeId,
        /// The object.
        address: Address,
    },
    /// A node refuses a transfer.
    #[error("node {node}: refuses {address}: {code}")]
    Refused {
        /// The node.
        node: NodeId,
        /// The object.
        address: Address,
        /// Why.
        code: AbortCode,
    },
    /// A node is not what the plan says.
    #[error("{who}: {address} is {found:#x} instead of {expected:#x}")]
    Identity {
        /// The node.
        who: AxisNode,
        /// The object.
        address: Address,
        /// What it should be.
        expected: u32,
        /// What it is.
        found: u32,
    },
    /// A node lacks a mode of operation.
    #[error("{who}: has no {mode:?} mode")]
    Mode {
        /// The node.
        who: AxisNode,
        /// The mode.
        mode: Mode,
    },
    /// A node has another value than it was given, and not one that is as safe.
    #[error("node {node}: {address} is {found}, allowed [{least}, {most}]")]
    Setting {
        /// The node.
        node: NodeId,
        /// The object.
        address: Address,
        /// What it has.
        found: i64,
        /// The least that it may have.
        least: i64,
        /// The most that it may have.
        most: i64,
    },
    /// A node has another COB-ID than it was given: a PDO that stays on or off, or goes by another
    /// identifier.
    #[error(
        "node {node}: {address} is {found:08X}h after {written:08X}h was written, and they may not differ in {mask:08X}h"
    )]
    CobId {
        /// The node.
        node: NodeId,
        /// The object.
        address: Address,
        /// What it was given.
        written: u32,
        /// What it has.
        found: u32,
        /// The bits that matter.
        mask: u32,
    },
    /// The interpolation period cannot be said in 60C2h.
    #[error("a cycle of {cycle_ns} ns has no value in 60C2h")]
    Period {
        /// The cycle.
        cycle_ns: u64,
    },
    /// A drive does not reach a state that homing needs.
    #[error("{who}: homing failed, status word {status:#06x}")]
    Homing {
        /// The node.
        who: AxisNode,
        /// What it says.
        status: u32,
    },
    /// A drive does not offer the homing method of the plan, by its 60E3h.
    #[error("{who}: does not offer homing method {method}")]
    HomingMethod {
        /// The node.
        who: AxisNode,
        /// 6098h.
        method: i8,
    },
    /// A drive reports a homing error.
    #[error("{who}: homing error, status word {status:#06x}")]
    HomingError {
        /// The node.
        who: AxisNode,
        /// Its status word, with bit 13.
        status: u32,
    },
    /// A drive has not found its reference in time.
    #[error("{who}: homing not complete after {limit_s} s, status word {status:#06x}")]
    HomingTimeOut {
        /// The node.
        who: AxisNode,
        /// The time limit.
        limit_s: f64,
        /// Its status word.
        status: u32,
    },
    /// Homing was cancelled; the axis was stopped on its way to the home position.
    #[error("{who}: homing was cancelled")]
    Cancelled {
        /// The node.
        who: AxisNode,
    },
    /// A drive is in fault when it is to be homed.
    #[error("{who}: is in fault: {code}; bring-up resets no faults")]
    Faulty {
        /// The node.
        who: AxisNode,
        /// What its object 603Fh says.
        code: ErrorCode,
    },
    /// A node still has an error before the first SYNC that is none of the communication.
    #[error("{who}: has an error before the first SYNC, its 1001h says {register}")]
    Unsound {
        /// The node.
        who: AxisNode,
        /// What it says.
        register: ErrorRegister,
    },
    /// A node has lost a setting, and no boot-up was received.
    #[error(
        "{who}: {address} is {found:#x} and was set to {expected:#x}: it must have been reset unnoticed"
    )]
    Forgotten {
        /// The node.
        who: AxisNode,
        /// The object.
        address: Address,
        /// What it was given.
        expected: u32,
        /// What it has.
        found: u32,
    },
    /// A node was reset after it had been set up: it is no more as it was set.
    #[error("{who}: booted up again, {step}")]
    Rebooted {
        /// The node.
        who: AxisNode,
        /// When it was heard.
        step: Step,
    },
    /// A node sent an emergency after it had been set up, or at any time that there is another one
    /// with its number.
    #[error("{who}: emergency {code}, {step}")]
    Emergency {
        /// The node.
        who: AxisNode,
        /// Its error code.
        code: ErrorCode,
        /// When it was heard.
        step: Step,
    },
    /// The arm failed while it was being enabled.
    #[error("{0}")]
    Fault(Fault),
    /// The drives were not enabled in time.
    #[error("the drives did not become enabled in time")]
    Slow,
    /// The drives were not enabled for this cause, and not all have confirmed thereafter that they
    /// are without torque.
    #[error("{0}; not all drives have confirmed that they have no torque")]
    NotDown(Box<BringUpError>),
    /// The drives may not have torque.
    #[error("the drives may not be enabled")]
    Denied,
}
