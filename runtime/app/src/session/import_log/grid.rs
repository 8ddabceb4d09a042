//! The steps of an episode: a grid of the rate that is wanted from the first usable frame on, and
//! the frames nearest to it.

use std::path::Path;

use hal::TimeNs;

use super::LogImportError;
use super::frames::{LoggedCamera, LoggedFrame};

const SECOND_NS: u64 = 1_000_000_000;

/// Frames may begin this long after the arms are asked first, and end this long before they no
/// longer are: a camera that shows nothing for two seconds ends a run.
const EDGE_NS: u64 = 3 * SECOND_NS;

/// Of this many steps one may show the frame of its neighbour again: a camera loses frames now and
/// then, and its clock drifts.
const STEPS_A_REPEAT: usize = 20;

/// What a step sees.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SeenStep {
    /// When: the stamp of the first camera's frame, or of one that was lost the grid's point.
    pub(super) at: TimeNs,
    /// Of each camera the place of its frame among those of the file.
    pub(super) places: Vec<usize>,
}

/// A grid over the frames of an episode that begins at `begin`.
#[derive(Debug)]
pub(super) struct Grid<'a> {
    cameras: &'a [LoggedCamera],
    fps: u32,
    begin: TimeNs,
    /// Of each point what it sees, or the camera that has nothing for it.
    points: Vec<Result<SeenStep, usize>>,
}

impl<'a> Grid<'a> {
    /// A point each 1/`fps` s from the first frame after `begin` that all cameras have, to the last
    /// frame of the first camera, or to where it shows nothing for so long that no episode goes on
    /// behind it.
    pub(super) fn lay(cameras: &'a [LoggedCamera], fps: u32, begin: TimeNs) -> Self {
        let mut grid = Self {
            cameras,
            fps,
            begin,
            points: Vec::new(),
        };
        let Some((first, others)) = cameras.split_first() else {
            return grid;
        };
        let from = first.frames.partition_point(|frame| frame.at < begin);
        let mut rest = first.frames[from..].iter().peekable();
        while let Some(frame) = rest.peek()
            && grid.seen(**frame, frame.at, others).is_err()
        {
            rest.next();
        }
        let Some(start) = rest.peek().map(|frame| frame.at) else {
            return grid;
        };
        let (mut best, mut chosen): (Option<LoggedFrame>, _) = (None, None);
        let mut points = Vec::new();
        let (mut before, mut unbroken) = (start, true);
        let rest = rest.take_while(|frame| {
            unbroken &= frame.at.since(before) <= EDGE_NS;
            before = frame.at;
            unbroken
        });
        for frame in rest {
            let point = grid.point(start, frame.at);
            while points.len() < point {
                let own = best.take().map(|frame| (frame, frame.at));
                let missed = || grid.neighbour(start, points.len(), [chosen, Some(*frame)]);
                let found = own.or_else(missed);
                chosen = found.map(|(frame, _)| frame).or(chosen);
                let found = found.ok_or(0);
                points.push(found.and_then(|(frame, at)| grid.seen(frame, at, others)));
            }
            let distance = |frame: &LoggedFrame| grid.off(start, frame.at, point).unsigned_abs();
            if best
                .as_ref()
                .is_none_or(|best| distance(frame) < distance(best))
            {
                best = Some(*frame);
            }
        }
        points.extend(best.map(|frame| grid.seen(frame, frame.at, others)));
        grid.points = points;
        grid
    }

    /// The point of the grid from `start` nearest to `at`, which is not before it: each frame is of
    /// one alone.
    fn point(&self, start: TimeNs, at: TimeNs) -> usize {
        let halves = 2 * u128::from(at.since(start)) * u128::from(self.fps);
        let second = u128::from(SECOND_NS);
        usize::try_from((halves + second) / (2 * second)).unwrap_or(usize::MAX)
    }

    /// How far `at` is behind the grid's `point`, in billionths of a step.
    fn off(&self, start: TimeNs, at: TimeNs, point: usize) -> i128 {
        let since = i128::from(at.since(start)) * i128::from(self.fps);
        since - point as i128 * i128::from(SECOND_NS)
    }

    /// For the grid's `point`, to which no frame is nearest, the nearer one of its neighbours'
    /// `frames`, at most a step away; and the point's instant.
    fn neighbour(
        &self,
        start: TimeNs,
        point: usize,
        frames: [Option<LoggedFrame>; 2],
    ) -> Option<(LoggedFrame, TimeNs)> {
        let off = |frame: &LoggedFrame| self.off(start, frame.at, point).unsigned_abs();
        let nearest = frames.into_iter().flatten().min_by_key(off);
        let near = nearest.filter(|frame| off(frame) <= u128::from(SECOND_NS))?;
        let since_ns = point as u128 * u128::from(SECOND_NS) / u128::from(self.fps);
        let at = start.plus_ns(u64::try_from(since_ns).ok()?);
        Some((near, at))
    }

