//! The file that says what point clouds are made of.
//!
//! Read once when training begins; the checkpoint keeps the recipe, so neither a run nor an
//! evaluation reads this file.

use std::path::Path;

use hal::config::{ConfigError, Source};
use serde::Deserialize;
use trocar_data::perception::{CloudFrame, CloudRecipe, Padding, Point};

/// Most points of a cloud.
///
/// 65536 points of three `f32` are 0.8 MB a sample.
const POINTS_MAX: usize = 1 << 16;

/// Longest coordinate of the box, m.
const BOX_MAX_M: f32 = 10.0;

/// The file as it is written, before its ranges are checked. Fields are explained in
/// `config/clouds.toml`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CloudFile {
    /// Of points and box: the scene's, or the first camera's.
    frame: CloudFrame,
    /// Lower corner `[x, y, z]` in `frame`, m; only together with the upper one.
    crop_min_m: Option<Point>,
    crop_max_m: Option<Point>,
    /// Instance ids of the renderer, of which no point is kept.
    dropped_instances: Vec<u8>,
    /// Edge of the cubes of which each keeps its first point; 1e-5 to 0.1 m, none thins nothing.
    voxel_m: Option<f32>,
    /// 1 to [`POINTS_MAX`]; that of the network's preset if not given.
    points: Option<usize>,
    /// What fills a cloud with fewer points.
    padding: Padding,
}

/// Reads `file`, or the built-in config/clouds.toml; where it names no number of points there are
/// `points`.
///
/// # Errors
/// [`ConfigError`] naming file, line and key.
pub(super) fn cloud_recipe(file: Option<&Path>, points: usize) -> Result<CloudRecipe, ConfigError> {
    let source = match file {
        Some(path) => Source::read(&path.display().to_string())?,
        None => Source::embedded(
            "config/clouds.toml",
            include_str!("../../../../config/clouds.toml"),
        ),
    };
    let read: CloudFile = source.parse()?;
    check(&source, &read)?;
    Ok(CloudRecipe {
        frame: read.frame,
        crop_m: match (read.crop_min_m, read.crop_max_m) {
            (Some(low), Some(high)) => Some([low, high]),
            _ => None,
        },
        dropped_instances: read.dropped_instances,
        voxel_m: read.voxel_m,
        points: read.points.unwrap_or(points),
        padding: read.padding,
    })
}

/// Ranges, and that the box has a volume: each maximum is above its minimum.
#[expect(clippy::cast_precision_loss, reason = "counts of points are small")]
fn check(source: &Source, read: &CloudFile) -> Result<(), ConfigError> {
    match (read.crop_min_m, read.crop_max_m) {
        (None, None) => {}
        (Some(low), Some(high)) => {
            for axis in 0..3 {
                let [low_key, high_key] = ["min", "max"].map(|end| format!("crop_{end}_m.{axis}"));
                let (least, most) = (f64::from(-BOX_MAX_M), f64::from(BOX_MAX_M));
                source.check_range(&low_key, f64::from(low[axis]), least, most)?;
                source.check_range(&high_key, f64::from(high[axis]), least, most)?;
                if low[axis] >= high[axis] {
                    let allowed = format!("({}, {most}]: above crop_min_m", low[axis]);
                    return Err(source.out_of_range(&high_key, &high[axis].to_string(), &allowed));
                }
            }
        }
        (Some(_), None) => {
            return Err(source.out_of_range("crop_min_m", "alone", "a box: crop_max_m is missing"));
        }
        (None, Some(_)) => {
            return Err(source.out_of_range("crop_max_m", "alone", "a box: crop_min_m is missing"));
        }
    }
    if let Some(voxel_m) = read.voxel_m {
        source.check_range("voxel_m", f64::from(voxel_m), 1e-5, 0.1)?;
    }
    match read.points {
        Some(points) => source.check_range("points", points as f64, 1.0, POINTS_MAX as f64),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::{CloudFrame, CloudRecipe, Padding, cloud_recipe};
    use std::fs;

    fn read(text: &str) -> Result<CloudRecipe, String> {
        let name = format!(
            "trocar-clouds-{}-{:?}.toml",
            std::process::id(),
            std::thread::current().id()
        );
        let file = std::env::temp_dir().join(name);
        fs::write(&file, text).unwrap();
        let recipe = cloud_recipe(Some(&file), 512).map_err(|error| error.to_string());
        fs::remove_file(&file).unwrap();
        recipe
    }

    #[test]
    fn the_built_in_file_keeps_what_works_and_what_is_worked_on() {
        let recipe = cloud_recipe(None, 1024).unwrap();
        assert_eq!((recipe.points, recipe.crop_m), (1024, None));
        let kept = recipe.options().instances;
        let dropped: Vec<u8> = (0..14).filter(|&id| !kept.contains(id)).collect();
        assert_eq!(dropped, [0, 1, 3, 6, 12]);
    }

    /// Every key is taken and what makes no sense is refused by key.
    #[test]
    fn cloud_file_keys_are_checked_one_by_one() {
        let good = "frame = \"first_camera\"\ncrop_min_m = [-0.1, -0.1, 0.0]\ncrop_max_m = [0.1, 0.1, 0.2]\n\
                    dropped_instances = [0]\nvoxel_m = 0.002\npoints = 64\npadding = \"origin\"\n";
        let recipe = CloudRecipe {
            frame: CloudFrame::FirstCamera,
            crop_m: Some([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.2]]),
            dropped_instances: vec![0],
            voxel_m: Some(0.002),
            points: 64,
            padding: Padding::Origin,
        };
        assert_eq!(read(good).unwrap(), recipe);
        for (from, to, said) in [
            (
                "points = 64",
                "points = 0",
                ":6: points = 0 is outside [1, 65536]",
            ),
            (
                "0.2]",
                "-0.2]",
                ":3: crop_max_m.2 = -0.2 is outside (0, 10]",
            ),
            ("voxel_m = 0.002", "voxel_m = nan", ":5: voxel_m"),
            (
                "crop_max_m = [0.1, 0.1, 0.2]\n",
                "",
                "crop_max_m is missing",
            ),
            ("points", "pints", "pints"),
        ] {
            let error = read(&good.replace(from, to)).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }
}
