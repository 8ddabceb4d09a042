//! A task's `safety.toml`: arms, margins and forbidden regions, from the scene's frame into each
//! arm's.

use hal::config::{ConfigError, Source, number_text};
use hal::joints::INSERTION;
use hal::psm::{EFFORT_MAX, RCC_M, SHAFT_RADIUS_M, TOOL_M, WRIST_M};
use hal::{ARM_NAMES, Pose};
use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{ArmConfig, BetweenArms, FORBIDDEN_MAX, Margins};
use crate::motion::{AXES, AxisLimits, JAW};
use crate::region::{Block, Region, Shape};
use crate::schema::{ArmTable, RegionTable, SafetyFile};

/// Farthest that anything in a scene may be from its origin, m.
const SCENE_M: f64 = 1.0;

/// What a task's file says, checked.
pub(super) struct Scene {
    /// One or two, named as `hal::ARM_NAMES`, in that order.
    pub(super) arms: Vec<ArmConfig>,
    pub(super) margins: Margins,
    pub(super) between_arms: Option<BetweenArms>,
    pub(super) jaw_closing_effort_n_m_max: f64,
}

/// Parses and checks a task's file. Regions are written once, in the scene's frame; every arm gets
/// its own copy in its RCM frame, so that the checks of one arm need no other frame.
///
/// # Errors
/// [`ConfigError`] for a text that does not parse, a number out of its range, an arm or a region
/// without the name that it must have, arms too near to one another, or a region at a remote
/// centre.
pub(super) fn scene(source: &Source) -> Result<Scene, ConfigError> {
    let file: SafetyFile = source.parse()?;
    let effort = file.jaw.closing_effort_n_m_max;
    source.check_range("jaw.closing_effort_n_m_max", effort, 0.001, EFFORT_MAX[JAW])?;
    let regions = regions(source, &file.forbidden)?;
    let mut arms = Vec::with_capacity(file.arm.len());
    for (index, table) in file.arm.iter().enumerate() {
        arms.push(arm(source, index, table, &regions)?);
    }
    let margins = margins(source, &file)?;
    let between_arms = between_arms(source, &file)?;
    if let ([first, second], Some(between)) = (arms.as_slice(), &between_arms) {
        check_pair(source, first, second, between, &margins)?;
    }
    check_entries(source, &arms, &margins)?;
    Ok(Scene {
        margins,
        between_arms,
        arms,
        jaw_closing_effort_n_m_max: effort,
    })
}

/// `guard_m` 0.1 to 20 mm, `filter_m` from there to 20 mm, `recovery_m` 0.01 to 1 mm. Whether they
/// are enough for the lag of the drives is checked later, when the speeds are known.
fn margins(source: &Source, file: &SafetyFile) -> Result<Margins, ConfigError> {
    let margins = &file.margins;
    source.check_range("margins.guard_m", margins.guard_m, 1e-4, 0.02)?;
    source.check_range("margins.filter_m", margins.filter_m, margins.guard_m, 0.02)?;
    source.check_range("margins.recovery_m", margins.recovery_m, 1e-5, 0.001)?;
    Ok(Margins {
        filter_m: margins.filter_m,
        guard_m: margins.guard_m,
        recovery_m: margins.recovery_m,
    })
}

/// Required with two arms, optional with one; gaps of 0 to 100 mm.
fn between_arms(source: &Source, file: &SafetyFile) -> Result<Option<BetweenArms>, ConfigError> {
    let count = file.arm.len();
    if !(1..=2).contains(&count) {
        return Err(source.out_of_range("arm", &count.to_string(), "one arm or two"));
    }
    let Some(table) = &file.between_arms else {
        let allowed = "a table where there are two arms";
        return match count {
            2 => Err(source.out_of_range("between_arms", "missing", allowed)),
            _ => Ok(None),
        };
    };
    for (key, gap_m) in [
        ("shaft_to_shaft_m", table.shaft_to_shaft_m),
        ("tip_to_shaft_m", table.tip_to_shaft_m),
    ] {
        source.check_range(&format!("between_arms.{key}"), gap_m, 0.0, 0.1)?;
    }
    Ok(Some(BetweenArms {
        shaft_to_shaft_m: table.shaft_to_shaft_m,
        tip_to_shaft_m: table.tip_to_shaft_m,
    }))
}

