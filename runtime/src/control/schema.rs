//! The controller's configuration files as they are written; `config.rs` checks what they say.

use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ControlFile {
    pub(super) limits: LimitsTable,
    pub(super) aggregation: AggregationTable,
    pub(super) gate: GateTable,
    pub(super) tracking: TrackingTable,
    pub(super) filter: FilterTable,
    pub(super) guard: GuardTable,
    pub(super) fault: FaultTable,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LimitsTable {
    pub(super) tip_speed_m_s: f64,
    pub(super) yaw: RotaryAxis,
    pub(super) pitch: RotaryAxis,
    pub(super) insertion: LinearAxis,
    pub(super) roll: RotaryAxis,
    pub(super) wrist_pitch: RotaryAxis,
    pub(super) wrist_yaw: RotaryAxis,
    pub(super) jaw: RotaryAxis,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RotaryAxis {
    pub(super) low_rad: f64,
    pub(super) high_rad: f64,
    pub(super) velocity_rad_s: f64,
    pub(super) acceleration_rad_s2: f64,
    pub(super) jerk_rad_s3: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LinearAxis {
    pub(super) low_m: f64,
    pub(super) high_m: f64,
    pub(super) velocity_m_s: f64,
    pub(super) acceleration_m_s2: f64,
    pub(super) jerk_m_s3: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AggregationTable {
    pub(super) mode: AggregationMode,
    pub(super) decay: f64,
    pub(super) stale_s: f64,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum AggregationMode {
    Ensemble,
    WholeChunk,
    Newest,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GateTable {
    pub(super) age_s_max: f64,
    pub(super) step_m_max: f64,
    pub(super) step_rad_max: f64,
    pub(super) jump_m_max: f64,
    pub(super) jump_rad_max: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrackingTable {
    pub(super) gain_1_s: f64,
    pub(super) lookahead_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FilterTable {
    pub(super) alpha_1_s: f64,
    pub(super) margin_m: f64,
    pub(super) tip_speed_fraction: f64,
    pub(super) acceleration_window_s: f64,
    pub(super) joint_weight: f64,
    pub(super) angular_speed_rad_s: f64,
    pub(super) iterations_max: u32,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GuardTable {
    pub(super) margin_m: f64,
    pub(super) recovery_m: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaultTable {
    pub(super) tracking_yaw_pitch_rad: f64,
    pub(super) tracking_insertion_m: f64,
    pub(super) tracking_wrist_rad: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SafetyFile {
    pub(super) scene_from_rcm: SceneFromRcm,
    pub(super) workspace: WorkspaceTable,
    #[serde(default)]
    pub(super) forbidden: Vec<SphereTable>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneFromRcm {
    pub(super) translation_m: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorkspaceTable {
    pub(super) min_m: [f64; 3],
    pub(super) max_m: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SphereTable {
    pub(super) name: String,
    pub(super) center_m: [f64; 3],
    pub(super) radius_m: f64,
}
