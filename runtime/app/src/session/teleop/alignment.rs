//! Whether a hand is held as its instrument points, which it must be to engage: as on the dVRK,
//! whose masters align with the instrument before they move it. What is left of the angle at a
//! clutch-in stays a constant offset, so that nothing jumps.
//!
//! A controller's handle, thumb end first (-z of WebXR's grip pose), stands for the instrument's
//! axis, and the grip's x for the hinge of its jaw. The jaw looks alike after half a turn about its
//! axis, so that either way round is aligned. Devices that say only by how much they turn
//! (keyboard, gamepad, mouse, SpaceMouse) have no orientation of their own: they are always
//! aligned.

use core::f64::consts::PI;
use core::ops::RangeInclusive;

use hal::Pose;
use nalgebra::{UnitQuaternion, Vector3};

use super::message::Hand;

/// By how much a hand may be held otherwise than its instrument and engage, unless the operator
/// chooses another bound, degrees.
pub const DEFAULT_ALIGN_DEG: f64 = 30.0;

/// Which bounds can be chosen, degrees. At 180 any orientation engages.
pub const ALIGNS_DEG: RangeInclusive<f64> = 5.0..=180.0;

/// The angle between how `hand` is held and how the instrument with its tip at `tip_in_view`
/// points, in the picture's axes, degrees, 0 to 180; none if there is nothing to align.
pub(super) fn misaligned_deg(hand: &Hand, tip_in_view: &Pose) -> Option<f64> {
    let held = hand.pose.rotation * tip_in_grip();
    let half_a_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    let angle = |held: UnitQuaternion<f64>| held.angle_to(&tip_in_view.rotation).to_degrees();
    hand.tracked
        .then(|| angle(held).min(angle(held * half_a_turn)))
}

/// The axes of an instrument's tip (x along the hinge, z along the closed fingers) in those of a
/// controller's grip.
fn tip_in_grip() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn held(turn: UnitQuaternion<f64>) -> Hand {
        Hand {
            clutch: true,
            tracked: true,
            pose: Pose::from_parts(Vector3::new(0.3, -0.1, 0.2).into(), turn),
            jaw: 0.0,
        }
    }

    /// An instrument that points away from the viewer, its hinge to the right, is held as a
    /// controller that points ahead.
    #[test]
    fn a_controller_stands_for_its_instrument() {
        let ahead = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let tip = Pose::from_parts(Vector3::new(0.0, 0.0, -0.1).into(), ahead);
        let angle = |turn| misaligned_deg(&held(turn), &tip).unwrap();
        assert!(angle(UnitQuaternion::identity()) < 1e-6);
        for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
            let turned = UnitQuaternion::from_axis_angle(&axis, 0.7);
            assert!((angle(turned) - 0.7_f64.to_degrees()).abs() < 1e-6);
        }
        let rolled = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI - 0.2);
        assert!((angle(rolled) - 0.2_f64.to_degrees()).abs() < 1e-6);
        let backwards = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), PI);
        assert!((angle(backwards) - 180.0).abs() < 1e-6);
    }

    #[test]
    fn a_device_without_orientation_is_aligned() {
        let hand = Hand {
            tracked: false,
            ..held(UnitQuaternion::from_euler_angles(1.0, 2.0, 3.0))
        };
        assert_eq!(misaligned_deg(&hand, &Pose::identity()), None);
    }
}
