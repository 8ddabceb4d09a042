//! What the conformance tests need beside the arm: time, a way to break it, and a driver that knows
//! where it wants to go.

use core::f64::consts::TAU;

use hal::tail::{AxisPoint, AxisTail, TAIL_AXES, TailPhase};
use hal::{Arm, ArmCommand, ArmError, ArmState, JOINT_COUNT, SafeTail, TimeNs};

/// One value an axis, jaw last, rad (insertion m).
pub(crate) type Axes = [f64; TAIL_AXES];

/// What one backend differs in from another without being wrong.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nature {
    /// Time between two reads, ns.
    pub(crate) period_ns: u64,
    /// How old a measurement may be when it is read, ns.
    pub(crate) age_max_ns: u64,
    /// How long the drives take to settle once their set-point rests, ns.
    pub(crate) settle_ns: u64,
    /// Periods without data that are bridged.
    pub(crate) bridged: u64,
}

/// An arm with what surrounds it.
pub(crate) trait Rig {
    /// The arm.
    fn arm(&mut self) -> &mut dyn Arm;

    /// What time it is: the beginning of a control period.
    fn now(&self) -> TimeNs;

    /// Lets the period pass.
    fn pass(&mut self);

    /// What is particular about it.
    fn nature(&self) -> Nature;

    /// Nothing that is measured in the next `periods` arrives; false if that can't be.
    fn deafen(&mut self, _periods: u64) -> bool {
        false
    }

    /// The drive of `axis` fails with `code`; false if it can't.
    fn fail(&mut self, _axis: u8, _code: u16) -> bool {
        false
    }

    /// The operator brings the arm up again; false if nobody can.
    fn reset(&mut self) -> bool {
        false
    }
}

/// Makes a fresh one, the same each time.
pub(crate) type Make<'a> = &'a dyn Fn() -> Box<dyn Rig>;

/// How far each axis goes.
pub(crate) const WAY: Axes = [0.1, -0.1, -0.02, 0.4, 0.3, -0.3, 0.3];
/// How long that takes, s.
pub(crate) const WAY_S: f64 = 0.5;
/// Time to bring the acceleration to zero, and then half the time to bring the velocity to zero, s.
const EASE_S: f64 = 0.02;
const HALF_BRAKE_S: f64 = 0.06;
/// Both together, ns.
pub(crate) const STOP_NS: u64 = 140_000_000;

pub(crate) fn positions(state: &ArmState) -> Axes {
    core::array::from_fn(|axis| {
        if axis < JOINT_COUNT {
            state.position[axis]
        } else {
            state.jaw_position
        }
    })
}

pub(crate) fn velocities(state: &ArmState) -> Axes {
    core::array::from_fn(|axis| {
        if axis < JOINT_COUNT {
            state.velocity[axis]
        } else {
            state.jaw_velocity
        }
    })
}

/// Whether every axis is where it should be, but for `share` of its way.
pub(crate) fn assert_near(actual: &Axes, wanted: &Axes, share: f64, when: &str) {
    for axis in 0..TAIL_AXES {
        let off = (actual[axis] - wanted[axis]).abs();
        assert!(
            off <= share * WAY[axis].abs(),
            "{when}: axis {axis} is {off} away from {}",
            wanted[axis]
        );
    }
}

/// First the acceleration goes, then the velocity.
fn stop(start: AxisPoint) -> AxisTail {
    let coasting = start.velocity + start.acceleration * EASE_S / 2.0;
    let jerk = coasting / (HALF_BRAKE_S * HALF_BRAKE_S);
    let phase = |duration_s, jerk| TailPhase { duration_s, jerk };
    AxisTail {
        start,
        phases: [
            phase(EASE_S, -start.acceleration / EASE_S),
            phase(HALF_BRAKE_S, -jerk),
            phase(HALF_BRAKE_S, jerk),
        ],
    }
}

/// A way of some axes, begun at a time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg {
    pub(crate) began: TimeNs,
    pub(crate) from: Axes,
    pub(crate) way: Axes,
}

