//! The verb `anatomy`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use trocar::session::preview::{self, Preview};
use trocar::session::run::write_json;
use trocar::session::{SessionError, anatomy, outputs};
use trocar_anatomy::build::{LEVELS_MAX, Options, Stage};
use trocar_anatomy::surface::Method;
use trocar_anatomy::texture::SIDE_PX;

use crate::args::between;
use crate::commands::Done;
use crate::console;
use crate::segment::{self, SegmentArgs, TrainSegmenterArgs};

/// Most voxels along an axis of a phantom.
const SIDE_MAX: usize = 1024;

/// What to do with an anatomy.
#[derive(Debug, Subcommand)]
pub(crate) enum AnatomyVerb {
    /// Make a procedural patient: a CT and its labels.
    #[command(
        after_help = "Example: trocar anatomy phantom --seed 7 --out runs/patient\n         trocar anatomy phantom --seed 8 --size 512x512x600 --out runs/large\n\nOUT gets ct.nii.gz (HU) and labels.nii.gz (VISTA3D's numbers) of 450 mm x 450 mm x 540 mm. The same seed and size give the same files."
    )]
    Phantom(PhantomArgs),
    /// Make meshes of a CT's labels.
    #[command(
        after_help = "Example: trocar anatomy build runs/patient/labels.nii.gz --out runs/patient\n         trocar anatomy build segmentation.nii.gz --groups totalsegmentator --max-error-mm 1 --out runs/case --json runs/case.json\n\nOUT gets patient.glb (glTF), patient.usda and patient.usdz (OpenUSD) and patient.json (what was measured), a mesh a tissue group, where the scan has them: right, anterior, superior, in metres. A label that the table does not have is refused; tables of your own have the form of those in config/anatomy/."
    )]
    Build(BuildArgs),
    /// Draw a patient on a turntable.
    #[command(
        after_help = "Example: trocar anatomy preview runs/patient --out runs/patient.gif\n         trocar anatomy preview runs/patient --groups liver,gallbladder,vessels --frames 6 --out runs/liver.png\n\nThe patient is what `trocar anatomy build` made. Without --groups all but the body around the organs are drawn."
    )]
    Preview(PreviewArgs),
    /// Label the tissues of a CT by a network.
    #[command(
        after_help = "Example: trocar anatomy segment runs/patient/ct.nii.gz --model runs/segmenter.safetensors --out runs/found.nii.gz\n         trocar anatomy segment scans/series4 --model vista3d.ts --settings vista3d --device cuda --out runs/found.nii.gz\n\nThe labels have the CT's voxels. They are those of the model's table, which the last line of the output names for `trocar anatomy build`. A TorchScript model maps (1, 1, x, y, z) to (1, classes, x, y, z); config/anatomy/models/vista3d.toml is an example of its settings."
    )]
    Segment(SegmentArgs),
    /// Train a network that labels CTs, on procedural patients.
    #[command(
        after_help = "Example: trocar anatomy train-segmenter --out runs/segmenter.safetensors --device cuda\n         trocar anatomy train-segmenter --spacing-mm 5 --patch 48 --patients 64 --steps 2000 --out runs/small.safetensors\n\nDice on unseen patients is measured with what was written, at the network's own voxel size."
    )]
    TrainSegmenter(TrainSegmenterArgs),
}

impl AnatomyVerb {
    /// Where the result goes as JSON.
    pub(crate) const fn json(&self) -> &Option<PathBuf> {
        match self {
            Self::Phantom(args) => &args.json,
            Self::Build(args) => &args.json,
            Self::Preview(_) => &None,
            Self::Segment(args) => &args.json,
            Self::TrainSegmenter(args) => &args.json,
        }
    }
}