/// Two arms must enter so far apart that their shafts can be.
fn check_pair(
    source: &Source,
    first: &ArmConfig,
    second: &ArmConfig,
    between: &BetweenArms,
    margins: &Margins,
) -> Result<(), ConfigError> {
    let apart = second.scene_from_rcm.translation.vector - first.scene_from_rcm.translation.vector;
    let least_m = between.shaft_to_shaft_m + 2.0 * SHAFT_RADIUS_M + margins.filter_m;
    if apart.norm() > least_m {
        return Ok(());
    }
    let found = format!("{} m from arm.0's", number_text(apart.norm()));
    let allowed = format!("more than {} m", number_text(least_m));
    Err(source.out_of_range("arm.1.rcm_in_scene_m", &found, &allowed))
}

/// A shaft cannot leave its remote centre, so no region may reach there.
fn check_entries(
    source: &Source,
    arms: &[ArmConfig],
    margins: &Margins,
) -> Result<(), ConfigError> {
    let least_m = SHAFT_RADIUS_M + margins.filter_m;
    for (arm, config) in arms.iter().enumerate() {
        for (index, region) in config.forbidden.iter().enumerate() {
            let distance_m = region
                .shape
                .distance_m(&Vector3::zeros(), &Vector3::zeros());
            if distance_m <= least_m {
                let found = format!(
                    "{:?} is {} m from the remote centre of arm.{arm}",
                    region.name,
                    number_text(distance_m)
                );
                let allowed = format!("more than {} m", number_text(least_m));
                let key = format!("forbidden.{index}");
                return Err(source.out_of_range(&key, &found, &allowed));
            }
        }
    }
    Ok(())
}

/// Each arm must reach some place of its workspace.
///
/// A grid of 25³ places is tried, so a box of which the arm reaches less than a grid step may be
/// refused.
pub(super) fn check_reach(
    source: &Source,
    arms: &[ArmConfig],
    axes: &[AxisLimits; AXES],
) -> Result<(), ConfigError> {
    for (index, arm) in arms.iter().enumerate() {
        if !reaches(&arm.workspace, axes) {
            let key = format!("arm.{index}.workspace_max_m");
            let found = "a box that the arm can't reach from its remote centre";
            let allowed = "what is within the limits of its yaw, pitch and insertion";
            return Err(source.out_of_range(&key, found, allowed));
        }
    }
    Ok(())
}

/// Grid steps along each edge of a box.
const PLACES: u32 = 24;

/// Whether the control point reaches some place of `workspace`, or one that the wrist may bend to
/// from there, with the wrist straight.
fn reaches(workspace: &Block, axes: &[AxisLimits; AXES]) -> bool {
    let [yaw, pitch, ..] = axes;
    let insertion = &axes[INSERTION];
    let within = |limits: &AxisLimits, value: f64| (limits.low..=limits.high).contains(&value);
    let at = |index: u32| 2.0 * f64::from(index) / f64::from(PLACES) - 1.0;
    let half_m = workspace.half_m + Vector3::repeat(WRIST_M);
    let reached = |x: u32, y: u32, z: u32| {
        let local_m = half_m.component_mul(&Vector3::new(at(x), at(y), at(z)));
        let place_m = workspace.center_m + workspace.axes * local_m;
        let reach_m = place_m.norm();
        within(yaw, place_m.x.atan2(-place_m.z))
            && within(pitch, (-place_m.y / reach_m).asin())
            && within(insertion, reach_m - WRIST_M + RCC_M - TOOL_M)
    };
    (0..=PLACES).any(|x| (0..=PLACES).any(|y| (0..=PLACES).any(|z| reached(x, y, z))))
}

