//! What chunks went through when they were stored, and how LZF, which the library lacks, is undone.
//!
//! A chunk in HDF5 goes through a pipeline of filters, each with a registered number; reading
//! undoes them in reverse order.

use hdf5_reader::FilterRegistry;
use hdf5_reader::error::Error;
use hdf5_reader::filters::{FILTER_DEFLATE, FILTER_FLETCHER32, FILTER_SHUFFLE, FilterFn};
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::object_header::ObjectHeader;

use super::lzf;

/// Bytes that a chunk may have, unpacked.
pub(super) const CHUNK_MAX: usize = 256 << 20;

/// What h5py's LZF is registered as. In the HDF Group's list of registered filters.
const FILTER_LZF: u16 = 32_000;

/// The library's filters and LZF.
pub(super) fn registry() -> FilterRegistry {
    let mut registry = FilterRegistry::new();
    let lzf: FilterFn = Box::new(|filter, packed, _| {
        // h5py's own version and LZF's stand before the size of a chunk.
        let size = filter.client_data.get(2).map(|&size| size as usize);
        lzf::decompress(packed, size.unwrap_or(CHUNK_MAX).min(CHUNK_MAX))
            .ok_or_else(|| Error::DecompressionError("LZF: damaged, or too long".to_owned()))
    });
    registry.register(FILTER_LZF, lzf);
    registry
}

/// Why the dataset with `header` can't be unpacked in bounded memory. The library bounds what one
/// compression may give by the chunk's size; of a second one in front of it, it could not know.
pub(super) fn defect(header: &ObjectHeader) -> Option<String> {
    let pipelines = header.messages.iter().filter_map(|message| {
        if let HdfMessage::FilterPipeline(pipeline) = message {
            return Some(&pipeline.filters);
        }
        None
    });
    let filters: Vec<u16> = pipelines.flatten().map(|filter| filter.id).collect();
    let known = [
        FILTER_DEFLATE,
        FILTER_LZF,
        FILTER_SHUFFLE,
        FILTER_FLETCHER32,
    ];
    let compressions = [FILTER_DEFLATE, FILTER_LZF];
    let twice = filters
        .iter()
        .filter(|id| compressions.contains(id))
        .count()
        > 1;
    (twice || filters.iter().any(|id| !known.contains(id)))
        .then(|| format!("went through the filters {filters:?}"))
}
