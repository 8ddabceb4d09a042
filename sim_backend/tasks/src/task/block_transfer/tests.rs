//! Facts about the block transfer: what is drawn, what rests, what counts.

mod rest;

use trocar_world::{Grasp, World};

use super::*;
use crate::simulation::pictures::{Looks, saturation};
use crate::task::{Judge, MonitorInput, Outcome, Reason, TaskConfig, TaskFiles};

fn task() -> TaskConfig {
    TaskConfig::shipped(NAME)
}

fn world(seed: u64) -> World {
    let task = task();
    let scenery = task.scene.scenery(seed);
    World::new(&task.world, &scenery, &task.arms)
}

/// The pairs of pegs that a thousand episodes have.
fn pairs(scene: &BlockTransfer) -> Vec<String> {
    let mut pairs: Vec<String> = (0..1000)
        .map(|seed| format!("{:?}", scene.pegs(seed)))
        .collect();
    pairs.sort();
    pairs.dedup();
    pairs
}

#[test]
fn the_block_starts_on_every_peg_but_the_goal_which_stays() {
    let scene = BlockTransfer::shipped();
    assert_eq!(pairs(&scene).len(), 5);
    for seed in 0..100 {
        let [start, goal] = scene.pegs(seed);
        assert_eq!(format!("{goal:?}"), "[0.0, 0.015]");
        assert_ne!(format!("{start:?}"), format!("{goal:?}"));
        let block = scene.block_at_start(seed).translation;
        assert!((block.x - start[0]).hypot(block.y - start[1]) < 0.001_5);
    }
}

#[test]
fn a_goal_that_is_not_given_is_drawn() {
    let mut scene = BlockTransfer::shipped();
    scene.start.goal_peg = None;
    assert_eq!(pairs(&scene).len(), 30);
}

#[test]
fn a_goal_beyond_the_last_peg_is_refused() {
    let text = TaskFiles::built_in(NAME).unwrap().scene.text().to_owned();
    let text = text.replace("goal_peg = 4", "goal_peg = 6");
    let source = Source::embedded("scene.toml", &text);
    let message = TaskConfig::parse(NAME, &source).unwrap_err().to_string();
    assert!(
        message.contains("block_start.goal_peg = 6 is outside [0, 5]"),
        "{message}"
    );
}

#[test]
fn block_rests_on_the_board_around_its_peg() {
    for seed in 0..4 {
        let mut world = world(seed);
        for _ in 0..500 {
            world.step();
        }
        let rest = world.thing_in_scene(0);
        for _ in 0..1000 {
            world.step();
        }
        let drift = rest.inverse() * world.thing_in_scene(0);
        assert!(drift.translation.vector.norm() < 1e-6 && drift.rotation.angle() < 1e-5);
        let block = BlockTransfer::shipped().block;
        let height_m = world.thing_in_scene(0).translation.z;
        assert!((height_m - 0.5 * block.height_m).abs() < 1e-4, "{height_m}");
        assert!(world.sunk_m(0) < 1e-4);
    }
}

#[test]
fn tool_that_is_driven_into_the_board_is_held_up_and_fails() {
    let task = task();
    let mut simulation =
        crate::simulation::Simulation::new(&task, 0, crate::simulation::Rendering::Off).unwrap();
    let mut down = crate::closed_loop::hold(&task);
    for tick in 0..4000 {
        down.position[2] = (0.100 + 3e-5 * f64::from(tick)).min(0.16);
        hal::Arm::write(&mut simulation, &down, &hal::SafeTail::hold(&down)).unwrap();
        simulation.step();
    }
    let outcome = simulation.outcome();
    assert!(
        matches!(outcome, Outcome::Failure(Reason::Pressed { force_n, seconds, .. }) if force_n > 8.0 && seconds > 2.0),
        "{outcome}"
    );
    let tip = task.arms[0].scene_from_rcm * simulation.scene_state().first.tip_in_rcm;
    // The control point is a finger above the ends of the fingers, which stand on the board.
    assert!(tip.translation.z > 0.0097, "{}", tip.translation);
}

/// A monitor of an episode, and sights to show it.
struct Bench {
    judge: Judge,
    scene: BlockTransfer,
    seed: u64,
}

const FIRM: Grasp = Grasp {
    left_force_n: 2.0,
    right_force_n: 2.0,
    both_touch: true,
    penetration_m: 0.000_02,
};

impl Bench {
    fn new() -> Self {
        let scene = BlockTransfer::shipped();
        let seed = 5;
        Self {
            judge: Judge::new(scene.monitor(seed), 25.0),
            scene,
            seed,
        }
    }

    fn resting(&self, peg: [f64; 2]) -> Pose {
        Pose::translation(peg[0], peg[1], 0.5 * self.scene.block.height_m)
    }