/// The file has the workspace as a box along the scene's axes; in the arm's RCM frame it is a box
/// in general orientation. `rpy` is roll about the fixed x, pitch about the fixed y, then yaw about
/// the fixed z.
fn arm(
    source: &Source,
    index: usize,
    table: &ArmTable,
    regions_in_scene: &[Region],
) -> Result<ArmConfig, ConfigError> {
    let key = |name: &str| format!("arm.{index}.{name}");
    // Logs and topics know the arms by these names.
    let known = ARM_NAMES.get(index).copied().unwrap_or_default();
    if table.name != known {
        let found = format!("{:?}", table.name);
        return Err(source.out_of_range(&key("name"), &found, &format!("{known:?}")));
    }
    let (low, high) = (table.workspace_min_m, table.workspace_max_m);
    for axis in 0..3 {
        let place_m = table.rcm_in_scene_m[axis];
        source.check_range(&key("rcm_in_scene_m"), place_m, -SCENE_M, SCENE_M)?;
        let angle = table.rcm_in_scene_rpy_rad[axis];
        source.check_range(&key("rcm_in_scene_rpy_rad"), angle, -3.15, 3.15)?;
        // Room for a box of a centimetre.
        let most = SCENE_M - 0.01;
        source.check_range(&key("workspace_min_m"), low[axis], -SCENE_M, most)?;
        let least = low[axis] + 0.01;
        source.check_range(&key("workspace_max_m"), high[axis], least, SCENE_M)?;
    }
    let [roll, pitch, yaw] = table.rcm_in_scene_rpy_rad;
    let scene_from_rcm = Pose::from_parts(
        Translation3::from(table.rcm_in_scene_m),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    );
    let rcm_from_scene = scene_from_rcm.inverse();
    let (low, high) = (Vector3::from(low), Vector3::from(high));
    Ok(ArmConfig {
        name: table.name.clone(),
        scene_from_rcm,
        workspace: Block {
            center_m: (low + high) / 2.0,
            half_m: (high - low) / 2.0,
            axes: Rotation3::identity(),
        }
        .moved(&rcm_from_scene),
        forbidden: regions_in_scene
            .iter()
            .map(|region| Region {
                name: region.name.clone(),
                shape: region.shape.moved(&rcm_from_scene),
            })
            .collect(),
    })
}

fn regions(source: &Source, tables: &[RegionTable]) -> Result<Vec<Region>, ConfigError> {
    if tables.len() > FORBIDDEN_MAX {
        return Err(source.out_of_range(
            "forbidden",
            &tables.len().to_string(),
            &format!("at most {FORBIDDEN_MAX} regions"),
        ));
    }
    let mut regions = Vec::with_capacity(tables.len());
    for (index, table) in tables.iter().enumerate() {
        let region = region(source, index, table)?;
        check_name(source, index, &region, &regions)?;
        regions.push(region);
    }
    Ok(regions)
}

/// The region `index` must have a name that none of those `before` has.
fn check_name(
    source: &Source,
    index: usize,
    region: &Region,
    before: &[Region],
) -> Result<(), ConfigError> {
    let allowed = if region.name.trim().is_empty() {
        "a name"
    } else if before.iter().any(|other| other.name == region.name) {
        "a name of its own"
    } else {
        return Ok(());
    };
    let key = format!("forbidden.{index}.name");
    Err(source.out_of_range(&key, &format!("{:?}", region.name), allowed))
}

/// A region of the file, whose entries messages name.
struct Entry<'a> {
    source: &'a Source,
    index: usize,
}

