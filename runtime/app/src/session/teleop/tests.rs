//! Hands move arms as they should, and nothing else does.

mod alignment;
mod marks;

use std::sync::Arc;

use hal::{ArmObservation, ArmState, JointVector, PerArm, TICK_NS, TimeNs, TipTarget};
use nalgebra::{UnitQuaternion, Vector3};
use rtrb::RingBuffer;
use serde_json::json;
use trocar_control::kinematics::forward;

use super::message::HandsMessageError;
use super::view::rcm_from_view;
use super::*;
use crate::mailbox::{MailboxWriter, mailbox};
use crate::session::source::seen_arm;
use crate::session::{PolicyChoice, Setup};

const MS: u64 = 1_000_000;

/// An arm that does at once what it is commanded, and a page that says where its hand is.
struct Bench {
    hands: Arc<Hands>,
    teleop: Teleop,
    commanded: MailboxWriter<Commanded>,
    setup: Setup,
    now: TimeNs,
    joints: JointVector,
    velocity: JointVector,
    jaw: f64,
    follows: bool,
    driver: Driver,
}

/// A hand at `at` that is turned by `turn` (a rotation vector).
#[derive(Clone, Copy)]
struct At {
    clutch: bool,
    at: [f64; 3],
    turn: [f64; 3],
    jaw: f64,
    /// Whether it holds a tracked controller.
    tracked: bool,
}

const REST: At = At {
    clutch: false,
    at: [0.0; 3],
    turn: [0.0; 3],
    jaw: 0.0,
    tracked: false,
};

impl Bench {
    /// Whoever steers lets go, for this reason.
    fn release(&mut self, cause: ReleaseCause) {
        self.hands.release(1, cause);
    }

    fn new(waits: bool) -> Self {
        let setup = Setup::load("needle-lift", None, &PolicyChoice::Teleop).unwrap();
        let hands = Arc::new(Hands::new());
        let teleop = Teleop::new(&rcms_from_view(&setup.task), Arc::clone(&hands), waits);
        let (commanded, from) = mailbox();
        hands.follow(from);
        Self {
            hands,
            teleop,
            commanded,
            setup,
            now: TimeNs(1000 * MS),
            joints: JointVector::new(0.1, -0.1, 0.12, 0.3, 0.2, -0.2),
            velocity: JointVector::zeros(),
            jaw: 0.4,
            follows: true,
            driver: Driver::Policy,
        }
    }

    fn message(&self, hand: At) -> HandsMessage {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::from(hand.turn)).coords;
        let told = json!({
            "t": self.now.seconds() * 1e3,
            "arms": [{ "clutch": hand.clutch, "at": hand.at, "turn": [turn.x, turn.y, turn.z, turn.w], "jaw": hand.jaw, "tracked": hand.tracked }],
        });
        serde_json::from_value(told).unwrap()
    }

    fn say_from(&self, seat: u64, hand: At) -> Result<(), HandsMessageError> {
        self.hands.hear_at(seat, &self.message(hand), self.now)
    }

    /// 20 ms on, the page says where its hand is; where the tip should be then.
    fn hand(&mut self, hand: At) -> TipTarget {
        self.now = self.now.plus_ns(20 * MS);
        self.say_from(1, hand).unwrap();
        self.target()
    }

    /// The control thread tells what it commands the arm.
    fn command(&mut self) {
        self.commanded.put(Commanded {
            at: self.now,
            sequence: 0,
            driver: self.driver,
            arms: PerArm::one(ArmCommanded {
                position: self.joints,
                velocity: self.velocity,
                jaw: self.jaw,
                target: None,
                follows: self.follows,
            }),
        });
    }

    fn views(&self) -> Vec<hal::Pose> {
        rcms_from_view(&self.setup.task)
    }

    fn seen(&self) -> PerArm<ArmObservation> {
        PerArm::one(seen_arm(&ArmState::at_rest(
            self.now,
            self.joints,
            self.jaw,
        )))
    }

    /// Where the tip should be now.
    fn target(&mut self) -> TipTarget {
        self.command();
        let look = self.hands.look_at(self.now);
        let chunk = self.teleop.answer_at(&self.seen(), &look).unwrap().first;
        assert_eq!(chunk.valid_targets().len(), 3);
        assert!(chunk.step_ns >= TICK_NS);
        chunk.valid_targets()[0]
    }

    fn tip(&self) -> TipTarget {
        TipTarget::new(&forward(&self.joints), self.jaw)
    }

    /// Whether the tip should be where it is.
    fn holds(&mut self) -> bool {
        let (target, tip) = (self.target(), self.tip());
        near(&target, &tip)
    }

    fn engage(&mut self, hand: At) -> TipTarget {
        self.hand(At {
            clutch: false,
            ..hand
        });
        self.hand(At {
            clutch: true,
            ..hand
        })
    }
}

