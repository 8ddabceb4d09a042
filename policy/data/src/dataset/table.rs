//! One parquet file that is being read: its footer, and columns taken out of it by name.

use std::{
    fs::File,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::{
    Array, ArrayRef, BinaryArray, BooleanArray, FixedSizeListArray, Float32Array, Float64Array,
    Int64Array, ListArray, RecordBatch, StringArray, StructArray,
};
use hal::files;
use parquet::{
    arrow::{
        ProjectionMask,
        arrow_reader::{
            ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader,
            ParquetRecordBatchReaderBuilder, RowSelection, RowSelector,
        },
    },
    errors::ParquetError,
    file::metadata::PageIndexPolicy,
};

use super::{
    DatasetError,
    guard::reading,
    store::{io_error, parquet_error},
};

/// A parquet file; holds the footer, not the rows.
#[derive(Debug)]
pub(super) struct Table {
    path: PathBuf,
    metadata: ArrowReaderMetadata,
}

impl Table {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        let file = files::open(path).map_err(io_error(path))?;
        let options = ArrowReaderOptions::new().with_page_index_policy(PageIndexPolicy::Optional);
        let metadata = reading(path, || {
            ArrowReaderMetadata::load(&file, options).map_err(parquet_error(path))
        })?;
        Ok(Self {
            path: path.to_owned(),
            metadata,
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn require(&self, name: &str) -> Result<(), DatasetError> {
        self.root(name).map(|_| ())
    }

    pub(super) fn integers(&self, name: &str) -> Result<Vec<i64>, DatasetError> {
        let mut values = Vec::new();
        for column in self.column(name)? {
            values.extend_from_slice(self.cast::<Int64Array>(&column, name, "int64")?.values());
        }
        Ok(values)
    }

    pub(super) fn flags(&self, name: &str) -> Result<Vec<bool>, DatasetError> {
        let mut values = Vec::new();
        for column in self.column(name)? {
            let flags = self.cast::<BooleanArray>(&column, name, "bool")?;
            values.extend(flags.values());
        }
        Ok(values)
    }

    pub(super) fn counts(&self, name: &str) -> Result<Vec<usize>, DatasetError> {
        let count = |value: i64| {
            usize::try_from(value)
                .map_err(|_| self.mismatch(name, value.to_string(), "a number from 0".to_owned()))
        };
        self.integers(name)?.into_iter().map(count).collect()
    }

    pub(super) fn reals(&self, name: &str) -> Result<Vec<f64>, DatasetError> {
        let mut values = Vec::new();
        for column in self.column(name)? {
            if let Some(narrow) = column.as_any().downcast_ref::<Float32Array>() {
                values.extend(narrow.values().iter().copied().map(f64::from));
            } else {
                let wide = self.cast::<Float64Array>(&column, name, "float32 or float64")?;
                values.extend_from_slice(wide.values());
            }
        }
        Ok(values)
    }

    pub(super) fn strings(&self, name: &str) -> Result<Vec<String>, DatasetError> {
        let mut values = Vec::new();
        for column in self.column(name)? {
            let texts = self.cast::<StringArray>(&column, name, "a string")?;
            values.extend(texts.iter().map(|text| text.unwrap_or_default().to_owned()));
        }
        Ok(values)
    }

    /// Rows of a vector column of `f32` or `f64`, each as `parts` parts of `N` numbers.
    pub(super) fn vectors<const N: usize>(
        &self,
        name: &str,
        parts: usize,
    ) -> Result<Vec<[f64; N]>, DatasetError> {
        let mut rows = Vec::new();
        for column in self.column(name)? {
            let values = self.lists(&column, name, parts * N)?;
            let values: Vec<f64> =
                if let Some(values) = values.as_any().downcast_ref::<Float32Array>() {
                    values.values().iter().copied().map(f64::from).collect()
                } else {
                    self.cast::<Float64Array>(&values, name, "a list of float32 or float64")?
                        .values()
                        .to_vec()
                };
            rows.extend(values.as_chunks::<N>().0);
        }
        Ok(rows)
    }

    /// A column of numbers or of lists of them, row after row, and how many a row has: those that
    /// every row must have.
    pub(super) fn numbers(&self, name: &str) -> Result<(usize, Vec<f64>), DatasetError> {
        let mut width = None;
        let mut rows = Vec::new();
        for column in self.column(name)? {
            let values = if is_list(&column) {
                let found = match width {
                    Some(width) => width,
                    None => self.first_width(&column, name)?,
                };
                width = Some(found);
                self.lists(&column, name, found)?
            } else {
                width = Some(1);
                column
            };
            rows.extend(self.wide(&values, name)?);
        }
        Ok((width.unwrap_or(1), rows))
    }

    /// How wide the first row of a column of lists is.
    fn first_width(&self, column: &ArrayRef, name: &str) -> Result<usize, DatasetError> {
        if let Some(lists) = column.as_any().downcast_ref::<ListArray>() {
            return Ok(lists.offsets().lengths().next().unwrap_or(0));
        }
        let lists = self.cast::<FixedSizeListArray>(column, name, "a list")?;
        Ok(usize::try_from(lists.value_length()).unwrap_or(0))
    }

    /// Numbers of any of the types that LeRobot has, as `f64`.
    fn wide(&self, values: &ArrayRef, name: &str) -> Result<Vec<f64>, DatasetError> {
        if let Some(narrow) = values.as_any().downcast_ref::<Float32Array>() {
            return Ok(narrow.values().iter().copied().map(f64::from).collect());
        }
        #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
        if let Some(whole) = values.as_any().downcast_ref::<Int64Array>() {
            return Ok(whole.values().iter().map(|&value| value as f64).collect());
        }
        let expected = "float32, float64 or int64, or lists of them";
        let wide = self.cast::<Float64Array>(values, name, expected)?;
        Ok(wide.values().to_vec())
    }

    /// The numbers of a column of lists, each of which must be `width` wide and whole.
    fn lists(&self, column: &ArrayRef, name: &str, width: usize) -> Result<ArrayRef, DatasetError> {
        let values = self.list_values(column, name, width)?;
        if values.null_count() > 0 {
            let found = "null in some rows".to_owned();
            return Err(self.mismatch(name, found, "a value in each".to_owned()));
        }
        Ok(values)
    }

    /// The numbers of a column of lists of `width`, of which some may be null.
    fn list_values(
        &self,
        column: &ArrayRef,
        name: &str,
        width: usize,
    ) -> Result<ArrayRef, DatasetError> {
        let odd = |found: usize| {
            Err(self.mismatch(name, format!("{found} numbers wide"), width.to_string()))
        };
        if let Some(lists) = column.as_any().downcast_ref::<ListArray>() {
            // Some writers leave the width out of the type; then every row has its own.
            let other = lists.offsets().lengths().find(|&length| length != width);
            if let Some(other) = other {
                return odd(other);
            }
            let offsets = lists.offsets();
            #[expect(clippy::expect_used, reason = "arrow asserts it of offsets")]
            let first = usize::try_from(offsets[0]).expect("offsets are not negative");
            Ok(lists.values().slice(first, width * lists.len()))
        } else {
            let lists = self.cast::<FixedSizeListArray>(column, name, "a list")?;
            let found = usize::try_from(lists.value_length()).unwrap_or(0);
            if found != width {
                return odd(found);
            }
            Ok(Arc::clone(lists.values()))
        }
    }

    /// The encoded image in one row of an image column; reads no more of the file than it has to.
    pub(super) fn image(&self, name: &str, row: usize) -> Result<Vec<u8>, DatasetError> {
        let column = self.cell(name, row)?;
        let images = self.cast::<StructArray>(&column, name, "a struct of bytes and path")?;
        let bytes = images.column_by_name("bytes");
        let bytes = bytes.ok_or_else(|| DatasetError::Missing {
            path: self.path.clone(),
            name: format!("{name}.bytes"),
        })?;
        let bytes = self.cast::<BinaryArray>(bytes, name, "binary")?;
        if bytes.is_null(0) {
            return Err(self.mismatch(
                name,
                format!("null in row {row}"),
                "an embedded image".to_owned(),
            ));
        }
        Ok(bytes.value(0).to_vec())
    }

    /// The vector in one row.
    pub(super) fn vector<const N: usize>(
        &self,
        name: &str,
        row: usize,
    ) -> Result<[f64; N], DatasetError> {
        let column = self.cell(name, row)?;
        let values = self.lists(&column, name, N)?;
        let values = self.cast::<Float64Array>(&values, name, "a list of float64")?;
        values.values().as_ref().try_into().map_err(|_| {
            let found = format!("{} numbers wide", values.len());
            self.mismatch(name, found, N.to_string())
        })
    }

    /// One row of a column.
    fn cell(&self, name: &str, row: usize) -> Result<ArrayRef, DatasetError> {
        let selection = RowSelection::from(vec![RowSelector::skip(row), RowSelector::select(1)]);
        let columns = reading(&self.path, || {
            let builder = self.builder(name)?.with_row_selection(selection);
            self.collect(builder.build().map_err(parquet_error(&self.path))?)
        })?;
        let column = columns.into_iter().find(|column| column.len() == 1);
        column.ok_or_else(|| self.mismatch(name, format!("without row {row}"), "one".to_owned()))
    }

    /// The columns of a damaged file may differ in their length: `name` must have as many rows as
    /// the others.
    pub(super) fn check_rows(
        &self,
        name: &str,
        found: usize,
        expected: usize,
    ) -> Result<(), DatasetError> {
        if found == expected {
            return Ok(());
        }
        Err(self.mismatch(name, format!("{found} rows long"), expected.to_string()))
    }

    pub(super) fn mismatch(&self, what: &str, found: String, expected: String) -> DatasetError {
        DatasetError::Mismatch {
            path: self.path.clone(),
            what: what.to_owned(),
            found,
            expected,
        }
    }

    fn root(&self, name: &str) -> Result<usize, DatasetError> {
        let missing = |_| DatasetError::Missing {
            path: self.path.clone(),
            name: format!("column {name}"),
        };
        self.metadata.schema().index_of(name).map_err(missing)
    }

    // A file opened anew has a position of its own, so several threads may read one table.
    fn builder(&self, name: &str) -> Result<ParquetRecordBatchReaderBuilder<File>, DatasetError> {
        let roots = ProjectionMask::roots(self.metadata.parquet_schema(), [self.root(name)?]);
        let file = files::open(&self.path).map_err(io_error(&self.path))?;
        Ok(
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone())
                .with_projection(roots),
        )
    }

    fn column(&self, name: &str) -> Result<Vec<ArrayRef>, DatasetError> {
        let columns = reading(&self.path, || {
            let builder = self.builder(name)?;
            self.collect(builder.build().map_err(parquet_error(&self.path))?)
        })?;
        match columns.iter().find(|column| column.null_count() > 0) {
            Some(_) => Err(self.mismatch(
                name,
                "null in some rows".to_owned(),
                "a value in each".to_owned(),
            )),
            None => Ok(columns),
        }
    }

    fn collect(&self, reader: ParquetRecordBatchReader) -> Result<Vec<ArrayRef>, DatasetError> {
        reader
            .map(|batch| {
                let batch: RecordBatch = batch
                    .map_err(ParquetError::from)
                    .map_err(parquet_error(&self.path))?;
                Ok(batch.column(0).clone())
            })
            .collect()
    }

    fn cast<'a, T: Array + 'static>(
        &self,
        column: &'a ArrayRef,
        name: &str,
        expected: &str,
    ) -> Result<&'a T, DatasetError> {
        let cast = column.as_any().downcast_ref::<T>();
        cast.ok_or_else(|| {
            self.mismatch(
                name,
                format!("of type {}", column.data_type()),
                expected.to_owned(),
            )
        })
    }
}

/// Whether the column has a list in each row.
fn is_list(column: &ArrayRef) -> bool {
    column.as_any().is::<ListArray>() || column.as_any().is::<FixedSizeListArray>()
}
