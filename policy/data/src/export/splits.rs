//! Which episodes are for what, as ranges: those without a disturbance first, then recoveries.

use std::collections::BTreeMap;

use serde_json::Value;

use super::note_of;
use crate::dataset::Notes;

/// The share of episodes without a disturbance that each of `val` and `test` gets, as one of so many.
const HELD_OUT: usize = 10;

/// The order of the episodes, and where its parts begin.
pub(super) struct Splits {
    /// The dataset's episodes in the exported order.
    pub(super) order: Vec<usize>,
    /// How many of them are without a disturbance.
    pub(super) perfect: usize,
}

impl Splits {
    pub(super) fn of(episodes: usize, notes: &Notes) -> Self {
        let recovers = |episode: &usize| note_of(notes, *episode).is_some_and(is_recovery);
        let (recoveries, mut order): (Vec<usize>, Vec<usize>) = (0..episodes).partition(recovers);
        let perfect = order.len();
        order.extend(recoveries);
        Self { order, perfect }
    }

    /// Ranges `a:b` by name.
    pub(super) fn ranges(&self) -> BTreeMap<String, String> {
        let (perfect, all) = (self.perfect, self.order.len());
        let held_out = perfect / HELD_OUT;
        let mut ranges = vec![
            ("val", 0, held_out),
            ("test", held_out, 2 * held_out),
            ("train", 2 * held_out, all),
            ("perfect", 0, perfect),
        ];
        if perfect < all {
            ranges.push(("recovery", perfect, all));
        }
        let text = ranges.into_iter();
        text.map(|(name, from, to)| (name.to_owned(), format!("{from}:{to}")))
            .collect()
    }
}

/// Whether an episode shows how to come out of a disturbance: it had one, or was labelled so where it comes from.
fn is_recovery(note: &Value) -> bool {
    let disturbed = note["disturbances"].as_array();
    disturbed.is_some_and(|them| !them.is_empty()) || note["recovery"] == true
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

    #[test]
    fn without_notes_all_are_perfect_and_none_is_a_recovery() {
        let ranges = Splits::of(3, &Notes::default()).ranges();
        assert_eq!(
            (ranges["perfect"].as_str(), ranges["train"].as_str()),
            ("0:3", "0:3")
        );
        assert_eq!(ranges.get("recovery"), None);
    }
}
