//! How a network computes its answers: where, in which precision, with how many threads.

use std::path::Path;

use tch::{Device, Kind};

use crate::checkpoint::{Cause, CheckpointError};

/// In which numbers a network computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arithmetic {
    /// Single precision, as it was trained.
    #[default]
    F32,
    /// Weights and most activations with 8 significant bits: less to read, and answers that differ
    /// from those in single precision. On CUDA only: a CPU's library picks its instructions by what
    /// the processor claims to have, and where a virtual machine does not let them through, the
    /// process ends.
    Bf16,
}

/// Where and how a network computes.
///
/// Device and arithmetic are the policy's own. Threads are the network library's, for the whole
/// process: the policy that is loaded last decides for all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Compute {
    /// Where.
    pub device: Device,
    /// In which numbers.
    pub arithmetic: Arithmetic,
    /// Threads of the network library on the CPU. With another number the same observation may give
    /// other bits.
    pub threads: usize,
}

impl From<Device> for Compute {
    /// In single precision, with one thread: on cores that are not reserved, several are slower.
    fn from(device: Device) -> Self {
        Self {
            device,
            arithmetic: Arithmetic::F32,
            threads: 1,
        }
    }
}

impl Compute {
    /// Sets the network library's threads, for the whole process, and says the kind of number for
    /// the policy in `folder`.
    pub(crate) fn prepare(self, folder: &Path) -> Result<Kind, CheckpointError> {
        tch::set_num_threads(i32::try_from(self.threads.max(1)).unwrap_or(i32::MAX));
        match self.arithmetic {
            Arithmetic::F32 => Ok(Kind::Float),
            Arithmetic::Bf16 if self.device.is_cuda() => Ok(Kind::BFloat16),
            Arithmetic::Bf16 => Err(Cause::Unsupported {
                field: "precision".to_owned(),
                value: "bf16".to_owned(),
                expected: "f32, or a CUDA device".to_owned(),
            }
            .in_file(folder)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use tch::{Device, Kind};

    use super::{Arithmetic, Compute};

    #[test]
    fn a_cpu_computes_in_single_precision_alone() {
        let folder = Path::new("somewhere");
        let compute = Compute::from(Device::Cpu);
        assert_eq!(compute.prepare(folder).unwrap(), Kind::Float);
        let half = Compute {
            arithmetic: Arithmetic::Bf16,
            ..compute
        };
        let error = half.prepare(folder).unwrap_err().to_string();
        assert!(error.contains("precision = bf16"), "{error}");
    }
}
