//! A contact sheet: what every camera of every task sees in the middle of an expert's episode, in colour, depth and ids.

mod font;
mod layout;
mod plates;

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use sim_backend::simulation::{Rendering, Simulation};
use tch::Device;

use super::episode::{Episode, Nobody, Plan};
use super::scene_options::SceneOptions;
use super::{PolicyChoice, SessionError, Setup, pictures};
use layout::{Block, Row};
use plates::Plates;

/// What to show.
#[derive(Clone, Debug)]
pub struct SheetOptions {
    /// The tasks, in order.
    pub tasks: Vec<String>,
    /// Their needle and view.
    pub scene: SceneOptions,
    /// The file, a PNG.
    pub out: PathBuf,
    /// The seed of every episode.
    pub seed: u64,
    /// Width of one picture, pixels.
    pub width: u32,
    /// The moment, as a share of the time that the expert takes, 0 to 1.
    pub at: f64,
}

/// Draws the sheet and writes it; `on_task` hears of each task when it is done.
///
/// # Errors
/// From the tasks, the simulation and the file.
pub fn write(options: &SheetOptions, on_task: &mut dyn FnMut(&str)) -> Result<(), SessionError> {
    let mut blocks = Vec::with_capacity(options.tasks.len());
    for task in &options.tasks {
        blocks.push(block(task, options)?);
        on_task(task);
    }
    let sheet = layout::compose(&blocks, options.width);
    save(&sheet, options)
}

/// The frames of one task.
fn block(task: &str, options: &SheetOptions) -> Result<Block, SessionError> {
    let setup = Setup::load(task, None, &PolicyChoice::Expert)?.with_scene(&options.scene)?;
    let (_, ticks) = play(&setup, options.seed, Rendering::Off, setup.tick_limit())?;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a share of the ticks of an episode"
    )]
    let moment = (ticks as f64 * options.at.clamp(0.0, 1.0)) as u64;
    let (mut simulation, _) = play(&setup, options.seed, Rendering::On, moment)?;
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
    let title = task.to_owned();
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
    let plan = Plan {
        latency_ticks: source.latency_ticks(),
        tick_limit,
    };
    let episode = Episode {
        simulation: &mut simulation,
        controller: &mut setup.controller()?,
        source: &mut source,
    };
    let end = episode.run(&plan, &mut Nobody)?;
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
