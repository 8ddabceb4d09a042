//! The master of an arm: it finds its drives, brings them to where they may be enabled, and sends
//! SYNC.
//!
//! [`plan`] says which node drives what, [`config`] reads it from `config/can.toml`. [`bringup`] is
//! the way to an enabled arm, a type a step; [`cycle`] is what happens between two SYNCs, without
//! clock or socket; [`arm`] makes a [`hal::Arm`] of it. [`link`] is the interface to the buses.
//!
//! What the master does about what can go wrong. "Lost" means that [`CanArm`] reports a lost
//! measurement, whereupon the controller plays its verified stop; "fault" means that every drive
//! that still receives set-points gets a quick stop, half a second later disable voltage, and that
//! nothing but a new bring-up leads out of it.
//!
//! ```text
//! what                                     noticed by                      reaction
//! bus-off, restarted, interface down       error frame                     fault at once; that bus is not sent to again
//! error passive, lost frames               error frame, receive counter    counted and reported
//! no room to send                          short send                      2 cycles lost, 20 cycles fault
//! TPDO missing, late, short, malformed     per-axis age                    extrapolated; 3 cycles lost, 20 cycles fault
//! or out of reach (none can be longer)
//! TPDOs missing or late too often          counted against those in time,  more than one in four: fault
//! or always                                SYNCs that are left out, below
//! set-point or SYNC short or long          the drive's emergency           fault with the drive's code
//! set-point or SYNC missing                the drive's own watchdogs       one is interpolated; 10 cycles fault
//! set-point with another target            following error                 fault; no faster than the drive may be
//! heartbeat missing                        three periods                   fault
//! boot-up or another NMT state             heartbeat                       fault; a node that takes no set-points is stopped
//! emergency                                its frame                       fault with the drive's code
//! not enabled any more                     status word                     fault
//! following error                          status word, own comparison     fault
//! power lost                               status word                     fault
//! another node's SYNC, NMT, set-points      their identifiers               fault, and the nodes are stopped in every cycle:
//! or SDO writes                                                            they take no set-points; our heartbeat ends
//! the same during bring-up                 their identifiers               no arm
//! boot-up or emergency of a drive that is  its frame                       no arm, and the nodes are stopped
//! set up, before the first SYNC
//! frames lost after our first, before       receive counter                 no arm, and the nodes are stopped
//! the nodes start
//! an earlier error, an unnoticed reset     bring-up reads before the start  no arm, and the nodes are stopped
//! duplicate node-ID                        the drive's emergency           fault; no arm if it was there before
//! wrong identity                           bring-up                        no arm
//! stored offset, PDOs, timers, time stamps bring-up                        cleared; no arm if a drive keeps them
//! stored limits, stops, torque, window     bring-up                        written; no arm if a drive keeps less safe ones
//! another encoder than planned             bring-up                        no arm
//! controller silent, NaN or a jump         no set-point in reach           the tail is played to rest
//! own process dead                         the drives' own watchdogs       they stop by themselves
//! ```
//!
//! A PDO does not say which SYNC it answers, so one that is always late by a cycle looks like the
//! next cycle's. But a node that becomes late, or is so from the first SYNC on, misses a cycle.
//! From then on a TPDO is taken, but may be as old as the first SYNC without one; and the next SYNC
//! is left out, over which drives interpolate. What comes meanwhile was late; if more may come, up
//! to two more SYNCs are left out. Then TPDOs and SYNCs are in phase again. A late TPDO is known as
//! such if it comes within four cycles of its SYNC and TPDOs are about equally late: where that
//! varies by cycles from one to the next, one may be up to three cycles older than it is reported
//! to be. Once a fault is latched every SYNC is sent.
//!
//! What goes before a quick stop. A bus has one queue, the kernel's and then the controller's, in
//! which nothing overtakes and from which nothing is called back. Set-points, SYNCs and heartbeats
//! are all that is in it when a drive is commanded: transfers of objects end with bring-up, each
//! answered or given up, and NMT stops come only after a fault, behind a SYNC. What finds no room
//! is forgotten; the next cycle's frames are made anew, from what is known then. So what goes
//! before a quick stop is what the queue already held: no more frames than it has places, which are
//! better few (a cycle has up to 16, with NMT stops). Of a part that finds room the SYNC is the
//! first, then NMT stops, then the set-points of drives that still follow, and of these the ones
//! that were sent least often: each is sent once before one is sent twice. None is said again
//! before the SYNC, though that would mostly save a period: how much room there is is unknown, and
//! where it takes the place of the SYNC all wait for the next.
//!
//! The head of that queue, too, waits while others have a frame with a lower identifier. TPDOs
//! (181h and up) win arbitration over set-points (201h and up), so on a bus that another node's
//! SYNCs fill with TPDOs a quick stop waits for as long as they do. What stops the drives then is
//! NMT stop (000h), once the frames before it are out, and at the latest their own watchdogs.

mod answers;
pub mod arm;
pub mod axis;
pub mod bringup;
pub mod config;
pub mod cycle;
pub mod fault;
mod foreign;
pub mod link;
pub mod plan;
pub mod space;

pub use arm::CanArm;
pub use bringup::client;
pub use bringup::{BringUpError, Homed, Offline, Permission, Step, enable_together};
pub use config::CanConfig;
pub use fault::Fault;
pub use link::{Bus, ControllerEvent, Received};
pub use plan::{ArmPlan, AxisNode, AxisPlan};
pub use space::Space;
