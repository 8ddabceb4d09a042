//! Tables of numbers as text: a line of names, then a line of numbers a row.
//!
//! Not a general reader: no quoted commas, no escaped line ends, which such recordings do not have.

use std::path::Path;

use hal::files;

use super::super::ImportError;
use super::recordings::Numbers;

/// Bytes that a table may have. The text is read whole.
const SIZE_MAX: u64 = 1 << 30;

/// Reads the table at `path`; columns that hold no numbers are NaN, which is refused where one is
/// wanted.
///
/// # Errors
/// [`ImportError::Io`]; [`ImportError::Mismatch`] for a row of another length, or a table without
/// rows.
pub(super) fn read_table(path: &Path) -> Result<Numbers, ImportError> {
    let io_error = |source| ImportError::Io {
        path: path.to_owned(),
        source,
    };
    let text = files::read_text(path, "a table", SIZE_MAX).map_err(io_error)?;
    let mut lines = text.lines().enumerate();
    let header = lines.next().map(|(_, line)| line).unwrap_or_default();
    let names: Vec<String> = cells(header).map(str::to_owned).collect();
    let mut values = Vec::new();
    for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let before = values.len();
        values.extend(cells(line).map(|cell| cell.parse().unwrap_or(f64::NAN)));
        let found = values.len() - before;
        if found != names.len() {
            return Err(ImportError::Mismatch {
                place: format!("{}:{}", path.display(), index + 1),
                name: "the row".to_owned(),
                found: format!("has {found} cells"),
                expected: format!("{}, as the first line has names", names.len()),
            });
        }
    }
    let width = names.len();
    Ok(Numbers {
        names,
        width,
        values,
    })
}

/// What stands between the commas, without blanks and quotation marks around it.
fn cells(line: &str) -> impl Iterator<Item = &str> {
    line.split(',').map(|cell| cell.trim().trim_matches('"'))
}
