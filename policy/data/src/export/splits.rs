//! Which episodes are for what, as ranges: those without a disturbance first, then recoveries, then
//! failures.

use std::collections::BTreeMap;

use serde_json::Value;

use super::note_of;
use crate::dataset::Notes;

/// The share of episodes without a disturbance that each of `val` and `test` gets, as one of so
/// many. Rounded down: below ten such episodes nothing is held out.
const HELD_OUT: usize = 10;

/// The order of the episodes, and where its parts begin.
pub(super) struct Splits {
    /// The dataset's episodes in the exported order.
    pub(super) order: Vec<usize>,
    /// How many of them are without a disturbance.
    pub(super) perfect: usize,
    /// How many of them succeeded.
    pub(super) succeeded: usize,
}

impl Splits {
    /// A stable partition: within each part the dataset's order stays. A failure counts as one even
    /// if it was disturbed too.
    pub(super) fn of(episodes: usize, notes: &Notes) -> Self {
        let is =
            |episode: &usize, what: fn(&Value) -> bool| note_of(notes, *episode).is_some_and(what);
        let (failures, rest): (Vec<usize>, Vec<usize>) =
            (0..episodes).partition(|episode| is(episode, is_failure));
        let (recoveries, mut order): (Vec<usize>, Vec<usize>) = rest
            .into_iter()
            .partition(|episode| is(episode, is_recovery));
        let perfect = order.len();
        order.extend(recoveries);
        let succeeded = order.len();
        order.extend(failures);
        Self {
            order,
            perfect,
            succeeded,
        }
    }

    /// Ranges `a:b` by name.
    ///
    /// `train` holds the recoveries, `perfect` overlaps `val`, `test` and `train`; empty `recovery`
    /// and `failure` are left out.
    pub(super) fn ranges(&self) -> BTreeMap<String, String> {
        let (perfect, succeeded, all) = (self.perfect, self.succeeded, self.order.len());
        let held_out = perfect / HELD_OUT;
        let mut ranges = vec![
            ("val", 0, held_out),
            ("test", held_out, 2 * held_out),
            ("train", 2 * held_out, succeeded),
            ("perfect", 0, perfect),
        ];
        if perfect < succeeded {
            ranges.push(("recovery", perfect, succeeded));
        }
        if succeeded < all {
            ranges.push(("failure", succeeded, all));
        }
        let text = ranges.into_iter();
        text.map(|(name, from, to)| (name.to_owned(), format!("{from}:{to}")))
            .collect()
    }
}

/// Whether an episode shows how to come out of a disturbance: it had one, or was labelled so where
/// it comes from.
fn is_recovery(note: &Value) -> bool {
    let disturbed = note["disturbances"].as_array();
    disturbed.is_some_and(|them| !them.is_empty()) || note["recovery"] == true
}

/// Whether an episode is of an attempt that failed: its reason is noted, or it was labelled so
/// where it comes from.
pub(super) fn is_failure(note: &Value) -> bool {
    note["failure"].is_string() || note["failure"] == true
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn recoveries_come_last_and_are_trained_on() {
        let disturbed = |episode: usize| match episode % 2 {
            0 => json!({"episode_index": episode, "disturbances": []}),
            _ => json!({"episode_index": episode, "disturbances": [{"kind": "slip"}]}),
        };
        let notes = Notes {
            episodes: (0..40).map(disturbed).collect(),
            ..Notes::default()
        };
        let splits = Splits::of(40, &notes);
        let odd = (1..40).step_by(2);
        assert_eq!(
            splits.order,
            (0..40).step_by(2).chain(odd).collect::<Vec<_>>()
        );
        let expected = [
            ("perfect", "0:20"),
            ("recovery", "20:40"),
            ("test", "2:4"),
            ("train", "4:40"),
            ("val", "0:2"),
        ];
        let expected = expected.map(|(name, range)| (name.to_owned(), range.to_owned()));
        assert_eq!(splits.ranges(), expected.into());
    }

    /// A failure is one though it was disturbed.
    #[test]
    fn failures_come_last_and_nobody_trains_on_them() {
        let note = |episode: usize| match episode {
            0 => {
                json!({"episode_index": 0, "failure": "dropped", "disturbances": [{"kind": "slip"}]})
            }
            1 => json!({"episode_index": 1, "failure": true}),
            2 => json!({"episode_index": 2, "disturbances": [{"kind": "slip"}]}),
            _ => json!({"episode_index": episode, "failure": false}),
        };
        let notes = Notes {
            episodes: (0..5).map(note).collect(),
            ..Notes::default()
        };
        let splits = Splits::of(5, &notes);
        assert_eq!(splits.order, [3, 4, 2, 0, 1]);
        let ranges = splits.ranges();
        for (name, range) in [
            ("train", "0:3"),
            ("perfect", "0:2"),
            ("recovery", "2:3"),
            ("failure", "3:5"),
        ] {
            assert_eq!(ranges[name], range, "{name}");
        }
    }

    #[test]
    fn without_notes_all_are_perfect_and_none_is_a_recovery() {
        let ranges = Splits::of(3, &Notes::default()).ranges();
        assert_eq!(
            (ranges["perfect"].as_str(), ranges["train"].as_str()),
            ("0:3", "0:3")
        );
        assert_eq!(
            (ranges.get("recovery"), ranges.get("failure")),
            (None, None)
        );
    }
}
