//! NIfTI-1 volumes in one file (`.nii`, `.nii.gz`), a slice at a time: what a file claims is
//! checked before it costs memory.
//!
//! A reader of our own, since a volume of 150 million voxels need not be held in the file's type,
//! and a damaged or hostile header must not decide how much is allocated. Format:
//! <https://nifti.nimh.nih.gov/nifti-1/>.
//!
//! `header` parses and checks 348 bytes, `read` streams slices through a callback that decides what
//! to keep, `write` does the reverse. Voxels run with the first axis fastest, as in the file. The
//! place is the sform's, or the qform's, with lengths turned to mm; both are maps to RAS by the
//! standard, so nothing is flipped. Extensions between header and voxels are passed over; NIfTI-2,
//! pairs of `.hdr` and `.img`, complex and RGB voxels are refused.

mod header;
mod read;
mod write;

#[cfg(test)]
mod tests;

use std::io;

pub use header::{DataType, Header};
pub use read::{LabelVolume, read_header, read_labels, read_slices};
pub use write::{Writer, write_labels};

/// Most voxels of a volume: 1024 slices of 1024 x 1024.
pub const VOXELS_MAX: usize = 1 << 30;

/// Most voxels along an axis.
pub const SIDE_MAX: usize = 4096;

/// What is wrong with a volume.
#[derive(Debug, thiserror::Error)]
pub enum NiftiError {
    /// The file can't be read.
    #[error("{path}: cannot be read")]
    Unreadable {
        /// The file.
        path: String,
        /// The system's reason; of a damaged gzip stream, the decoder's.
        #[source]
        source: io::Error,
    },
    /// The file can't be written.
    #[error("{path}: cannot be written")]
    Unwritable {
        /// The file.
        path: String,
        /// The system's reason.
        #[source]
        source: io::Error,
    },
    /// The file ends before its voxels do.
    #[error(
        "{path}: the file ends within slice {slice} of {slices}: it is cut off or its header is wrong"
    )]
    Cut {
        /// The file.
        path: String,
        /// The slice, from 1.
        slice: usize,
        /// Slices that the header claims.
        slices: usize,
    },
    /// A field of the header has a value that is not allowed.
    #[error("{path}: {field} is {found}, allowed is {allowed}")]
    Header {
        /// The file.
        path: String,
        /// The field's name in the NIfTI-1 standard.
        field: &'static str,
        /// Its value.
        found: String,
        /// What may stand there.
        allowed: &'static str,
    },
    /// A voxel is no label.
    #[error("{path}: voxel ({}, {}, {}) is {value}; a label is a whole number in [0, 65535]", .voxel[0], .voxel[1], .voxel[2])]
    NoLabel {
        /// The file.
        path: String,
        /// Its indices, from 0.
        voxel: [usize; 3],
        /// Its value.
        value: f64,
    },
    /// Labels that the table of groups does not have.
    #[error("{path}: {table} has no {labels}; add each to a group or to [left_out]")]
    Unknown {
        /// The file.
        path: String,
        /// The table of labels.
        table: String,
        /// The labels with how many voxels they have.
        labels: String,
    },
}
