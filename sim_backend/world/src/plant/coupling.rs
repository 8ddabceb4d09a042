//! The cable coupling between the instrument's discs and its joints; yaw, pitch and insertion drive
//! their joints directly.

use hal::JOINT_COUNT;
use hal::psm::COUPLING;

/// Joints and jaw, or three joint motors and four discs.
pub const AXIS_COUNT: usize = JOINT_COUNT + 1;

/// One value an axis: in joint space with the jaw last, or in actuator space with the discs last.
pub type AxisVector = [f64; AXIS_COUNT];

/// Joint positions (rates) that belong to actuator positions (rates), jaw last.
#[must_use]
pub fn joint_positions(actuator: &AxisVector) -> AxisVector {
    let disc = [actuator[3], actuator[4], actuator[5], actuator[6]];
    let row =
        |row: [f64; 4]| row[0] * disc[0] + row[1] * disc[1] + row[2] * disc[2] + row[3] * disc[3];
    with_tool(actuator, COUPLING.map(row))
}

/// Actuator positions (rates) that belong to joint positions (rates): the inverse of
/// [`joint_positions`].
#[must_use]
pub fn actuator_positions(joint: &AxisVector) -> AxisVector {
    let [roll, pitch, yaw, jaw] = COUPLING;
    let first = joint[3] / roll[0];
    let second = joint[4] / pitch[1];
    let (third, fourth) = solve(
        yaw[2],
        yaw[3],
        jaw[2],
        jaw[3],
        joint[5] - yaw[1] * second,
        joint[6],
    );
    with_tool(joint, [first, second, third, fourth])
}

/// Actuator efforts that do the same work as joint efforts: `COUPLING^T * joint`.
#[must_use]
pub fn actuator_efforts(joint: &AxisVector) -> AxisVector {
    let column = |disc: usize| {
        COUPLING[0][disc] * joint[3]
            + COUPLING[1][disc] * joint[4]
            + COUPLING[2][disc] * joint[5]
            + COUPLING[3][disc] * joint[6]
    };
    with_tool(joint, [column(0), column(1), column(2), column(3)])
}

/// Joint efforts that do the same work as actuator efforts: the inverse of [`actuator_efforts`].
#[must_use]
pub fn joint_efforts(actuator: &AxisVector) -> AxisVector {
    let [roll, pitch, yaw, jaw] = COUPLING;
    let (yaw_effort, jaw_effort) = solve(yaw[2], jaw[2], yaw[3], jaw[3], actuator[5], actuator[6]);
    let pitch_effort = (actuator[4] - yaw[1] * yaw_effort) / pitch[1];
    with_tool(
        actuator,
        [actuator[3] / roll[0], pitch_effort, yaw_effort, jaw_effort],
    )
}

fn with_tool(axes: &AxisVector, tool: [f64; 4]) -> AxisVector {
    [
        axes[0], axes[1], axes[2], tool[0], tool[1], tool[2], tool[3],
    ]
}

/// Solves `[a b; c d] x = [e; f]`.
fn solve(a: f64, b: f64, c: f64, d: f64, e: f64, f: f64) -> (f64, f64) {
    let determinant = a * d - b * c;
    ((e * d - b * f) / determinant, (a * f - e * c) / determinant)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: AxisVector = [0.3, -0.2, 0.11, 1.3, -0.7, 0.45, 0.2];

    fn close(a: &AxisVector, b: &AxisVector) -> bool {
        a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-12)
    }

    #[test]
    fn positions_and_efforts_return_from_a_round_trip() {
        assert!(close(
            &joint_positions(&actuator_positions(&SAMPLE)),
            &SAMPLE
        ));
        assert!(close(&joint_efforts(&actuator_efforts(&SAMPLE)), &SAMPLE));
    }

    #[test]
    fn inverse_coupling_has_the_published_entries() {
        let disc = actuator_positions(&[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert!((disc[4] - 0.981_740).abs() < 1e-6 && (disc[5] - 0.669_595).abs() < 1e-6);
        let disc = actuator_positions(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        assert!((disc[3] + 0.639_713).abs() < 1e-6);
        assert!((disc[5] + 0.410_610).abs() < 1e-6 && (disc[6] - 0.410_610).abs() < 1e-6);
    }

    #[test]
    fn coupling_keeps_power() {
        let rates = [0.1, 0.4, -0.02, 2.0, -1.0, 0.5, 3.0];
        let power =
            |a: &AxisVector, b: &AxisVector| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let joint_power = power(&SAMPLE, &joint_positions(&rates));
        assert!((joint_power - power(&actuator_efforts(&SAMPLE), &rates)).abs() < 1e-12);
    }
}