impl Leg {
    /// The stop from where the motion is at `now`, whose first point is the set-point; at its end
    /// the axes rest.
    pub(crate) fn tail(&self, now: TimeNs) -> SafeTail {
        let share = (TimeNs(now.since(self.began)).seconds() / WAY_S).min(1.0);
        let axes = core::array::from_fn(|axis| {
            let way = self.way[axis];
            stop(AxisPoint {
                position: self.from[axis] + way * (share - (TAU * share).sin() / TAU),
                velocity: way / WAY_S * (1.0 - (TAU * share).cos()),
                acceleration: way / (WAY_S * WAY_S) * TAU * (TAU * share).sin(),
            })
        });
        SafeTail {
            stamp: now,
            axes,
            enabled: true,
        }
    }
}

/// A controller that reads once and writes once a period, or not.
pub(crate) struct Driver {
    pub(crate) rig: Box<dyn Rig>,
    pub(crate) nature: Nature,
    /// Where the arm was found.
    pub(crate) found: Axes,
    leg: Leg,
}

impl Driver {
    /// Reads for a few periods where the arm is.
    pub(crate) fn new(make: Make<'_>) -> Self {
        let rig = make();
        let nature = rig.nature();
        let mut driver = Self {
            rig,
            nature,
            found: [0.0; TAIL_AXES],
            leg: Leg {
                began: TimeNs(0),
                from: [0.0; TAIL_AXES],
                way: [0.0; TAIL_AXES],
            },
        };
        let state = driver.silent(5);
        driver.found = positions(&state);
        driver.depart(WAY);
        driver
    }

    /// Periods of `ns`.
    pub(crate) fn periods(&self, ns: u64) -> u64 {
        ns.div_ceil(self.nature.period_ns)
    }

    /// Begins the way `way` now, from where the last one ends.
    pub(crate) fn depart(&mut self, way: Axes) {
        let from = if self.leg.began == TimeNs(0) {
            self.found
        } else {
            core::array::from_fn(|axis| self.leg.from[axis] + self.leg.way[axis])
        };
        self.depart_from(from, way);
    }

    /// Begins the way `way` now at `from`.
    pub(crate) fn depart_from(&mut self, from: Axes, way: Axes) {
        let began = self.rig.now();
        self.leg = Leg { began, from, way };
    }

    /// One period: read, write `said` if anything, and time.
    pub(crate) fn period(
        &mut self,
        said: Option<(ArmCommand, SafeTail)>,
    ) -> Result<ArmState, ArmError> {
        let now = self.rig.now();
        let measured = self.rig.arm().read(now);
        if let Some((command, tail)) = said {
            let _ = self.rig.arm().write(&command, &tail);
        }
        self.rig.pass();
        measured
    }

    /// What one would say now on the way.
    pub(crate) fn set_point(&self) -> (ArmCommand, SafeTail) {
        let now = self.rig.now();
        let tail = self.leg.tail(now);
        (tail.command_at(now), tail)
    }

    /// Goes on along the way for `ns`; gives what was read last, and the last stop.
    pub(crate) fn go(&mut self, ns: u64) -> (ArmState, SafeTail) {
        let mut newest = None;
        for _ in 0..self.periods(ns) {
            let said = self.set_point();
            let state = self.period(Some(said)).unwrap();
            newest = Some((state, said.1));
        }
        newest.unwrap()
    }

    /// Goes the whole way and waits for the drives to settle.
    pub(crate) fn arrive(&mut self) -> ArmState {
        self.go(500_000_000 + self.nature.settle_ns).0
    }

    /// Says nothing for `periods`; gives what was read last.
    pub(crate) fn silent(&mut self, periods: u64) -> ArmState {
        let mut newest = None;
        for _ in 0..periods {
            newest = Some(self.period(None).unwrap());
        }
        newest.unwrap()
    }

    /// Says what `nonsense` makes of the set-point at which the arm already is.
    pub(crate) fn say(&mut self, nonsense: impl Fn(&mut ArmCommand, &mut SafeTail)) -> ArmState {
        let (mut command, mut tail) = self.set_point();
        nonsense(&mut command, &mut tail);
        self.period(Some((command, tail))).unwrap()
    }
}
