//! The port of Ruckig against the original in C++, on random problems.
//!
//! Both get the same numbers, three axes at a time. Either both refuse, or durations and the states
//! at nine moments agree to 1e-9, or the port breaks the jerk limit, which only one kind of problem
//! may do.

use rsruckig::prelude as port;

use hal::random::SplitMix64;

const DOFS: usize = 3;

/// Cases of each kind, synchronised and not: 1e5 of the first three, 6.8e4 that are near.
const CASES: u32 = 17_000;

/// States of a trajectory that are compared.
const SAMPLES: u32 = 8;

const TOLERANCE: f64 = 1e-9;

type Dofs = [f64; DOFS];

/// Which question is put.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    PositionToRest,
    PositionToMotion,
    Velocity,
    /// A position 1e-12 to 1e-6 from the current one, from rest to rest.
    Near,
    /// A velocity 1e-12 to 1e-6 from the current one.
    NearVelocity,
}

/// One question for both libraries.
#[derive(Clone, Debug)]
struct Problem {
    kind: Kind,
    synchronized: bool,
    current: [Dofs; 3],
    target: [Dofs; 3],
    limits: [Dofs; 3],
}

impl Problem {
    /// States about zero, limits from tight to loose. One in fifty asks for a target above its
    /// limit: both must refuse it.
    fn random(kind: Kind, synchronized: bool, random: &mut SplitMix64) -> Self {
        let mut vector = |half: f64, zero: f64| -> Dofs {
            core::array::from_fn(|_| {
                if random.happens(zero) {
                    0.0
                } else {
                    random.between(-half, half)
                }
            })
        };
        let current = [vector(8.0, 0.0), vector(1.6, 0.1), vector(1.6, 0.2)];
        let rest = if kind == Kind::PositionToRest {
            1.0
        } else {
            0.2
        };
        let mut target = [vector(8.0, 0.0), vector(1.6, rest), vector(1.6, rest)];
        let mut limit = |least: &Dofs| least.map(|x| x.abs() + random.between(0.08, 16.0));
        let limits = [limit(&target[1]), limit(&target[2]), limit(&[0.0; DOFS])];
        if random.happens(0.02) {
            let dof = usize::from(random.happens(0.5));
            target[2][dof] = limits[1][dof] * 1.01;
        }
        Self {
            kind,
            synchronized,
            current,
            target,
            limits,
        }
    }

    /// A target that is almost where the axes are.
    fn near(kind: Kind, synchronized: bool, random: &mut SplitMix64) -> Self {
        let mut problem = Self::random(kind, synchronized, random);
        let near = 10.0_f64.powf(random.between(-12.0, -6.0));
        problem.current[2] = [0.0; DOFS];
        if kind == Kind::Near {
            problem.current[1] = [0.0; DOFS];
        }
        problem.target = problem.current;
        let order = usize::from(kind == Kind::NearVelocity);
        for x in &mut problem.target[order] {
            *x += random.between(-near, near);
        }
        for (limit, v) in problem.limits[0].iter_mut().zip(&problem.current[1]) {
            *limit += v.abs();
        }
        problem
    }
}

/// What a library answers, if it does: the duration, and where the axes are at some moments.
#[derive(Clone, Debug)]
struct Answer {
    duration_s: f64,
    states: Vec<[Dofs; 3]>,
}

impl Answer {
    /// Durations relative, states absolute or, above one, relative.
    fn is_near(&self, other: &Self) -> bool {
        let near = |x: f64, y: f64| (x - y).abs() <= TOLERANCE * x.abs().max(1.0);
        let numbers = |answer: &Self| answer.states.clone().into_iter().flatten().flatten();
        (self.duration_s - other.duration_s).abs() <= TOLERANCE * other.duration_s
            && numbers(self).zip(numbers(other)).all(|(x, y)| near(x, y))
    }
}

fn moments(duration_s: f64) -> impl Iterator<Item = f64> {
    (0..=SAMPLES).map(move |i| duration_s * f64::from(i) / f64::from(SAMPLES))
}

/// The port, as the smoother uses it but for the errors, which the smoother's own checks forestall.
struct Port {
    ruckig: port::Ruckig<DOFS, port::ThrowErrorHandler>,
    trajectory: port::Trajectory<DOFS>,
}

impl Port {
    fn solve(&mut self, problem: &Problem) -> Option<port::RuckigResult> {
        let mut input = port::InputParameter::<DOFS>::new(None);
        input.control_interface = match problem.kind {
            Kind::Velocity | Kind::NearVelocity => port::ControlInterface::Velocity,
            Kind::PositionToRest | Kind::PositionToMotion | Kind::Near => {
                port::ControlInterface::Position
            }
        };
        input.synchronization = if problem.synchronized {
            port::Synchronization::Time
        } else {
            port::Synchronization::None
        };
        for dof in 0..DOFS {
            input.current_position[dof] = problem.current[0][dof];
            input.current_velocity[dof] = problem.current[1][dof];
            input.current_acceleration[dof] = problem.current[2][dof];
            input.target_position[dof] = problem.target[0][dof];
            input.target_velocity[dof] = problem.target[1][dof];
            input.target_acceleration[dof] = problem.target[2][dof];
            input.max_velocity[dof] = problem.limits[0][dof];
            input.max_acceleration[dof] = problem.limits[1][dof];
            input.max_jerk[dof] = problem.limits[2][dof];
        }
        self.ruckig.calculate(&input, &mut self.trajectory).ok()
    }

