//! CUDA graphs of networks and of training steps: captured once, replayed at each further inference
//! or step.
//!
//! Launching hundreds of small kernels one by one takes longer than running them. A graph is
//! launched with one call and computes the same: the same kernels on the same device. A training
//! step is captured after a few that run eagerly.

mod aside;
mod functions;
mod graph;
#[cfg(test)]
mod mock;

use tch::{Device, TchError, Tensor};

use aside::SideStream;
pub(crate) use functions::stream_of;
pub use functions::{allow_tf32_products, sleep_while_waiting};
use graph::Graph;

/// The CUDA graph of a network, if there is one.
#[derive(Debug, Default)]
pub(crate) enum NetworkGraph {
    /// No inference has run yet.
    #[default]
    NotYet,
    /// There is nothing to be gained, or it can't be done.
    Never,
    /// Replayed for inputs of the shapes that it was captured with.
    Ready(CapturedGraph),
}

/// A captured graph with the tensors that it reads and writes.
#[derive(Debug)]
pub struct CapturedGraph {
    /// Dropped before what it works in.
    graph: Graph,
    inputs: Vec<Tensor>,
    answer: Tensor,
}

impl NetworkGraph {
    /// What `network` answers to `inputs`, all of which are on one device. On CUDA the answer is
    /// overwritten by the next one.
    ///
    /// `network` must do the same with the device for all inputs of these shapes, read nothing of
    /// them back, and keep what it works in.
    ///
    /// # Errors
    /// Those of `network`, and the network library's.
    pub(crate) fn answer<const N: usize>(
        &mut self,
        inputs: [&Tensor; N],
        mut network: impl FnMut([&Tensor; N]) -> Result<Tensor, TchError>,
    ) -> Result<Tensor, TchError> {
        if matches!(self, Self::NotYet) {
            let made = tch::no_grad(|| CapturedGraph::of(inputs, &mut network))?;
            *self = made.map_or(Self::Never, Self::Ready);
        }
        match self {
            Self::Ready(graph) if graph.fits(&inputs) => tch::no_grad(|| graph.answer(&inputs)),
            Self::NotYet | Self::Never | Self::Ready(_) => network(inputs),
        }
    }
}

/// A capture to come on a CUDA device: what the libraries set up at first must be done while this
/// lives.
#[derive(Debug)]
pub struct Capture(SideStream);

impl Capture {
    /// None if `device` is not the thread's current CUDA device, or the libraries here have no
    /// CUDA.
    ///
    /// # Errors
    /// CUDA's.
    pub fn begin(device: Device) -> Result<Option<Self>, TchError> {
        let Device::Cuda(device) = device else {
            return Ok(None);
        };
        let Ok(device) = i32::try_from(device) else {
            return Ok(None);
        };
        Ok(SideStream::of(device)?.map(Self))
    }

    /// Captures what `work` does with tensors like `inputs`; nothing of it runs yet. What else it
    /// reads and writes must stay where it is as long as the graph lives.
    ///
    /// # Errors
    /// Why it can't be captured.
    pub fn capture(
        self,
        inputs: &[Tensor],
        work: impl FnOnce(&[Tensor]) -> Result<Tensor, TchError>,
    ) -> Result<CapturedGraph, TchError> {
        let own: Vec<Tensor> = inputs
            .iter()
            .map(Tensor::f_zeros_like)
            .collect::<Result<_, _>>()?;
        let (graph, answer) = Graph::captured_on(&self.0, || work(&own))?;
        Ok(CapturedGraph {
            graph,
            inputs: own,
            answer,
        })
    }
}

impl CapturedGraph {
    /// None where nothing can be captured.
    fn of<const N: usize>(
        inputs: [&Tensor; N],
        network: &mut impl FnMut([&Tensor; N]) -> Result<Tensor, TchError>,
    ) -> Result<Option<Self>, TchError> {
        let Some(Device::Cuda(device)) = inputs.first().map(|input| input.device()) else {
            return Ok(None);
        };
        let Ok(device) = i32::try_from(device) else {
            return Ok(None);
        };
        let own: Vec<Tensor> = inputs
            .iter()
            .map(|input| input.f_zeros_like())
            .collect::<Result<_, _>>()?;
        let read: [&Tensor; N] = core::array::from_fn(|index| &own[index]);
        let captured = Graph::capture(device, || network(read))?;
        Ok(captured.map(|(graph, answer)| Self {
            graph,
            inputs: own,
            answer,
        }))
    }

    fn fits(&self, inputs: &[&Tensor]) -> bool {
        let form = |tensor: &Tensor| (tensor.size(), tensor.kind(), tensor.device());
        let own = self.inputs.iter().map(form);
        own.eq(inputs.iter().map(|input| form(input)))
    }

