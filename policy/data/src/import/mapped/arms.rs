//! The numbers of an episode's arms by a mapping: checked, brought to metres, radians and the arm's
//! RCM frame.
//!
//! Order of work in a step: the jaw, the measured pose into the RCM frame, joints as given or from
//! the pose by inverse kinematics, the command, and the check that the two belong together. Nothing
//! is clipped or repaired: the first number that can't be right ends the import.

use std::collections::BTreeMap;

use hal::joints::{JOINT_NAMES, ROLL};
use hal::psm::{DH, JAW_MAX, JAW_MIN, POSITION_MAX, POSITION_MIN};
use hal::{JOINT_COUNT, Pose};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use super::super::ImportError;
use super::super::chain::{PoseNumbers, tip_in_rcm};
use super::super::inverse::{SLACK, joints_at};
use super::mapping::{ArmMapping, Columns, Frame, Mapping, QuaternionOrder};
use super::recordings::{Numbers, Recordings};
use crate::dataset::ArmFrame;

/// By how much the length of a quaternion may differ from 1. What is within it is normalised.
const UNIT_TOLERANCE: f64 = 1e-3;
/// How far a commanded tip can be from the measured one, m: beyond, it is no absolute command of
/// this arm.
const COMMAND_AWAY_MAX_M: f64 = 0.1;

/// Furthest that a command may be turned from the measured tip, rad: a quarter turn.
const COMMAND_TURNED_MAX_RAD: f64 = std::f64::consts::FRAC_PI_2;

/// The frames of one episode, a list a step with the arms in it.
pub(super) type ArmFrames = Vec<Vec<ArmFrame>>;

/// Reads and checks an episode's arms. `arms` are those of the mapping that the first episode has;
/// see [`arms_of`].
///
/// # Errors
/// An [`ImportError`] with the file, the episode, the mapping's key, the arm and the step.
pub(super) fn read_arms(
    recordings: &mut dyn Recordings,
    episode: usize,
    mapping: &Mapping,
    arms: &[ArmMapping],
) -> Result<ArmFrames, ImportError> {
    let place = recordings.place(episode);
    let steps = recordings.steps(episode)?;
    let mut frames: ArmFrames = vec![Vec::with_capacity(arms.len()); steps];
    for (index, arm) in arms.iter().enumerate() {
        let parts = Parts::read(recordings, episode, arm)?;
        let reader = ArmReader {
            place: &place,
            number: index + 1,
            mapping,
            rcm_from_source: arm.rcm_in_source.as_ref().map(|it| pose_of(it).inverse()),
            parts,
        };
        let mut state = Following::default();
        for (step, frame) in frames.iter_mut().enumerate() {
            frame.push(reader.frame(step, &mut state)?);
        }
    }
    Ok(frames)
}

/// The arms of the mapping that an episode has.
///
/// # Errors
/// [`ImportError::Missing`] if the first is not there, or the second in part.
pub(super) fn arms_of(
    recordings: &mut dyn Recordings,
    episode: usize,
    mapping: &Mapping,
) -> Result<Vec<ArmMapping>, ImportError> {
    let mut arms = Vec::new();
    for arm in &mapping.arms {
        if arm.optional && !is_there(recordings, episode, arm)? {
            continue;
        }
        arms.push(arm.clone());
    }
    match arms.is_empty() {
        false => Ok(arms),
        true => Err(ImportError::Missing {
            place: recordings.place(episode),
            name: "each arm of the mapping".to_owned(),
        }),
    }
}