/// Options of `anatomy phantom`.
#[derive(Args, Debug)]
pub(crate) struct PhantomArgs {
    /// Random seed: the same seed gives the same patient.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Voxels along x, y and z, 16 to 1024 each.
    #[arg(long, value_name = "WxHxD", default_value = "256x256x300", value_parser = size)]
    size: Size,
    /// The folder, which is made.
    #[arg(long)]
    out: PathBuf,
    /// Write what was made as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Voxels along the axes.
#[derive(Clone, Copy, Debug)]
struct Size([usize; 3]);

fn size(text: &str) -> Result<Size, String> {
    let sides: Option<Vec<usize>> = text.split('x').map(|side| side.parse().ok()).collect();
    let allowed = |side: &usize| (16..=SIDE_MAX).contains(side);
    match sides.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(allowed) => Ok(Size([x, y, z])),
        _ => Err(format!(
            "three numbers from 16 to {SIDE_MAX}, such as 256x256x300"
        )),
    }
}

/// Options of `anatomy build`.
#[derive(Args, Debug)]
pub(crate) struct BuildArgs {
    /// The label volume: NIfTI, .nii or .nii.gz.
    #[arg(value_name = "LABELS")]
    labels: PathBuf,
    /// The folder, which is made.
    #[arg(long)]
    out: PathBuf,
    /// Which label is which tissue group: vista3d, totalsegmentator, groups (our own segmenter's),
    /// or a file.
    #[arg(long, value_name = "NAME|FILE", default_value = "vista3d")]
    groups: String,
    /// How far meshes may be from the smooth surface, mm, 0.01 to 10.
    #[arg(long, value_name = "E", default_value_t = 0.5, value_parser = error_mm)]
    max_error_mm: f64,
    /// How surfaces are found: nets share vertices between neighbours, marching cubes make each
    /// group by itself.
    #[arg(long, value_enum, default_value = "nets")]
    surface: Surface,
    /// Pieces of a group that are smaller go to their neighbours, mm³, up to 100000.
    #[arg(long, value_name = "V", default_value_t = 30.0, value_parser = island_mm3)]
    min_island_mm3: f64,
    /// Measure distances from the voxels after each stage that moves surfaces too; they go into
    /// patient.json.
    #[arg(long)]
    measure_stages: bool,
    /// Fill the groups with tetrahedra too, of a body-centred cubic lattice with cells of this
    /// side, mm, 0.5 to 50: tetrahedra.usda.
    #[arg(long, value_name = "MM", value_parser = side_mm)]
    tetrahedra: Option<f64>,
    /// Paint a texture of this side for each group too, pixels, 16 to 2048: patient-textured.glb
    /// and patient-textured.usdz, which have them embedded.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(i64::from(SIDE_PX[0])..=i64::from(SIDE_PX[1])))]
    textures: Option<u32>,
    /// Make so many coarser levels of detail too, 0 to 4, each with twice the error of the one
    /// before: patient-level-1.usda and following, and patient-levels.usda with all as variants
    /// (LOD).
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=i64::from(LEVELS_MAX)))]
    levels: u32,
    /// Write what was made, with times and memory of each stage, as JSON, to standard output if it
    /// is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Options of `anatomy preview`.
#[derive(Args, Debug)]
pub(crate) struct PreviewArgs {
    /// The patient's folder, or a .glb, .usda or .usdz of another program.
    #[arg(value_name = "DIR|FILE")]
    patient: PathBuf,
    /// The file, .gif for an animation or .png for images side by side; parent folders are made.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// The tissue groups, with commas between them.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    groups: Vec<String>,
    /// Side of an image, pixels, 16 to 2048.
    #[arg(long, value_name = "PX", default_value_t = 320, value_parser = clap::value_parser!(u32).range(16..=2048))]
    width: u32,
    /// Frames of a turn, 1 to 120.
    #[arg(long, value_name = "N", default_value_t = 36, value_parser = clap::value_parser!(u32).range(1..=120))]
    frames: u32,
}

/// How surfaces are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Surface {
    /// Surface nets of all groups at once.
    Nets,
    /// Marching cubes of each group alone.
    MarchingCubes,
}

fn error_mm(text: &str) -> Result<f64, String> {
    between(text, 0.01, 10.0)
}

fn island_mm3(text: &str) -> Result<f64, String> {
    between(text, 0.0, 1e5)
}

fn side_mm(text: &str) -> Result<f64, String> {
    between(text, 0.5, 50.0)
}

