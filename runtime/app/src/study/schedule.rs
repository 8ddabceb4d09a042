//! What of a machine a cell takes, and whether it is free.

use super::file::{RunSection, StudyFile};
use super::job::{Job, Kind};

/// A GPU as shares. Trainings have one such whole, and evaluations another, so that none waits for
/// the others' end.
const WHOLE_GPU: usize = 1_000_000;

/// What a machine has for a study.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Machine {
    /// Cores.
    pub cores: usize,
    /// GPUs, by the names that `CUDA_VISIBLE_DEVICES` takes.
    pub gpus: Vec<String>,
}

/// Resources that a cell needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResourceRequest {
    /// Cores.
    pub cores: usize,
    /// Shares of one GPU.
    pub gpu: usize,
    /// Of which whole.
    pub of: Whole,
}

/// Whose share of a GPU it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Whole {
    /// Trainings'.
    Trainings,
    /// Evaluations'.
    Evaluations,
}

impl ResourceRequest {
    /// Of `job`, on a machine with `cores`.
    #[must_use]
    pub fn of(job: &Job, file: &StudyFile, cores: usize) -> Self {
        let run = &file.run;
        let wanted = match job {
            Job::Recording(job) => run.record_jobs.min(job.episodes.max(1)),
            // The GPU computes; the threads decode images first.
            Job::Training(_) if job.on_gpu() => 1,
            Job::Training(job) => job.threads,
            Job::Evaluation(job) => run.eval_jobs.min(job.trials),
        };
        Self {
            cores: wanted.clamp(1, cores.max(1)),
            gpu: if job.on_gpu() {
                gpu_share(job.kind(), run)
            } else {
                0
            },
            of: match job.kind() {
                Kind::Recording | Kind::Training => Whole::Trainings,
                Kind::Evaluation => Whole::Evaluations,
            },
        }
    }
}

const fn gpu_share(kind: Kind, run: &RunSection) -> usize {
    match kind {
        Kind::Recording => 0,
        Kind::Training => WHOLE_GPU / run.trainings_per_gpu,
        Kind::Evaluation => WHOLE_GPU / run.evaluations_per_gpu,
    }
}

/// How many cells of such a need run at a time.
#[must_use]
pub fn at_a_time(need: ResourceRequest, machine: &Machine) -> usize {
    let by_cores = machine.cores.max(1) / need.cores.max(1);
    if need.gpu == 0 {
        return by_cores.max(1);
    }
    by_cores
        .min(machine.gpus.len() * (WHOLE_GPU / need.gpu))
        .max(1)
}

/// Resources allocated to a cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Allocation {
    need: ResourceRequest,
    /// Which GPU.
    gpu: Option<usize>,
}

/// What is free.
#[derive(Clone, Debug)]
pub struct Pool {
    cores: usize,
    /// By name, free shares of trainings and of evaluations.
    gpus: Vec<(String, [usize; 2])>,
}

/// Why resources are not available now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unavailable {
    /// Too few cores are free.
    Cores,
    /// No GPU has room.
    Gpu,
}

impl Pool {
    /// All of `machine`.
    #[must_use]
    pub fn new(machine: &Machine) -> Self {
        Self {
            cores: machine.cores.max(1),
            gpus: machine
                .gpus
                .iter()
                .map(|gpu| (gpu.clone(), [WHOLE_GPU; 2]))
                .collect(),
        }
    }

    /// Takes `need`, from the GPU with the most room.
    ///
    /// # Errors
    /// [`Unavailable`], and nothing was taken.
    pub fn take(&mut self, need: ResourceRequest) -> Result<Allocation, Unavailable> {
        if need.cores > self.cores {
            return Err(Unavailable::Cores);
        }
        let mut gpu = None;
        if need.gpu > 0 {
            let roomy = self.gpus.iter_mut().enumerate().rev();
            let of = need.of as usize;
            let roomiest = roomy.max_by_key(|(_, (_, free))| free[of]);
            let (index, (_, free)) = roomiest.ok_or(Unavailable::Gpu)?;
            free[of] = free[of].checked_sub(need.gpu).ok_or(Unavailable::Gpu)?;
            gpu = Some(index);
        }
        self.cores -= need.cores;
        Ok(Allocation { need, gpu })
    }

    /// Gives back what was taken.
    pub fn give(&mut self, grant: &Allocation) {
        self.cores += grant.need.cores;
        let gpu = grant.gpu.and_then(|index| self.gpus.get_mut(index));
        if let Some((_, free)) = gpu {
            free[grant.need.of as usize] += grant.need.gpu;
        }
    }

    /// The name of the GPU of `grant`.
    #[must_use]
    pub fn gpu_name(&self, grant: &Allocation) -> Option<&str> {
        let gpu = grant.gpu.and_then(|index| self.gpus.get(index))?;
        Some(&gpu.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine() -> Machine {
        Machine {
            cores: 8,
            gpus: vec!["0".to_owned(), "1".to_owned()],
        }
    }

    fn need(cores: usize, gpu: usize) -> ResourceRequest {
        ResourceRequest {
            cores,
            gpu,
            of: Whole::Trainings,
        }
    }

    #[test]
    fn trainings_spread_over_gpus_and_share_them() {
        let mut pool = Pool::new(&machine());
        let need = need(1, WHOLE_GPU / 3);
        let grants: Vec<Allocation> = (0..6).map(|_| pool.take(need).unwrap()).collect();
        let names: Vec<_> = grants
            .iter()
            .map(|grant| pool.gpu_name(grant).unwrap())
            .collect();
        assert_eq!(names, ["0", "1", "0", "1", "0", "1"]);
        assert_eq!(pool.take(need), Err(Unavailable::Gpu));
        assert_eq!(at_a_time(need, &machine()), 6);
        // Evaluations do not wait for them.
        let evaluation = ResourceRequest {
            cores: 1,
            gpu: WHOLE_GPU,
            of: Whole::Evaluations,
        };
        assert!(pool.clone().take(evaluation).is_ok());
        pool.give(&grants[3]);
        let again = pool.take(need).unwrap();
        assert_eq!(pool.gpu_name(&again), Some("1"));
    }

    #[test]
    fn what_is_not_free_is_not_taken() {
        let mut pool = Pool::new(&machine());
        let wide = pool.take(need(6, 0)).unwrap();
        assert_eq!(pool.take(need(3, 0)), Err(Unavailable::Cores));
        let narrow = pool.take(need(2, WHOLE_GPU)).unwrap();
        pool.give(&wide);
        pool.give(&narrow);
        assert!(pool.take(need(8, WHOLE_GPU)).is_ok());
        let none = Machine {
            cores: 1,
            gpus: Vec::new(),
        };
        assert_eq!(Pool::new(&none).take(need(1, 1)), Err(Unavailable::Gpu));
    }
}