    /// What a step sees `at` that instant, whose frame of the first camera is `frame`; of the
    /// `others` a frame may be a step away.
    fn seen(
        &self,
        frame: LoggedFrame,
        at: TimeNs,
        others: &[LoggedCamera],
    ) -> Result<SeenStep, usize> {
        let mut places = Vec::with_capacity(1 + others.len());
        places.push(frame.place);
        for (index, camera) in others.iter().enumerate() {
            let near = camera.nearest(at);
            let near = near.filter(|near| self.is_within_steps(at, near.at, 2));
            places.push(near.ok_or(index + 1)?.place);
        }
        Ok(SeenStep { at, places })
    }

    /// Whether two instants are at most so many half steps apart.
    pub(super) fn is_within_steps(&self, one: TimeNs, other: TimeNs, halves: u64) -> bool {
        let apart = 2 * u128::from(one.0.abs_diff(other.0)) * u128::from(self.fps);
        apart <= u128::from(halves) * u128::from(SECOND_NS)
    }

    /// The point `index` with what it sees, which is nothing at a hole.
    pub(super) fn get(&self, index: usize) -> Option<Option<&SeenStep>> {
        self.points.get(index).map(|point| point.as_ref().ok())
    }

    /// Points up to the last step that is not after `end`.
    fn until(&self, end: TimeNs) -> &[Result<SeenStep, usize>] {
        let is_in = |point: &Result<SeenStep, usize>| point.as_ref().is_ok_and(|it| it.at <= end);
        let last = self.points.iter().rposition(is_in);
        &self.points[..last.map_or(0, |last| last + 1)]
    }

    /// The steps of an episode of `log` that ends at `end`.
    ///
    /// # Errors
    /// [`LogImportError::TooFew`] if a point has no frame near it, or too many have that of their
    /// neighbour.
    pub(super) fn whole(&self, log: &Path, end: TimeNs) -> Result<Vec<SeenStep>, LogImportError> {
        let Some(culprit) = self.hole(end) else {
            return Ok(self.until(end).iter().flatten().cloned().collect());
        };
        let lower = (1..self.fps).rev();
        let enough = lower
            .map(|fps| Self::lay(self.cameras, fps, self.begin))
            .find(|grid| grid.hole(end).is_none());
        let remedy = enough.map_or_else(
            || "leave the log out".to_owned(),
            |grid| format!("--fps {} is possible with this log", grid.fps),
        );
        Err(self.too_few(log, end, culprit, remedy))
    }

    /// The camera that has nothing for a point before `end`, if one has.
    fn hole(&self, end: TimeNs) -> Option<usize> {
        let points = self.until(end);
        let steps = || points.iter().flatten();
        if let Some(culprit) = points.iter().find_map(|point| point.as_ref().err()) {
            return Some(*culprit);
        }
        let repeats = steps().zip(steps().skip(1));
        let repeats = repeats
            .filter(|(one, next)| one.places.first() == next.places.first())
            .count();
        if repeats * STEPS_A_REPEAT > points.len() {
            return Some(0);
        }
        let ends = steps().next().zip(steps().next_back());
        let reaches = ends.is_some_and(|(first, last)| {
            first.at.since(self.begin) <= EDGE_NS && end.since(last.at) <= EDGE_NS
        });
        let most = || (0..self.cameras.len()).max_by_key(|&index| self.gap(index, end).0);
        (!reaches).then(most).flatten()
    }

    /// The longest time without a frame of the camera `index` until `end`, ns, and when that
    /// begins.
    fn gap(&self, index: usize, end: TimeNs) -> (u64, TimeNs) {
        let mut longest = (0, self.begin);
        let mut before = self.begin;
        let within = self.within(index, end).map(|frame| frame.at);
        for at in within.chain([end]) {
            if at.since(before) > longest.0 {
                longest = (at.since(before), before);
            }
            before = at;
        }
        longest
    }

    /// The frames of the camera `index` between `begin` and `end`.
    fn within(&self, index: usize, end: TimeNs) -> impl Iterator<Item = &LoggedFrame> {
        let camera = self.cameras.get(index).into_iter();
        let frames = camera.flat_map(|camera| &camera.frames);
        frames.filter(move |frame| (self.begin..=end).contains(&frame.at))
    }

    /// How many frames a second the camera `index` has between its first and its last one.
    fn rate_hz(&self, index: usize, end: TimeNs) -> f64 {
        let mut within = self.within(index, end).map(|frame| frame.at);
        let Some(first) = within.next() else {
            return 0.0;
        };
        let (count, last) = within.fold((0.0, first), |(count, _), at| (count + 1.0, at));
        let long_ns = last.since(first).max(1);
        count / TimeNs(long_ns).seconds()
    }

    fn too_few(&self, log: &Path, end: TimeNs, culprit: usize, remedy: String) -> LogImportError {
        let (gap_ns, from) = self.gap(culprit, end);
        let camera = self.cameras.get(culprit);
        LogImportError::TooFew {
            log: log.to_owned(),
            camera: camera.map_or_else(String::new, |camera| camera.name.clone()),
            fps: self.fps,
            rate_hz: self.rate_hz(culprit, end),
            gap_ms: 1e3 * TimeNs(gap_ns).seconds(),
            from_s: from.seconds(),
            // A frame may be a step away, on either side.
            needed_ms: 2e3 / f64::from(self.fps),
            remedy,
        }
    }
}
