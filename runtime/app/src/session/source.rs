//! Where chunks come from: the scripted expert, a network, or one of the two policies that must
//! never succeed.

use hal::{
    ARMS_MAX, ArmObservation, ArmState, Chunk, FrameRef, Observation, Policy, TimeNs, TipTarget,
};
use nalgebra::{Translation3, Vector3};
use trocar_nets::checkpoint::Recipe;
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_tasks::expert::{Activity, Expert};

use trocar_tasks::scene::SceneState;
use trocar_world::rng::Rng;

use super::SessionError;
use super::external::ExternalPolicy;
use super::steps::PolicySteps;
use super::teleop::{CHUNK_TICKS, SimulatedOperator, Teleop, TeleopSummary};
use hal::PerArm;
use trocar_control::kinematics;
use trocar_log::TickRecord;

/// Control periods in one policy step.
pub const STEP_TICKS: u64 = hal::POLICY_STEP_NS / hal::TICK_NS;

/// Ticks from an observation to a network's chunk in lockstep: about what it takes in real time on
/// two shared cores.
pub const NETWORK_LATENCY_TICKS: u64 = 4 * STEP_TICKS;

/// One policy step, ns.
pub const STEP_NS: u64 = hal::POLICY_STEP_NS;

/// An arm that measured `state`, as a policy sees it.
#[must_use]
pub fn seen_arm(state: &ArmState) -> ArmObservation {
    ArmObservation {
        state: *state,
        tip_in_rcm: kinematics::forward(&state.position),
    }
}

/// What a source may look at. Only the expert looks at `scene`.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    /// The measured arms.
    pub arms: PerArm<ArmObservation>,
    /// Frames of the cameras in [`ChunkSource::cameras`].
    pub frames: &'a [FrameRef<'a>],
    /// The true state of the scene, of which a robot knows nothing.
    pub scene: Option<&'a SceneState>,
}

/// A source of chunks.
pub enum ChunkSource {
    /// The scripted expert.
    Expert {
        /// The expert itself.
        expert: Box<Expert>,
        /// Chunks so far.
        sequence: u64,
    },
    /// Holds the pose that it saw first of each arm.
    Noop {
        /// These poses and jaw angles.
        held: Option<PerArm<TipTarget>>,
        /// Chunks so far.
        sequence: u64,
    },
    /// Wanders around the pose that it saw first of each arm.
    Random {
        /// These poses and jaw angles.
        home: Option<PerArm<TipTarget>>,
        /// The dice.
        rng: Rng,
        /// Chunks so far.
        sequence: u64,
    },
    /// An operator's hands.
    Teleop(Box<Teleop>),
    /// A simulated operator.
    Operator(Box<SimulatedOperator>),
    /// A policy that sees the arms and cameras: a trained network, or anyone's.
    Policy(Observer),
}

/// A policy with what it has to be shown, and when.
pub struct Observer {
    policy: Box<dyn Policy + Send>,
    cameras: Vec<SizedCamera>,
    query_every_steps: u64,
    steps: PolicySteps,
}

/// Makes a policy of the caller's, [`ChunkSource::policy`].
pub type MakeSource<'a> = &'a (dyn Fn() -> Result<ChunkSource, SessionError> + Sync);

/// A camera by name, and the size in pixels that its frames must have, if any.
pub(super) type SizedCamera = (String, Option<(u32, u32)>);

impl ChunkSource {
    /// A policy that looks through `cameras` (names of the task's, or of a robot's) and is asked
    /// every `query_every_steps` policy steps of 40 ms, at least each step.
    #[must_use]
    pub fn policy(
        policy: Box<dyn Policy + Send>,
        cameras: Vec<String>,
        query_every_steps: u64,
    ) -> Self {
        let cameras = cameras.into_iter().map(|name| (name, None)).collect();
        Self::seeing(policy, cameras, query_every_steps)
    }

    /// The same with the sizes of the cameras' frames.
    fn seeing(
        policy: Box<dyn Policy + Send>,
        cameras: Vec<SizedCamera>,
        query_every_steps: u64,
    ) -> Self {
        Self::Policy(Observer {
            policy,
            cameras,
            query_every_steps: query_every_steps.max(1),
            steps: PolicySteps::USUAL,
        })
    }

    /// The same source, in lockstep asked in other steps if it is a policy.
    #[must_use]
    pub fn in_steps(mut self, steps: PolicySteps) -> Self {
        if let Self::Policy(observer) = &mut self {
            observer.steps = steps;
        }
        self
    }

    /// A policy in another process.
    #[must_use]
    pub fn external(policy: ExternalPolicy) -> Self {
        let (cameras, every) = (policy.cameras(), policy.query_every_steps());
        Self::policy(Box::new(policy), cameras, every)
    }

    /// A trained network.
    #[must_use]
    pub fn network(network: LoadedPolicy) -> Self {
        let every = u64::from(network.recipe().query_every_steps);
        let cameras = sized_cameras(network.recipe());
        Self::seeing(Box::new(network), cameras, every)
    }

