//! The 348 bytes at the beginning of a volume.
//!
//! Fields by their offsets in `nifti1.h`: `dim` 40, `datatype` 70, `bitpix` 72, `pixdim` 76,
//! `vox_offset` 108, `scl_slope` 112, `scl_inter` 116, `xyzt_units` 123, `qform_code` 252,
//! `sform_code` 254, `quatern_b` 256, `qoffset_x` 268, `srow_x` 280, `magic` 344. No field is
//! believed: sides, voxel sizes, places and offsets have bounds, so that what is allocated after it
//! is bounded too.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::{NiftiError, SIDE_MAX, VOXELS_MAX};
use crate::grid::Grid;
use crate::number::{count_i16, single};

/// Bytes of a header.
pub(super) const HEADER_LEN: usize = 348;

/// How a voxel is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DataType {
    /// Unsigned, 8 bits.
    U8,
    /// Signed, 8 bits.
    I8,
    /// Unsigned, 16 bits.
    U16,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 32 bits.
    U32,
    /// Signed, 32 bits.
    I32,
    /// Floating point, 32 bits.
    F32,
    /// Floating point, 64 bits.
    F64,
}

/// Types with their codes in the standard and their bytes.
///
/// The order is the standard's. Types that are not here are refused.
const TYPES: [(DataType, i16, usize); 8] = [
    (DataType::U8, 2, 1),
    (DataType::I16, 4, 2),
    (DataType::I32, 8, 4),
    (DataType::F32, 16, 4),
    (DataType::F64, 64, 8),
    (DataType::I8, 256, 1),
    (DataType::U16, 512, 2),
    (DataType::U32, 768, 4),
];

impl DataType {
    /// Its code in the standard.
    #[must_use]
    pub fn code(self) -> i16 {
        let found = TYPES.iter().find(|(kind, ..)| *kind == self);
        found.map_or(0, |(_, code, _)| *code)
    }

    /// Bytes of a voxel.
    #[must_use]
    pub fn size(self) -> usize {
        let found = TYPES.iter().find(|(kind, ..)| *kind == self);
        found.map_or(0, |(.., size)| *size)
    }
}

/// What a header says, checked.
#[derive(Clone, Debug)]
pub struct Header {
    /// The lattice and its place, mm, RAS.
    pub grid: Grid,
    /// How voxels are stored.
    pub data_type: DataType,
    /// Whether the file is big-endian.
    pub big_endian: bool,
    /// The first voxel's offset from the beginning of the (unzipped) file, bytes; 348 to 2^24.
    pub offset: usize,
    /// A voxel's value is `slope` times what is stored, plus `intercept`. A slope of 0 or NaN in
    /// the file means that values are as stored: 1 and 0 here.
    pub slope: f64,
    /// See `slope`.
    pub intercept: f64,
}

/// The bytes of a header with the file's name and byte order.
struct Fields<'a> {
    /// For messages only.
    path: &'a str,
    bytes: &'a [u8; HEADER_LEN],
    /// Told by `sizeof_hdr`, which is 348 in one order only.
    big_endian: bool,
}

