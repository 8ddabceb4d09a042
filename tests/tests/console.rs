//! The web console: who may open it, what a page may say, and what it is told; with a browser, what
//! it looks like.
#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "console/access.rs"]
mod access;
#[path = "console/browser.rs"]
mod browser;
#[path = "console/dataset.rs"]
mod dataset;
#[path = "console/desk.rs"]
mod desk;
#[path = "console/devices.rs"]
mod devices;
#[path = "console/devtools.rs"]
mod devtools;
#[path = "console/elsewhere.rs"]
mod elsewhere;
#[path = "console/emulated.rs"]
mod emulated;
#[path = "console/foxglove.rs"]
mod foxglove;
#[path = "console/handover.rs"]
mod handover;
#[path = "console/intervention.rs"]
mod intervention;
#[path = "console/lift.rs"]
mod lift;
#[path = "console/log.rs"]
mod log;
#[path = "console/monitor.rs"]
mod monitor;
#[path = "console/page.rs"]
mod page;
#[path = "console/recorded.rs"]
mod recorded;
#[path = "console/replayed.rs"]
mod replayed;
#[path = "console/run.rs"]
mod run;
#[path = "console/secure.rs"]
mod secure;
#[path = "console/steering.rs"]
mod steering;
#[path = "console/teleop.rs"]
mod teleop;
