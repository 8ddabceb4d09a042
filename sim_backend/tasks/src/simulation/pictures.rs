//! Tests of what the tasks look like, and that looking changes nothing.

use hal::CameraFrame;
use trocar_render::visual::instance;

use super::{Rendering, Simulation};
use crate::scene::SceneSnapshot;
use crate::task::{Calibration, SIDE, TaskConfig};

/// What endoscope and side camera together see of a task at its start.
pub(crate) struct Looks {
    task: TaskConfig,
    frame: CameraFrame,
}

impl Looks {
    /// Those of the built-in task `name`.
    pub(crate) fn of(name: &str) -> Self {
        let task = TaskConfig::shipped(name);
        let mut simulation = Simulation::new(&task, 1, Rendering::On).unwrap();
        let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
        simulation.render(0, &mut frame).unwrap();
        if let Some(folder) = std::env::var_os("TROCAR_TASK_SAMPLES") {
            let mut picture = b"P6 512 512 255\n".to_vec();
            picture.extend(&frame.colour);
            let path = std::path::Path::new(&folder).join(format!("{name}.ppm"));
            std::fs::write(path, picture).unwrap();
        }
        // From so steeply above, wrists hide most of jaws that point down, and little is seen of
        // what is behind.
        let side = simulation.cameras().unwrap().find(SIDE).unwrap();
        let mut other = simulation.cameras().unwrap().blank_frame(side).unwrap();
        simulation.render(side, &mut other).unwrap();
        frame.colour.extend(&other.colour);
        frame.instance.extend(&other.instance);
        Self { task, frame }
    }

    /// Checks that of each instance id there are at least as many pixels.
    pub(crate) fn show(&self, least: &[(u8, usize)]) {
        for &(id, least) in least {
            let seen = self.frame.instance.iter();
            let pixels = seen.filter(|&&seen| seen == id).count();
            let name = &self.task.name;
            assert!(pixels >= least, "{name}: {pixels} pixels of instance {id}");
        }
    }

    /// Mean colour of the pixels of one id.
    pub(crate) fn colour(&self, id: u8) -> [f64; 3] {
        let (mut sums, mut count) = ([0.0; 3], 0.0);
        for (pixel, _) in self
            .frame
            .colour
            .chunks_exact(3)
            .zip(&self.frame.instance)
            .filter(|(_, seen)| **seen == id)
        {
            count += 1.0;
            for (sum, byte) in sums.iter_mut().zip(pixel) {
                *sum += f64::from(*byte);
            }
        }
        sums.map(|sum| sum / count)
    }

    /// Checks what tells something apart.
    pub(crate) fn check(&self, holds: bool, what: &str) {
        let ground = self.colour(instance::ORGAN);
        assert!(holds, "{}: {what}, ground {ground:?}", self.task.name);
    }
}

/// 0 for grey, 1 for a pure colour.
pub(crate) fn saturation(colour: [f64; 3]) -> f64 {
    let [high, low] = [f64::max, f64::min].map(|of| colour.into_iter().fold(colour[0], of));
    (high - low) / high
}

#[test]
fn every_task_shows_all_of_its_parts() {
    for name in TaskConfig::names() {
        let looks = Looks::of(name);
        looks.show(&[(instance::ORGAN, 40_000)]);
        let arms = [
            [(instance::SHAFT, 300), (instance::JAW, 500)],
            [(instance::SECOND_SHAFT, 300), (instance::SECOND_JAW, 500)],
        ];
        for arm in &arms[..looks.task.arms.len()] {
            looks.show(arm);
        }
        for visual in looks.task.scene.visuals() {
            looks.show(&[(visual.instance, 150)]);
        }
        // What tells organs and tools apart must be in the picture: hues, greys, light and dark.
        if looks.frame.instance.contains(&0) {
            let dim = (4.0..110.0).contains(&looks.colour(0)[0]);
            looks.check(dim, "the backdrop is dim, no void");
        }
        let jaw = saturation(looks.colour(instance::JAW));
        looks.check(jaw < 0.3, "jaws are steel");
        if looks.frame.instance.contains(&instance::NEEDLE) {
            looks.show(&[(instance::NEEDLE, 500)]);
            let needle = saturation(looks.colour(instance::NEEDLE));
            let ground = saturation(looks.colour(instance::ORGAN));
            looks.check(needle < 0.3, "the needle is steel");
            looks.check(needle < ground - 0.1, "unlike what it lies on");
        }
    }
}

/// Pixels of a plain picture, along one axis, whose rays fall on the centre of a pixel of a
/// calibrated one by OpenCV's formula: both indices. `plain` and `calibrated` are focal length and
/// principal point.
fn matching(size: u32, plain: [f64; 2], calibrated: [f64; 2]) -> Vec<(usize, usize)> {
    let pairs = (0..size).filter_map(|pixel| {
        let ray = (f64::from(pixel) + 0.5 - plain[1]) / plain[0];
        let place = calibrated[0] * ray + calibrated[1];
        let mut others = 0..size - 1;
        let other = others.find(|other| (f64::from(*other) - place).abs() < 1e-6)?;
        Some((pixel as usize, other as usize))
    });
    pairs.collect()
}

