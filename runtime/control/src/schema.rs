//! The controller's configuration files as they are written; `config.rs` checks what they say.
//!
//! Keys carry their unit. An unknown key is an error, so that a misspelt limit is not silently
//! missing; what may be left out has a `default` or is an `Option`. Ranges are checked in
//! `config/sections.rs` and `config/scene.rs`.

use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ControlFile {
    pub(super) limits: LimitsTable,
    pub(super) aggregation: AggregationTable,
    pub(super) gate: GateTable,
    pub(super) tracking: TrackingTable,
    pub(super) filter: FilterTable,
    pub(super) fault: FaultTable,
    #[serde(default)]
    pub(super) policy: PolicyTable,
}

/// `[policy]`: supervision of a policy process. The only table of `control.toml` that may be
/// missing.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PolicyTable {
    pub(super) restarts: u32,
    pub(super) backoff_s: f64,
    pub(super) return_s: f64,
    #[serde(default)]
    pub(super) frozen_s: f64,
}

impl Default for PolicyTable {
    fn default() -> Self {
        Self {
            restarts: 0,
            backoff_s: 0.5,
            return_s: 30.0,
            frozen_s: 0.0,
        }
    }
}

/// `[limits]`: of the tip, and one table an axis.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LimitsTable {
    pub(super) tip_speed_m_s: f64,
    pub(super) tip_angular_speed_rad_s: f64,
    pub(super) yaw: RotaryAxis,
    pub(super) pitch: RotaryAxis,
    pub(super) insertion: LinearAxis,
    pub(super) roll: RotaryAxis,
    pub(super) wrist_pitch: RotaryAxis,
    pub(super) wrist_yaw: RotaryAxis,
    pub(super) jaw: RotaryAxis,
}

/// Of a joint that turns, or of the jaw.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RotaryAxis {
    pub(super) low_rad: f64,
    pub(super) high_rad: f64,
    pub(super) velocity_rad_s: f64,
    pub(super) acceleration_rad_s2: f64,
    pub(super) jerk_rad_s3: f64,
}

/// Of the insertion. It needs keys of its own: the same numbers in another unit would pass.
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

/// `"ensemble"`, `"whole_chunk"` or `"newest"`.
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
    #[serde(default = "resume_m_max")]
    pub(super) resume_m_max: f64,
    #[serde(default = "resume_rad_max")]
    pub(super) resume_rad_max: f64,
}

/// Committed networks go on from 4 mm away, and what moves at 0.1 m/s is due 10 mm away after 0.1
/// s.
const fn resume_m_max() -> f64 {
    0.01
}

const fn resume_rad_max() -> f64 {
    0.2
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrackingTable {
    pub(super) gain_1_s: f64,
    pub(super) lookahead_s: f64,
    pub(super) soft_start_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FilterTable {
    pub(super) alpha_1_s: f64,
    pub(super) speed_fraction: f64,
    pub(super) acceleration_window_s: f64,
    pub(super) joint_weight: f64,
    pub(super) iterations_max: u32,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaultTable {
    pub(super) tracking_tip_m: f64,
    pub(super) tracking_turn_rad: f64,
    #[serde(default = "ends_run")]
    pub(super) ends_run: bool,
}

const fn ends_run() -> bool {
    true
}

/// A task's `safety.toml`. Lengths are m, in the scene's frame.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SafetyFile {
    pub(super) margins: MarginsTable,
    pub(super) jaw: JawTable,
    pub(super) between_arms: Option<BetweenArmsTable>,
    pub(super) arm: Vec<ArmTable>,
    #[serde(default)]
    pub(super) forbidden: Vec<RegionTable>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MarginsTable {
    pub(super) filter_m: f64,
    pub(super) guard_m: f64,
    pub(super) recovery_m: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JawTable {
    pub(super) closing_effort_n_m_max: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BetweenArmsTable {
    pub(super) shaft_to_shaft_m: f64,
    pub(super) tip_to_shaft_m: f64,
}

/// `[[arm]]`: the pose of its remote centre, and its workspace as a box along the scene's axes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmTable {
    pub(super) name: String,
    pub(super) rcm_in_scene_m: [f64; 3],
    pub(super) rcm_in_scene_rpy_rad: [f64; 3],
    pub(super) workspace_min_m: [f64; 3],
    pub(super) workspace_max_m: [f64; 3],
}

/// `[[forbidden]]`, told apart by the key `shape`.
#[derive(Debug, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum RegionTable {
    Sphere {
        name: String,
        center_m: [f64; 3],
        radius_m: f64,
    },
    Capsule {
        name: String,
        from_m: [f64; 3],
        to_m: [f64; 3],
        radius_m: f64,
    },
    HalfSpace {
        name: String,
        point_m: [f64; 3],
        normal: [f64; 3],
    },
    Box {
        name: String,
        center_m: [f64; 3],
        size_m: [f64; 3],
        rpy_rad: [f64; 3],
    },
}
