//! `meta/README.md` under the headings that Open-H-Embodiment requires; what is unknown is left to
//! be filled in, in brackets.

use std::ops::Range;

use super::Source;

/// How the demonstrations came about, in words; what is not known stays to be filled in.
///
/// The command line fills it from the options that a recording noted; of other datasets it is
/// [`Provenance::default`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// One sentence on the dataset.
    pub summary: String,
    /// Where it is from, such as `Table-top phantom` or `Digital simulation`.
    pub data_type: String,
    /// Who acted, such as `Human teleoperation` or `Programmatic / state machine`.
    pub method: String,
    /// How many operators, how skilled, when.
    pub operators: String,
    /// What the recoveries recover from.
    pub recoveries: String,
    /// What was varied on purpose, by Open-H-Embodiment's names.
    ///
    /// Only names of the page's list have an effect: `Camera position / angle`,
    /// `Lighting conditions`, `Target object`, `Spatial layout`.
    pub varied: Vec<&'static str>,
    /// How.
    pub variation: String,
    /// The robot.
    pub robot: String,
    /// How cameras and robot are synchronised.
    pub synchronization: String,
}

impl Default for Provenance {
    /// Nothing is known.
    fn default() -> Self {
        let unknown = |what: &str| format!("[{what}]");
        Self {
            summary: unknown("One sentence on the dataset."),
            data_type: unknown(
                "Clinical, ex vivo, table-top phantom, digital or physical simulation",
            ),
            method: unknown("Human teleoperation, programmatic or policy"),
            operators: unknown("number, level of skill, period"),
            recoveries: unknown("what they recover from"),
            varied: Vec::new(),
            variation: unknown("What was varied, and how."),
            robot: unknown("generation of the dVRK"),
            synchronization: unknown("How cameras and robot are synchronised."),
        }
    }
}

/// The page; `frames` are those of all episodes.
pub(super) fn text(source: &Source<'_>, frames: usize) -> String {
    [
        overview(source, frames),
        collection(source),
        equipment(source),
        representation(source),
        closing(source),
    ]
    .join("\n")
}

fn overview(source: &Source<'_>, frames: usize) -> String {
    let (episodes, fps) = (source.splits.order.len(), source.dataset.fps());
    #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
    let hours = frames as f64 / f64::from(fps) / 3600.0;
    let provenance = &source.options.provenance;
    let skills = source.tasks.iter().map(|task| format!("- {task}\n"));
    format!(
        "# [Dataset name]

{} Exported by trocar {}.

| | |
| :--- | :--- |
| **Total trajectories** | {episodes} |
| **Total hours** | {hours:.3} |
| **Data type** | {} |
| **License** | [fill in; Open-H-Embodiment asks for CC BY 4.0] |
| **Version** | [fill in] |

## Tasks and domain

Domain: surgical robotics. Demonstrated skills:

{}",
        provenance.summary,
        env!("CARGO_PKG_VERSION"),
        provenance.data_type,
        skills.collect::<String>(),
    )
}

fn collection(source: &Source<'_>) -> String {
    let provenance = &source.options.provenance;
    let splits = &source.splits;
    let (perfect, succeeded) = (splits.perfect, splits.succeeded);
    let recoveries = episodes(perfect..succeeded, &provenance.recoveries);
    let failed = "attempts that do not do the task; in no split but `failure`";
    let failures = episodes(succeeded..splits.order.len(), failed);
    let dimensions = [
        "Camera position / angle",
        "Lighting conditions",
        "Target object",
        "Spatial layout",
    ];
    let dimensions = dimensions.map(|name| {
        let mark = if provenance.varied.contains(&name) {
            "x"
        } else {
            " "
        };
        format!("- [{mark}] **{name}**\n")
    });
    format!(
        "## Data collection

- Method: {}
- Operators: {}
- Recovery demonstrations: {recoveries}
- Failures: {failures}

## Diversity

{}
{}
",
        provenance.method,
        provenance.operators,
        dimensions.concat(),
        provenance.variation,
    )
}

/// Which episodes are something, and what.
fn episodes(range: Range<usize>, what: &str) -> String {
    match (range.len(), range.start) {
        (0, _) => "none".to_owned(),
        (1, first) => format!("episode {first}: {what}"),
        (_, first) => format!("episodes {first} to {}: {what}", range.end - 1),
    }
}

fn equipment(source: &Source<'_>) -> String {
    let dataset = source.dataset;
    let tools: Vec<&str> = (0..dataset.arms()).map(|arm| source.tool(arm)).collect();
    let cameras = source.cameras.iter().zip(&dataset.spec().cameras);
    let cameras = cameras.map(|(feature, camera)| {
        let (width, height, fps) = (camera.width, camera.height, dataset.fps());
        format!("| {feature} | {width} x {height}, {fps} frames a second |\n")
    });
    format!(
        "## Equipment

- **Robot:** {}
- **Arms:** {} ({})

| Camera | Details |
| :--- | :--- |
{}",
        source.options.provenance.robot,
        dataset.arms(),
        tools.join(", "),
        cameras.collect::<String>(),
    )
}

fn representation(source: &Source<'_>) -> String {
    let arms = match source.dataset.arms() {
        1 => "psm1",
        _ => "psm1, then psm2",
    };
    format!(
        "## Action and state

- [x] **Absolute Cartesian** set-points of the tip
- [x] **Quaternions** (x, y, z, w)
- [x] **Robot base frame**: each arm's own, at its remote centre of motion

```
action: {arms}, each [x, y, z, qx, qy, qz, qw, jaw] (m, unit quaternion, rad)
observation.state: {arms}, each [x, y, z, qx, qy, qz, qw, jaw], measured
observation.state.joint_positions: {arms}, each six joints (rad, insertion m), measured
```

The tip is the wrist-yaw axis, the dVRK's control point without a tool-tip offset.
"
    )
}

fn closing(source: &Source<'_>) -> String {
    format!(
        "## Data synchronization

{} Timestamps count from the episode's first frame.

## Attribution

| | |
| :--- | :--- |
| **Dataset lead** | [fill in] |
| **Institution** | [fill in] |
| **Contact** | [fill in] |
| **Citation** | [fill in] |
",
        source.options.provenance.synchronization
    )
}