    /// A copy of the output for `inputs`, which must be of the shapes that the graph was captured
    /// with; random numbers continue from the state of the generator.
    ///
    /// # Errors
    /// The network library's: shapes do not fit, or the device fails.
    pub fn replay(&mut self, inputs: &[Tensor]) -> Result<Tensor, TchError> {
        for (own, input) in self.inputs.iter_mut().zip(inputs) {
            own.f_copy_(input)?;
        }
        self.graph.replay_drawing()?;
        self.answer.f_detach_copy()
    }

    fn answer(&mut self, inputs: &[&Tensor]) -> Result<Tensor, TchError> {
        for (own, input) in self.inputs.iter_mut().zip(inputs) {
            own.f_copy_(input)?;
        }
        self.graph.replay()?;
        Ok(self.answer.shallow_clone())
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind, TchError, Tensor};

    use super::{Capture, NetworkGraph};
    use crate::generator::seeded;

    /// The device that has graphs, where there is one.
    fn device() -> Device {
        Device::cuda_if_available()
    }

    #[test]
    fn every_answer_is_that_of_the_network_to_its_own_inputs() {
        let mut graph = NetworkGraph::default();
        let on_device = (Kind::Float, device());
        let weight = Tensor::arange(12, on_device).sin().view([4, 3]);
        for (rows, offset) in [(2, 0.0), (2, 0.5), (5, 0.25), (2, -1.0)] {
            let x = (Tensor::arange(rows * 4, on_device) + offset).view([rows, 4]);
            let y = x.cos();
            let answer = graph.answer([&x, &y], |[x, y]| (x * y).f_mm(&weight));
            assert_eq!(answer.unwrap(), (&x * &y).mm(&weight), "{rows}, {offset}");
        }
        let is_captured = matches!(graph, NetworkGraph::Ready(_));
        assert_eq!(is_captured, device().is_cuda(), "{graph:?}");
    }

    #[test]
    fn what_the_network_refuses_is_refused_each_time() {
        let mut graph = NetworkGraph::default();
        let x = Tensor::zeros([2, 4], (Kind::Float, device()));
        for _ in 0..2 {
            let answer = graph.answer([&x], |[x]| x.f_mm(x));
            let error = answer.unwrap_err().to_string();
            assert!(error.contains("2x4"), "{error}");
        }
    }

    /// Numbers drawn on the device by `work`, after the same seed.
    fn drawn(work: impl FnOnce() -> Tensor) -> Vec<f32> {
        let _drawing = seeded(3);
        Vec::<f32>::try_from(work().to_device(Device::Cpu)).unwrap()
    }

    #[test]
    fn random_numbers_depend_on_the_seed_captured_or_not() {
        let on_device = (Kind::Float, device());
        if !device().is_cuda() {
            assert!(Capture::begin(device()).unwrap().is_none());
            return;
        }
        let plus = |x: &Tensor| Tensor::f_rand([1000], on_device)?.f_add(x);
        let one = Tensor::ones([1], on_device);
        let inputs = [one.shallow_clone()];
        let mut graph = {
            let _drawing = seeded(1);
            let capture = Capture::begin(device()).unwrap().unwrap();
            for _ in 0..2 {
                let _warm = plus(&one).unwrap();
            }
            let captured = capture.capture(&inputs, |inputs| plus(&inputs[0]));
            captured.unwrap()
        };
        let eager = drawn(|| plus(&one).unwrap());
        let replayed = drawn(|| graph.replay(&inputs).unwrap());
        assert_eq!(eager, replayed);
        // The second of two without a seed between them.
        let next = drawn(|| {
            let _first = graph.replay(&inputs).unwrap();
            graph.replay(&inputs).unwrap()
        });
        assert_ne!(next, eager);
    }

    /// Random numbers are then drawn as before.
    #[test]
    fn work_that_synchronises_is_not_captured() {
        if !device().is_cuda() {
            return;
        }
        let on_device = (Kind::Float, device());
        let wanted = drawn(|| Tensor::rand([100], on_device));
        let one = [Tensor::ones([1], on_device)];
        let captured = |work: &dyn Fn(&Tensor) -> Result<Tensor, TchError>| {
            let _drawing = seeded(1);
            let capture = Capture::begin(device()).unwrap().unwrap();
            capture.capture(&one, |inputs| work(&inputs[0])).map(drop)
        };
        let waits = captured(&|one| {
            let noise = Tensor::f_rand([1], on_device)?;
            noise.f_add_scalar(one.f_double_value(&[0])?)
        });
        assert!(waits.is_err());
        assert_eq!(drawn(|| Tensor::rand([100], on_device)), wanted);
        assert!(captured(&|one| one.f_view([3])).is_err());
        assert_eq!(drawn(|| Tensor::rand([100], on_device)), wanted);
        captured(&Tensor::f_sin).unwrap();
    }
}
