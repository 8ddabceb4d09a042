//! The velocities of a sub-step, by Newton's method on a convex cost: the drives' and the things'
//! momentum, the drives' dry friction, and every contact together.
//!
//! The cost is strictly convex, so its minimum is unique; each Newton step has a line search. What
//! a drive with hundreds of times a thing's mass presses on the ground is solved as exactly as a
//! thing that lies alone.

use nalgebra::{Matrix3, Matrix4, Vector4};

use super::contact::{Cone, DIRECTIONS, Row, THING_DOF};
use crate::plant::AXIS_COUNT;

/// Most Newton steps in a sub-step; a hard grasp on hard ground takes up to ten.
const STEPS_MAX: u32 = 40;
/// Residual at which the velocities count as found, as a share of the momentum that is exchanged.
const TOLERANCE: f64 = 1e-9;
/// Most evaluations in a search along a direction.
const SEARCH_MAX: u32 = 24;
/// Share of the first slope along a direction that may be left.
const SEARCH_TOLERANCE: f64 = 0.05;
/// Velocity up to which dry friction of a drive is viscous, rad/s (m/s).
const DRY_CREEP: f64 = 1e-6;

/// One diagonal entry of the mass matrix with what acts on it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Axis {
    /// Velocity without contacts and dry friction.
    pub(super) free: f64,
    /// Inertia, kg m² (kg).
    pub(super) inertia: f64,
    /// Greatest impulse of dry friction, N m s (N s).
    pub(super) dry: f64,
}

/// The mass matrix: drives one by one, and of each thing its mass and its inertia in the scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Masses {
    /// Arms' drives, in order.
    pub(super) drives: Vec<Axis>,
    /// Things: mass, inertia in the scene, free velocity of the centre of mass and free angular
    /// velocity.
    pub(super) things: Vec<ThingMass>,
}

/// A thing in the mass matrix.
#[derive(Clone, Copy, Debug)]
pub(super) struct ThingMass {
    pub(super) mass_kg: f64,
    pub(super) inertia: Matrix3<f64>,
    pub(super) free: [f64; THING_DOF],
}

/// Room for the solution, kept between steps.
#[derive(Debug, Default)]
pub(super) struct Newton {
    /// The velocities: the guess before, the solution after.
    pub(super) velocity: Vec<f64>,
    gradient: Vec<f64>,
    direction: Vec<f64>,
    hessian: Vec<f64>,
    cones: Vec<Cone>,
    speeds: Vec<Vector4<f64>>,
    turns: Vec<Vector4<f64>>,
}

impl Masses {
    fn count(&self) -> usize {
        self.drives.len() + THING_DOF * self.things.len()
    }

    /// `out += mass matrix * v`.
    fn add_momentum(&self, v: &[f64], out: &mut [f64]) {
        for (axis, drive) in self.drives.iter().enumerate() {
            out[axis] += drive.inertia * v[axis];
        }
        for (index, thing) in self.things.iter().enumerate() {
            let at = self.drives.len() + THING_DOF * index;
            for i in 0..3 {
                out[at + i] += thing.mass_kg * v[at + i];
                for j in 0..3 {
                    out[at + 3 + i] += thing.inertia[(i, j)] * v[at + 3 + j];
                }
            }
        }
    }

    /// Sum of squares of `momentum`, each over its diagonal entry of the mass matrix: about twice a
    /// kinetic energy, J.
    fn energy(&self, momentum: &[f64]) -> f64 {
        let drives = self.drives.iter().zip(momentum);
        let drives: f64 = drives.map(|(drive, p)| p * p / drive.inertia).sum();
        let mut things = 0.0;
        for (index, thing) in self.things.iter().enumerate() {
            let at = self.drives.len() + THING_DOF * index;
            for i in 0..3 {
                things += momentum[at + i] * momentum[at + i] / thing.mass_kg;
                things += momentum[at + 3 + i] * momentum[at + 3 + i] / thing.inertia[(i, i)];
            }
        }
        drives + things
    }

    fn free(&self, index: usize) -> f64 {
        match index.checked_sub(self.drives.len()) {
            None => self.drives[index].free,
            Some(at) => self.things[at / THING_DOF].free[at % THING_DOF],
        }
    }
}

impl Row {
    fn offsets(&self, drives: usize) -> [Option<usize>; 2] {
        [
            self.arm.map(|(slot, _)| AXIS_COUNT * slot),
            self.thing.map(|(slot, _)| drives + THING_DOF * slot),
        ]
    }

    /// Relative velocity along normal and tangents, and of spin, at the velocities `v`, m/s.
    fn speed(&self, drives: usize, v: &[f64]) -> Vector4<f64> {
        let mut speed = Vector4::zeros();
        let [arm, thing] = self.offsets(drives);
        if let (Some(at), Some((_, rows))) = (arm, &self.arm) {
            for (row, jacobian) in rows.iter().enumerate() {
                speed[row] += dot(jacobian, &v[at..at + AXIS_COUNT]);
            }
        }
        if let (Some(at), Some((_, rows))) = (thing, &self.thing) {
            for (row, jacobian) in rows.iter().enumerate() {
                speed[row] += dot(jacobian, &v[at..at + THING_DOF]);
            }
        }
        speed
    }