    /// Shows one place for a while, with the arm above it, near or far.
    fn show(&mut self, block: Pose, grasp: Grasp, above_m: f64, seconds: f64) -> Outcome {
        let mut shown_s = 0.0;
        while shown_s < seconds {
            self.judge.observe(&MonitorInput {
                thing_in_scene: block,
                grasps: vec![grasp],
                tips_in_scene: vec![Translation3::new(0.0, 0.0, above_m) * block],
                sunk_m: 0.0,
                ground_force_n: 0.0,
                tissue: None,
                free_energy_j: None,
            });
            shown_s += 1e-3;
        }
        self.judge.outcome()
    }

    /// Moves the block slowly from one place to another.
    fn slide(&mut self, from: &Pose, to: &Pose, grasp: Grasp) {
        for step in 0..1000 {
            let place = from.lerp_slerp(to, f64::from(step) / 1000.0);
            self.show(place, grasp, 0.014, 0.001);
        }
    }

    /// Takes the block to `height_m` above its start and from there to the goal.
    fn transfer(&mut self, height_m: f64, grasp: Grasp) -> Pose {
        let [start, goal] = self.scene.pegs(self.seed);
        let up = Translation3::new(0.0, 0.0, height_m);
        let (start, goal) = (self.resting(start), self.resting(goal));
        self.slide(&start, &(up * start), grasp);
        self.slide(&(up * start), &(up * goal), grasp);
        self.slide(&(up * goal), &goal, grasp);
        goal
    }
}

#[test]
fn block_that_was_lifted_and_placed_is_a_success() {
    let mut bench = Bench::new();
    let goal = bench.transfer(0.022, FIRM);
    assert_eq!(bench.show(goal, FIRM, 0.03, 1.0), Outcome::Running);
    assert_eq!(
        bench.show(goal, Grasp::default(), 0.015, 1.0),
        Outcome::Running
    );
    assert_eq!(
        bench.show(goal, Grasp::default(), 0.03, 0.4),
        Outcome::Running
    );
    assert_eq!(
        bench.show(goal, Grasp::default(), 0.03, 0.2),
        Outcome::Success
    );
}

#[test]
fn block_that_came_another_way_is_no_success() {
    // Not high enough, or not in the fingers.
    for (height_m, grasp) in [(0.020, FIRM), (0.025, Grasp::default())] {
        let mut bench = Bench::new();
        let goal = bench.transfer(height_m, grasp);
        assert_eq!(
            bench.show(goal, Grasp::default(), 0.03, 2.0),
            Outcome::Running
        );
    }
}

#[test]
fn block_beside_tilted_or_above_is_no_success() {
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.1);
    let others = [
        Pose::translation(0.004, 0.0, 0.0),
        Pose::translation(0.0, 0.0, 0.003),
        Pose::from_parts([0.0; 3].into(), tilt),
    ];
    for other in others {
        let mut bench = Bench::new();
        let goal = bench.transfer(0.022, FIRM);
        let placed = goal * other;
        bench.slide(&goal, &placed, FIRM);
        assert_eq!(
            bench.show(placed, Grasp::default(), 0.03, 2.0),
            Outcome::Running
        );
    }
}

#[test]
fn thrown_and_fallen_blocks_are_failures() {
    let mut bench = Bench::new();
    let start = bench.resting(bench.scene.pegs(bench.seed)[0]);
    for step in 0..40 {
        let up = Translation3::new(0.0, 0.0, 0.001 * f64::from(step));
        bench.show(up * start, FIRM, 0.014, 0.001);
    }
    assert!(matches!(
        bench.judge.outcome(),
        Outcome::Failure(Reason::Thrown { .. })
    ));
    let mut bench = Bench::new();
    let beside = Pose::translation(0.06, 0.0, 0.007);
    assert!(matches!(
        bench.show(beside, Grasp::default(), 0.03, 0.01),
        Outcome::Failure(Reason::Fallen { .. })
    ));
}

#[test]
fn block_and_goal_are_seen_by_their_colours() {
    let looks = Looks::of(NAME);
    looks.show(&[(BLOCK, 1_500), (PEG, 1_000), (GOAL_PEG, 150)]);
    let grey = saturation(looks.colour(instance::ORGAN));
    looks.check(grey < 0.12, "the board is grey");
    let [red, green, blue] = looks.colour(GOAL_PEG);
    looks.check(red > 2.0 * green && blue > 1.3 * green, "the goal is pink");
    looks.check(saturation(looks.colour(PEG)) < 0.2, "other pegs are not");
    let [red, _, blue] = looks.colour(BLOCK);
    looks.check(blue > 2.0 * red, "the block is blue");
}