fn way(one: &TipTarget, other: &TipTarget) -> f64 {
    let [one, other] = [one, other].map(|it| it.tip_in_rcm().translation.vector);
    (one - other).norm()
}

fn near(one: &TipTarget, other: &TipTarget) -> bool {
    let turn = one
        .tip_in_rcm()
        .rotation
        .angle_to(&other.tip_in_rcm().rotation);
    way(one, other) < 1e-9 && turn < 1e-6
}

const HELD: At = At {
    clutch: true,
    ..REST
};

/// Wherever the hand is and however it is turned as it takes the clutch, the target is where the
/// arm is; only what the hand does from then on counts, in the picture's axes and to scale.
#[test]
fn engaging_moves_nothing_and_motion_is_relative() {
    let mut bench = Bench::new(false);
    let tip = bench.tip();
    let held = At {
        at: [1.0, -2.0, 0.5],
        turn: [0.3, -1.2, 2.0],
        ..HELD
    };
    assert!(near(&bench.engage(held), &tip));
    let mut moved = held;
    moved.at[0] += 0.02;
    let target = bench.hand(moved);
    let arm = &bench.setup.task.arms[0];
    let axes = rcm_from_view(&bench.setup.task, &arm.scene_from_rcm).rotation;
    let step = target.tip_in_rcm().translation.vector - tip.tip_in_rcm().translation.vector;
    let expected = axes * Vector3::x() * 0.02 * DEFAULT_SCALE;
    assert!((step - expected).norm() < 1e-9, "{step} {expected}");
    // A turn of the hand about the view's z, from however it was turned, is one of the tip about
    // the same axis.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.2);
    let turned = turn * UnitQuaternion::from_scaled_axis(Vector3::from(held.turn));
    moved.turn = turned.scaled_axis().into();
    let target = bench.hand(moved);
    let turned = target.tip_in_rcm().rotation * tip.tip_in_rcm().rotation.inverse();
    let expected = axes * Vector3::z() * 0.2;
    assert!((turned.scaled_axis() - expected).norm() < 1e-6);
    assert_eq!(bench.hands.summary().engagements, 1);
}

#[test]
fn an_open_clutch_moves_nothing() {
    let mut bench = Bench::new(false);
    for step in 0..20 {
        let x = 0.05 * f64::from(step);
        let target = bench.hand(At {
            at: [x, -x, 0.0],
            turn: [x, 0.0, 0.0],
            jaw: 0.5,
            ..REST
        });
        assert!(near(&target, &bench.tip()) && (target.jaw - 0.4).abs() < 1e-9);
    }
}

/// A hand that has moved elsewhere with the clutch open goes on from where the arm is.
#[test]
fn clutching_again_starts_from_the_arm() {
    let mut bench = Bench::new(false);
    bench.engage(REST);
    let mut hand = HELD;
    hand.at[1] = 0.02;
    let reached = bench.hand(hand);
    // The arm does not move here: its target while the clutch is open is where it is.
    assert!(way(&reached, &bench.tip()) > 0.005);
    hand = At {
        clutch: false,
        at: [0.5, 0.5, 0.5],
        ..hand
    };
    assert!(near(&bench.hand(hand), &bench.tip()));
    hand.clutch = true;
    assert!(near(&bench.hand(hand), &bench.tip()));
}

