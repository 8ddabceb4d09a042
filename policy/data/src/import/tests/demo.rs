//! Demonstrations whose every number is known: as h5py wrote them (`policy/data/tests/hdf5`, made
//! by the lines below), and made here.
//!
//! ```python
//! def joints(steps, arms, lag=0):
//!     return np.array([[0.04 + 0.004 * (s + lag) + 0.01 * j for j in range(7 * arms)] for s in range(steps)])
//! def images(steps, height, width):
//!     s, y, x, c = np.ogrid[:steps, :height, :width, :3]
//!     return ((s * 31 + y * 7 + x * 3 + c * 11) % 256).astype(np.uint8)
//! with h5py.File("act/episode_0.hdf5", "w", libver="earliest") as file:
//!     file.attrs["sim"] = True
//!     file["observations/qpos"] = joints(4, 1).astype(np.float32)
//!     file["observations/qvel"] = 0 * joints(4, 1)
//!     file["observations/images/top"] = images(4, 6, 8)
//!     file["action"] = joints(4, 1, 1)
//! with h5py.File("robomimic.hdf5", "w", libver="earliest") as file:
//!     for demo, arms in ((0, 2), (1, 2)):
//!         group = file.create_group(f"data/demo_{demo}")
//!         group.attrs["num_samples"] = 3 + demo
//!         for name, values, filters in (
//!             ("obs/joint_pos", joints(3 + demo, arms), {"compression": "gzip", "shuffle": True}),
//!             ("obs/scope_image", images(3 + demo, 6, 8), {"compression": "lzf", "chunks": (2, 3, 8, 3)}),
//!             ("actions", joints(3 + demo, arms, 1).astype(">f4"), {"chunks": True, "fletcher32": True}),
//!         ):
//!             group.create_dataset(name, data=values, **filters)
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use hal::psm;
use hdf5_pure::{DatasetBuilder, FileBuilder};

use crate::import::{ImportOptions, Layout};

pub(super) const HEIGHT: usize = 6;
pub(super) const WIDTH: usize = 8;

/// A folder of its own for one test, removed at the end.
pub(super) struct Folder(pub(super) PathBuf);

impl Folder {
    pub(super) fn new(test: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("trocar-import-{test}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// What h5py wrote.
pub(super) fn by_h5py(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/hdf5")
        .join(name)
}

pub(super) fn act(source: &Path, out: &Path) -> ImportOptions {
    ImportOptions {
        layout: Layout::Act,
        source: source.to_owned(),
        out: out.to_owned(),
        fps: 25,
        task: "Lift the needle".to_owned(),
        joints: None,
        action_joints: None,
        action_pose: None,
        images: Vec::new(),
        chain: psm::DH,
        video: None,
        size: None,
    }
}

pub(super) fn robomimic(source: &Path, out: &Path) -> ImportOptions {
    ImportOptions {
        layout: Layout::Robomimic,
        joints: Some("obs/joint_pos".to_owned()),
        action_joints: Some("actions".to_owned()),
        images: vec!["obs/scope_image".to_owned()],
        ..act(source, out)
    }
}

fn real(count: usize) -> f64 {
    f64::from(u32::try_from(count).unwrap())
}

/// Joint `place` of all arms' in `step`.
pub(super) fn joint(step: usize, place: usize) -> f64 {
    0.04 + 0.004 * real(step) + 0.01 * real(place)
}

pub(super) fn joints(steps: usize, arms: usize, lag: usize) -> Vec<f64> {
    let step = |step| (0..7 * arms).map(move |place| joint(step + lag, place));
    (0..steps).flat_map(step).collect()
}

/// The RGB image of `step`, row after row.
pub(super) fn image(step: usize) -> Vec<u8> {
    let mut rgb = Vec::new();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            for c in 0..3 {
                rgb.push(u8::try_from((step * 31 + y * 7 + x * 3 + c * 11) % 256).unwrap());
            }
        }
    }
    rgb
}

pub(super) fn images(steps: usize) -> Vec<u8> {
    (0..steps).flat_map(image).collect()
}

/// One episode in ACT's layout, whose parts a test may change.
pub(super) struct Episode {
    pub(super) qpos: (Vec<f64>, Vec<u64>),
    pub(super) action: (Vec<f64>, Vec<u64>),
    pub(super) camera: (Vec<u8>, Vec<u64>),
    /// How datasets are stored.
    pub(super) stored: fn(&mut DatasetBuilder, &[u64]),
}

impl Episode {
    pub(super) fn new(steps: usize, arms: usize) -> Self {
        let table = |lag| {
            let shape = vec![steps as u64, 7 * arms as u64];
            (joints(steps, arms, lag), shape)
        };
        let camera = vec![steps as u64, HEIGHT as u64, WIDTH as u64, 3];
        Self {
            qpos: table(0),
            action: table(1),
            camera: (images(steps), camera),
            stored: |_, _| {},
        }
    }

    pub(super) fn write(&self, path: &Path) {
        let mut file = FileBuilder::new();
        let mut observations = file.create_group("observations");
        let put = |dataset: &mut DatasetBuilder, shape: &[u64]| {
            dataset.with_shape(shape);
            (self.stored)(dataset, shape);
        };
        let (values, shape) = &self.qpos;
        put(
            observations.create_dataset("qpos").with_f64_data(values),
            shape,
        );
        let mut cameras = observations.create_group("images");
        let (bytes, shape) = &self.camera;
        put(cameras.create_dataset("top").with_u8_data(bytes), shape);
        observations.add_group(cameras.finish());
        file.add_group(observations.finish());
        let (values, shape) = &self.action;
        put(file.create_dataset("action").with_f64_data(values), shape);
        fs::write(path, file.finish().unwrap()).unwrap();
    }
}
