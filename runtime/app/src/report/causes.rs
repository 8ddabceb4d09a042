//! Why trials were lost, counted. A reason is the verdict's or the fault's text with its numbers
//! taken out.

use std::collections::BTreeMap;

use super::load::{Results, Trial};
use super::tables::{Table, entries_of};

/// Why `trial` was lost or is invalid, if it was or is, without its numbers.
fn loss(trial: &Trial) -> Option<String> {
    if trial.success && !trial.invalid {
        return None;
    }
    let kind = if trial.invalid { "invalid: " } else { "" };
    Some(format!("{kind}{}", without_numbers(&trial.reason)))
}

/// Why trials were lost: reasons without their numbers, with how often each column had it. The most
/// frequent first, equal ones by their text. An invalid trial is a reason of its own.
#[must_use]
pub(super) fn losses(results: &Results, table: &Table) -> Vec<(String, Vec<usize>)> {
    let mut counts: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for entry in entries_of(&results.study, &table.grid) {
        let column = table
            .columns
            .iter()
            .position(|name| *name == entry.at.on(table.grid.columns));
        let (Some(column), Some(evaluation)) = (column, results.evaluations.get(&entry.evaluation))
        else {
            continue;
        };
        for reason in evaluation.trials.iter().filter_map(loss) {
            let row = counts
                .entry(reason)
                .or_insert_with(|| vec![0; table.columns.len()]);
            row[column] += 1;
        }
    }
    let mut losses: Vec<_> = counts.into_iter().collect();
    losses.sort_by_key(|(_, counts)| core::cmp::Reverse(counts.iter().sum::<usize>()));
    losses
}

/// `reason` with an ellipsis for every number, so that reasons that differ in a measured value
/// alone are one. A digit within a word (`psm1`) is no number.
fn without_numbers(reason: &str) -> String {
    let mut text = String::new();
    let mut in_number = false;
    let mut previous = ' ';
    for c in reason.chars() {
        let digit = c.is_ascii_digit() && (in_number || !previous.is_ascii_alphanumeric());
        let inner = in_number && (c == '.' || c.is_ascii_digit());
        if digit || inner {
            if !in_number {
                text.push('…');
            }
            in_number = true;
        } else {
            in_number = false;
            text.push(c);
        }
        previous = c;
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_that_differ_in_a_number_alone_are_one() {
        let plain = without_numbers("psm1 sank 0.73 mm into what it lies on");
        assert_eq!(plain, "psm1 sank … mm into what it lies on");
        assert_eq!(
            plain,
            without_numbers("psm1 sank 12 mm into what it lies on")
        );
        assert_eq!(without_numbers("time"), "time");
    }
}