/// Each way to lose a hand: the arm holds, and goes on holding with the clutch held until it was
/// let go.
#[test]
fn whatever_is_lost_holds_until_a_new_clutch() {
    type Loss = (&'static str, fn(&mut Bench));
    let losses: [Loss; 9] = [
        ("stale", |bench| bench.now = bench.now.plus_ns(STALE_NS + 1)),
        ("late", |bench| {
            let told = bench.message(HELD);
            bench.now = bench.now.plus_ns(90 * MS);
            bench.say_from(1, HELD).unwrap();
            bench.now = bench.now.plus_ns(20 * MS);
            let mut old = told;
            old.t += 90.1;
            // It was sent 20 ms ago, and 150 ms are on their way.
            bench.now = bench.now.plus_ns(STALE_NS + 10 * MS);
            bench.hands.hear_at(1, &old, bench.now).unwrap();
        }),
        ("gone", |bench| bench.release(ReleaseCause::PageGone)),
        ("hidden", |bench| bench.release(ReleaseCause::Hidden)),
        ("another page", |bench| {
            bench.say_from(2, HELD).unwrap();
        }),
        ("jump", |bench| {
            let mut far = HELD;
            far.at[2] = 0.2;
            bench.say_from(1, far).unwrap();
        }),
        ("nonsense", |bench| {
            let mut bad = HELD;
            bad.jaw = 2.0;
            assert_eq!(bench.say_from(1, bad), Err(HandsMessageError::Numbers));
        }),
        ("back in time", |bench| {
            let mut old = bench.message(HELD);
            old.t -= 50.0;
            assert_eq!(
                bench.hands.hear_at(1, &old, bench.now),
                Err(HandsMessageError::Time)
            );
        }),
        ("disabled", |bench| {
            bench.follows = false;
            bench.target();
            bench.follows = true;
        }),
    ];
    for (name, lose) in losses {
        let mut bench = Bench::new(false);
        bench.engage(REST);
        let mut hand = HELD;
        hand.at[0] = 0.01;
        let target = bench.hand(hand);
        assert!(way(&target, &bench.tip()) > 0.003, "{name}");
        lose(&mut bench);
        assert!(bench.holds(), "{name}");
        assert_eq!(bench.hands.summary().forced_releases, 1, "{name}");
        for step in 0..10 {
            hand.at[0] += 0.01 * f64::from(step);
            let target = bench.hand(hand);
            assert!(
                near(&target, &bench.tip()),
                "{name}: moved without a new clutch"
            );
        }
        let start = bench.engage(hand);
        assert!(near(&start, &bench.tip()), "{name}");
        hand.at[0] -= 0.01;
        let target = bench.hand(hand);
        assert!(
            way(&target, &bench.tip()) > 0.003,
            "{name}: moves after a new clutch"
        );
    }
}

/// A clutch that is taken while nothing is heard of the hand, or by another hand, is none.
#[test]
fn a_clutch_that_was_taken_out_of_sight_moves_nothing() {
    let losses: [fn(&mut Bench); 4] = [
        |bench| bench.now = bench.now.plus_ns(STALE_NS + 1),
        |bench| bench.hands.release(1, ReleaseCause::PageGone),
        |bench| bench.hands.release(1, ReleaseCause::Hidden),
        |bench| bench.say_from(2, HELD).unwrap(),
    ];
    for (index, lose) in losses.into_iter().enumerate() {
        let mut bench = Bench::new(false);
        bench.hand(REST);
        lose(&mut bench);
        for step in 0..10 {
            let mut hand = HELD;
            hand.at[0] = 0.01 * f64::from(step);
            assert!(near(&bench.hand(hand), &bench.tip()), "{index}");
        }
        assert_eq!(bench.hands.summary().forced_releases, 0, "{index}");
    }
}

/// Hands that go on coming late stay late; with a round trip that long, those that all come alike
/// late are.
#[test]
fn hands_that_go_on_coming_late_move_nothing() {
    let mut bench = Bench::new(false);
    bench.hand(REST);
    bench.now = bench.now.plus_ns(700 * MS);
    for step in 0..200 {
        bench.now = bench.now.plus_ns(20 * MS);
        let mut hand = if step % 20 == 0 { REST } else { HELD };
        hand.at[0] = 0.003 * f64::from(step % 20);
        let mut old = bench.message(hand);
        old.t -= 600.0;
        bench.hands.hear_at(1, &old, bench.now).unwrap();
        assert!(bench.holds(), "{step}");
    }
    let mut bench = Bench::new(false);
    bench.engage(REST);
    bench.hands.round_trip(1, 2 * STALE_NS + 2);
    bench.engage(REST);
    let mut hand = HELD;
    hand.at[0] = 0.01;
    assert!(near(&bench.hand(hand), &bench.tip()));
    bench.hands.round_trip(1, 10 * MS);
    bench.engage(REST);
    assert!(way(&bench.hand(hand), &bench.tip()) > 0.003);
}

/// What ends with its episode was not taken by force.
#[test]
fn an_episode_that_ends_forces_nothing() {
    let mut bench = Bench::new(false);
    bench.engage(REST);
    bench.hands.rest();
    assert!(bench.holds());
    assert_eq!(bench.hands.summary().forced_releases, 0);
}

/// The first thing that is heard of a hand is that it holds the clutch, as after a reload in
/// mid-motion.
#[test]
fn a_hand_that_comes_with_its_clutch_held_moves_nothing() {
    let mut bench = Bench::new(false);
    for step in 0..10 {
        let mut hand = HELD;
        hand.at[0] = 0.01 * f64::from(step);
        assert!(near(&bench.hand(hand), &bench.tip()));
    }
}

/// An arm that is released in motion gets a target ahead of it, towards which its velocity falls
/// from what it is.
#[test]
fn a_released_arm_stops_without_turning_back() {
    let mut bench = Bench::new(false);
    bench.engage(REST);
    bench.velocity[1] = 0.2;
    let target = bench.hand(REST);
    let mut stop = bench.joints;
    stop[1] += 0.2 * 0.05;
    assert!(near(&target, &TipTarget::new(&forward(&stop), 0.0)));
    // There it stays, wherever the arm is on its way.
    bench.joints = stop;
    bench.velocity[1] = 0.01;
    assert!(near(&bench.hand(REST), &target));
}

/// A hand that runs ahead pulls the target no further than a leash; as soon as it turns back, so
/// does the target.
#[test]
fn an_arm_never_owes_more_than_the_leash() {
    let mut bench = Bench::new(false);
    bench.engage(REST);
    let mut hand = HELD;
    let mut furthest = 0.0_f64;
    for _ in 0..40 {
        hand.at[0] += 0.05;
        hand.turn[2] += 0.1;
        let target = bench.hand(hand);
        furthest = furthest.max(way(&target, &bench.tip()));
        let turn = target
            .tip_in_rcm()
            .rotation
            .angle_to(&bench.tip().tip_in_rcm().rotation);
        assert!(turn < 0.4 + 1e-6, "{turn}");
    }
    assert!((furthest - 0.012).abs() < 1e-6, "{furthest}");
    hand.at[0] -= 0.01;
    let target = bench.hand(hand);
    assert!((way(&target, &bench.tip()) - (0.012 - 0.01 * DEFAULT_SCALE)).abs() < 1e-6);
}

/// A jaw that holds something is not opened by a trigger that is let go as the clutch is taken;
/// from where they meet it follows.
#[test]
fn a_jaw_follows_from_where_the_trigger_meets_it() {
    let mut bench = Bench::new(false);
    bench.jaw = -0.1;
    assert!((bench.engage(REST).jaw + 0.1).abs() < 1e-9);
    let mut hand = HELD;
    let mut jaws = Vec::new();
    for jaw in [0.5, 1.0, 0.9, 0.0] {
        hand.jaw = jaw;
        jaws.push(bench.hand(hand).jaw);
    }
    let expected = [-0.1, -0.15, -0.065, 0.7];
    for (found, expected) in jaws.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-9, "{jaws:?}");
    }
}