pub(crate) fn anatomy(verb: &AnatomyVerb) -> Done {
    match verb {
        AnatomyVerb::Phantom(args) => phantom(args),
        AnatomyVerb::Build(args) => build(args),
        AnatomyVerb::Preview(args) => draw(args),
        AnatomyVerb::Segment(args) => segment::segment(args),
        AnatomyVerb::TrainSegmenter(args) => segment::train(args),
    }
}

fn draw(args: &PreviewArgs) -> Done {
    outputs::check(&[("--out", Some(args.out.as_path()))], &[])?;
    let preview = Preview {
        patient: args.patient.clone(),
        groups: args.groups.clone(),
        out: args.out.clone(),
        width: args.width,
        frames: args.frames,
    };
    let bar = console::progress(u64::from(args.frames), "frames");
    preview::draw(&preview, &mut |done| bar.set_position(u64::from(done)))?;
    bar.finish_and_clear();
    console::result(&format!("wrote {}", args.out.display()));
    Ok(true)
}

fn phantom(args: &PhantomArgs) -> Done {
    outputs::check(&[("--json", args.json.as_deref())], &[])?;
    let bar = console::progress(0, "slices");
    let made = anatomy::phantom(args.seed, args.size.0, &args.out, |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    let out = args.out.display();
    console::result(&format!(
        "seed {}: {} parts in {out}",
        made.seed,
        made.parts.len()
    ));
    if let Some(path) = &args.json {
        write_json(path, &made)?;
    }
    Ok(true)
}

/// `trocar anatomy build`. A surface that is not closed is an error after everything has been
/// written, so that it can be looked at.
fn build(args: &BuildArgs) -> Done {
    let labels = ("the labels", Some(args.labels.as_path()));
    outputs::check(&[("--json", args.json.as_deref())], &[labels])?;
    let options = build_options(args);
    let bar = console::bar("read");
    bar.set_length(Stage::ALL.len() as u64);
    let mut watch = |stage: Stage| {
        bar.set_message(stage.name());
        bar.inc(1);
    };
    let made = anatomy::build(&args.labels, &args.groups, &args.out, &options, &mut watch)?;
    bar.finish_and_clear();
    tell(&made);
    if let Some(path) = &args.json {
        write_json(path, &made)?;
    }
    let mut groups = made.report.groups.iter();
    if let Some(open) = groups.find(|group| !group.measures.watertight) {
        let text = format!("the surface of {} is not closed", open.name);
        return Err(SessionError::output(&args.out, text));
    }
    Ok(true)
}

fn build_options(args: &BuildArgs) -> Options {
    Options {
        max_error_mm: args.max_error_mm,
        surface: match args.surface {
            Surface::Nets => Method::Nets,
            Surface::MarchingCubes => Method::MarchingCubes,
        },
        min_island_mm3: args.min_island_mm3,
        measure_stages: args.measure_stages,
        tetrahedra_mm: args.tetrahedra,
        textures_px: args.textures,
        levels: args.levels,
        ..Options::default()
    }
}

/// A row a group: volume, triangles, and distances from the voxels, in voxels.
fn tell(made: &anatomy::Built) {
    let report = &made.report;
    console::result("group         volume ml  triangles  Hausdorff  mean  Dice");
    for group in &report.groups {
        let found = &group.measures;
        console::result(&format!(
            "{:<12} {:>10.1} {:>10} {:>10.2} {:>5.2} {:.3}",
            group.name,
            found.mesh_mm3 * 1e-3,
            group.triangles,
            found.hausdorff_voxels,
            found.mean_voxels,
            found.dice
        ));
    }
    let seconds: f64 = made.stages.iter().map(|stage| stage.seconds).sum();
    for without in &report.tetrahedra {
        if let Some(reason) = &without.none_since {
            console::result(&format!("no tetrahedra of {}: {reason}", without.group));
        }
    }
    let repaired = &report.repaired;
    console::result(&format!(
        "{} of {} triangles left; {} islands and {} holes repaired; {seconds:.1} s; distances in voxels",
        report.triangles, report.triangles_fine, repaired.islands, repaired.holes
    ));
}
