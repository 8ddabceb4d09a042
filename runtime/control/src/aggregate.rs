//! Overlapping chunks to one target: temporal aggregation, indexed by time. Hot path: bounded, no
//! allocation, no I/O, no lock.
//!
//! Source: ACT's temporal ensembling (weights `exp(-m i)`, `i = 0` the oldest prediction), by due
//! time instead of by query count, so that late and missing chunks do no harm.
//!
//! With `w_i = exp(-m i)` and `p_i` the target positions at one instant: the position is
//! `sum w_i p_i / sum w_i`, the rotation the weighted sum of quaternions brought to one hemisphere
//! and normalised, the jaw that of the newest chunk, without a mean. `i` counts only chunks that
//! cover the instant. A positive `m` favours the oldest prediction, a negative one the newest.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{ARMS_MAX, Chunk, TimeNs, TipTarget, count};

use super::gate::Gate;
use super::snapshot::{HELD_MAX, Reader, Snapshot, SnapshotError, Words as _, layout, possible};

/// Chunks that are kept: as many as can cover one instant when a policy answers every step.
const RING: usize = CHUNK_STEPS_MAX;

/// Above this cosine of half the angle, normalised linear interpolation is as even as the spherical
/// one to 1e-6.
const NEARLY_PARALLEL: f64 = 0.9995;

/// How overlapping chunks become one target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aggregation {
    /// Every chunk that covers the instant, weighted `exp(-decay * i)` with `i = 0` the oldest.
    Ensemble {
        /// ACT's `m`.
        decay: f64,
    },
    /// Each chunk to its end, then the newest one.
    WholeChunk,
    /// Receding horizon: the newest chunk alone, from when it arrives.
    Newest,
}

/// The chunks that have passed the gate, and the target they agree on.
#[derive(Debug)]
pub struct Aggregator {
    mode: Aggregation,
    /// `exp(-decay * i)`; all 1 in the other modes.
    weights: [f64; RING],
    /// `RING` slots at all times, blank where nothing was put. Of [`Aggregation::WholeChunk`] only
    /// the first two are used.
    ring: Vec<Chunk>,
    /// Slot that the next chunk goes into.
    next: usize,
    /// Valid slots.
    count: usize,
}

impl Aggregator {
    /// An aggregator without chunks; this allocates all it will ever need.
    #[must_use]
    pub fn new(mode: Aggregation) -> Self {
        let decay = match mode {
            Aggregation::Ensemble { decay } => decay,
            Aggregation::WholeChunk | Aggregation::Newest => 0.0,
        };
        let mut age = 0.0;
        let weights = core::array::from_fn(|_| {
            let weight = f64::exp(-decay * age);
            age += 1.0;
            weight
        });
        Self {
            mode,
            weights,
            ring: vec![blank(); RING],
            next: 0,
            count: 0,
        }
    }

    /// Forgets every chunk.
    pub fn clear(&mut self) {
        self.next = 0;
        self.count = 0;
    }

    /// Takes in a chunk that the gate has accepted at `now`.
    pub fn push(&mut self, chunk: &Chunk, now: TimeNs) {
        match self.mode {
            Aggregation::Ensemble { .. } | Aggregation::Newest => {
                self.ring[self.next] = *chunk;
                self.next = (self.next + 1) % RING;
                self.count = (self.count + 1).min(RING);
            }
            // Slot 0 is being played, slot 1 waits.
            Aggregation::WholeChunk => {
                let playing = self.count > 0 && place(&self.ring[0], now).is_some();
                self.ring[usize::from(playing)] = *chunk;
                self.count = if playing { 2 } else { 1 };
            }
        }
    }

    /// Goes on to the waiting chunk if the one that is played has ended.
    pub fn advance(&mut self, now: TimeNs) {
        if self.mode == Aggregation::WholeChunk
            && self.count == 2
            && place(&self.ring[0], now).is_none()
        {
            self.ring.swap(0, 1);
            self.count = 1;
        }
    }

    /// When the newest chunk's observation was taken.
    ///
    /// None without a chunk. The caller compares it with the age at which an arm stops following.
    #[must_use]
    pub fn newest_observed_at(&self) -> Option<TimeNs> {
        let newest = self.count.checked_sub(1)?;
        Some(match self.mode {
            Aggregation::WholeChunk => self.ring[newest].observed_at,
            Aggregation::Ensemble { .. } | Aggregation::Newest => self.by_age(newest).observed_at,
        })
    }