    /// `out -= Jacobian^T * impulse`.
    fn take_impulse(&self, drives: usize, impulse: &Vector4<f64>, out: &mut [f64]) {
        let [arm, thing] = self.offsets(drives);
        if let (Some(at), Some((_, rows))) = (arm, &self.arm) {
            for (row, jacobian) in rows.iter().enumerate() {
                for (out, j) in out[at..].iter_mut().zip(jacobian) {
                    *out -= impulse[row] * j;
                }
            }
        }
        if let (Some(at), Some((_, rows))) = (thing, &self.thing) {
            for (row, jacobian) in rows.iter().enumerate() {
                for (out, j) in out[at..].iter_mut().zip(jacobian) {
                    *out -= impulse[row] * j;
                }
            }
        }
    }

    /// Adds `Jacobian^T * slope * Jacobian` to the lower triangle of `hessian`.
    fn add_slope(&self, drives: usize, slope: &Matrix4<f64>, hessian: &mut [f64], count: usize) {
        const MOST: usize = AXIS_COUNT + THING_DOF;
        let mut columns = [[0.0; DIRECTIONS]; MOST];
        let mut places = [0; MOST];
        let mut used = 0;
        let [arm, thing] = self.offsets(drives);
        if let (Some(at), Some((_, rows))) = (arm, &self.arm) {
            for axis in 0..AXIS_COUNT {
                columns[used] = rows.map(|row| row[axis]);
                places[used] = at + axis;
                used += 1;
            }
        }
        if let (Some(at), Some((_, rows))) = (thing, &self.thing) {
            for axis in 0..THING_DOF {
                columns[used] = rows.map(|row| row[axis]);
                places[used] = at + axis;
                used += 1;
            }
        }
        for i in 0..used {
            let c = &columns[i];
            let pulled = slope * Vector4::from(*c);
            // Drives come before things, so the places rise.
            let line = &mut hessian[places[i] * count..places[i] * count + count];
            for j in 0..=i {
                let d = &columns[j];
                line[places[j]] += pulled.dot(&Vector4::from(*d));
            }
        }
    }
}

impl Newton {
    /// Finds the velocities at the end of a sub-step of `step_s`, from the guess in `velocity`, and
    /// adds each contact's impulse to its row.
    pub(super) fn solve(&mut self, masses: &Masses, rows: &mut [Row], step_s: f64) {
        let (count, drives) = (masses.count(), masses.drives.len());
        self.cones.clear();
        self.cones.extend(rows.iter().map(|row| row.cone(step_s)));
        self.speeds.clear();
        let speeds = rows.iter().map(|row| row.speed(drives, &self.velocity));
        self.speeds.extend(speeds);
        for _ in 0..STEPS_MAX {
            let scale = self.assemble(masses, rows);
            if masses.energy(&self.gradient) <= TOLERANCE * TOLERANCE * scale {
                break;
            }
            if !self.descend(count) {
                break;
            }
            let direction = &self.direction;
            self.turns.clear();
            self.turns
                .extend(rows.iter().map(|row| row.speed(drives, direction)));
            let share = self.search(masses);
            for (v, d) in self.velocity.iter_mut().zip(&self.direction) {
                *v += share * d;
            }
            for (speed, turn) in self.speeds.iter_mut().zip(&self.turns) {
                *speed += turn * share;
            }
        }
        for ((row, cone), speed) in rows.iter_mut().zip(&self.cones).zip(&self.speeds) {
            row.impulse += cone.impulse(speed).x;
            row.gap_m += step_s * speed.x;
        }
    }

    /// Gradient and Hessian at the velocities; gives the size of what the gradient is the
    /// difference of.
    fn assemble(&mut self, masses: &Masses, rows: &[Row]) -> f64 {
        let (count, drives) = (masses.count(), masses.drives.len());
        let Self {
            velocity,
            gradient,
            direction: scratch,
            hessian,
            ..
        } = self;
        for buffer in [&mut *gradient, scratch] {
            buffer.clear();
            buffer.resize(count, 0.0);
        }
        hessian.clear();
        hessian.resize(count * count, 0.0);
        masses.add_momentum(velocity, gradient);
        let moved = masses.energy(gradient);
        gradient.fill(0.0);
        for (index, change) in scratch.iter_mut().enumerate() {
            *change = velocity[index] - masses.free(index);
        }
        masses.add_momentum(scratch, gradient);
        masses_into(masses, hessian, count);
        for (axis, drive) in masses.drives.iter().enumerate() {
            let (dragged, slope) = dry(drive.dry, velocity[axis]);
            gradient[axis] += dragged;
            hessian[axis * count + axis] += slope;
        }
        scratch.fill(0.0);
        for ((row, cone), speed) in rows.iter().zip(&self.cones).zip(&self.speeds) {
            let (impulse, slope) = cone.impulse_and_slope(speed);
            if impulse.x > 0.0 {
                row.take_impulse(drives, &impulse, scratch);
                row.add_slope(drives, &slope, hessian, count);
            }
        }
        let pushed = masses.energy(scratch);
        for (gradient, push) in gradient.iter_mut().zip(scratch.iter()) {
            *gradient += push;
        }
        moved.max(pushed)
    }

