//! Networks whose work on a CUDA device is recorded at the first answer and repeated at each further one.
//!
//! A network of many small steps takes as long as telling the device what to do, again and again the same. A recording is told
//! with one call, and answers as the network does: it is the same work on the same device. A training's steps are recorded
//! likewise, after a few that were not.

mod aside;
mod functions;
mod graph;

use tch::{Device, TchError, Tensor};

use aside::Aside;
pub(crate) use functions::stream_of;
pub use functions::{allow_tf32_products, sleep_while_waiting};
use graph::Graph;

/// What was recorded of a network, if anything.
#[derive(Debug, Default)]
pub(crate) enum Recorded {
    /// No answer was asked for yet.
    #[default]
    NotYet,
    /// There is nothing to be gained, or it can't be done.
    Never,
    /// It answers observations of the shapes that it saw.
    Ready(Recording),
}

/// A recording with what it reads and writes.
#[derive(Debug)]
pub struct Recording {
    /// Dropped before what it works in.
    graph: Graph,
    inputs: Vec<Tensor>,
    answer: Tensor,
}

impl Recorded {
    /// What `network` answers to `inputs`, all of which are on one device. On CUDA the answer is overwritten by the next one.
    ///
    /// `network` must do the same with the device for all inputs of these shapes, read nothing of them back, and keep what it
    /// works in.
    ///
    /// # Errors
    /// Those of `network`, and the network library's.
    pub(crate) fn answer<const N: usize>(
        &mut self,
        inputs: [&Tensor; N],
        mut network: impl FnMut([&Tensor; N]) -> Result<Tensor, TchError>,
    ) -> Result<Tensor, TchError> {
        if matches!(self, Self::NotYet) {
            let made = tch::no_grad(|| Recording::of(inputs, &mut network))?;
            *self = made.map_or(Self::Never, Self::Ready);
        }
        match self {
            Self::Ready(recording) if recording.fits(&inputs) => {
                tch::no_grad(|| recording.answer(&inputs))
            }
            Self::NotYet | Self::Never | Self::Ready(_) => network(inputs),
        }
    }
}

/// Work on a CUDA device that is going to be recorded: what the libraries set up at first must be done while this lives.
#[derive(Debug)]
pub struct Recorder(Aside);

impl Recorder {
    /// None if `device` is not the thread's current CUDA device, or the libraries here have no CUDA.
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
        Ok(Aside::of(device)?.map(Self))
    }

    /// Records what `work` does with tensors like `inputs`; nothing of it is done yet. What else it reads and writes must stay
    /// where it is as long as the recording lives.
    ///
    /// # Errors
    /// Why it can't be recorded.
    pub fn record(
        self,
        inputs: &[Tensor],
        work: impl FnOnce(&[Tensor]) -> Result<Tensor, TchError>,
    ) -> Result<Recording, TchError> {
        let own: Vec<Tensor> = inputs
            .iter()
            .map(Tensor::f_zeros_like)
            .collect::<Result<_, _>>()?;
        let (graph, answer) = Graph::recorded_on(&self.0, || work(&own))?;
        Ok(Recording {
            graph,
            inputs: own,
            answer,
        })
    }
}

impl Recording {
    /// None where nothing can be recorded.
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
        let recorded = Graph::record(device, || network(read))?;
        Ok(recorded.map(|(graph, answer)| Self {
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

    /// A copy of what the recorded work answers to `inputs`, which must be of the shapes that it was recorded with; it draws
    /// random numbers on from where the generator stands.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn drawn_answer(&mut self, inputs: &[Tensor]) -> Result<Tensor, TchError> {
        for (own, input) in self.inputs.iter_mut().zip(inputs) {
            own.f_copy_(input)?;
        }
        self.graph.replay_drawing();
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

    use super::{Recorded, Recorder};
    use crate::generator::seeded;

    /// The device that has graphs, where there is one.
    fn device() -> Device {
        Device::cuda_if_available()
    }

    #[test]
    fn every_answer_is_that_of_the_network_to_its_own_inputs() {
        let mut recorded = Recorded::default();
        let on_device = (Kind::Float, device());
        let weight = Tensor::arange(12, on_device).sin().view([4, 3]);
        for (rows, offset) in [(2, 0.0), (2, 0.5), (5, 0.25), (2, -1.0)] {
            let x = (Tensor::arange(rows * 4, on_device) + offset).view([rows, 4]);
            let y = x.cos();
            let answer = recorded.answer([&x, &y], |[x, y]| (x * y).f_mm(&weight));
            assert_eq!(answer.unwrap(), (&x * &y).mm(&weight), "{rows}, {offset}");
        }
        let is_recorded = matches!(recorded, Recorded::Ready(_));
        assert_eq!(is_recorded, device().is_cuda(), "{recorded:?}");
    }

    #[test]
    fn what_the_network_refuses_is_refused_each_time() {
        let mut recorded = Recorded::default();
        let x = Tensor::zeros([2, 4], (Kind::Float, device()));
        for _ in 0..2 {
            let answer = recorded.answer([&x], |[x]| x.f_mm(x));
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
            assert!(Recorder::begin(device()).unwrap().is_none());
            return;
        }
        let plus = |x: &Tensor| Tensor::f_rand([1000], on_device)?.f_add(x);
        let one = Tensor::ones([1], on_device);
        let inputs = [one.shallow_clone()];
        let mut recording = {
            let _drawing = seeded(1);
            let recorder = Recorder::begin(device()).unwrap().unwrap();
            for _ in 0..2 {
                let _warm = plus(&one).unwrap();
            }
            let recorded = recorder.record(&inputs, |inputs| plus(&inputs[0]));
            recorded.unwrap()
        };
        let told = drawn(|| plus(&one).unwrap());
        let recorded = drawn(|| recording.drawn_answer(&inputs).unwrap());
        assert_eq!(told, recorded);
        // The second of two without a seed between them.
        let next = drawn(|| {
            let _first = recording.drawn_answer(&inputs).unwrap();
            recording.drawn_answer(&inputs).unwrap()
        });
        assert_ne!(next, told);
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
        let recorded = |work: &dyn Fn(&Tensor) -> Result<Tensor, TchError>| {
            let _drawing = seeded(1);
            let recorder = Recorder::begin(device()).unwrap().unwrap();
            recorder.record(&one, |inputs| work(&inputs[0])).map(drop)
        };
        let waits = recorded(&|one| {
            let noise = Tensor::f_rand([1], on_device)?;
            noise.f_add_scalar(one.f_double_value(&[0])?)
        });
        assert!(waits.is_err());
        assert_eq!(drawn(|| Tensor::rand([100], on_device)), wanted);
        assert!(recorded(&|one| one.f_view([3])).is_err());
        assert_eq!(drawn(|| Tensor::rand([100], on_device)), wanted);
        recorded(&Tensor::f_sin).unwrap();
    }
}