    /// Forgets the past; everything random afterwards depends on `seed`. What is made with its seed
    /// is not changed.
    pub fn reset(&mut self, seed: u64) {
        if let Self::Policy(observer) = self {
            observer.policy.reset(seed);
        }
    }

    /// One that holds still.
    #[must_use]
    pub const fn noop() -> Self {
        Self::Noop {
            held: None,
            sequence: 0,
        }
    }

    /// One that moves at random, by `seed`.
    #[must_use]
    pub fn random(seed: u64) -> Self {
        Self::Random {
            home: None,
            rng: Rng::stream(seed, "random policy"),
            sequence: 0,
        }
    }

    /// Names of the cameras whose frames a query needs.
    #[must_use]
    pub fn cameras(&self) -> Vec<String> {
        let cameras = self.sized_cameras().iter();
        cameras.map(|(name, _)| name.clone()).collect()
    }

    /// The same with the sizes that their frames must have.
    pub(super) fn sized_cameras(&self) -> &[SizedCamera] {
        match self {
            Self::Expert { .. }
            | Self::Noop { .. }
            | Self::Random { .. }
            | Self::Teleop(_)
            | Self::Operator(_) => &[],
            Self::Policy(observer) => &observer.cameras,
        }
    }

    /// Policy steps from one query to the next.
    #[must_use]
    pub fn query_every_steps(&self) -> u64 {
        match self {
            Self::Expert { .. } | Self::Noop { .. } | Self::Teleop(_) | Self::Operator(_) => 1,
            Self::Random { .. } => 5,
            Self::Policy(observer) => observer.query_every_steps,
        }
    }

    /// The policy steps of an episode in lockstep.
    #[must_use]
    pub const fn steps(&self) -> PolicySteps {
        match self {
            Self::Expert { .. }
            | Self::Noop { .. }
            | Self::Random { .. }
            | Self::Teleop(_)
            | Self::Operator(_) => PolicySteps::USUAL,
            Self::Policy(observer) => observer.steps,
        }
    }

    /// Ticks from one query to the next in real time, with frames none.
    pub(super) fn query_every_ticks(&self) -> u64 {
        match self {
            Self::Teleop(_) | Self::Operator(_) => CHUNK_TICKS,
            Self::Expert { .. } | Self::Noop { .. } | Self::Random { .. } | Self::Policy(_) => {
                STEP_TICKS * self.query_every_steps()
            }
        }
    }

    /// Whether it answers in lockstep at the tick `tick` between two policy steps.
    pub(super) const fn answers_between(&self, tick: u64) -> bool {
        matches!(self, Self::Operator(_)) && tick.is_multiple_of(CHUNK_TICKS)
    }

    /// A tick is over in lockstep.
    pub(super) fn ticked(&mut self, record: &TickRecord) {
        if let Self::Operator(operator) = self {
            operator.ticked(record);
        }
    }

    /// What the log is to say of it, since the last call.
    pub(super) fn take_notices(&mut self) -> Vec<String> {
        match self {
            Self::Teleop(teleop) => teleop.take_notices(),
            Self::Expert { .. }
            | Self::Noop { .. }
            | Self::Random { .. }
            | Self::Operator(_)
            | Self::Policy(_) => Vec::new(),
        }
    }

    /// What each arm is doing, as far as the source tells: the expert does.
    #[must_use]
    pub fn activities(&self) -> [Activity; ARMS_MAX] {
        match self {
            Self::Expert { expert, .. } => expert.activities(),
            Self::Noop { .. }
            | Self::Random { .. }
            | Self::Teleop(_)
            | Self::Operator(_)
            | Self::Policy(_) => [Activity::Other; ARMS_MAX],
        }
    }

    /// Grasps that the expert or the simulated operator has tried, the present one included; 0 of
    /// any other source.
    #[must_use]
    pub fn attempts(&self) -> u32 {
        match self {
            Self::Expert { expert, .. } => expert.attempts(),
            Self::Operator(operator) => operator.attempts(),
            Self::Noop { .. } | Self::Random { .. } | Self::Teleop(_) | Self::Policy(_) => 0,
        }
    }

    /// What a simulated operator's hands did.
    pub(super) fn by_hand(&self) -> Option<TeleopSummary> {
        match self {
            Self::Operator(operator) => Some(operator.summary()),
            Self::Expert { .. }
            | Self::Noop { .. }
            | Self::Random { .. }
            | Self::Teleop(_)
            | Self::Policy(_) => None,
        }
    }

    /// Policy steps before a query that it wants to have observed too.
    #[must_use]
    pub fn history_steps(&self) -> u64 {
        match self {
            Self::Expert { .. }
            | Self::Noop { .. }
            | Self::Random { .. }
            | Self::Teleop(_)
            | Self::Operator(_) => 0,
            Self::Policy(observer) => observer.policy.history_steps(),
        }
    }

