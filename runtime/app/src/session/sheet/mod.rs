//! A contact sheet: what every camera of every task sees in the middle of an expert's episode, in
//! colour, depth and ids.

mod font;
mod layout;
mod plates;

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use tch::Device;
use trocar_render::Shading;
use trocar_tasks::simulation::{Rendering, Simulation};

use super::episode::{Episode, NoObserver, Timing};
use super::latency::Latency;
use super::scene_options::SceneOptions;
use super::{PolicyChoice, SessionError, Setup, pictures};
use layout::{Block, Row};
use plates::Plates;

/// What to show.
#[derive(Clone, Debug)]
pub struct SheetOptions {
    /// The tasks, in order: names or paths of folders.
    pub tasks: Vec<String>,
    /// Their needle and view, and the scene file if it is one task. The needle goes to the tasks
    /// that have a choice.
    pub scene: SceneOptions,
    /// The file, a PNG.
    pub out: PathBuf,
    /// The seed of every episode.
    pub seed: u64,
    /// Width of one image, pixels.
    pub width: u32,
    /// The moment, as a share of the time that the expert takes, 0 to 1.
    pub at: f64,
    /// The shading; each scene's own if not given.
    pub shading: Option<Shading>,
}

/// Draws the sheet and writes it; `on_task` hears of each task when it is done.
///
/// # Errors
/// From the tasks, the simulation and the file; [`SessionError::BadArgument`] for a task that is
/// named twice, a needle that goes to none, and a scene file for several tasks.
pub fn write(options: &SheetOptions, on_task: &mut dyn FnMut(&str)) -> Result<(), SessionError> {
    let setups = setups(options)?;
    let mut blocks = Vec::with_capacity(setups.len());
    for setup in &setups {
        blocks.push(block(setup, options)?);
        on_task(&setup.task_name);
    }
    let sheet = layout::compose(&blocks, options.width);
    save(&sheet, options)
}

/// The tasks as they were asked for.
fn setups(options: &SheetOptions) -> Result<Vec<Setup>, SessionError> {
    let refused = |reason: String| Err(SessionError::BadArgument(reason));
    let tasks = &options.tasks;
    if let (Some(file), true) = (&options.scene.file, tasks.len() != 1) {
        return refused(format!(
            "--scene {}: it is of one task; name that one with --task",
            file.display()
        ));
    }
    let mut setups = tasks
        .iter()
        .map(|task| Setup::load(task, None, &PolicyChoice::Expert))
        .collect::<Result<Vec<_>, _>>()?;
    for (index, setup) in setups.iter().enumerate() {
        let named = |other: &Setup| other.task_name == setup.task_name;
        if setups[..index].iter().any(named) {
            return refused(format!("--task: {} is named twice", setup.task_name));
        }
    }
    let has_choice = |setup: &Setup| setup.task.needle().is_some();
    // If none has, the first says so.
    let any_choice = setups.iter().any(has_choice);
    for setup in &mut setups {
        let mut scene = options.scene.clone();
        scene.needle = scene.needle.filter(|_| has_choice(setup) || !any_choice);
        *setup = setup.clone().with_scene(&scene)?;
        setup.task.shading = options.shading.unwrap_or(setup.task.shading);
    }
    Ok(setups)
}

/// The frames of one task.
fn block(setup: &Setup, options: &SheetOptions) -> Result<Block, SessionError> {
    let (_, ticks) = play(setup, options.seed, Rendering::Off, setup.tick_limit())?;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a share of the ticks of an episode"
    )]
    let moment = (ticks as f64 * options.at.clamp(0.0, 1.0)) as u64;
    let (mut simulation, _) = play(setup, options.seed, Rendering::On, moment)?;
    let mut rows = Vec::new();
    let mut ids = Vec::new();
    for (index, camera) in setup.camera_names().into_iter().enumerate() {
        let mut frame = simulation.cameras()?.blank_frame(index)?;
        simulation.render(index, &mut frame)?;
        let plates = Plates::new(&frame, options.width);
        ids.append(&mut frame.instance);
        ids.sort_unstable();
        ids.dedup();
        rows.push(Row { camera, plates });
    }
    let title = setup.task_name.clone();
    Ok(Block { title, rows, ids })
}

/// The expert's episode up to its end or to `tick_limit`, and how many ticks that were.
fn play(
    setup: &Setup,
    seed: u64,
    rendering: Rendering,
    tick_limit: u64,
) -> Result<(Simulation, u64), SessionError> {
    let mut simulation = Simulation::new(&setup.task, seed, rendering)?;
    let mut source = setup.source(&PolicyChoice::Expert, seed, Device::Cpu)?;
    let timing = Timing {
        latency: Latency::fixed(source.latency_ticks()),
        tick_limit,
    };
    let episode = Episode {
        simulation: &mut simulation,
        controller: &mut setup.controller()?,
        source: &mut source,
    };
    let end = episode.run(&timing, &mut NoObserver)?;
    Ok((simulation, end.tally.ticks()))
}

fn save(sheet: &RgbImage, options: &SheetOptions) -> Result<(), SessionError> {
    let path = &options.out;
    pictures::create_parent(path)?;
    let file = File::create(path).map_err(|error| SessionError::output(path, error))?;
    let (best, adaptive) = (CompressionType::Best, FilterType::Adaptive);
    PngEncoder::new_with_quality(BufWriter::new(file), best, adaptive)
        .write_image(
            sheet,
            sheet.width(),
            sheet.height(),
            ExtendedColorType::Rgb8,
        )
        .map_err(|error| SessionError::output(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn needles(tasks: &[&str], needle: &str) -> Result<Vec<Option<String>>, String> {
        let options = SheetOptions {
            tasks: tasks.iter().map(|&task| task.to_owned()).collect(),
            scene: SceneOptions {
                needle: Some(needle.to_owned()),
                ..SceneOptions::default()
            },
            out: PathBuf::new(),
            seed: 0,
            width: 24,
            at: 0.5,
            shading: None,
        };
        let needle = |setup: &Setup| setup.task.needle().map(str::to_owned);
        match setups(&options) {
            Ok(setups) => Ok(setups.iter().map(needle).collect()),
            Err(error) => {
                assert!(error.is_bad_input());
                Err(error.to_string())
            }
        }
    }

    /// A needle goes to the tasks that have a choice and must go to one.
    #[test]
    fn needle_is_for_tasks_with_a_choice() {
        let found = needles(&["block-transfer", "needle-lift"], "N2");
        assert_eq!(found, Ok(vec![None, Some("N2".to_owned())]));
        let error = needles(&["block-transfer", "needle-lift"], "N9").unwrap_err();
        assert!(error.contains("it has N1, N2"), "{error}");
        let error = needles(&["block-transfer", "suture-pad"], "N2").unwrap_err();
        assert!(error.contains("block-transfer has no needle"), "{error}");
    }

    #[test]
    fn a_task_is_shown_once() {
        let error = needles(&["needle-lift", "suture-pad", "needle-lift"], "N2").unwrap_err();
        assert_eq!(error, "--task: needle-lift is named twice");
    }
}