    /// Where the tip should be at `at`, and where the same chunks want it at `ahead`, which is not
    /// before `at`.
    ///
    /// A chunk that ends between the two stays at its last target. `None` past the horizon of every
    /// chunk.
    ///
    /// Each is interpolated between two steps of a chunk: positions and jaw linearly, rotations
    /// along the shorter arc. An ensemble costs two interpolations for each chunk that covers `at`,
    /// of which there are at most 128; the other modes cost two.
    #[must_use]
    pub fn targets(&self, at: TimeNs, ahead: TimeNs) -> Option<(TipTarget, TipTarget)> {
        let both = |chunk: &Chunk| Some((in_chunk(chunk, at)?, in_chunk_or_last(chunk, ahead)?));
        match self.mode {
            Aggregation::Ensemble { .. } => self.ensemble(both),
            Aggregation::WholeChunk => self.ring[..self.count].first().and_then(both),
            Aggregation::Newest => (0..self.count)
                .rev()
                .find_map(|rank| both(self.by_age(rank))),
        }
    }

    /// Slots that hold a chunk, whether it still counts or not, the newest one's last.
    fn filled(&self) -> impl Iterator<Item = usize> {
        let begin = match self.mode {
            Aggregation::WholeChunk => 0,
            Aggregation::Ensemble { .. } | Aggregation::Newest => self.next + RING - self.count,
        };
        (begin..begin + self.count).map(|slot| slot % RING)
    }

    /// Adds the state at the tick `newest` to a snapshot: of chunks those whose horizon has not
    /// passed, and the newest one, whose age counts.
    pub(super) fn save(&self, arm: usize, newest: TimeNs, to: &mut Snapshot) {
        let Self {
            mode: _,
            weights: _,
            ring,
            next,
            count,
        } = self;
        const { assert!(ARMS_MAX * RING <= HELD_MAX) }
        (*next, *count).put(to);
        let last = self.filled().last();
        for slot in self.filled() {
            let chunk = &ring[slot];
            if Some(slot) == last || place(chunk, newest).is_some() {
                to.hold(arm, slot, chunk);
            }
        }
    }

    /// Takes over the state that [`Self::save`] added; `gate` is that of the same arm.
    pub(super) fn restore(
        &mut self,
        arm: usize,
        newest: TimeNs,
        gate: &Gate,
        from: &mut Reader<'_>,
    ) -> Result<(), SnapshotError> {
        let Self {
            mode: _,
            weights: _,
            ring,
            next,
            count,
        } = self;
        *next = usize::take(from)?;
        *count = usize::take(from)?;
        possible(*next < RING && *count <= RING)?;
        ring.fill(blank());
        for (slot, chunk) in from.chunks(arm) {
            possible(gate.may_have_accepted(chunk, newest))?;
            *ring.get_mut(slot).ok_or(SnapshotError::Impossible)? = *chunk;
        }
        Ok(())
    }

    /// The chunk at `slot`.
    pub(super) fn at(&self, slot: usize) -> Option<&Chunk> {
        self.ring.get(slot)
    }

    /// The `rank`th oldest of the `count` chunks in the ring.
    fn by_age(&self, rank: usize) -> &Chunk {
        &self.ring[(self.next + RING - self.count + rank) % RING]
    }

    /// `both` gives a chunk's targets at the two instants. Both means have the same chunks and
    /// weights, so their difference is the motion of one blend.
    fn ensemble(
        &self,
        both: impl Fn(&Chunk) -> Option<(TipTarget, TipTarget)>,
    ) -> Option<(TipTarget, TipTarget)> {
        let mut weights = self.weights.iter();
        let (mut here, mut later) = (Blend::default(), Blend::default());
        for rank in 0..self.count {
            let Some((target, next)) = both(self.by_age(rank)) else {
                continue;
            };
            let Some(&weight) = weights.next() else { break };
            here.add(&target, weight);
            later.add(&next, weight);
        }
        Some((here.target()?, later.target()?))
    }
}

/// What [`Aggregator::save`] adds, by name.
pub(super) const LAYOUT: u64 = layout("Aggregator next count arm slot", &[]);

/// Words that it adds, apart from chunks.
pub(super) const WORDS: usize = 2;

/// A chunk that covers no instant.
fn blank() -> Chunk {
    Chunk::new(TimeNs(0), 0, hal::TICK_NS, &[])
}

