//! A controller engages only while it is held as its instrument points.

use super::*;

/// A controller that is held by `turn` (a rotation vector in the picture's axes) and by `roll`
/// about the instrument's axis otherwise than the instrument of `bench` points.
fn controller(bench: &Bench, turn: [f64; 3], roll: f64) -> At {
    let arm = &bench.setup.task.arms[0];
    let view = rcm_from_view(&bench.setup.task, &arm.scene_from_rcm).rotation;
    let tip = view.inverse() * bench.tip().tip_in_rcm().rotation;
    let about_x = UnitQuaternion::from_scaled_axis(Vector3::x() * core::f64::consts::PI);
    let roll = UnitQuaternion::from_scaled_axis(Vector3::z() * roll);
    let held = UnitQuaternion::from_scaled_axis(Vector3::from(turn)) * tip * roll * about_x;
    At {
        turn: held.scaled_axis().into(),
        tracked: true,
        ..HELD
    }
}

fn misaligned_deg(bench: &Bench) -> Option<f64> {
    bench.hands.status().unwrap().arms[0].misaligned_deg
}

/// A controller that is held otherwise than its instrument points engages as soon as it is turned
/// within the bound, its clutch still held, with what is left of the angle as an offset: nothing
/// jumps. From then on it may turn as it likes.
#[test]
fn a_misaligned_controller_engages_once_it_is_aligned() {
    let mut bench = Bench::new(false);
    let tip = bench.tip();
    assert!(bench.holds());
    for (degrees, told) in [(90.0_f64, 90.0), (40.2, 41.0), (30.5, 31.0)] {
        let hand = controller(&bench, [0.0, degrees.to_radians(), 0.0], 0.0);
        let start = bench.engage(hand);
        assert!(near(&start, &tip) && near(&bench.hand(hand), &tip));
        assert_eq!(misaligned_deg(&bench), Some(told), "{degrees}");
        assert!(!bench.hands.status().unwrap().arms[0].engaged);
    }
    let counted = bench.hands.summary();
    assert_eq!((counted.engagements, counted.device), (0, None));
    let aligned = controller(&bench, [0.0, 29.5_f64.to_radians(), 0.0], 0.0);
    assert!(near(&bench.hand(aligned), &tip), "no jump");
    assert_eq!(misaligned_deg(&bench), None);
    let counted = bench.hands.summary();
    let headset = Some(HandDevice::Headset);
    assert_eq!((counted.engagements, counted.device), (1, headset));
    let turned = bench.hand(controller(&bench, [0.0, 40.0_f64.to_radians(), 0.0], 0.0));
    let (turned, tip) = (turned.tip_in_rcm().rotation, tip.tip_in_rcm().rotation);
    let angle = turned.angle_to(&tip).to_degrees();
    assert!((angle - 10.5).abs() < 1e-3, "{angle}");
    assert_eq!(misaligned_deg(&bench), None);
    assert_eq!(bench.hands.summary().engagements, 1);
}

/// The jaw looks alike half a turn about its axis on.
#[test]
fn a_controller_is_aligned_either_way_round() {
    for (roll, engages) in [(0.0, true), (3.1, true), (-3.0, true), (1.57, false)] {
        let mut bench = Bench::new(false);
        bench.target();
        let hand = controller(&bench, [0.1, 0.0, 0.0], roll);
        bench.engage(hand);
        let status = bench.hands.status().unwrap();
        assert_eq!(status.arms[0].engaged, engages, "{roll}");
    }
}

/// Whatever is lost while a controller waits to be aligned asks for a new clutch, as ever; without
/// a known instrument it waits.
#[test]
fn alignment_gives_back_no_lost_clutch() {
    let mut bench = Bench::new(false);
    let aligned = controller(&bench, [0.0; 3], 0.0);
    let off = controller(&bench, [0.9, 0.0, 0.0], 0.0);
    let engaged = |bench: &Bench| bench.hands.status().unwrap().arms[0].engaged;
    bench
        .say_from(
            1,
            At {
                clutch: false,
                ..aligned
            },
        )
        .unwrap();
    bench.say_from(1, aligned).unwrap();
    assert!(!engaged(&bench) && misaligned_deg(&bench).is_none());
    bench.target();
    bench.engage(off);
    assert_eq!(misaligned_deg(&bench), Some(52.0));
    bench.now = bench.now.plus_ns(STALE_NS + 1);
    bench.target();
    assert_eq!(misaligned_deg(&bench), None);
    for hand in [off, aligned, aligned] {
        bench.hand(hand);
        assert!(!engaged(&bench));
    }
    bench.engage(aligned);
    assert!(engaged(&bench));
    assert_eq!(bench.hands.summary().forced_releases, 0);
}

/// The bound is the operator's choice, within limits; at 180 degrees any orientation engages.
#[test]
fn the_bound_of_the_alignment_is_chosen() {
    let mut bench = Bench::new(false);
    for degrees in [4.9, 180.1, f64::NAN, f64::INFINITY, -30.0] {
        let refused = bench.hands.set_align_deg(degrees);
        assert_eq!(refused, Err(HandsMessageError::Align), "{degrees}");
    }
    let chosen_deg = bench.hands.summary().align_deg;
    assert!((chosen_deg - DEFAULT_ALIGN_DEG).abs() < 1e-9);
    bench.target();
    for (bound_deg, engages) in [(19.0, false), (21.0, true), (180.0, true)] {
        bench.hands.set_align_deg(bound_deg).unwrap();
        let turn = if bound_deg < 180.0 { 20.0 } else { 170.0_f64 };
        let hand = controller(&bench, [0.0, turn.to_radians(), 0.0], 0.0);
        bench.engage(hand);
        let status = bench.hands.status().unwrap();
        assert_eq!(status.arms[0].engaged, engages, "{bound_deg}");
        assert!((status.align_deg.unwrap() - bound_deg).abs() < 1e-9);
    }
}
