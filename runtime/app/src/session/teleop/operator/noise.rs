//! What a hand does that its owner does not mean: tremor, and errors that grow with speed.

use nalgebra::Vector3;
use trocar_world::rng::Rng;

use super::OperatorFigures;

/// Sines that make the tremor along one axis.
const SINES: usize = 5;

/// Tremor along three axes: sines within its band, so that it beats as a hand's does.
#[derive(Clone, Debug)]
pub(super) struct Tremor {
    /// Frequency and phase, rad/s and rad.
    sines: [[[f64; 2]; SINES]; 3],
    amplitude: f64,
}

impl Tremor {
    /// One of `rms` in all three directions together, in whatever unit.
    pub(super) fn new(rms: f64, [low_hz, high_hz]: [f64; 2], rng: &mut Rng) -> Self {
        let turn = core::f64::consts::TAU;
        let mut sine = || [turn * rng.range(low_hz, high_hz), rng.range(0.0, turn)];
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let sines = 3.0 * SINES as f64;
        Self {
            sines: core::array::from_fn(|_| core::array::from_fn(|_| sine())),
            amplitude: rms * (2.0 / sines).sqrt(),
        }
    }

    /// It at `seconds`.
    pub(super) fn at(&self, seconds: f64) -> Vector3<f64> {
        let along = |axis: usize| {
            let sines = self.sines[axis].iter();
            sines.fold(0.0, |sum, [rate, phase]| {
                sum + (rate * seconds + phase).sin()
            })
        };
        Vector3::new(along(0), along(1), along(2)) * self.amplitude
    }
}

/// Ornstein-Uhlenbeck process of unit variance along each of three axes.
#[derive(Clone, Debug)]
pub(super) struct OrnsteinUhlenbeck {
    now: Vector3<f64>,
}

impl OrnsteinUhlenbeck {
    pub(super) fn new(rng: &mut Rng) -> Self {
        Self { now: normals(rng) }
    }

    /// It after `step_s`, with the correlation time `correlation_s`.
    pub(super) fn next(&mut self, step_s: f64, correlation_s: f64, rng: &mut Rng) -> Vector3<f64> {
        let kept = (-step_s / correlation_s).exp();
        self.now = self.now * kept + normals(rng) * (1.0 - kept * kept).sqrt();
        self.now
    }
}

/// All of it of one hand.
#[derive(Clone, Debug)]
pub(super) struct Noise {
    rng: Rng,
    tremor: [Tremor; 2],
    way: OrnsteinUhlenbeck,
    turn: OrnsteinUhlenbeck,
    trigger: OrnsteinUhlenbeck,
}

impl Noise {
    pub(super) fn new(figures: &OperatorFigures, mut rng: Rng) -> Self {
        let tremor_m = figures.tremor_mm * 1e-3;
        let mut tremor = |rms| Tremor::new(rms, figures.tremor_hz, &mut rng);
        let tremor = [tremor(tremor_m), tremor(tremor_m / figures.tremor_lever_m)];
        let [way, turn, trigger] = [(); 3].map(|()| OrnsteinUhlenbeck::new(&mut rng));
        Self {
            rng,
            tremor,
            way,
            turn,
            trigger,
        }
    }

    /// Tremor at `seconds`: of the place, m, and of the turn, rad.
    pub(super) fn tremor(&self, seconds: f64) -> [Vector3<f64>; 2] {
        [0, 1].map(|part| self.tremor[part].at(seconds))
    }

    /// What a hand does that wants to go `way` and to turn by `turn` in `step_s`; and by what its
    /// trigger is off.
    pub(super) fn step(
        &mut self,
        [way, turn]: [Vector3<f64>; 2],
        figures: &OperatorFigures,
        step_s: f64,
    ) -> ([Vector3<f64>; 2], f64) {
        let correlation_s = figures.noise_s;
        let along = self.way.next(step_s, correlation_s, &mut self.rng);
        let about = self.turn.next(step_s, correlation_s, &mut self.rng);
        let trigger = self
            .trigger
            .next(step_s, 3.0 * correlation_s, &mut self.rng)
            .x;
        let noisy = [
            way + along * (figures.noise * way.norm()),
            turn + about * (figures.noise * turn.norm()),
        ];
        (noisy, trigger * figures.trigger_noise)
    }
}

/// Three numbers of about a normal distribution: sums of twelve even ones (Irwin and Hall).
fn normals(rng: &mut Rng) -> Vector3<f64> {
    let mut normal = || (0..12).fold(-6.0, |sum, _| sum + rng.unit());
    Vector3::new(normal(), normal(), normal())
}
