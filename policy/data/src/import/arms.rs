//! The numbers of an episode's arms: checked, and made into what a dataset holds.
//!
//! From HDF5 alone; `mapped/arms` does the same for what a mapping describes, where joints may be
//! missing. Here joints are always given and poses follow from them.

use hal::joints::JOINT_NAMES;
use hal::psm::{DhRow, JAW_MAX, JAW_MIN, POSITION_MAX, POSITION_MIN};
use hal::{ARM_NAMES, JOINT_COUNT};

use super::ImportError;
use super::chain::{PoseNumbers, tip_in_rcm};
use super::file::{Numbers, Recording};
use super::names::{Action, Names};
use crate::dataset::{ACTION_WIDTH, ArmFrame, STATE_WIDTH};

/// A recording's noise at a limit, rad (m). Degrees or a normalised gripper exceed the limits by
/// far more.
const SLACK: f64 = 0.02;
/// How far from its RCM a tip can be on any axis, m.
const REACH_M: f64 = 1.0;
/// By how much the length of a quaternion may differ from 1: rounding to single precision, twice.
const UNIT_TOLERANCE: f64 = 1e-3;

/// The arms' numbers of one episode.
#[derive(Debug)]
pub(super) struct Arms {
    /// One or two.
    pub(super) count: usize,
    pub(super) steps: usize,
    /// The arms of a step, step after step.
    frames: Vec<ArmFrame>,
}

impl Arms {
    /// Reads and checks them.
    ///
    /// Each arm's quaternions keep their sign from step to step, of measured and of commanded poses
    /// separately.
    pub(super) fn read(
        recording: &Recording,
        names: &Names,
        chain: &[DhRow; JOINT_COUNT],
    ) -> Result<Self, ImportError> {
        let joints = joints_of(recording, &names.joints)?;
        let (action, pose) = match &names.action {
            Action::Joints(name) => (joints_of(recording, name)?, false),
            Action::Pose(name) => (poses_of(recording, name)?, true),
        };
        let action_width = if pose { ACTION_WIDTH } else { STATE_WIDTH };
        let (count, steps) = (joints.width / STATE_WIDTH, joints.steps());
        let (others, other_steps) = (action.width / action_width, action.steps());
        if (count, steps) != (others, other_steps) {
            let found = format!("has {others} arms and {other_steps} steps");
            let expected = format!("those of {}: {count} and {steps}", names.joints);
            return Err(recording.mismatch(names.action.name(), found, expected));
        }
        let mut seen = [PoseNumbers::default(); ARM_NAMES.len()];
        let mut wanted = seen;
        let rows = joints.values.chunks_exact(STATE_WIDTH);
        let actions = action.values.chunks_exact(action_width);
        let frames = rows.zip(actions).enumerate().map(|(index, (row, action))| {
            let arm = index % count;
            ArmFrame {
                state: std::array::from_fn(|joint| single(row[joint])),
                tip_pose: seen[arm].of(&tip_in_rcm(chain, row)),
                action: match pose {
                    true => std::array::from_fn(|place| action[place]),
                    false => with_jaw(
                        wanted[arm].of(&tip_in_rcm(chain, action)),
                        action[JOINT_COUNT],
                    ),
                },
            }
        });
        Ok(Self {
            count,
            steps,
            frames: frames.collect(),
        })
    }

    /// The arms of each step. psm1 first, then psm2.
    pub(super) fn by_step(&self) -> impl Iterator<Item = &[ArmFrame]> {
        self.frames.chunks_exact(self.count)
    }
}

/// A row of `action`: pose, then jaw (rad).
fn with_jaw(pose: [f64; 7], jaw: f64) -> [f64; ACTION_WIDTH] {
    let [x, y, z, i, j, k, w] = pose;
    [x, y, z, i, j, k, w, jaw]
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a dataset's joints are f32"
)]
const fn single(value: f64) -> f32 {
    value as f32
}

/// `width` numbers for each of one or two arms.
///
/// The number of arms follows from the width of a step.
fn of_arms(recording: &Recording, name: &str, width: usize) -> Result<Numbers, ImportError> {
    let numbers = recording.numbers(name)?;
    if (1..=ARM_NAMES.len()).any(|arms| numbers.width == arms * width) {
        return Ok(numbers);
    }
    let found = format!("has {} numbers a step", numbers.width);
    let expected = format!("{width} for each of one or two arms");
    Err(recording.mismatch(name, found, expected))
}

/// Joints and jaws, which must be within the arm's limits.
fn joints_of(recording: &Recording, name: &str) -> Result<Numbers, ImportError> {
    let numbers = of_arms(recording, name, STATE_WIDTH)?;
    for (index, &value) in numbers.values.iter().enumerate() {
        let joint = index % STATE_WIDTH;
        let (joint, min, max) = match joint {
            JOINT_COUNT => ("jaw", JAW_MIN, JAW_MAX),
            joint => (JOINT_NAMES[joint], POSITION_MIN[joint], POSITION_MAX[joint]),
        };
        if !(min - SLACK..=max + SLACK).contains(&value) {
            return Err(ImportError::Outside {
                place: recording.place.clone(),
                name: name.to_owned(),
                arm: index % numbers.width / STATE_WIDTH + 1,
                joint,
                value,
                step: index / numbers.width,
                min,
                max,
            });
        }
    }
    Ok(numbers)
}

/// What LeRobot's datasets call the robot with so many patient-side manipulators.
#[must_use]
pub const fn robot_type(arms: usize) -> &'static str {
    match arms {
        1 => "dvrk_psm",
        _ => "bi_dvrk_psm",
    }
}

/// Commanded tip poses and jaws.
///
/// Quaternions must be of unit length and positions within a metre, which catches millimetres and
/// most deltas.
fn poses_of(recording: &Recording, name: &str) -> Result<Numbers, ImportError> {
    let numbers = of_arms(recording, name, ACTION_WIDTH)?;
    for (index, row) in numbers.values.chunks_exact(ACTION_WIDTH).enumerate() {
        let arms = numbers.width / ACTION_WIDTH;
        if let Some(found) = out_of_reach(row, index % arms + 1, index / arms) {
            let expected = format!(
                "positions in m within [-{REACH_M}, {REACH_M}] and the jaw in rad within [{JAW_MIN:.3}, {JAW_MAX:.3}]"
            );
            return Err(recording.mismatch(name, found, expected));
        }
        let length = row[3..7].iter().map(|part| part * part).sum::<f64>().sqrt();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            return Err(ImportError::Quaternion {
                place: recording.place.clone(),
                name: name.to_owned(),
                arm: index % arms + 1,
                length,
                step: index / arms,
            });
        }
    }
    Ok(numbers)
}

/// Where the pose `row` of an arm is, if it is farther than any arm gets.
fn out_of_reach(row: &[f64], arm: usize, step: usize) -> Option<String> {
    let jaw = JAW_MIN - SLACK..=JAW_MAX + SLACK;
    let within = row[..3].iter().all(|along| along.abs() <= REACH_M);
    if within && jaw.contains(&row[7]) {
        return None;
    }
    Some(format!(
        "of arm {arm} is at {:.4e}, {:.4e}, {:.4e} with the jaw at {:.4e} in step {step}",
        row[0], row[1], row[2], row[7],
    ))
}
