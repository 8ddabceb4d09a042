//! The scene of a world as it travels between processes: what the simulator knows, as plain numbers
//! and back.

use hal::TimeNs;
use trocar_tasks::scene::{ArmScene, SceneState};
use trocar_tasks::simulation::Simulation;
use trocar_tasks::task::{Criteria, Criterion, Outcome};
use trocar_topics::{
    CriterionReport, Line, PoseMessage, SceneArm, SceneReport, SceneTissue, TaskReport, Verdict,
};
use trocar_world::Grasp;
use trocar_world::tissue::TissueExtremes;

use super::summary::TissueSummary;

const _: () = assert!(trocar_tasks::task::CRITERIA_MAX == trocar_topics::CRITERIA_MAX);

/// What a world knows of itself at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorldState {
    /// The scene.
    pub(super) scene: SceneState,
    /// Whether the drives of all arms are operational, in the sense of NMT.
    pub(super) operational: bool,
    /// How the episode stands, once it has begun.
    pub(super) outcome: Option<Outcome>,
    /// What a soft tissue went through, if there is one.
    pub(super) tissue: Option<TissueExtremes>,
    /// How the task stands.
    pub(super) task: TaskState,
}

impl WorldState {
    /// That of `simulation`, whose drives are `operational` or not, in an episode that has `begun`
    /// or not.
    pub(super) fn of(simulation: &Simulation, operational: bool, begun: bool) -> Self {
        Self {
            scene: simulation.scene_state(),
            operational,
            outcome: begun.then(|| simulation.outcome()),
            tissue: simulation.tissue_extremes(),
            task: TaskState::of(simulation),
        }
    }
}

/// How a task stands.
#[derive(Clone, Copy, Debug)]
pub struct TaskState {
    /// What has not happened as long as there is no success, in words.
    pub missing: &'static str,
    /// What has to be so for success.
    pub criteria: Criteria,
}

impl TaskState {
    /// That of `simulation`.
    #[must_use]
    pub fn of(simulation: &Simulation) -> Self {
        Self {
            missing: simulation.missing(),
            criteria: simulation.criteria(),
        }
    }

    /// The same as whoever looks on is told, of the instant `stamp` and the policy step `sequence`.
    pub(crate) fn report(&self, stamp: TimeNs, sequence: u64) -> TaskReport {
        let mut report = TaskReport {
            stamp,
            sequence,
            missing: Line::new(self.missing),
            ..TaskReport::default()
        };
        for (told, criterion) in report.criteria.iter_mut().zip(self.criteria.iter()) {
            *told = told_of(criterion);
            report.criterion_count += 1;
        }
        report
    }
}

fn told_of(criterion: &Criterion) -> CriterionReport {
    CriterionReport {
        name: Line::new(criterion.name),
        unit: Line::new(criterion.unit),
        value: criterion.value,
        goal: criterion.goal,
        at_least: u64::from(criterion.at_least),
        met: u64::from(criterion.met),
    }
}

/// Which world it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct WorldName {
    /// The task.
    pub(super) task: String,
    /// What [`Setup::scene_hash`](super::Setup::scene_hash) says of its scene.
    pub(super) scene_hash: u64,
    /// The episode's seed.
    pub(super) seed: u64,
}

/// The report of `state` at `stamp` on the system's clock, the step `sequence` of the episode of
/// `world`.
pub(super) fn report(
    stamp: TimeNs,
    sequence: u64,
    world: &WorldName,
    state: &WorldState,
) -> SceneReport {
    let second = state.scene.second.as_ref();
    let verdict = match &state.outcome {
        None if state.operational => Verdict::Operational,
        None => Verdict::Waiting,
        Some(Outcome::Running) => Verdict::Running,
        Some(Outcome::Success) => Verdict::Success,
        Some(Outcome::Failure(_)) => Verdict::Failure,
        Some(Outcome::Invalid(_)) => Verdict::Invalid,
    };
    let reason = match &state.outcome {
        Some(Outcome::Failure(reason) | Outcome::Invalid(reason)) => Line::new(&reason.to_string()),
        _ => Line::default(),
    };
    let tissue = state.tissue.unwrap_or_default();
    SceneReport {
        stamp,
        sequence,
        task: Line::new(&world.task),
        scene_hash: world.scene_hash,
        seed: world.seed,
        arm_count: if second.is_some() { 2 } else { 1 },
        arms: [
            scene_arm(&state.scene.first),
            second.map(scene_arm).unwrap_or_default(),
        ],
        has_goal: u64::from(state.scene.goal_in_scene.is_some()),
        goal_in_scene: state
            .scene
            .goal_in_scene
            .as_ref()
            .map(PoseMessage::new)
            .unwrap_or_default(),
        has_tissue: u64::from(state.tissue.is_some()),
        tissue: SceneTissue {
            force_n: tissue.force_n,
            squeeze_n: tissue.squeeze_n,
            stretch: tissue.stretch,
            mark_rise_m: tissue.mark_rise_m,
        },
        code: SceneReport::code_of(verdict),
        reason,
    }
}