/// The scale changes in mid-motion without a jump.
#[test]
fn scale_is_bounded_and_changes_without_a_jump() {
    let mut bench = Bench::new(false);
    for scale in [0.05, 1.01, f64::NAN, f64::INFINITY, -1.0] {
        assert_eq!(
            bench.hands.set_scale(scale),
            Err(HandsMessageError::Scale),
            "{scale}"
        );
    }
    bench.engage(REST);
    let mut hand = HELD;
    hand.at[0] = 0.01;
    let before = bench.hand(hand);
    bench.hands.set_scale(1.0).unwrap();
    assert!(near(&bench.hand(hand), &before));
    hand.at[0] = 0.012;
    assert!((way(&bench.hand(hand), &before) - 0.002).abs() < 1e-9);
}

/// Before an episode is started hands move nothing; after it either.
#[test]
fn hands_move_nothing_outside_an_episode() {
    let mut bench = Bench::new(true);
    assert!(near(&bench.engage(REST), &bench.tip()));
    let mut hand = HELD;
    hand.at[0] = 0.01;
    assert!(near(&bench.hand(hand), &bench.tip()));
    bench.hands.start();
    hand.at[0] = 0.02;
    assert!(
        near(&bench.hand(hand), &bench.tip()),
        "that clutch is an old one"
    );
    bench.engage(hand);
    hand.at[0] = 0.03;
    assert!(!near(&bench.hand(hand), &bench.tip()));
    bench.hands.rest();
    assert!(bench.holds());
}

