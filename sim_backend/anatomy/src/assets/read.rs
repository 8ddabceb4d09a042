//! A patient's meshes out of the `.glb` that [`super::glb`] made; files of other programs are
//! [`super::foreign`]'s. Whatever else is in the file's place is refused with the reason.
//!
//! It is told by `asset.extras.frame`, which must be [`FRAME`]. Ours are read strictly, with every
//! array in a view of its own, and without the rotation of the root; sizes are checked before
//! anything is copied.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use hal::Mesh;
use serde::Deserialize;

use super::foreign;
use super::gltf::{FLOAT, UNSIGNED_INT, chunks};
use super::part::{PARTS_MAX, Part, fault};
use super::{FRAME, GLB_FILE};

/// Most bytes of a file.
const BYTES_MAX: u64 = 256 << 20;

/// How names of files end that may be a patient; those of binary OpenUSD are there for the reason
/// that it is refused with.
const FILES: [&str; 5] = ["glb", "usda", "usdz", "usd", "usdc"];

/// Why there is no patient in a folder.
#[derive(Debug, thiserror::Error)]
pub enum PatientError {
    /// The file can't be read.
    #[error("{path} can't be read: {source}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The file is not a patient's.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// Who made the file.
#[derive(Deserialize)]
struct Heading {
    asset: Header,
}

#[derive(Deserialize)]
struct Document {
    #[serde(default)]
    accessors: Vec<Accessor>,
    #[serde(default, rename = "bufferViews")]
    views: Vec<View>,
    #[serde(default)]
    meshes: Vec<MeshFile>,
    #[serde(default)]
    materials: Vec<MaterialFile>,
}

#[derive(Deserialize)]
struct Header {
    #[serde(default)]
    extras: serde_json::Value,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: usize,
    component_type: u32,
    count: usize,
    #[serde(rename = "type")]
    shape: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct View {
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
}

#[derive(Deserialize)]
struct MeshFile {
    name: String,
    primitives: [Primitive; 1],
}

#[derive(Deserialize)]
struct Primitive {
    attributes: Attributes,
    indices: usize,
    material: usize,
}

#[derive(Deserialize)]
struct Attributes {
    #[serde(rename = "POSITION")]
    position: usize,
    #[serde(rename = "NORMAL")]
    normal: usize,
}

#[derive(Deserialize)]
struct MaterialFile {
    #[serde(rename = "pbrMetallicRoughness")]
    base: Base,
    #[serde(default)]
    extensions: Extensions,
    #[serde(default)]
    extras: MaterialExtras,
}

/// What only our files say.
#[derive(Default, Deserialize)]
struct MaterialExtras {
    /// The group's colour, where a texture has taken its place.
    colour: Option<[f32; 3]>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Base {
    base_color_factor: [f32; 4],
    roughness_factor: f32,
}

#[derive(Default, Deserialize)]
struct Extensions {
    #[serde(default, rename = "KHR_materials_clearcoat")]
    film: Film,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Film {
    #[serde(default)]
    clearcoat_factor: f32,
}

/// The document with the numbers it speaks of.
struct Content<'a> {
    document: Document,
    numbers: &'a [u8],
    /// Bytes that may still be taken, as many as there are: arrays that share them make no large
    /// patient of a small file.
    left: usize,
}

/// The file of a patient that is called `place`: a folder that `trocar anatomy build` wrote, or a
/// `.glb`, `.usda` or `.usdz` of any program.
#[must_use]
pub fn file_of(place: &Path) -> PathBuf {
    let end = place.extension().unwrap_or_default();
    if FILES.iter().any(|own| end.eq_ignore_ascii_case(own)) {
        place.to_owned()
    } else {
        place.join(GLB_FILE)
    }
}

/// The groups of the patient at `place` ([`file_of`]), in the file's order.
///
/// # Errors
/// [`PatientError`] with the file and what is wrong with it.
pub fn read(place: &Path) -> Result<Vec<Part>, PatientError> {
    let path = file_of(place);
    let bytes = load(&path).map_err(|source| PatientError::Unreadable {
        path: path.clone(),
        source,
    })?;
    parts(&bytes).map_err(|reason| PatientError::Malformed { path, reason })
}

/// The bound holds for files that grow while they are read too.
fn load(path: &Path) -> io::Result<Vec<u8>> {
    let found = fs::metadata(path)?;
    if !found.is_file() {
        return Err(io::Error::other("it is no file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?
        .take(BYTES_MAX + 1)
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > BYTES_MAX {
        let reason = format!("it has more than {BYTES_MAX} bytes");
        return Err(io::Error::other(reason));
    }
    Ok(bytes)
}

/// The groups in the bytes of a file, or what is wrong with them.
pub(super) fn parts(file: &[u8]) -> Result<Vec<Part>, String> {
    if foreign::is_usd(file) {
        return foreign::of_usd(file);
    }
    let [json, numbers] = chunks(file)?;
    let heading: Heading = serde_json::from_slice(json).map_err(|error| error.to_string())?;
    if heading.asset.extras["frame"].as_str() != Some(FRAME) {
        return foreign::of_glb(file);
    }
    let document: Document = serde_json::from_slice(json).map_err(|error| error.to_string())?;
    let count = document.meshes.len();
    if !(1..=PARTS_MAX).contains(&count) {
        return Err(format!("it has {count} meshes, of 1 to {PARTS_MAX}"));
    }
    let mut content = Content {
        document,
        numbers,
        left: numbers.len(),
    };
    (0..count).map(|mesh| content.part(mesh)).collect()
}

impl Content<'_> {
    /// The mesh `index` as a part, or what is wrong with it.
    fn part(&mut self, index: usize) -> Result<Part, String> {
        let MeshFile { name, primitives } = &self.document.meshes[index];
        let name = name.clone();
        let [primitive] = primitives;
        let Attributes { position, normal } = primitive.attributes;
        let (indices, material) = (primitive.indices, primitive.material);
        let surface = self.document.materials.get(material);
        let surface = surface.ok_or_else(|| format!("{name}: it has no material {material}"))?;
        let [r, g, b, _] = surface.base.base_color_factor;
        let [r, g, b] = surface.extras.colour.unwrap_or([r, g, b]);
        let film = surface.extensions.film.clearcoat_factor;
        let looks = [r, g, b, surface.base.roughness_factor, film];
        let mut of = |accessor, kind| {
            self.array(accessor, kind)
                .map_err(|e| format!("{name}: {e}"))
        };
        let mesh = Mesh {
            positions: vectors(&of(position, (FLOAT, "VEC3"))?),
            normals: vectors(&of(normal, (FLOAT, "VEC3"))?),
            indices: of(indices, (UNSIGNED_INT, "SCALAR"))?,
        };
        let wrong = fault(&mesh).or_else(|| {
            let outside = looks.iter().any(|value| !(0.0..=1.0).contains(value));
            outside.then_some("a colour, roughness or film is outside [0, 1]")
        });
        if let Some(reason) = wrong {
            return Err(format!("{name}: {reason}"));
        }
        Ok(Part {
            name,
            mesh,
            colour: [r, g, b],
            roughness: looks[3],
            wetness: film,
        })
    }

    /// The words of an accessor of the given component type and shape.
    fn array(&mut self, index: usize, kind: (u32, &str)) -> Result<Vec<u32>, String> {
        let accessor = self.document.accessors.get(index);
        let accessor = accessor.ok_or_else(|| format!("there is no accessor {index}"))?;
        if (accessor.component_type, accessor.shape.as_str()) != kind {
            return Err(format!("accessor {index} has another type"));
        }
        let wide = if kind.1 == "SCALAR" { 1 } else { 3 };
        let length = accessor.count.checked_mul(4 * wide);
        let view = self.document.views.get(accessor.buffer_view);
        let bytes = view
            .filter(|view| Some(view.byte_length) == length && view.byte_length <= self.left)
            .and_then(|view| {
                let end = view.byte_offset.checked_add(view.byte_length)?;
                self.numbers.get(view.byte_offset..end)
            })
            .ok_or_else(|| format!("accessor {index} has no place among the numbers"))?;
        self.left -= bytes.len();
        let words = bytes.as_chunks::<4>().0;
        Ok(words.iter().map(|word| u32::from_le_bytes(*word)).collect())
    }
}

/// Words as vectors of single precision; a rest of less than three is dropped.
fn vectors(words: &[u32]) -> Vec<[f32; 3]> {
    let vectors = words.as_chunks::<3>().0.iter();
    vectors.map(|v| v.map(f32::from_bits)).collect()
}