impl Fields<'_> {
    /// The four bytes at an offset.
    fn four(&self, at: usize) -> [u8; 4] {
        let b = &self.bytes[at..at + 4];
        [b[0], b[1], b[2], b[3]]
    }

    /// The 16-bit number with a sign at an offset.
    fn short(&self, at: usize) -> i16 {
        let b = [self.bytes[at], self.bytes[at + 1]];
        if self.big_endian {
            i16::from_be_bytes(b)
        } else {
            i16::from_le_bytes(b)
        }
    }

    /// The single-precision number at an offset; may be NaN.
    fn float(&self, at: usize) -> f64 {
        let b = self.four(at);
        f64::from(if self.big_endian {
            f32::from_be_bytes(b)
        } else {
            f32::from_le_bytes(b)
        })
    }

    /// The error that a field is not allowed.
    fn refuse(
        &self,
        field: &'static str,
        found: impl ToString,
        allowed: &'static str,
    ) -> NiftiError {
        NiftiError::Header {
            path: self.path.to_owned(),
            field,
            found: found.to_string(),
            allowed,
        }
    }

    /// Voxels along the axes.
    ///
    /// `dim[0]` counts dimensions; those beyond the third must be 1 long or less, so series over
    /// time are refused.
    fn dims(&self) -> Result<[usize; 3], NiftiError> {
        let rank = self.short(40);
        if !(3..=7).contains(&rank) {
            return Err(self.refuse("dim[0]", rank, "3, or up to 7 with further dimensions of 1"));
        }
        let side = |axis: usize| {
            let side = self.short(40 + 2 * axis);
            let found = usize::try_from(side).ok();
            found
                .filter(|side| (1..=SIDE_MAX).contains(side))
                .ok_or_else(|| self.refuse("dim[1..3]", side, "1 to 4096"))
        };
        let dims = [side(1)?, side(2)?, side(3)?];
        for axis in 4..=usize::try_from(rank).unwrap_or(3) {
            let side = self.short(40 + 2 * axis);
            if side > 1 {
                return Err(self.refuse("dim[4..]", side, "1: a volume has three dimensions"));
            }
        }
        if dims.iter().product::<usize>() > VOXELS_MAX {
            let found = format!("{} x {} x {}", dims[0], dims[1], dims[2]);
            return Err(self.refuse("dim[1..3]", found, "at most 2^30 voxels in all"));
        }
        Ok(dims)
    }

    /// `bitpix` says the same again and must agree.
    fn data_type(&self) -> Result<DataType, NiftiError> {
        let code = self.short(70);
        let found = TYPES.iter().find(|(_, known, _)| *known == code);
        let allowed =
            "2, 4, 8, 16, 64, 256, 512 or 768: integers of 8 to 32 bits, real numbers of 32 or 64";
        let (kind, _, size) = found.ok_or_else(|| self.refuse("datatype", code, allowed))?;
        let bits = self.short(72);
        if usize::try_from(bits).ok() != Some(8 * size) {
            return Err(self.refuse("bitpix", bits, "the bits of datatype"));
        }
        Ok(*kind)
    }

    /// Millimetres of the unit of length.
    ///
    /// The low three bits of `xyzt_units`; 0 (unknown) is taken for mm, as most writers mean it.
    fn unit_mm(&self) -> Result<f64, NiftiError> {
        match self.bytes[123] & 7 {
            0 | 2 => Ok(1.0),
            1 => Ok(1000.0),
            3 => Ok(0.001),
            other => Err(self.refuse(
                "xyzt_units",
                other,
                "metres (1), millimetres (2) or micrometres (3)",
            )),
        }
    }

    /// Steps and origin by the sform, else by the qform.
    ///
    /// The sform is the affine itself. The qform is a unit quaternion `(a, b, c, d)` of which the
    /// file has the last three, `a = sqrt(1 - b^2 - c^2 - d^2)`, times the diagonal of voxel sizes,
    /// the third with the sign of `pixdim[0]`.
    fn place(&self) -> Result<(Matrix3<f64>, Vector3<f64>), NiftiError> {
        if self.short(254) > 0 {
            let row =
                |row: usize| [0, 1, 2, 3].map(|column| self.float(280 + 16 * row + 4 * column));
            let rows = [row(0), row(1), row(2)];
            let steps = Matrix3::from_fn(|i, j| rows[i][j]);
            return Ok((steps, Vector3::from_fn(|i, _| rows[i][3])));
        }
        if self.short(252) <= 0 {
            let allowed = "above 0 in one of them: nothing else says which side is left";
            return Err(self.refuse("qform_code and sform_code", 0, allowed));
        }
        let [b, c, d] = [256, 260, 264].map(|at| self.float(at));
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(a, b, c, d));
        let handed = if self.float(76) < 0.0 { -1.0 } else { 1.0 };
        let scale = [self.float(80), self.float(84), handed * self.float(88)];
        let steps = rotation.to_rotation_matrix().into_inner()
            * Matrix3::from_diagonal(&Vector3::from(scale));
        Ok((
            steps,
            Vector3::new(self.float(268), self.float(272), self.float(276)),
        ))
    }

    /// Steps are refused where they span less than a hundredth of the volume of a box with their
    /// lengths. NaN fails the comparisons and is refused with them.
    fn grid(&self) -> Result<Grid, NiftiError> {
        let dims = self.dims()?;
        let unit = self.unit_mm()?;
        let (steps, origin) = self.place()?;
        let grid = Grid {
            dims,
            steps: steps * unit,
            origin: origin * unit,
        };
        let spacing = grid.spacing();
        let finite = grid
            .steps
            .iter()
            .chain(grid.origin.iter())
            .all(|x| x.abs() < 1e6);
        if !finite || !spacing.iter().all(|s| (0.01..=100.0).contains(s)) {
            let found = format!("{spacing:?} mm");
            return Err(self.refuse("voxel size", found, "0.01 to 100 mm"));
        }
        // Columns that are nearly parallel make a volume without content.
        if grid.voxel_mm3() < 1e-2 * spacing.iter().product::<f64>() {
            return Err(self.refuse(
                "orientation",
                format!("{:?}", grid.steps),
                "three directions",
            ));
        }
        Ok(grid)
    }

    /// 352 is usual: the header and 4 bytes that say whether extensions follow. 348 is allowed too.
    fn offset(&self) -> Result<usize, NiftiError> {
        let offset = self.float(108);
        let allowed = "a whole number from 348 to 2^24";
        if !(348.0..=16_777_216.0).contains(&offset) || offset.fract() > 0.0 {
            return Err(self.refuse("vox_offset", offset, allowed));
        }
        Ok(crate::number::floor_to(offset, 1 << 24))
    }

    /// See [`Header::slope`].
    fn scale(&self) -> Result<(f64, f64), NiftiError> {
        let (slope, intercept) = (self.float(112), self.float(116));
        if slope.abs() <= 0.0 || slope.is_nan() {
            return Ok((1.0, 0.0));
        }
        if !slope.is_finite() || !intercept.is_finite() {
            return Err(self.refuse(
                "scl_slope and scl_inter",
                format!("{slope}, {intercept}"),
                "finite",
            ));
        }
        Ok((slope, intercept))
    }
}