/// Beside a policy the hands hold the arms until the episode's start, which is nobody's driving: no
/// frame is by hand before the policy's first, however late the start is heard, by the hands' end
/// or by the control thread. Later, too, a frame is that of whom the control thread follows, whose
/// target it has.
#[test]
fn who_drives_is_whom_the_control_thread_follows_since_the_start() {
    let mut bench = Bench::new(false);
    let (to, mut control_thread) = RingBuffer::new(1);
    let mut beside = Intervention::new(&bench.views(), &bench.hands, (true, 10.0), to);
    let driver = |beside: &Intervention| beside.asked().map(|(driver, _)| driver);
    let look = |bench: &mut Bench, beside: &mut Intervention, follows| {
        bench.driver = follows;
        bench.command();
        beside.answer(&bench.seen()).unwrap();
        driver(beside)
    };
    assert_eq!(look(&mut bench, &mut beside, Driver::Policy), None);
    assert_eq!(look(&mut bench, &mut beside, Driver::Operator), None);
    bench.hands.start();
    assert_eq!(driver(&beside), None, "the hands' end has not looked yet");
    // The control thread has not even taken what it was told first.
    assert_eq!(look(&mut bench, &mut beside, Driver::Operator), None);
    assert_eq!(control_thread.pop().unwrap().driver, Driver::Operator);
    assert_eq!(look(&mut bench, &mut beside, Driver::Operator), None);
    assert_eq!(control_thread.pop().unwrap().driver, Driver::Policy);
    assert_eq!(
        look(&mut bench, &mut beside, Driver::Policy),
        Some(Driver::Policy)
    );
    // Whatever the hands want meanwhile.
    assert_eq!(
        look(&mut bench, &mut beside, Driver::Operator),
        Some(Driver::Operator)
    );
}

#[test]
fn wishes_apply_where_they_make_sense() {
    let hands = Hands::new();
    assert_eq!(
        hands.wish(EpisodeCommand::Start),
        Err(HandsMessageError::NoRecording)
    );
    let told = |phase| Recording {
        phase,
        kept: 0,
        wanted: 1,
        seed: 3,
    };
    for (phase, allowed) in [
        (Phase::Waiting, &[EpisodeCommand::Start][..]),
        (
            Phase::Running,
            &[
                EpisodeCommand::Keep,
                EpisodeCommand::Redo,
                EpisodeCommand::Discard,
            ],
        ),
        (Phase::Writing, &[]),
    ] {
        hands.tell_recording(told(phase));
        for wish in [
            EpisodeCommand::Start,
            EpisodeCommand::Keep,
            EpisodeCommand::Redo,
            EpisodeCommand::Discard,
        ] {
            let applies = allowed.contains(&wish);
            assert_eq!(hands.wish(wish).is_ok(), applies, "{phase:?} {wish:?}");
            assert_eq!(hands.take_episode_command(), applies.then_some(wish));
        }
    }
}

/// A run with another policy hears no hands.
#[test]
fn hands_of_a_run_with_another_policy_are_refused() {
    let bench = Bench::new(false);
    let hands = Hands::new();
    let message = bench.message(HELD);
    assert_eq!(hands.hear(1, &message), Err(HandsMessageError::NoTeleop));
    assert!(hands.status().is_none());
}

#[test]
fn latency_is_from_the_message_to_the_command() {
    let mut bench = Bench::new(false);
    bench.engage(REST);
    bench.hand(HELD);
    assert_eq!(bench.hands.summary().hand_to_command_ms, None);
    let sent = bench.now;
    let sequence = bench.teleop.answer_at(
        &PerArm::one(seen_arm(&ArmState::at_rest(sent, bench.joints, 0.4))),
        &bench.hands.look_at(sent),
    );
    let arms = PerArm::one(ArmCommanded {
        position: bench.joints,
        velocity: bench.velocity,
        jaw: 0.4,
        target: None,
        follows: true,
    });
    bench.commanded.put(Commanded {
        at: sent.plus_ns(5 * MS),
        sequence: sequence.unwrap().first.sequence,
        driver: Driver::Operator,
        arms,
    });
    let look = bench.hands.look_at(sent.plus_ns(6 * MS));
    let state = ArmState::at_rest(look.now, bench.joints, 0.4);
    let _chunk = bench
        .teleop
        .answer_at(&PerArm::one(seen_arm(&state)), &look);
    let latency = bench.hands.summary().hand_to_command_ms.unwrap();
    assert!((4.8..25.5).contains(&latency.p50), "{latency:?}");
}