impl Entry<'_> {
    fn check(&self, name: &str, value: f64, low: f64, high: f64) -> Result<(), ConfigError> {
        let key = format!("forbidden.{}.{name}", self.index);
        self.source.check_range(&key, value, low, high)
    }

    /// A length, m.
    fn length(&self, name: &str, value: f64) -> Result<f64, ConfigError> {
        self.check(name, value, 0.001, 1.0)?;
        Ok(value)
    }

    /// A place in the scene, m.
    fn place(&self, name: &str, values: [f64; 3]) -> Result<Vector3<f64>, ConfigError> {
        for value in values {
            self.check(name, value, -SCENE_M, SCENE_M)?;
        }
        Ok(Vector3::from(values))
    }

    fn sphere(&self, center_m: [f64; 3], radius_m: f64) -> Result<Shape, ConfigError> {
        let radius_m = self.length("radius_m", radius_m)?;
        let center_m = self.place("center_m", center_m)?;
        Ok(Shape::Sphere { center_m, radius_m })
    }

    fn capsule(
        &self,
        from_m: [f64; 3],
        to_m: [f64; 3],
        radius_m: f64,
    ) -> Result<Shape, ConfigError> {
        let radius_m = self.length("radius_m", radius_m)?;
        Ok(Shape::Capsule {
            from_m: self.place("from_m", from_m)?,
            to_m: self.place("to_m", to_m)?,
            radius_m,
        })
    }

    /// `normal` points out of the region, and is normalised.
    fn half_space(&self, point_m: [f64; 3], normal: [f64; 3]) -> Result<Shape, ConfigError> {
        let point_m = self.place("point_m", point_m)?;
        let normal = self.place("normal", normal)?;
        // Written by hand, so a thousandth off is meant to be a unit vector.
        self.check("normal", normal.norm(), 0.999, 1.001)?;
        let normal = normal.normalize();
        Ok(Shape::HalfSpace { point_m, normal })
    }

    fn block(
        &self,
        center_m: [f64; 3],
        size_m: [f64; 3],
        rpy_rad: [f64; 3],
    ) -> Result<Shape, ConfigError> {
        for size in size_m {
            self.length("size_m", size)?;
        }
        for angle in rpy_rad {
            self.check("rpy_rad", angle, -3.15, 3.15)?;
        }
        let [roll, pitch, yaw] = rpy_rad;
        Ok(Shape::Box(Block {
            center_m: self.place("center_m", center_m)?,
            half_m: Vector3::from(size_m) / 2.0,
            axes: Rotation3::from_euler_angles(roll, pitch, yaw),
        }))
    }
}

fn region(source: &Source, index: usize, table: &RegionTable) -> Result<Region, ConfigError> {
    let entry = Entry { source, index };
    let (name, shape) = match table {
        RegionTable::Sphere {
            name,
            center_m,
            radius_m,
        } => (name, entry.sphere(*center_m, *radius_m)?),
        RegionTable::Capsule {
            name,
            from_m,
            to_m,
            radius_m,
        } => (name, entry.capsule(*from_m, *to_m, *radius_m)?),
        RegionTable::HalfSpace {
            name,
            point_m,
            normal,
        } => (name, entry.half_space(*point_m, *normal)?),
        RegionTable::Box {
            name,
            center_m,
            size_m,
            rpy_rad,
        } => (name, entry.block(*center_m, *size_m, *rpy_rad)?),
    };
    let name = name.clone();
    Ok(Region { name, shape })
}

#[cfg(test)]
mod tests {
    use crate::config::ControlConfig;
    use crate::rows::tests::TWO_ARMS;
    use hal::config::Source;

    /// What is said to the two-armed scene with one text replaced.
    fn message(from: &str, to: &str) -> String {
        let changed = TWO_ARMS.replacen(from, to, 1);
        assert_ne!(changed, TWO_ARMS, "{from}");
        let source = Source::embedded("safety.toml", &changed);
        ControlConfig::load(&ControlConfig::default_control(), &source)
            .map_or_else(|error| error.to_string(), |_| "loaded".to_owned())
    }

    #[test]
    fn what_no_two_arms_can_keep_is_refused() {
        let base = "rcm_in_scene_m = [-0.06, 0.0, 0.15]";
        let same = message(base, "rcm_in_scene_m = [0.06, 0.0, 0.15]");
        assert!(
            same.contains("arm.1.rcm_in_scene_m = 0 m from arm.0's"),
            "{same}"
        );
        let near = message(base, "rcm_in_scene_m = [0.052, 0.0, 0.15]");
        assert!(near.contains("outside more than 0.0115 m"), "{near}");
        for name in ["psm1", "psm3", ""] {
            let said = message("name = \"psm2\"", &format!("name = \"{name}\""));
            let expected = format!("arm.1.name = {name:?} is outside \"psm2\"");
            assert!(said.contains(&expected), "{said}");
        }
        let alone = message("[between_arms]", "[[forbidden]]\nname = \"x\"\n[nonsense]");
        assert!(!alone.contains("loaded"), "{alone}");
    }

