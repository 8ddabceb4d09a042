//! How the data files are laid out in pages.
//!
//! Parquet stores a column of a row group as pages, and its page index says where each begins; a
//! reader that wants one row decodes one page. The other columns keep the library's page size.

use parquet::{
    basic::Compression,
    file::properties::{EnabledStatistics, WriterProperties},
    schema::types::ColumnPath,
};

use super::{
    DatasetSpec,
    schema::{DEPTH_PREFIX, INSTANCE_PREFIX, image_feature},
};

/// One page an image, so that a reader fetches an image without its neighbours; PNG is not
/// compressed again.
pub(super) fn data_properties(spec: &DatasetSpec) -> WriterProperties {
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_dictionary_enabled(false)
        // The limit on rows in a page is looked at after each such batch.
        .set_write_batch_size(1);
    let colour = spec
        .cameras
        .iter()
        .map(|camera| image_feature(&camera.name));
    let planes = spec.depth_cameras().flat_map(|(camera, _)| {
        [DEPTH_PREFIX, INSTANCE_PREFIX].map(|prefix| format!("{prefix}{}", camera.name))
    });
    for feature in colour.chain(planes) {
        let bytes = ColumnPath::new(vec![feature, "bytes".to_owned()]);
        properties = properties
            .set_column_compression(bytes.clone(), Compression::UNCOMPRESSED)
            .set_column_statistics_enabled(bytes.clone(), EnabledStatistics::None)
            .set_column_data_page_row_count_limit(bytes, 1);
    }
    properties.build()
}