/// A weighted mean of targets: positions by weight, rotations on the sphere, the jaw from the
/// newest.
#[derive(Clone, Copy, Debug, Default)]
struct Blend {
    weight: f64,
    position: [f64; 3],
    rotation: [f64; 4],
    newest: Option<TipTarget>,
}

impl Blend {
    fn add(&mut self, target: &TipTarget, weight: f64) {
        self.weight += weight;
        for (sum, &value) in self.position.iter_mut().zip(&target.position_m) {
            *sum += weight * value;
        }
        // A quaternion and its negative are one rotation: take the one on the side of the sum.
        let side = if dot(&self.rotation, &target.rotation_xyzw) < 0.0 {
            -weight
        } else {
            weight
        };
        for (sum, &value) in self.rotation.iter_mut().zip(&target.rotation_xyzw) {
            *sum += side * value;
        }
        self.newest = Some(*target);
    }

    fn target(&self) -> Option<TipTarget> {
        let newest = self.newest?;
        let norm = dot(&self.rotation, &self.rotation).sqrt();
        // Opposed rotations have no mean; then the newest decides.
        let rotation_xyzw = if norm > 1e-3 * self.weight {
            self.rotation.map(|x| x / norm)
        } else {
            newest.rotation_xyzw
        };
        Some(TipTarget {
            position_m: self.position.map(|x| x / self.weight),
            rotation_xyzw,
            jaw: newest.jaw,
        })
    }
}

/// Index and fraction of the step that `at` falls into, if the chunk covers it.
///
/// The index is `floor((at - observed_at) / step)`. The horizon ends with the last target, which is
/// included.
fn place(chunk: &Chunk, at: TimeNs) -> Option<(usize, f64)> {
    let last = chunk.valid_targets().len().checked_sub(1)?;
    if at < chunk.observed_at || chunk.step_ns == 0 {
        return None;
    }
    let age_ns = at.since(chunk.observed_at);
    let index = count::index(age_ns / chunk.step_ns);
    let rest_ns = age_ns % chunk.step_ns;
    if index > last || (index == last && rest_ns > 0) {
        return None;
    }
    #[expect(
        clippy::cast_precision_loss,
        reason = "the gate admits steps of a second at most"
    )]
    let fraction = rest_ns as f64 / chunk.step_ns as f64;
    Some((index, fraction))
}

/// Interpolated at `at`; none outside the chunk's horizon.
fn in_chunk(chunk: &Chunk, at: TimeNs) -> Option<TipTarget> {
    let (index, fraction) = place(chunk, at)?;
    let targets = chunk.valid_targets();
    let from = targets.get(index)?;
    Some(
        targets
            .get(index + 1)
            .map_or(*from, |to| between(from, to, fraction)),
    )
}

/// Like [`in_chunk`], but past its end a chunk stays at its last target.
fn in_chunk_or_last(chunk: &Chunk, at: TimeNs) -> Option<TipTarget> {
    in_chunk(chunk, at).or_else(|| {
        if at < chunk.observed_at {
            None
        } else {
            chunk.valid_targets().last().copied()
        }
    })
}

/// The weights of the two ends of an arc whose angle has this cosine, at `fraction` of it; a line's
/// where they are nearly parallel.
fn arc_weights(cosine: f64, fraction: f64) -> (f64, f64) {
    if cosine > NEARLY_PARALLEL {
        return (1.0 - fraction, fraction);
    }
    let angle = cosine.acos();
    (
        (angle * (1.0 - fraction)).sin() / angle.sin(),
        (angle * fraction).sin() / angle.sin(),
    )
}

/// The target at `fraction` of the way, the tip moving evenly.
fn between(from: &TipTarget, to: &TipTarget, fraction: f64) -> TipTarget {
    let mix = |a: f64, b: f64| a + (b - a) * fraction;
    let position_m = core::array::from_fn(|i| mix(from.position_m[i], to.position_m[i]));
    let cosine = dot(&from.rotation_xyzw, &to.rotation_xyzw);
    let (near, cosine) = if cosine < 0.0 {
        (-1.0, -cosine)
    } else {
        (1.0, cosine)
    };
    let (keep, take) = arc_weights(cosine, fraction);
    let mixed: [f64; 4] =
        core::array::from_fn(|i| keep * from.rotation_xyzw[i] + near * take * to.rotation_xyzw[i]);
    let norm = dot(&mixed, &mixed).sqrt();
    TipTarget {
        position_m,
        rotation_xyzw: mixed.map(|x| x / norm),
        jaw: mix(from.jaw, to.jaw),
    }
}

fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests;