    #[test]
    fn a_region_about_a_remote_centre_is_refused() {
        let said = message(
            "center_m = [0.0, 0.05, 0.0]",
            "center_m = [0.06, 0.005, 0.155]",
        );
        assert!(
            said.contains("forbidden.0") && said.contains("arm.0"),
            "{said}"
        );
        let said = message("point_m = [0.0, 0.0, -0.01]", "point_m = [0.0, 0.0, 0.146]");
        assert!(said.contains("forbidden.2"), "{said}");
    }

    #[test]
    fn a_region_without_a_name_of_its_own_is_refused() {
        for (name, allowed) in [
            ("", "a name"),
            (" ", "a name"),
            ("vessel", "a name of its own"),
        ] {
            let said = message("name = \"artery\"", &format!("name = \"{name}\""));
            let expected = format!("forbidden.1.name = {name:?} is outside {allowed}");
            assert!(said.contains(&expected), "{said}");
        }
    }

    #[test]
    fn a_workspace_that_no_arm_reaches_is_refused() {
        let safety = ControlConfig::needle_lift_safety();
        let with = |low: &str, high: &str| {
            let text = safety
                .text()
                .replace("workspace_min_m = [-0.06, -0.05, -0.005]", low)
                .replace("workspace_max_m = [0.06, 0.05, 0.09]", high);
            let source = Source::embedded("safety.toml", &text);
            ControlConfig::load(&ControlConfig::default_control(), &source)
                .map_or_else(|error| error.to_string(), |_| "loaded".to_owned())
        };
        // Above the remote centre, and deeper than the instrument gets.
        for (low, high) in [
            ("[-0.06, -0.05, 0.2]", "[0.06, 0.05, 0.3]"),
            ("[-0.06, -0.05, -0.3]", "[0.06, 0.05, -0.12]"),
        ] {
            let said = with(
                &format!("workspace_min_m = {low}"),
                &format!("workspace_max_m = {high}"),
            );
            assert!(
                said.contains("arm.0.workspace_max_m = a box that"),
                "{said}"
            );
        }
        // A corner is enough.
        let corner = with(
            "workspace_min_m = [0.045, 0.035, -0.005]",
            "workspace_max_m = [0.06, 0.05, 0.09]",
        );
        assert_eq!(corner, "loaded");
    }

    #[test]
    fn regions_that_are_none_are_refused() {
        for (from, to, key) in [
            (
                "normal = [0.0, 0.0, 1.0]",
                "normal = [0.0, 0.0, 0.0]",
                "forbidden.2.normal",
            ),
            (
                "normal = [0.0, 0.0, 1.0]",
                "normal = [0.0, 0.0, 2.0]",
                "forbidden.2.normal",
            ),
            ("radius_m = 0.006", "radius_m = 0.0", "forbidden.1.radius_m"),
            ("radius_m = 0.006", "radius_m = nan", "forbidden.1.radius_m"),
            (
                "size_m = [0.03, 0.02, 0.04]",
                "size_m = [0.03, -0.02, 0.04]",
                "forbidden.3.size_m",
            ),
            ("shape = \"box\"", "shape = \"cone\"", "cone"),
            (
                "rpy_rad = [0.2, -0.3, 0.5]",
                "rpy = [0.2, -0.3, 0.5]",
                "rpy",
            ),
        ] {
            let said = message(from, to);
            assert!(said.contains(key), "{to}: {said}");
        }
        // A capsule whose ends meet is a sphere.
        let ball = message("to_m = [0.05, -0.05, 0.03]", "to_m = [-0.04, -0.04, 0.01]");
        assert_eq!(ball, "loaded");
    }
}