    /// Turns the gradient into the Newton direction; false if the Hessian is not positive definite,
    /// which only input that is not finite can make it.
    fn descend(&mut self, count: usize) -> bool {
        let Self {
            gradient,
            direction,
            hessian,
            ..
        } = self;
        for i in 0..count {
            for j in 0..=i {
                let (before, line) = hessian.split_at_mut(i * count);
                let sum = if i == j {
                    line[i] - dot(&line[..j], &line[..j])
                } else {
                    line[j] - dot(&line[..j], &before[j * count..j * count + j])
                };
                if i == j {
                    if !(sum > 0.0 && sum.is_finite()) {
                        return false;
                    }
                    line[j] = sum.sqrt();
                } else {
                    line[j] = sum / before[j * count + j];
                }
            }
        }
        for i in 0..count {
            let line = &hessian[i * count..i * count + i];
            let sum = -gradient[i] - dot(line, &direction[..i]);
            direction[i] = sum / hessian[i * count + i];
        }
        for i in (0..count).rev() {
            let mut sum = direction[i];
            for k in i + 1..count {
                sum -= hessian[k * count + i] * direction[k];
            }
            direction[i] = sum / hessian[i * count + i];
        }
        true
    }

    /// How far to go along the direction: to where the cost along it is nearly least, at most all
    /// the way.
    fn search(&self, masses: &Masses) -> f64 {
        let first = self.slope_at(masses, 0.0);
        let last = self.slope_at(masses, 1.0);
        if last <= SEARCH_TOLERANCE * first.abs() {
            return 1.0;
        }
        // A rising function with a zero between: regula falsi, with the end that stays weighed down
        // (Illinois).
        let (mut low, mut high) = ((0.0, first), (1.0, last));
        for _ in 0..SEARCH_MAX {
            let share = high.0 - high.1 * (high.0 - low.0) / (high.1 - low.1);
            let slope = self.slope_at(masses, share);
            if slope.abs() <= SEARCH_TOLERANCE * first.abs() {
                return share;
            }
            if slope > 0.0 {
                high = (share, slope);
                low.1 *= 0.5;
            } else {
                low = (share, slope);
                high.1 *= 0.5;
            }
        }
        low.0
    }

    /// Derivative of the cost along the direction, `share` of it away.
    fn slope_at(&self, masses: &Masses, share: f64) -> f64 {
        let drives = masses.drives.len();
        let mut slope = 0.0;
        for (axis, drive) in masses.drives.iter().enumerate() {
            let d = self.direction[axis];
            let v = self.velocity[axis] + share * d;
            slope += d * (drive.inertia * (v - drive.free) + dry(drive.dry, v).0);
        }
        for (index, thing) in masses.things.iter().enumerate() {
            let at = drives + THING_DOF * index;
            let d = &self.direction[at..at + THING_DOF];
            let change: [f64; THING_DOF] =
                core::array::from_fn(|i| self.velocity[at + i] + share * d[i] - thing.free[i]);
            for i in 0..3 {
                slope += d[i] * thing.mass_kg * change[i];
                for j in 0..3 {
                    slope += d[3 + i] * thing.inertia[(i, j)] * change[3 + j];
                }
            }
        }
        for ((cone, speed), turn) in self.cones.iter().zip(&self.speeds).zip(&self.turns) {
            slope -= cone.impulse(&(speed + turn * share)).dot(turn);
        }
        slope
    }
}

/// Impulse of dry friction of at most `most` against the velocity `v`, and its slope.
fn dry(most: f64, v: f64) -> (f64, f64) {
    if v.abs() < DRY_CREEP {
        (most * v / DRY_CREEP, most / DRY_CREEP)
    } else {
        (most.copysign(v), 0.0)
    }
}

/// The mass matrix's lower triangle, onto zeros.
fn masses_into(masses: &Masses, hessian: &mut [f64], count: usize) {
    for (axis, drive) in masses.drives.iter().enumerate() {
        hessian[axis * count + axis] = drive.inertia;
    }
    for (index, thing) in masses.things.iter().enumerate() {
        let at = masses.drives.len() + THING_DOF * index;
        for i in 0..3 {
            hessian[(at + i) * count + at + i] = thing.mass_kg;
            for j in 0..=i {
                hessian[(at + 3 + i) * count + at + 3 + j] = thing.inertia[(i, j)];
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