/// Of a camera with pixels three times as narrow, off centre, a pixel with the ray of a plain
/// camera's pixel shows its id, depth and colour. The next column or row does not: half a pixel
/// would be seen.
#[test]
fn calibrated_camera_sees_along_opencvs_rays() {
    let plain = TaskConfig::shipped("needle-lift");
    // The endoscope's lens would change the light.
    let mut standing = plain.cameras.iter();
    let side = standing.position(|camera| camera.name == SIDE).unwrap();
    let lens = plain.cameras[side].intrinsics();
    let calibration = Calibration {
        fx_px: 3.0 * lens.fx,
        fy_px: lens.fy,
        cx_px: lens.cx - 0.5 + 31.0,
        cy_px: lens.cy - 0.5 - 4.0,
    };
    let mut calibrated = plain.clone();
    calibrated.cameras[side].vertical_fov_rad = None;
    calibrated.cameras[side].calibration = Some(calibration);
    let shoot = |task: &TaskConfig| {
        let mut simulation = Simulation::new(task, 1, Rendering::On).unwrap();
        let mut frame = simulation.cameras().unwrap().blank_frame(side).unwrap();
        simulation.render(side, &mut frame).unwrap();
        frame
    };
    let (before, seen) = (shoot(&plain), shoot(&calibrated));
    assert_eq!(seen.intrinsics, calibrated.cameras[side].intrinsics());

    let Calibration { fx_px, fy_px, .. } = calibration;
    let columns = matching(lens.width, [lens.fx, lens.cx], [fx_px, calibration.cx_px]);
    let rows = matching(lens.height, [lens.fy, lens.cy], [fy_px, calibration.cy_px]);
    assert!(columns.len() > 150 && rows.len() > 500);
    let wide = lens.width as usize;
    let (mut pixels, mut other_ids, mut colour) = (0, 0, 0_u32);
    // Differences of depth at the place, a column and a row beside it.
    let mut apart = [0.0; 3];
    for &(row, seen_row) in &rows {
        for &(column, seen_column) in &columns {
            let (from, to) = (row * wide + column, seen_row * wide + seen_column);
            pixels += 1;
            other_ids += u32::from(before.instance[from] != seen.instance[to]);
            for channel in 0..3 {
                let bytes = (
                    before.colour[3 * from + channel],
                    seen.colour[3 * to + channel],
                );
                colour += u32::from(bytes.0.abs_diff(bytes.1));
            }
            let beside = [to, to + 1, to + wide];
            if beside
                .iter()
                .all(|at| seen.instance[*at] == before.instance[from])
            {
                for (sum, at) in apart.iter_mut().zip(beside) {
                    *sum += f64::from((seen.depth_m[at] - before.depth_m[from]).abs());
                }
            }
        }
    }
    assert!(500 * other_ids < pixels, "{other_ids} of {pixels}");
    assert!(colour < 8 * 3 * pixels, "{colour} of {pixels} pixels");
    assert!(apart[0] < 0.1 * apart[1].min(apart[2]), "{apart:?}");
}

#[test]
fn a_flap_is_drawn_where_it_has_gone() {
    let task = TaskConfig::shipped("tissue-retraction");
    let mut simulation = Simulation::new(&task, 1, Rendering::On).unwrap();
    let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
    let flat = simulation.snapshot();
    // Lifted by 2 cm as a whole: more than any lens would miss.
    let raised = SceneSnapshot {
        flap: flat.flap.map(|flap| flap.moved([0.0, 0.0, 0.02])),
        ..flat
    };
    let cameras = simulation.cameras.as_mut().unwrap();
    let mut mean_depth_m = |snapshot: &SceneSnapshot, id: u8| {
        cameras.render(0, snapshot, &mut frame).unwrap();
        let seen = frame.instance.iter().zip(&frame.depth_m);
        let depths: Vec<f64> = seen
            .filter(|(seen, _)| **seen == id)
            .map(|(_, depth_m)| f64::from(*depth_m))
            .collect();
        let count = u32::try_from(depths.len()).unwrap();
        depths.iter().sum::<f64>() / f64::from(count)
    };
    let low_m = mean_depth_m(&flat, instance::MARK);
    let high_m = mean_depth_m(&raised, instance::MARK);
    // The endoscope looks down at 65 degrees.
    assert!(
        (0.012..0.019).contains(&(low_m - high_m)),
        "{low_m} {high_m}"
    );
    let high_m = mean_depth_m(&raised, instance::TISSUE);
    let low_m = mean_depth_m(&flat, instance::TISSUE);
    assert!(
        (0.012..0.022).contains(&(low_m - high_m)),
        "{low_m} {high_m}"
    );
    let again_m = mean_depth_m(&flat, instance::TISSUE);
    assert!((again_m - low_m).abs() < 1e-12);
}

#[test]
fn looking_changes_nothing() {
    // Two arms, and tissue that bends: opening a renderer takes seconds.
    for name in ["needle-handover", "tissue-retraction"] {
        let task = TaskConfig::shipped(name);
        let hash = |rendering| {
            let mut simulation = Simulation::new(&task, 3, rendering).unwrap();
            for step in 0..100 {
                if rendering == Rendering::On && step % 40 == 0 {
                    let mut frame = simulation.cameras().unwrap().blank_frame(0).unwrap();
                    simulation.render(0, &mut frame).unwrap();
                }
                simulation.step();
            }
            simulation.state_hash()
        };
        assert_eq!(hash(Rendering::On), hash(Rendering::Off), "{name}");
    }
}
