//! What every binary glTF 2.0 file is made of: numbers with their views and accessors, and the
//! container.
//!
//! Little-endian throughout; the file is a header of 12 bytes and two chunks, JSON and numbers,
//! each of a multiple of 4 bytes (glTF 2.0, section 4). Each array has a view of its own, without
//! stride.

use serde_json::{Value, json};

use crate::number::index;

/// Component types of accessors.
pub(super) const FLOAT: u32 = 5126;
pub(super) const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

const MAGIC: &[u8; 4] = b"glTF";
/// Kinds of chunks.
const JSON: &[u8; 4] = b"JSON";
const BINARY: &[u8; 4] = b"BIN\0";

/// The numbers of a binary glTF file, with a view and an accessor for each array.
#[derive(Debug, Default)]
pub struct Numbers {
    /// The buffer; every array begins at a multiple of 4.
    bytes: Vec<u8>,
    /// Ranges of `bytes`.
    views: Vec<Value>,
    /// What the numbers in a view are.
    accessors: Vec<Value>,
}

impl Numbers {
    /// Adds a vertex attribute of `N` floats; gives its accessor's index. `bounds` adds the extent,
    /// which glTF demands of positions.
    pub fn vectors<const N: usize>(&mut self, vectors: &[[f32; N]], bounds: bool) -> usize {
        let numbers = vectors.iter().flatten().map(|x| x.to_le_bytes());
        let mut accessor =
            json!({"componentType": FLOAT, "count": vectors.len(), "type": format!("VEC{N}")});
        if bounds {
            let of = |choose: fn(f32, f32) -> f32| {
                let all = vectors.iter().copied();
                let chosen =
                    all.reduce(|best, v| core::array::from_fn(|axis| choose(best[axis], v[axis])));
                json!(chosen.unwrap_or([0.0; N]).as_slice())
            };
            accessor["min"] = of(f32::min);
            accessor["max"] = of(f32::max);
        }
        self.add(numbers, ARRAY_BUFFER, accessor)
    }

    /// Adds the indices of vertices; gives their accessor's index.
    pub fn indices(&mut self, indices: &[u32]) -> usize {
        let numbers = indices.iter().map(|i| i.to_le_bytes());
        let accessor =
            json!({"componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR"});
        self.add(numbers, ELEMENT_ARRAY_BUFFER, accessor)
    }

    /// Adds the bytes of an image file; gives their view's index.
    pub fn image(&mut self, file: &[u8]) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend(file);
        self.views
            .push(json!({"buffer": 0, "byteOffset": offset, "byteLength": file.len()}));
        // What follows are numbers of four bytes.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    /// Appends an array with its view and accessor; the accessor's index.
    fn add(
        &mut self,
        numbers: impl Iterator<Item = [u8; 4]>,
        target: u32,
        mut accessor: Value,
    ) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend(numbers.flatten());
        let length = self.bytes.len() - offset;
        self.views.push(
            json!({"buffer": 0, "byteOffset": offset, "byteLength": length, "target": target}),
        );
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// The bytes of a `.glb` that has these numbers; `document` is its JSON without accessors,
    /// views and buffers.
    ///
    /// # Panics
    /// If the file would exceed 4 GiB.
    #[must_use]
    pub fn file(mut self, mut document: Value) -> Vec<u8> {
        document["accessors"] = json!(self.accessors);
        document["bufferViews"] = json!(self.views);
        document["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let length = 12 + 8 + text.len() + 8 + self.bytes.len();
        let mut file = Vec::with_capacity(length);
        let word = |file: &mut Vec<u8>, value: usize| file.extend(index(value).to_le_bytes());
        file.extend(MAGIC);
        word(&mut file, 2);
        word(&mut file, length);
        for (kind, chunk) in [(JSON, &text), (BINARY, &self.bytes)] {
            word(&mut file, chunk.len());
            file.extend(kind);
            file.extend(chunk);
        }
        file
    }
}

/// Takes the next `count` bytes.
///
/// # Errors
/// If there are not as many.
pub(super) fn take<'a>(from: &mut &'a [u8], count: usize) -> Result<&'a [u8], &'static str> {
    let (taken, rest) = from
        .split_at_checked(count)
        .ok_or("it ends in the middle")?;
    *from = rest;
    Ok(taken)
}

/// Takes the next word.
fn word(from: &mut &[u8]) -> Result<usize, &'static str> {
    let bytes = take(from, 4)?.first_chunk().copied().unwrap_or_default();
    Ok(u32::from_le_bytes(bytes) as usize)
}

/// The JSON and the numbers of a `.glb`; what of it is wrong if it is none.
pub(super) fn chunks(file: &[u8]) -> Result<[&[u8]; 2], &'static str> {
    let mut rest = file;
    if take(&mut rest, 4)? != MAGIC || word(&mut rest)? != 2 {
        return Err("it is no binary glTF 2.0 and no OpenUSD text (#usda 1.0)");
    }
    if word(&mut rest)? != file.len() {
        return Err("it has not the length that it says");
    }
    let mut chunk = |kind: &[u8; 4]| {
        let length = word(&mut rest)?;
        if take(&mut rest, 4)? != kind {
            return Err("its chunks are not JSON and numbers");
        }
        take(&mut rest, length)
    };
    Ok([chunk(JSON)?, chunk(BINARY)?])
}