/// Whether an episode has any of the numbers of an arm.
///
/// Any one of them: an arm of which some are missing is then refused rather than left out.
fn is_there(
    recordings: &mut dyn Recordings,
    episode: usize,
    arm: &ArmMapping,
) -> Result<bool, ImportError> {
    for (_, columns, _) in arm.parts() {
        let numbers = recordings.numbers(episode, &columns.feature)?;
        let named = columns
            .names
            .iter()
            .any(|name| numbers.names.contains(name));
        let numbered = columns.indices.iter().any(|&index| index < numbers.width);
        let whole = columns.names.is_empty() && columns.indices.is_empty();
        if named || numbered || whole {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The parts of an arm by the mapping's key, row after row, in the mapping's order. The value is
/// the width of a row and the row-major numbers, in the source's units.
struct Parts(BTreeMap<&'static str, (usize, Vec<f64>)>);

impl Parts {
    fn read(
        recordings: &mut dyn Recordings,
        episode: usize,
        arm: &ArmMapping,
    ) -> Result<Self, ImportError> {
        let mut parts = BTreeMap::new();
        for (key, columns, width) in arm.parts() {
            let place = recordings.place(episode);
            let numbers = recordings.numbers(episode, &columns.feature)?;
            let chosen = chosen(&place, key, &numbers, columns, width)?;
            let rows = numbers.values.chunks_exact(numbers.width.max(1));
            let mut values = Vec::with_capacity(width * rows.len());
            for (step, row) in rows.enumerate() {
                for &index in &chosen {
                    if !row[index].is_finite() {
                        let name = format!("{key} in {}", columns.feature);
                        return Err(ImportError::NotFinite { place, name, step });
                    }
                    values.push(row[index]);
                }
            }
            parts.insert(key, (width, values));
        }
        Ok(Self(parts))
    }

    /// The part `key` of a step, if the mapping has it.
    fn row(&self, key: &str, step: usize) -> Option<&[f64]> {
        let (width, values) = self.0.get(key)?;
        values.get(step * width..(step + 1) * width)
    }
}

/// Indices of `columns` in the numbers of their feature.
///
/// Names win where they are given; otherwise indices; otherwise all numbers, of which there must
/// then be `width`.
fn chosen(
    place: &str,
    key: &str,
    numbers: &Numbers,
    columns: &Columns,
    width: usize,
) -> Result<Vec<usize>, ImportError> {
    let missing = |what: String| ImportError::Missing {
        place: place.to_owned(),
        name: format!(
            "{what} of feature {}, {key} of the mapping,",
            columns.feature
        ),
    };
    if !columns.names.is_empty() {
        let index = |name: &String| {
            let found = numbers.names.iter().position(|other| other == name);
            let found = found.filter(|&index| index < numbers.width);
            found.ok_or_else(|| missing(name.clone()))
        };
        return columns.names.iter().map(index).collect();
    }
    let all: Vec<usize> = (0..numbers.width).collect();
    let chosen = match columns.indices.is_empty() {
        true => all,
        false => columns.indices.clone(),
    };
    if let Some(index) = chosen.iter().find(|&&index| index >= numbers.width) {
        return Err(missing(format!("number {index}")));
    }
    if chosen.len() != width {
        return Err(ImportError::Mismatch {
            place: place.to_owned(),
            name: format!("{}, {key} of the mapping,", columns.feature),
            found: format!("has {} numbers a step", chosen.len()),
            expected: width.to_string(),
        });
    }
    Ok(chosen)
}

/// What goes over from step to step.
#[derive(Default)]
struct Following {
    /// Signs of the measured quaternions.
    seen: PoseNumbers,
    /// Signs of the commanded ones.
    wanted: PoseNumbers,
    /// The last roll (rad), so that the inverse kinematics stays on the same turn; 0 in the first
    /// step.
    roll: f64,
}

/// One arm of one episode.
struct ArmReader<'a> {
    place: &'a str,
    /// From 1.
    number: usize,
    mapping: &'a Mapping,
    /// Takes poses of the source's frame into the RCM frame; none if they are in it.
    rcm_from_source: Option<Pose>,
    /// The arm's numbers of the whole episode.
    parts: Parts,
}

impl ArmReader<'_> {
    /// One step of the arm, in m and rad. Given joints are kept even where a pose is given too; the
    /// two are not compared.
    fn frame(&self, step: usize, following: &mut Following) -> Result<ArmFrame, ImportError> {
        let jaw = self.jaw("jaw", step)?;
        let pose = self.pose(["tip_position", "tip_orientation"], step)?;
        let given = self.joints("joints", step)?;
        let joints = match (given, &pose) {
            (Some(joints), _) => joints,
            (None, Some(pose)) => {
                let found = joints_at(pose, following.roll);
                found.map_err(|reason| self.out_of_reach(step, reason))?
            }
            (None, None) => return Err(self.without("tip_position", step)),
        };
        following.roll = joints[ROLL];
        let tip = pose.unwrap_or_else(|| tip_in_rcm(&DH, &joints));
        let command = self.command(step)?;
        self.check_near(step, &tip, &command)?;
        let mut state = [0.0; JOINT_COUNT + 1];
        state[..JOINT_COUNT].copy_from_slice(&joints);
        state[JOINT_COUNT] = jaw;
        let mut action = [0.0; 8];
        action[..7].copy_from_slice(&following.wanted.of(&command));
        action[7] = self.jaw("action_jaw", step)?;
        Ok(ArmFrame {
            state: state.map(single),
            tip_pose: following.seen.of(&tip),
            action,
        })
    }

    /// The commanded pose of the tip.
    fn command(&self, step: usize) -> Result<Pose, ImportError> {
        if let Some(pose) = self.pose(["action_position", "action_orientation"], step)? {
            return Ok(pose);
        }
        let joints = self.joints("action_joints", step)?;
        let joints = joints.ok_or_else(|| self.without("action_joints", step))?;
        Ok(tip_in_rcm(&DH, &joints))
    }

    /// A pose in the RCM frame, of the wrist-yaw axis.
    ///
    /// `rcm_from_source * tip_in_source`, moved back by `tip_beyond_wrist_m` along its own z; none
    /// if the mapping has no such part.
    fn pose(
        &self,
        [position, orientation]: [&str; 2],
        step: usize,
    ) -> Result<Option<Pose>, ImportError> {
        let rows = self
            .parts
            .row(position, step)
            .zip(self.parts.row(orientation, step));
        let Some((at, turn)) = rows else {
            return Ok(None);
        };
        let (&[x, y, z], &[first, second, third, fourth]) = (at, turn) else {
            return Err(self.without(position, step));
        };
        let [i, j, k, w] = match self.mapping.quaternion {
            QuaternionOrder::Xyzw => [first, second, third, fourth],
            QuaternionOrder::Wxyz => [second, third, fourth, first],
        };
        let turn = Quaternion::new(w, i, j, k);
        if (turn.norm() - 1.0).abs() > UNIT_TOLERANCE {
            return Err(ImportError::Quaternion {
                place: self.place.to_owned(),
                name: orientation.to_owned(),
                arm: self.number,
                length: turn.norm(),
                step,
            });
        }
        let metres = self.mapping.length_unit.metres();
        let at = Translation3::new(x * metres, y * metres, z * metres);
        let tip_in_source = Pose::from_parts(at, UnitQuaternion::from_quaternion(turn));
        let tip = match &self.rcm_from_source {
            Some(rcm_from_source) => rcm_from_source * tip_in_source,
            None => tip_in_source,
        };
        let beyond = Translation3::new(0.0, 0.0, -self.mapping.tip_beyond_wrist_m);
        Ok(Some(tip * beyond))
    }

    /// Joints within the arm's limits, rad (m).
    fn joints(&self, key: &str, step: usize) -> Result<Option<[f64; JOINT_COUNT]>, ImportError> {
        let Some(row) = self.parts.row(key, step) else {
            return Ok(None);
        };
        let mut joints = [0.0; JOINT_COUNT];
        for (joint, (to, &from)) in joints.iter_mut().zip(row).enumerate() {
            let slides = DH[joint].prismatic;
            *to = from
                * match slides {
                    true => self.mapping.length_unit.metres(),
                    false => self.mapping.angle_unit.radians(),
                };
            let limits = [POSITION_MIN[joint], POSITION_MAX[joint]];
            self.check_limits(key, JOINT_NAMES[joint], *to, limits, step)?;
        }
        Ok(Some(joints))
    }

    /// A jaw angle within its limits, rad.
    fn jaw(&self, key: &str, step: usize) -> Result<f64, ImportError> {
        let row = self.parts.row(key, step);
        let Some(&[angle]) = row else {
            return Err(self.without(key, step));
        };
        let jaw = angle * self.mapping.angle_unit.radians();
        self.check_limits(key, "jaw", jaw, [JAW_MIN, JAW_MAX], step)?;
        Ok(jaw)
    }

    /// Within the limits and [`SLACK`], in rad or m.
    fn check_limits(
        &self,
        key: &str,
        joint: &'static str,
        value: f64,
        [min, max]: [f64; 2],
        step: usize,
    ) -> Result<(), ImportError> {
        if (min - SLACK..=max + SLACK).contains(&value) {
            return Ok(());
        }
        Err(ImportError::Outside {
            place: self.place.to_owned(),
            name: key.to_owned(),
            arm: self.number,
            joint,
            value,
            step,
            min,
            max,
        })
    }

    /// A command far from where the tip is belongs to another frame or another unit, or is a delta.
    fn check_near(&self, step: usize, tip: &Pose, command: &Pose) -> Result<(), ImportError> {
        let away_m = (command.translation.vector - tip.translation.vector).norm();
        let turned_rad = command.rotation.angle_to(&tip.rotation);
        if away_m <= COMMAND_AWAY_MAX_M && turned_rad > COMMAND_TURNED_MAX_RAD {
            return Err(ImportError::Mismatch {
                place: self.place.to_owned(),
                name: format!("the action of arm {} in step {step}", self.number),
                found: format!("is turned by {turned_rad:.2} rad from the measured tip"),
                expected: format!(
                    "at most {COMMAND_TURNED_MAX_RAD:.2}: an absolute orientation in the frame of the measured one, no delta"
                ),
            });
        }
        if away_m <= COMMAND_AWAY_MAX_M {
            return Ok(());
        }
        Err(ImportError::Mismatch {
            place: self.place.to_owned(),
            name: format!("the action of arm {} in step {step}", self.number),
            found: format!("is {away_m:.3} m from the measured tip"),
            expected: format!(
                "at most {COMMAND_AWAY_MAX_M}: an absolute pose in the frame and unit of the measured one, no delta"
            ),
        })
    }

    fn out_of_reach(&self, step: usize, reason: impl std::fmt::Display) -> ImportError {
        ImportError::Reach {
            place: self.place.to_owned(),
            arm: self.number,
            step,
            reason: reason.to_string(),
        }
    }

    fn without(&self, key: &str, step: usize) -> ImportError {
        ImportError::Missing {
            place: self.place.to_owned(),
            name: format!("{key} of arm {} in step {step}", self.number),
        }
    }
}

/// A frame of the mapping as a pose; the quaternion is normalised.
fn pose_of(frame: &Frame) -> Pose {
    let [x, y, z] = frame.position_m;
    let [i, j, k, w] = frame.orientation_xyzw;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Pose::from_parts(Translation3::new(x, y, z), turn)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a dataset's joints are f32"
)]
const fn single(value: f64) -> f32 {
    value as f32
}