    fn at(&self, time_s: f64) -> [Dofs; 3] {
        let mut state = [(); 3].map(|()| port::DataArrayOrVec::Stack([0.0; DOFS]));
        let [position, velocity, acceleration] = &mut state;
        self.trajectory.at_time(
            time_s,
            &mut Some(position),
            &mut Some(velocity),
            &mut Some(acceleration),
            &mut None,
            &mut None,
        );
        state.map(|vector| core::array::from_fn(|dof| vector[dof]))
    }

    /// Whether a phase of the last answer has more jerk than is allowed.
    fn breaks_jerk(&self, problem: &Problem) -> bool {
        let profiles = &self.trajectory.get_profiles()[0];
        (0..DOFS).any(|dof| {
            let most = problem.limits[2][dof] * (1.0 + TOLERANCE);
            profiles[dof].j.iter().any(|jerk| jerk.abs() > most)
        })
    }

    fn answer(&mut self, problem: &Problem) -> Option<Answer> {
        let result = self.solve(problem)?;
        (result == port::RuckigResult::Working).then(|| {
            let duration_s = self.trajectory.get_duration();
            Answer {
                duration_s,
                states: moments(duration_s).map(|t| self.at(t)).collect(),
            }
        })
    }
}

/// The original. It never gets waypoints, which it would send to its vendor.
struct Original {
    ruckig: ruckig::Ruckig,
    trajectory: ruckig::Trajectory,
}

impl Original {
    fn answer(&mut self, problem: &Problem) -> Option<Answer> {
        let mut input = ruckig::InputParameter::new(DOFS);
        input.control_interface = match problem.kind {
            Kind::Velocity | Kind::NearVelocity => ruckig::ControlInterface::Velocity,
            Kind::PositionToRest | Kind::PositionToMotion | Kind::Near => {
                ruckig::ControlInterface::Position
            }
        };
        input.synchronization = if problem.synchronized {
            ruckig::Synchronization::Time
        } else {
            ruckig::Synchronization::None
        };
        input.current_position = problem.current[0].to_vec();
        input.current_velocity = problem.current[1].to_vec();
        input.current_acceleration = problem.current[2].to_vec();
        input.target_position = problem.target[0].to_vec();
        input.target_velocity = problem.target[1].to_vec();
        input.target_acceleration = problem.target[2].to_vec();
        input.max_velocity = problem.limits[0].to_vec();
        input.max_acceleration = problem.limits[1].to_vec();
        input.max_jerk = problem.limits[2].to_vec();
        let result = self.ruckig.calculate(&mut input, &mut self.trajectory);
        (result == ruckig::Result::Working).then(|| {
            let duration_s = self.trajectory.get_duration();
            Answer {
                duration_s,
                states: moments(duration_s)
                    .map(|t| {
                        let (p, v, a) = self.trajectory.at_time(t);
                        [p, v, a].map(|vector| core::array::from_fn(|dof| vector[dof]))
                    })
                    .collect(),
            }
        })
    }
}

/// How many cases came out how; any other way ends the test.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tally {
    same: u32,
    both_refuse: u32,
    /// The port goes beyond the jerk limit, see [`the_port_answers_what_the_original_answers`].
    port_breaks_jerk: u32,
}

impl Tally {
    fn count(&mut self, port: &mut Port, original: &mut Original, problem: &Problem) {
        let ours = port.answer(problem);
        let theirs = original.answer(problem);
        let slot = match (&ours, &theirs) {
            (None, None) => &mut self.both_refuse,
            (Some(ours), Some(theirs)) if ours.is_near(theirs) => &mut self.same,
            (Some(_), Some(_)) if port.breaks_jerk(problem) => &mut self.port_breaks_jerk,
            _ => panic!("{problem:?}: {ours:?} is not {theirs:?}"),
        };
        *slot += 1;
    }
}

/// Where the axes are to be brought to a velocity at the same moment, the port (3.0.1) leaves out a
/// check of the original's: it takes a profile whose jerk is above the limit. The smoother never
/// synchronises. Everything else is the same.
#[test]
fn the_port_answers_what_the_original_answers() {
    let mut port = Port {
        ruckig: port::Ruckig::new(None, 1e-3),
        trajectory: port::Trajectory::new(None),
    };
    let mut original = Original {
        ruckig: ruckig::Ruckig::new_direct(DOFS, 1e-3),
        trajectory: ruckig::Trajectory::new_direct(DOFS),
    };
    let mut random = SplitMix64::new(20);
    let far = [Kind::PositionToRest, Kind::PositionToMotion, Kind::Velocity];
    let near = [Kind::Near, Kind::NearVelocity];
    for kind in far.into_iter().chain(near) {
        for synchronized in [false, true] {
            let mut tally = Tally::default();
            for _ in 0..CASES {
                let problem = if near.contains(&kind) {
                    Problem::near(kind, synchronized, &mut random)
                } else {
                    Problem::random(kind, synchronized, &mut random)
                };
                tally.count(&mut port, &mut original, &problem);
            }
            let label = format!("{kind:?}, synchronized {synchronized}: {tally:?}");
            let known = kind == Kind::Velocity && synchronized;
            let most = if known { CASES / 50 } else { 0 };
            assert!(tally.port_breaks_jerk <= most, "{label}");
            let most = if near.contains(&kind) { 0 } else { CASES / 20 };
            assert!(tally.both_refuse <= most, "{label}");
            assert!(tally.same >= CASES / 10 * 9, "{label}");
        }
    }
}
