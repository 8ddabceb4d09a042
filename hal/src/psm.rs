//! The dVRK Classic patient-side manipulator with a Large Needle Driver 400006 (8 mm), as data.
//!
//! Geometry, limits, coupling, motors and joint controllers as the dVRK ships them
//! (`sawIntuitiveResearchKit`: `share/kinematic/PSM.json`,
//! `share/tool/LARGE_NEEDLE_DRIVER_400006.json`, `share/pid/sawControllersPID-PSM.json`,
//! `core/applications/io-config-generator`). The controller and the simulator both build from it
//! and share nothing else.

use crate::JOINT_COUNT;

/// One row of modified (Craig) Denavit-Hartenberg parameters: `Rx(alpha) Tx(a) Rz(theta) Tz(d)`,
/// the joint value added to `theta` or, for the prismatic joint, to `d`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DhRow {
    /// Twist of the previous link, rad.
    pub alpha: f64,
    /// Length of the previous link, m.
    pub a: f64,
    /// Offset along the joint axis, m.
    pub d: f64,
    /// Offset about the joint axis, rad.
    pub theta: f64,
    /// Whether the joint slides.
    pub prismatic: bool,
}

const QUARTER: f64 = core::f64::consts::FRAC_PI_2;

const fn row(alpha: f64, a: f64, d: f64, theta: f64, prismatic: bool) -> DhRow {
    DhRow {
        alpha,
        a,
        d,
        theta,
        prismatic,
    }
}

/// The chain from the RCM to the wrist-yaw frame; the tip frame is [`TIP_FROM_WRIST_YAW`] further.
pub const DH: [DhRow; JOINT_COUNT] = [
    row(QUARTER, 0.0, 0.0, QUARTER, false),
    row(-QUARTER, 0.0, 0.0, -QUARTER, false),
    row(QUARTER, 0.0, -RCC_M, 0.0, true),
    row(0.0, 0.0, TOOL_M, 0.0, false),
    row(-QUARTER, 0.0, 0.0, -QUARTER, false),
    row(-QUARTER, WRIST_M, 0.0, -QUARTER, false),
];

/// Remote centre to the insertion carriage at zero insertion, m.
pub const RCC_M: f64 = 0.4318;

/// Carriage to the wrist-pitch axis, m.
pub const TOOL_M: f64 = 0.4162;

/// Wrist-pitch axis to wrist-yaw axis, m.
pub const WRIST_M: f64 = 0.0091;

/// Wrist-yaw axis (the control point, the dVRK's tool centre point) to the finger tips, along the
/// tip frame's z, m.
pub const FINGER_M: f64 = 0.0102;

/// Radius of the instrument shaft, m.
pub const SHAFT_RADIUS_M: f64 = 0.004;

/// Rotation from the sixth frame to the tip frame, row-major; no translation.
pub const TIP_FROM_WRIST_YAW: [[f64; 3]; 3] = [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]];

/// Lower joint limits, rad (m).
pub const POSITION_MIN: [f64; JOINT_COUNT] =
    [-1.588, -0.925_025, 0.0, -4.537_86, -1.396_26, -1.396_26];

/// Upper joint limits, rad (m).
pub const POSITION_MAX: [f64; JOINT_COUNT] =
    [1.588, 0.925_025, 0.240, 4.537_86, 1.396_26, 1.396_26];

/// Jaw limits, rad. Negative angles press the closed fingers together.
pub const JAW_MIN: f64 = -0.698_132;
/// See [`JAW_MIN`].
pub const JAW_MAX: f64 = 1.396_26;

/// Lower mechanical stops, rad (m), jaw last: the joint limits are the stops, but closed fingers
/// stop each other at 0, above [`JAW_MIN`].
pub const STOP_MIN: [f64; JOINT_COUNT + 1] = jaw_last(POSITION_MIN, 0.0);

/// Upper mechanical stops, rad (m), jaw last.
pub const STOP_MAX: [f64; JOINT_COUNT + 1] = jaw_last(POSITION_MAX, JAW_MAX);

const fn jaw_last(joints: [f64; JOINT_COUNT], jaw: f64) -> [f64; JOINT_COUNT + 1] {
    let [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw] = joints;
    [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw, jaw]
}

/// Joint effort limits from the files, N m (N), jaw last.
pub const EFFORT_MAX: [f64; JOINT_COUNT + 1] =
    [3.316_101, 3.316_101, 9.877_926, 0.33, 0.25, 0.20, 0.16];

/// Trajectory velocity limits of the dVRK, rad/s (m/s), jaw last.
pub const VELOCITY_MAX: [f64; JOINT_COUNT + 1] = {
    let arm = 90.0 * DEGREE;
    let disc = 1080.0 * DEGREE;
    [arm, arm, 0.2, disc, disc, disc, disc]
};

/// One degree, rad.
pub const DEGREE: f64 = core::f64::consts::PI / 180.0;

/// `joint = COUPLING * disc` for roll, wrist pitch, wrist yaw, jaw (rows) and the four tool discs
/// (columns).
pub const COUPLING: [[f64; 4]; 4] = [
    [-1.5632, 0.0, 0.0, 0.0],
    [0.0, 1.0186, 0.0, 0.0],
    [0.0, -0.8306, 0.6089, 0.6089],
    [0.0, 0.0, -1.2177, 1.2177],
];

/// One actuator: three joint motors, then four tool discs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Actuator {
    /// Encoder counts a motor turn.
    pub encoder_counts_per_turn: f64,
    /// Motor radians per actuator radian (per metre for insertion).
    pub gear_ratio: f64,
    /// Motor torque constant, N m/A.
    pub torque_constant_n_m_a: f64,
    /// Current limit, A.
    pub current_max_a: f64,
    /// Position gain, N m/rad (N/m).
    pub p: f64,
    /// Velocity gain, N m s/rad (N s/m).
    pub d: f64,
    /// Tracking error at which the dVRK gives up, rad (m).
    pub trip_error: f64,
}

const fn actuator(
    counts: f64,
    gear: f64,
    current_max_a: f64,
    p: f64,
    d: f64,
    trip_error: f64,
) -> Actuator {
    Actuator {
        encoder_counts_per_turn: counts,
        gear_ratio: gear,
        torque_constant_n_m_a: 0.0438,
        current_max_a,
        p,
        d,
        trip_error,
    }
}

/// Actuators in order yaw, pitch, insertion, disc 1 to 4, with the joint controllers as shipped (no
/// integral term).
pub const ACTUATORS: [Actuator; JOINT_COUNT + 1] = [
    actuator(14_400.0, 56.50, 1.34, 120.0, 6.0, 0.5),
    actuator(14_400.0, 56.50, 1.34, 120.0, 5.0, 0.5),
    actuator(14_400.0, 336.6, 0.67, 6000.0, 200.0, 0.05),
    actuator(4_000.0, 11.71, 0.67, 6.0, 0.09, 0.6),
    actuator(4_000.0, 11.71, 0.67, 6.0, 0.09, 0.6),
    actuator(4_000.0, 11.71, 0.67, 6.0, 0.09, 0.6),
    actuator(4_000.0, 11.71, 0.67, 6.0, 0.09, 0.6),
];

/// Insertion at which the dVRK homes in simulation, m; the other joints at zero.
pub const HOME_INSERTION_M: f64 = 0.12;
