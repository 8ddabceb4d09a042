//! How a recording begins: in a new folder, or behind the last episode of one that was made with
//! the same options.

use serde_json::Value;
use trocar_data::dataset::{DatasetSpec, DatasetWriter, Notes, Totals};

use super::RecordOptions;
use super::notes::{options_note, recording_note};
use crate::session::{Plan, SessionError, outputs};

/// What a recording finds when it begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Found {
    /// What is finished.
    pub(super) totals: Totals,
    /// How many attempts led to it.
    pub(super) attempts: u64,
}

/// Looks at the folder, which must be a new one, or that of a recording that can be resumed;
/// changes nothing in a dataset.
///
/// # Errors
/// [`SessionError::BadArgument`] if it is another.
pub(super) fn look(plan: &Plan, options: &RecordOptions) -> Result<Found, SessionError> {
    if options.resume {
        outputs::dataset_folder("--out", &options.out)?;
        let totals = Totals::read(&options.out)?;
        let notes = Notes::read(&options.out)?;
        check_options(plan, options, totals, &notes)?;
        let attempts = attempts(plan, options, totals, &notes)?;
        return Ok(Found { totals, attempts });
    }
    if outputs::has_dataset(&options.out) {
        return Err(refused(
            options,
            "exists and is not an empty folder; it is a dataset, which --resume appends to",
        ));
    }
    outputs::new_folder("--out", &options.out)?;
    Ok(Found::default())
}

/// Opens the dataset, new or to go on with, behind what was `found` there.
///
/// # Errors
/// Those of [`DatasetWriter::create_with`] and [`DatasetWriter::resume`];
/// [`SessionError::BadArgument`] if the dataset has changed since.
pub(super) fn begin(
    plan: &Plan,
    options: &RecordOptions,
    found: &Found,
    spec: &DatasetSpec,
) -> Result<DatasetWriter, SessionError> {
    let mut writer = if options.resume {
        DatasetWriter::resume(&options.out, spec, options.video)?
    } else {
        DatasetWriter::create_with(&options.out, spec, options.video)?
    };
    if writer.totals() != found.totals {
        return Err(refused(options, "another recording has just written there"));
    }
    // One that was cut off before its first episode may not even have said how it is made.
    if found.totals.episodes == 0 {
        if let Some(description) = recording_note(plan, options)? {
            writer.describe(description)?;
        }
        writer.keep_options(options_note(plan, options)?)?;
    }
    Ok(writer)
}

/// The dataset must have been made with these options.
fn check_options(
    plan: &Plan,
    options: &RecordOptions,
    totals: Totals,
    notes: &Notes,
) -> Result<(), SessionError> {
    let Some(recorded) = &notes.options else {
        return match totals.episodes {
            0 => Ok(()),
            _ => Err(unknown(options, "meta/trocar_recording.json is missing")),
        };
    };
    let asked = options_note(plan, options)?;
    for (key, asked) in asked.as_object().into_iter().flatten() {
        let recorded = &recorded[key];
        // What is the same of another version is seen by its files.
        if recorded == asked || key == "trocar" {
            continue;
        }
        if key == "files" {
            let files = asked.as_object().into_iter().flatten();
            let mut files = files.filter(|(name, hash)| recorded[name.as_str()] != **hash);
            let name = files.next().map_or("configuration", |(name, _)| name);
            let reason = format!(
                "was recorded with another {name}: by --scene, --config, --set or another version"
            );
            return Err(refused(options, &reason));
        }
        let option = option(key);
        let [recorded, asked] = [recorded, asked].map(shown);
        let reason = format!("was recorded with {option} {recorded}, now {asked} is asked for");
        return Err(refused(options, &reason));
    }
    Ok(())
}

/// How many attempts led to what is there: the seed of the last episode tells.
fn attempts(
    plan: &Plan,
    options: &RecordOptions,
    totals: Totals,
    notes: &Notes,
) -> Result<u64, SessionError> {
    let numbers = notes
        .episodes
        .iter()
        .map(|note| note["episode_index"].as_u64());
    if !numbers.eq((0..totals.episodes as u64).map(Some)) {
        let reason = "meta/trocar_episodes.jsonl has not one line for each episode";
        return Err(unknown(options, reason));
    }
    let Some(last) = notes.episodes.last() else {
        return Ok(0);
    };
    let Some(seed) = last["seed"].as_u64() else {
        let reason = "meta/trocar_episodes.jsonl lacks the seed of the last episode";
        return Err(unknown(options, reason));
    };
    let attempts = seed.wrapping_sub(plan.seed).saturating_add(1);
    if attempts < totals.episodes as u64 {
        let reason = "meta/trocar_episodes.jsonl has a seed that its last episode can't have";
        return Err(unknown(options, reason));
    }
    Ok(attempts)
}

/// The option that chooses what the note calls `key`.
fn option(key: &str) -> String {
    match key {
        "varied" => "--vary".to_owned(),
        _ => format!("--{}", key.replace('_', "-")),
    }
}

/// A value as a person types it.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::Bool(true) => "on".to_owned(),
        Value::Bool(false) => "off".to_owned(),
        Value::Array(values) if values.is_empty() => "none".to_owned(),
        Value::Array(values) => values.iter().map(shown).collect::<Vec<_>>().join(","),
        Value::String(text) => text.clone(),
        Value::Number(_) | Value::Object(_) => value.to_string(),
    }
}

fn unknown(options: &RecordOptions, reason: &str) -> SessionError {
    let reason = format!(
        "does not say how it was recorded ({reason}): it is of an older version or of another program, and can't be resumed"
    );
    refused(options, &reason)
}

fn refused(options: &RecordOptions, reason: &str) -> SessionError {
    SessionError::BadArgument(format!("--out {}: {reason}", options.out.display()))
}
