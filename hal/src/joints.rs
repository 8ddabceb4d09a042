//! Joint vectors and poses.

/// Joints of the arm without the jaw: yaw, pitch, insertion, roll, wrist pitch, wrist yaw.
pub const JOINT_COUNT: usize = 6;

/// Index of the insertion joint, the only prismatic one.
pub const INSERTION: usize = 2;

/// Index of the roll joint, whose range exceeds a full turn.
pub const ROLL: usize = 3;

/// One value a joint, in the order yaw, pitch, insertion, roll, wrist pitch, wrist yaw.
///
/// Positions in rad (insertion m), velocities in rad/s (m/s), efforts in N m (N).
pub type JointVector = nalgebra::Vector6<f64>;

/// A pose, or a transform named `frame_from_frame`: metres and a unit quaternion.
pub type Pose = nalgebra::Isometry3<f64>;

/// Short names of the joints, in order, as logs and datasets use them.
pub const JOINT_NAMES: [&str; JOINT_COUNT] = [
    "yaw",
    "pitch",
    "insertion",
    "roll",
    "wrist_pitch",
    "wrist_yaw",
];
