//! What an exported dataset's README says of recordings that the simulator made. Its fields are
//! those of Open-H-Embodiment's dataset card; data type, method and variations are words of its
//! lists.

use serde_json::Value;
use trocar_data::dataset::Notes;
use trocar_data::export::Provenance;

/// Of a recording whose options are noted, which are those of `trocar record`; of any other nothing
/// is known. A default leaves them in brackets, to be filled in by whoever publishes the dataset.
pub(crate) fn provenance(notes: &Notes) -> Provenance {
    let Some(options) = notes.options.as_ref() else {
        return Provenance::default();
    };
    let listed = options["varied"].as_array().into_iter().flatten();
    let varied: Vec<&str> = listed.filter_map(Value::as_str).collect();
    let seed = options["seed"].as_u64().unwrap_or_default();
    Provenance {
        summary: "Demonstrations of a scripted expert on simulated patient-side manipulators of the dVRK."
            .to_owned(),
        data_type: "Digital simulation".to_owned(),
        method: "Programmatic / state machine".to_owned(),
        operators: "none: a scripted expert acts on the state of the simulation; successful episodes are kept"
            .to_owned(),
        recoveries: "disturbed on purpose (an offset path, a missed grasp, a slip, a nudge); the action is the expert's, which corrects it"
            .to_owned(),
        varied: dimensions(&varied),
        variation: variation(seed, &varied),
        robot: "dVRK Classic patient-side manipulator, simulated: dynamics, drives, contact, rendering".to_owned(),
        synchronization: "One simulation clock: a row's joints, poses and images are of the same instant, and rows are equally spaced."
            .to_owned(),
    }
}

/// What the dataset card calls that which differs between episodes.
fn dimensions(varied: &[&str]) -> Vec<&'static str> {
    let mut dimensions = vec!["Spatial layout"];
    for (ours, theirs) in [
        ("views", "Camera position / angle"),
        ("light", "Lighting conditions"),
        ("needles", "Target object"),
    ] {
        if varied.contains(&ours) {
            dimensions.push(theirs);
        }
    }
    dimensions
}

/// In words: what lies elsewhere in each episode, and which variations (`--vary`) were drawn with
/// it.
fn variation(seed: u64, varied: &[&str]) -> String {
    let more = match varied.is_empty() {
        true => String::new(),
        false => format!("; drawn anew for each: {}", varied.join(", ")),
    };
    format!(
        "Objects lie elsewhere in each episode, drawn from its seed ({seed} and following){more}."
    )
}
