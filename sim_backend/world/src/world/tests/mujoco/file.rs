//! The file that the simulator and MuJoCo share: parameters, loads, and what one of them made of
//! these.

use core::fmt::Write as _;

use hal::JOINT_COUNT;
use serde::Deserialize;

use crate::plant::AxisVector;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) parameters: Parameters,
    #[serde(rename = "static")]
    pub(super) still: Vec<Still>,
    pub(super) run: Vec<Run>,
}

/// All that the model is made of.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Parameters {
    /// Alpha, a, d, theta, and 1 for a joint that slides.
    pub(super) dh: Vec<[f64; 5]>,
    pub(super) tip_from_wrist_yaw: [[f64; 3]; 3],
    pub(super) coupling: [[f64; 4]; 4],
    pub(super) inertia: AxisVector,
    pub(super) coulomb: AxisVector,
    pub(super) viscous: AxisVector,
    pub(super) p: AxisVector,
    pub(super) d: AxisVector,
    pub(super) encoder_counts: AxisVector,
    pub(super) gear_ratio: AxisVector,
    pub(super) current_max: AxisVector,
    pub(super) torque_constant: AxisVector,
    pub(super) effort_max: AxisVector,
}

/// A force and a moment at the tip of an arm that does not move.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Still {
    pub(super) joints: [f64; JOINT_COUNT],
    pub(super) wrench: [f64; 6],
    pub(super) efforts: [f64; JOINT_COUNT],
    pub(super) tip: [f64; 7],
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    Torque,
    Force,
    Drive,
}

/// One second or so of motion: joints and tip (place, quaternion xyzw) every `sample_ms`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Run {
    pub(super) kind: Kind,
    pub(super) milliseconds: u32,
    pub(super) sample_ms: u32,
    pub(super) start: AxisVector,
    /// Waves of joint efforts, or of force and moment.
    #[serde(default)]
    pub(super) amplitude: Vec<f64>,
    #[serde(default)]
    pub(super) frequency_hz: Vec<f64>,
    /// Where the drives are told to go.
    #[serde(default)]
    pub(super) target: Vec<f64>,
    pub(super) joints: Vec<AxisVector>,
    pub(super) tips: Vec<[f64; 7]>,
}

/// Our side in the form of the golden file.
pub(super) fn dump(file: &File) -> String {
    let p = &file.parameters;
    let mut text = format!(
        "[parameters]\ndh = {:?}\ntip_from_wrist_yaw = {:?}\ncoupling = {:?}\n",
        p.dh, p.tip_from_wrist_yaw, p.coupling
    );
    for (name, values) in [
        ("inertia", p.inertia),
        ("coulomb", p.coulomb),
        ("viscous", p.viscous),
        ("p", p.p),
        ("d", p.d),
        ("encoder_counts", p.encoder_counts),
        ("gear_ratio", p.gear_ratio),
        ("current_max", p.current_max),
        ("torque_constant", p.torque_constant),
        ("effort_max", p.effort_max),
    ] {
        writeln!(text, "{name} = {values:?}").unwrap();
    }
    for still in &file.still {
        writeln!(
            text,
            "\n[[static]]\njoints = {:?}\nwrench = {:?}\nefforts = {:?}\ntip = {:?}",
            still.joints, still.wrench, still.efforts, still.tip
        )
        .unwrap();
    }
    for run in &file.run {
        let kind = format!("{:?}", run.kind).to_lowercase();
        writeln!(
            text,
            "\n[[run]]\nkind = \"{kind}\"\nmilliseconds = {}\nsample_ms = {}\nstart = {:?}",
            run.milliseconds, run.sample_ms, run.start
        )
        .unwrap();
        for (name, values) in [
            ("amplitude", &run.amplitude),
            ("frequency_hz", &run.frequency_hz),
            ("target", &run.target),
        ] {
            if !values.is_empty() {
                writeln!(text, "{name} = {values:?}").unwrap();
            }
        }
        writeln!(text, "joints = {:?}\ntips = {:?}", run.joints, run.tips).unwrap();
    }
    text
}