    /// Shows it what comes before its next query.
    ///
    /// # Errors
    /// Whatever the network reports.
    pub fn observe(
        &mut self,
        arms: &PerArm<ArmObservation>,
        frames: &[FrameRef<'_>],
    ) -> Result<(), SessionError> {
        if let Self::Policy(observer) = self {
            let arms: Vec<ArmObservation> = arms.iter().copied().collect();
            let arms = &arms;
            observer.policy.observe(&Observation { arms, frames })?;
        }
        Ok(())
    }

    /// Ticks from observation to delivery in lockstep, unless the user says otherwise.
    #[must_use]
    pub fn latency_ticks(&self) -> u64 {
        match self {
            Self::Expert { .. }
            | Self::Noop { .. }
            | Self::Random { .. }
            | Self::Teleop(_)
            | Self::Operator(_) => 0,
            Self::Policy(_) => NETWORK_LATENCY_TICKS,
        }
    }

    /// The chunks that answer `query`, one for each arm.
    ///
    /// # Errors
    /// Whatever the network reports; [`SessionError::BadArgument`] if the policy commands no arm.
    pub fn answer(&mut self, query: &Query<'_>) -> Result<PerArm<Chunk>, SessionError> {
        let now = query.arms.first.state.stamp;
        let here = query.arms.map(|arm| arm.here());
        match self {
            Self::Expert { expert, sequence } => {
                *sequence += 1;
                per_arm(expert.chunks(now, seen_scene(query)?, *sequence))
            }
            Self::Noop { held, sequence } => {
                *sequence += 1;
                let held = *held.get_or_insert(here);
                Ok(held.map(|target| Chunk::new(now, *sequence, STEP_NS, &[target; 2])))
            }
            Self::Random {
                home,
                rng,
                sequence,
            } => {
                *sequence += 1;
                let home = *home.get_or_insert(here);
                Ok(home.map(|home| wander(now, *sequence, &home, rng)))
            }
            Self::Teleop(teleop) => teleop.answer(&query.arms),
            Self::Operator(operator) => operator.answer(&query.arms, seen_scene(query)?),
            Self::Policy(observer) => {
                let arms: Vec<ArmObservation> = query.arms.iter().copied().collect();
                let observation = Observation {
                    arms: &arms,
                    frames: query.frames,
                };
                let chunks = observer.policy.infer(&observation)?;
                let (said, arms) = (chunks.len(), arms.len());
                if said != arms {
                    return Err(SessionError::BadArgument(format!(
                        "the policy answers with {said} chunks for {arms} arms: expected one per arm"
                    )));
                }
                per_arm(chunks)
            }
        }
    }
}

fn seen_scene<'a>(query: &Query<'a>) -> Result<&'a SceneState, SessionError> {
    let missing = || SessionError::BadArgument("this policy needs a scene to see".to_owned());
    query.scene.ok_or_else(missing)
}

fn per_arm(chunks: Vec<Chunk>) -> Result<PerArm<Chunk>, SessionError> {
    PerArm::collect(chunks)
        .ok_or_else(|| SessionError::BadArgument("the policy commands no arm".to_owned()))
}

/// Whether a policy that is asked every `every` steps wants to have seen the step `step` too, which
/// is no query's.
#[must_use]
pub const fn precedes_query(step: u64, every: u64, history_steps: u64) -> bool {
    let since = step % every;
    since != 0 && every - since <= history_steps
}

/// Names of the cameras that a network of this `recipe` looks through: LeRobot's feature names
/// without their common beginning.
#[must_use]
pub fn camera_names(recipe: &Recipe) -> Vec<String> {
    let name = |feature: &str| {
        feature
            .strip_prefix("observation.images.")
            .unwrap_or(feature)
            .to_owned()
    };
    recipe
        .cameras
        .iter()
        .map(|camera| name(&camera.feature))
        .collect()
}

/// The same with the sizes that the network was trained with.
pub(super) fn sized_cameras(recipe: &Recipe) -> Vec<SizedCamera> {
    let sizes = recipe.cameras.iter();
    let sizes = sizes.map(|camera| Some((camera.width, camera.height)));
    camera_names(recipe).into_iter().zip(sizes).collect()
}

/// A straight stretch to a random place, up to 4 cm from `home` along each axis, the jaw anywhere.
fn wander(now: TimeNs, sequence: u64, home: &TipTarget, rng: &mut Rng) -> Chunk {
    const STEPS: u32 = 15;
    const REACH_M: f64 = 0.04;
    let mut draw = || rng.range(-REACH_M, REACH_M);
    let offset = Vector3::new(draw(), draw(), draw());
    let jaw = rng.range(-0.2, 1.0);
    let home_in_rcm = home.tip_in_rcm();
    let targets: Vec<TipTarget> = (0..STEPS)
        .map(|step| {
            let share = f64::from(step) / f64::from(STEPS);
            let moved = Translation3::from(offset * share) * home_in_rcm;
            TipTarget::new(&moved, jaw)
        })
        .collect();
    Chunk::new(now, sequence, STEP_NS, &targets)
}