impl Header {
    /// What `bytes` say; `path` is for messages.
    ///
    /// # Errors
    /// [`NiftiError::Header`] for the first field that is not allowed.
    pub(super) fn parse(path: &str, bytes: &[u8; HEADER_LEN]) -> Result<Self, NiftiError> {
        let size = &bytes[0..4];
        let big_endian = size == 348_i32.to_be_bytes();
        let fields = Fields {
            path,
            bytes,
            big_endian,
        };
        if !big_endian && size != 348_i32.to_le_bytes() {
            let found = i32::from_le_bytes(fields.four(0));
            let allowed = "348: NIfTI-1 (540 is NIfTI-2)";
            return Err(fields.refuse("sizeof_hdr", found, allowed));
        }
        if &bytes[344..348] != b"n+1\0" {
            let found = String::from_utf8_lossy(&bytes[344..348])
                .escape_debug()
                .to_string();
            return Err(fields.refuse("magic", found, "n+1: header and voxels in one file"));
        }
        let (slope, intercept) = fields.scale()?;
        Ok(Self {
            grid: fields.grid()?,
            data_type: fields.data_type()?,
            big_endian,
            offset: fields.offset()?,
            slope,
            intercept,
        })
    }

    /// The header of a volume on `grid`, little-endian, its voxels 352 bytes in. No side of `grid`
    /// may be longer than [`SIDE_MAX`].
    ///
    /// Both forms are written. A sheared lattice fits the sform alone: its qform is the rotation
    /// nearest to the axes, which readers that prefer the sform never see.
    pub(super) fn bytes(grid: &Grid, data_type: DataType) -> [u8; HEADER_LEN] {
        let mut bytes = [0; HEADER_LEN];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(0, &348_i32.to_le_bytes());
        let side = |axis: usize| count_i16(grid.dims[axis]);
        for (axis, side) in [3, side(0), side(1), side(2), 1, 1, 1, 1]
            .into_iter()
            .enumerate()
        {
            put(40 + 2 * axis, &side.to_le_bytes());
        }
        put(70, &data_type.code().to_le_bytes());
        put(72, &count_i16(8 * data_type.size()).to_le_bytes());
        let float = |value: f64| single(value).to_le_bytes();
        put(108, &float(352.0));
        put(112, &float(1.0));
        // Millimetres.
        put(123, &[2]);
        put(344, b"n+1\0");
        let spacing = grid.spacing();
        let handed = if grid.is_mirrored() { -1.0 } else { 1.0 };
        put(76, &float(handed));
        for (axis, spacing) in spacing.into_iter().enumerate() {
            put(80 + 4 * axis, &float(spacing));
        }
        // Scanner coordinates, said in both forms.
        put(252, &1_i16.to_le_bytes());
        put(254, &1_i16.to_le_bytes());
        let mut axes = Matrix3::from_fn(|i, j| grid.steps[(i, j)] / spacing[j]);
        axes.column_mut(2).scale_mut(handed);
        let turned = UnitQuaternion::from_matrix(&axes);
        let sign = if turned.w < 0.0 { -1.0 } else { 1.0 };
        let quaternion = [turned.i, turned.j, turned.k].map(|x| sign * x);
        for (at, value) in [256, 260, 264].into_iter().zip(quaternion) {
            put(at, &float(value));
        }
        for axis in 0..3 {
            put(268 + 4 * axis, &float(grid.origin[axis]));
            for column in 0..3 {
                put(
                    280 + 16 * axis + 4 * column,
                    &float(grid.steps[(axis, column)]),
                );
            }
            put(280 + 16 * axis + 12, &float(grid.origin[axis]));
        }
        bytes
    }
}
