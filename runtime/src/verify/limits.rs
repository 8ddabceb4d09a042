//! The limits of a run, read from the configuration texts in its log.
//!
//! Looked up by key in the plain TOML tables: the controller's own parser is one of the things that are checked here.

use hal::joints::{INSERTION, JOINT_NAMES};
use nalgebra::Vector3;
use toml::{Table, Value};

use super::VerifyError;
use super::differences::AXES;
use crate::log::RunLog;

/// File with the axes' limits.
const CONTROL: &str = "control.toml";
/// File with the places where the instrument may be.
const SAFETY: &str = "safety.toml";

/// Limits of one axis, rad (insertion m) and their derivatives.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct AxisLimits {
    pub(super) name: String,
    pub(super) low: f64,
    pub(super) high: f64,
    /// Bounds of velocity, acceleration and jerk.
    pub(super) derivatives: [f64; 3],
}

/// A region that the instrument may not touch, RCM frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sphere {
    pub(super) name: String,
    pub(super) center_m: Vector3<f64>,
    pub(super) radius_m: f64,
}

/// Everything that a command is checked against.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Limits {
    pub(super) axes: Vec<AxisLimits>,
    pub(super) tip_speed_m_s: f64,
    /// How much further out an arm that was enabled outside may get, m.
    pub(super) recovery_m: f64,
    /// Box for control point and finger tips, RCM frame, m.
    pub(super) box_low_m: Vector3<f64>,
    pub(super) box_high_m: Vector3<f64>,
    pub(super) spheres: Vec<Sphere>,
}

impl Limits {
    /// The limits that `log` says its run had.
    pub(super) fn of(log: &RunLog) -> Result<Self, VerifyError> {
        let control = Document::parse(log, CONTROL)?;
        let safety = Document::parse(log, SAFETY)?;
        let rcm_in_scene = safety.vector("scene_from_rcm.translation_m")?;
        let mut axes = Vec::with_capacity(AXES);
        for (index, name) in JOINT_NAMES.into_iter().chain(["jaw"]).enumerate() {
            let unit = if index == INSERTION { "m" } else { "rad" };
            let number = |key: &str| control.number(&format!("limits.{name}.{key}"));
            axes.push(AxisLimits {
                name: name.to_owned(),
                low: number(&format!("low_{unit}"))?,
                high: number(&format!("high_{unit}"))?,
                derivatives: [
                    number(&format!("velocity_{unit}_s"))?,
                    number(&format!("acceleration_{unit}_s2"))?,
                    number(&format!("jerk_{unit}_s3"))?,
                ],
            });
        }
        Ok(Self {
            axes,
            tip_speed_m_s: control.number("limits.tip_speed_m_s")?,
            recovery_m: control.number("guard.recovery_m")?,
            box_low_m: safety.vector("workspace.min_m")? - rcm_in_scene,
            box_high_m: safety.vector("workspace.max_m")? - rcm_in_scene,
            spheres: safety.spheres(&rcm_in_scene)?,
        })
    }
}

/// A parsed configuration text and its name.
struct Document {
    file: &'static str,
    table: Table,
}

impl Document {
    fn parse(log: &RunLog, file: &'static str) -> Result<Self, VerifyError> {
        let text = log
            .text(file)
            .ok_or(VerifyError::NoConfiguration { file })?;
        let table = text
            .parse()
            .map_err(|error: toml::de::Error| VerifyError::Malformed {
                file,
                reason: error.message().to_owned(),
            })?;
        Ok(Self { file, table })
    }

    fn missing(&self, key: &str) -> VerifyError {
        VerifyError::Malformed {
            file: self.file,
            reason: format!("`{key}` is missing or of another type"),
        }
    }

    fn value(&self, key: &str) -> Option<&Value> {
        let mut parts = key.split('.');
        let first = self.table.get(parts.next()?)?;
        parts.try_fold(first, |here, part| here.get(part))
    }

    fn number(&self, key: &str) -> Result<f64, VerifyError> {
        self.value(key)
            .and_then(number)
            .ok_or_else(|| self.missing(key))
    }

    fn vector(&self, key: &str) -> Result<Vector3<f64>, VerifyError> {
        self.value(key)
            .and_then(vector)
            .ok_or_else(|| self.missing(key))
    }

    fn spheres(&self, rcm_in_scene: &Vector3<f64>) -> Result<Vec<Sphere>, VerifyError> {
        let Some(list) = self.value("forbidden") else {
            return Ok(Vec::new());
        };
        let list = list.as_array().ok_or_else(|| self.missing("forbidden"))?;
        let sphere = |(index, entry): (usize, &Value)| {
            Some(Sphere {
                name: entry
                    .get("name")
                    .and_then(Value::as_str)
                    .map_or(index.to_string(), str::to_owned),
                center_m: vector(entry.get("center_m")?)? - rcm_in_scene,
                radius_m: number(entry.get("radius_m")?)?,
            })
        };
        list.iter()
            .enumerate()
            .map(|entry| sphere(entry).ok_or_else(|| self.missing("forbidden")))
            .collect()
    }
}

/// A finite number; TOML's integers count.
#[expect(clippy::cast_precision_loss, reason = "limits are small numbers")]
fn number(value: &Value) -> Option<f64> {
    value
        .as_float()
        .or_else(|| value.as_integer().map(|whole| whole as f64))
        .filter(|number| number.is_finite())
}

fn vector(value: &Value) -> Option<Vector3<f64>> {
    let [x, y, z] = value.as_array()?.as_slice() else {
        return None;
    };
    Some(Vector3::new(number(x)?, number(y)?, number(z)?))
}
