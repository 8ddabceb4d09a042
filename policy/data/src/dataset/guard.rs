//! The parquet reader asserts some things of a damaged file instead of refusing it; here that
//! becomes an error.

use std::{
    cell::RefCell,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
};

use parquet::errors::ParquetError;

use super::DatasetError;

thread_local! {
    /// Set only while [`reading`] runs on this thread.
    static READING: RefCell<Option<PathBuf>> = const { RefCell::new(None) };
}

/// The dataset's file that this thread is reading, in the middle of it.
///
/// For a panic hook that ends the program: such a panic becomes an error instead.
#[must_use]
pub fn file_being_read() -> Option<PathBuf> {
    // A panic within the access itself must not lead to a second one.
    READING
        .try_with(|path| path.try_borrow().ok().and_then(|path| path.clone()))
        .ok()
        .flatten()
}

/// What `read` makes of the file `path`; a panic in it is an error that names the file.
///
/// Every call into the parquet reader goes through here. Works only where panics unwind, and where
/// the panic hook does not end the program while [`file_being_read`] names a file.
pub(super) fn reading<T>(
    path: &Path,
    read: impl FnOnce() -> Result<T, DatasetError>,
) -> Result<T, DatasetError> {
    READING.set(Some(path.to_owned()));
    // Nothing outlives the panic but the error: what `read` borrows is only read.
    let outcome = catch_unwind(AssertUnwindSafe(read));
    READING.set(None);
    outcome.unwrap_or_else(|_| {
        Err(DatasetError::Parquet {
            path: path.to_owned(),
            source: ParquetError::General("its parts contradict each other".to_owned()),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::{file_being_read, reading};
    use std::path::Path;

    #[test]
    fn a_panic_while_a_file_is_read_becomes_an_error_that_names_it() {
        let path = Path::new("data.parquet");
        let inside = reading(path, || Ok(file_being_read())).unwrap();
        assert_eq!(inside.as_deref(), Some(path));
        let error = reading::<()>(path, || panic!("an assertion of the reader's")).unwrap_err();
        assert_eq!(error.to_string(), "data.parquet: not a whole parquet file");
        assert_eq!(file_being_read(), None);
    }
}
