//! What the trainings of all networks share: fresh parameters laid flat, a learner on views of
//! them, the steps, and in the end the network with averaged weights.

use serde::Serialize;
use tch::Device;

use super::curve::LossCurve;
use super::flat::FlatParameters;
use super::options::TrainOptions;
use super::run_state::RunState;
use super::steps::{Learner, Split, Steps};
use super::{TrainError, TrainingObserver};
use trocar_data::perception::CloudRecipe;
use trocar_data::relative_action::RELATIVE_ACTION_DIM;
use trocar_nets::act::Act;
use trocar_nets::act_pc::ActPc;
use trocar_nets::checkpoint::BackboneWeights;
use trocar_nets::cuda_graph::{allow_tf32_products, sleep_while_waiting};
use trocar_nets::dimension::dimension;
use trocar_nets::dp3::Dp3;
use trocar_nets::normalise::Statistics;
use trocar_nets::parameters::{ParameterError, ParameterSource, Parameters};

/// A network that can be trained.
pub trait Network: Sized {
    /// What it is built from.
    type Config: Clone + Serialize;
    /// What its inputs and outputs are normalised with.
    type Statistics: Clone;

    /// The network of `config` with the parameters of `source`.
    ///
    /// # Errors
    /// [`ParameterError`] if a tensor is missing, left over or of another shape.
    fn build(config: Self::Config, source: ParameterSource) -> Result<Self, ParameterError>;

    /// The outcome of its training among those of all networks.
    fn any(trained: Trained<Self>) -> AnyTrained;
}

/// The outcome of a run.
#[derive(Debug)]
pub struct Trained<N: Network> {
    /// The network with averaged weights, on the training device.
    pub network: N,
    /// Statistics of the frames trained on.
    pub statistics: N::Statistics,
    /// The losses along the way. `l1` is the mean error of the actions, as the configuration counts
    /// it; of DP3 what is minimised, the mean square.
    pub curve: LossCurve,
    /// Frames trained on.
    pub frames: usize,
}

/// The outcome of a run of any network.
#[derive(Debug)]
pub enum AnyTrained {
    /// ACT.
    Act(Box<Trained<Act>>),
    /// ACT-PC.
    ActPc(Box<Trained<ActPc>>),
    /// DP3.
    Dp3(Box<Trained<Dp3>>),
}

impl AnyTrained {
    /// The losses along the way.
    #[must_use]
    pub const fn curve(&self) -> &LossCurve {
        match self {
            Self::Act(trained) => &trained.curve,
            Self::ActPc(trained) => &trained.curve,
            Self::Dp3(trained) => &trained.curve,
        }
    }

    /// Frames trained on.
    #[must_use]
    pub const fn frames(&self) -> usize {
        match self {
            Self::Act(trained) => trained.frames,
            Self::ActPc(trained) => trained.frames,
            Self::Dp3(trained) => trained.frames,
        }
    }
}

/// A dataset that is ready to be drawn from.
pub(super) struct Prepared<'a, S> {
    /// The frames.
    pub(super) split: Split<'a>,
    /// How point clouds were made; none of images.
    pub(super) cloud: Option<&'a CloudRecipe>,
    /// Of state and action, among the `statistics`.
    pub(super) features: [&'a Statistics; 2],
    /// Statistics of inputs and outputs, for the checkpoint.
    pub(super) statistics: &'a S,
}

/// Trains networks on one device.
#[derive(Debug)]
pub struct Trainer {
    /// Where it trains.
    pub(super) device: Device,
    /// The state of the run that goes on, if one does.
    pub(super) from: Option<RunState>,
    /// Imported weights of the backbone, if there are any.
    pub(super) backbone: Option<BackboneWeights>,
}

impl Trainer {
    /// A trainer on `device`.
    #[must_use]
    pub const fn new(device: Device) -> Self {
        Self {
            device,
            from: None,
            backbone: None,
        }
    }

    /// The same, but that a run goes on from `state` instead of starting: on the CPU, and with the
    /// same options, dataset and number of threads, to the same bits as one that was never stopped.
    #[must_use]
    pub fn resuming(self, state: RunState) -> Self {
        Self {
            from: Some(state),
            ..self
        }
    }

    /// Sets what the network library keeps for the whole process: threads, and on CUDA that it may
    /// try which kernels are the fastest (every step has the same shapes) and that matrix products
    /// of single precision are TF32, as convolutions are. Waiting takes no core from other
    /// trainings.
    pub(super) fn begin(&self, options: &TrainOptions) {
        tch::set_num_threads(i32::try_from(options.threads.max(1)).unwrap_or(1));
        if self.device.is_cuda() {
            sleep_while_waiting();
            allow_tf32_products();
            tch::Cuda::cudnn_set_benchmark(true);
        }
    }

    /// Trains the network `config` from the `fresh` parameters on what is `prepared`: `learner`
    /// makes, of the network whose weights the optimiser moves, what takes the steps.
    pub(super) fn train<N: Network, L: Learner>(
        &self,
        (config, fresh): (&N::Config, &Parameters),
        prepared: &Prepared<'_, N::Statistics>,
        options: &TrainOptions,
        learner: impl FnOnce(N) -> Result<L, TrainError>,
        watch: &mut dyn TrainingObserver,
    ) -> Result<Trained<N>, TrainError> {
        let mut flat = FlatParameters::new(fresh, self.device, options)?;
        let build = |tensors| N::build(config.clone(), ParameterSource::given(tensors));
        let learner = learner(build(flat.working_tensors())?)?;
        let trained = |flat: &FlatParameters, curve: LossCurve| {
            Ok::<_, TrainError>(Trained {
                network: build(flat.averaged_tensors()?)?,
                statistics: prepared.statistics.clone(),
                curve,
                frames: prepared.split.trained.len(),
            })
        };
        let steps = Steps {
            learner: &learner,
            options,
            split: prepared.split,
            run: run_of(config, prepared, options),
            so_far: &|flat, curve| Ok(N::any(trained(flat, curve)?)),
        };
        let curve = steps.take(&mut flat, self.from.as_ref(), watch)?;
        trained(&flat, curve)
    }
}

/// What must be the same in a run that resumes another one's state, as JSON. A resumed run compares
/// it as text, and names the first key that differs.
fn run_of<S>(
    config: &impl Serialize,
    prepared: &Prepared<'_, S>,
    options: &TrainOptions,
) -> String {
    let [state, action] = prepared.features;
    let dataset = serde_json::json!({
        "frames": prepared.split.trained.len(),
        "state": [state.mean, state.std],
        "action": [action.mean, action.std],
    });
    // Where images lie and how often the state is kept changes no number.
    let options = TrainOptions {
        images_on_host: false,
        save_every: 0,
        ..*options
    };
    serde_json::json!({
        "network": config,
        "cloud": prepared.cloud,
        "options": options,
        "dataset": dataset,
    })
    .to_string()
}

/// Refuses options or a configuration with a `defect`.
pub(super) fn refuse(defect: Option<String>) -> Result<(), TrainError> {
    defect.map_or(Ok(()), |defect| Err(TrainError::Options(defect)))
}

/// The network must have the numbers of `arms` arms, the dataset's, for state and action.
pub(super) fn check_arms([state, action]: [i64; 2], arms: usize) -> Result<(), TrainError> {
    let numbers = dimension(arms * RELATIVE_ACTION_DIM);
    if [state, action] == [numbers; 2] {
        return Ok(());
    }
    Err(TrainError::Dataset(format!(
        "it has {arms} arms, {numbers} numbers of state and of action, the network {state} and {action}"
    )))
}