fn scene_arm(arm: &ArmScene) -> SceneArm {
    SceneArm {
        tip_in_rcm: PoseMessage::new(&arm.tip_in_rcm),
        thing_in_rcm: PoseMessage::new(&arm.thing_in_rcm),
        jaw: arm.jaw,
        finger_force_n: [arm.grasp.left_force_n, arm.grasp.right_force_n],
        penetration_m: arm.grasp.penetration_m,
        held: u64::from(arm.grasp.both_touch),
    }
}

/// The scene in `report`, as experts see it.
pub(super) fn scene_state(report: &SceneReport) -> SceneState {
    let arm = |arm: &SceneArm| ArmScene {
        tip_in_rcm: arm.tip_in_rcm.pose(),
        thing_in_rcm: arm.thing_in_rcm.pose(),
        jaw: arm.jaw,
        grasp: Grasp {
            left_force_n: arm.finger_force_n[0],
            right_force_n: arm.finger_force_n[1],
            both_touch: arm.held != 0,
            penetration_m: arm.penetration_m,
        },
    };
    SceneState {
        first: arm(&report.arms[0]),
        second: (report.arm_count > 1).then(|| arm(&report.arms[1])),
        goal_in_scene: (report.has_goal != 0).then(|| report.goal_in_scene.pose()),
    }
}

/// What the tissue of `report` went through, if there is one.
pub(super) fn tissue(report: &SceneReport) -> Option<TissueSummary> {
    (report.has_tissue != 0).then_some(TissueSummary {
        force_n_max: report.tissue.force_n,
        squeeze_n_max: report.tissue.squeeze_n,
        stretch_max: report.tissue.stretch,
        mark_rise_m_max: report.tissue.mark_rise_m,
    })
}

#[cfg(test)]
mod tests {
    use trocar_tasks::simulation::Rendering;
    use trocar_tasks::task::TaskConfig;

    use super::*;

    #[test]
    fn a_scene_comes_back_bit_for_bit() {
        for name in TaskConfig::names() {
            let task = TaskConfig::built_in(name).unwrap();
            let simulation = Simulation::new(&task, 5, Rendering::Off).unwrap();
            let state = WorldState::of(&simulation, true, true);
            let world = WorldName {
                task: name.to_owned(),
                scene_hash: 9,
                seed: 5,
            };
            let told = report(TimeNs(7), 3, &world, &state);
            assert_eq!(
                format!("{:?}", scene_state(&told)),
                format!("{:?}", state.scene)
            );
            assert_eq!((told.task.text().as_str(), told.seed), (name, 5));
            assert_eq!(told.verdict(), Verdict::Running);
            assert_eq!(tissue(&told).is_some(), task.kind == "tissue-retraction");
            let waits = |operational| {
                let waiting = WorldState::of(&simulation, operational, false);
                report(TimeNs(7), 3, &world, &waiting).verdict()
            };
            assert_eq!(waits(false), Verdict::Waiting);
            assert_eq!(waits(true), Verdict::Operational);
        }
    }

    /// Whoever looks on is told of every criterion what the judge says of it.
    #[test]
    fn all_criteria_are_told() {
        for name in TaskConfig::names() {
            let task = TaskConfig::built_in(name).unwrap();
            let simulation = Simulation::new(&task, 5, Rendering::Off).unwrap();
            let state = TaskState::of(&simulation);
            let told = state.report(TimeNs(7), 3);
            assert_eq!((told.stamp, told.sequence), (TimeNs(7), 3));
            assert_eq!(told.missing.text(), state.missing);
            assert_eq!(told.criteria().len(), state.criteria.iter().count());
            assert!(!told.criteria().is_empty(), "{name}");
            for (told, criterion) in told.criteria().iter().zip(state.criteria.iter()) {
                assert_eq!(told.name.text(), criterion.name);
                assert_eq!(told.unit.text(), criterion.unit);
                assert_eq!(told.value.to_bits(), criterion.value.to_bits());
                assert_eq!(told.goal.to_bits(), criterion.goal.to_bits());
                let flags = (told.at_least == 1, told.met == 1);
                assert_eq!(flags, (criterion.at_least, criterion.met));
            }
        }
    }
}
