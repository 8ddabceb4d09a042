//! Service data: one side of the conversation between a client and a node's object dictionary.
//!
//! CiA 301, section 7.2.4.3: figures 12 to 17 (expedited and segmented transfers, abort). Block
//! transfers are not spoken here; their commands parse as an error that a server answers with 0504
//! 0001h.

mod content;

use core::fmt;

use super::AbortCode;
use crate::frame::exactly;
use crate::{Payload, WireError};

pub use content::{Content, Expedited, Segment};

/// Where a value lives in an object dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Address {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

impl Address {
    /// The value at `index` and `sub`.
    #[must_use]
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}:{:02X}", self.index, self.sub)
    }
}

/// Bytes of an SDO frame, whatever they hold.
#[derive(Clone, Copy, Debug)]
pub struct SdoView<'a>(pub &'a [u8]);

impl SdoView<'_> {
    fn bytes(&self) -> Result<[u8; 8], WireError> {
        exactly(self.0)
    }

    /// The command specifier: the first byte's upper three bits.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn specifier(&self) -> Result<u8, WireError> {
        Ok(self.bytes()?[0] >> 5)
    }

    /// The object; of no meaning in segments.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn address(&self) -> Result<Address, WireError> {
        let [_, low, high, sub, ..] = self.bytes()?;
        Ok(Address::new(u16::from_le_bytes([low, high]), sub))
    }

    /// The last four bytes as a number: a size or an abort code.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn number(&self) -> Result<u32, WireError> {
        let [_, _, _, _, number @ ..] = self.bytes()?;
        Ok(u32::from_le_bytes(number))
    }

    /// The toggle bit of a segment.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn toggle(&self) -> Result<bool, WireError> {
        Ok(self.bytes()?[0] & 0x10 != 0)
    }

    /// How an initiating frame carries its data.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn content(&self) -> Result<Content, WireError> {
        let bytes = self.bytes()?;
        let (expedited, sized) = (bytes[0] & 2 != 0, bytes[0] & 1 != 0);
        Ok(match (expedited, sized) {
            (true, sized) => {
                let unused = if sized { (bytes[0] >> 2) & 3 } else { 0 };
                let end = 8 - usize::from(unused);
                Content::Expedited(Expedited {
                    data: Payload::truncated(&bytes[4..end]),
                    sized,
                })
            }
            (false, true) => Content::Segmented(Some(self.number()?)),
            (false, false) => Content::Segmented(None),
        })
    }

    /// The data of a segment.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn segment(&self) -> Result<Segment, WireError> {
        let bytes = self.bytes()?;
        let end = 8 - usize::from((bytes[0] >> 1) & 7);
        Ok(Segment {
            toggle: self.toggle()?,
            data: Payload::truncated(&bytes[1..end]),
            last: bytes[0] & 1 != 0,
        })
    }
}

/// What a client asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Begin to write an object, or write it whole.
    Download(Address, Content),
    /// Write the next bytes.
    DownloadSegment(Segment),
    /// Read an object.
    Upload(Address),
    /// Read the next bytes; the toggle bit.
    UploadSegment(bool),
    /// Give up.
    Abort(Address, AbortCode),
}

/// What a node answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// The object is written, or its segments may come.
    Download(Address),
    /// The segment with this toggle bit came.
    DownloadSegment(bool),
    /// The object, or how long it will be.
    Upload(Address, Content),
    /// The next bytes.
    UploadSegment(Segment),
    /// Give up, and why.
    Abort(Address, AbortCode),
}

impl Request {
    /// What a client's data bytes mean.
    ///
    /// # Errors
    /// [`WireError`] for another length than eight or a command that is not spoken here.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let view = SdoView(data);
        match view.specifier()? {
            0 => Ok(Self::DownloadSegment(view.segment()?)),
            1 => Ok(Self::Download(view.address()?, view.content()?)),
            2 => Ok(Self::Upload(view.address()?)),
            3 => Ok(Self::UploadSegment(view.toggle()?)),
            4 => Ok(Self::Abort(view.address()?, AbortCode(view.number()?))),
            other => Err(unknown(other)),
        }
    }

    /// The data bytes.
    #[must_use]
    pub fn emit(self) -> Payload {
        match self {
            Self::DownloadSegment(segment) => segment.emit(0),
            Self::Download(address, content) => initiate(1, address, content),
            Self::Upload(address) => addressed(2 << 5, address, 0),
            Self::UploadSegment(toggle) => single(3 << 5 | u8::from(toggle) << 4),
            Self::Abort(address, code) => addressed(4 << 5, address, code.0),
        }
    }
}

impl Response {
    /// What a node's data bytes mean.
    ///
    /// # Errors
    /// [`WireError`] for another length than eight or a command that is not spoken here.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let view = SdoView(data);
        match view.specifier()? {
            0 => Ok(Self::UploadSegment(view.segment()?)),
            1 => Ok(Self::DownloadSegment(view.toggle()?)),
            2 => Ok(Self::Upload(view.address()?, view.content()?)),
            3 => Ok(Self::Download(view.address()?)),
            4 => Ok(Self::Abort(view.address()?, AbortCode(view.number()?))),
            other => Err(unknown(other)),
        }
    }

    /// The data bytes.
    #[must_use]
    pub fn emit(self) -> Payload {
        match self {
            Self::UploadSegment(segment) => segment.emit(0),
            Self::DownloadSegment(toggle) => single(1 << 5 | u8::from(toggle) << 4),
            Self::Upload(address, content) => initiate(2, address, content),
            Self::Download(address) => addressed(3 << 5, address, 0),
            Self::Abort(address, code) => addressed(4 << 5, address, code.0),
        }
    }
}

fn unknown(specifier: u8) -> WireError {
    WireError::Value {
        field: "SDO command specifier",
        value: specifier.into(),
    }
}

fn single(command: u8) -> Payload {
    Payload::full([command, 0, 0, 0, 0, 0, 0, 0])
}

fn addressed(command: u8, address: Address, number: u32) -> Payload {
    let [low, high] = address.index.to_le_bytes();
    let [a, b, c, d] = number.to_le_bytes();
    Payload::full([command, low, high, address.sub, a, b, c, d])
}

fn initiate(specifier: u8, address: Address, content: Content) -> Payload {
    match content {
        Content::Expedited(Expedited { data, sized }) => {
            let mut number = [0; 4];
            number[..data.as_slice().len()].copy_from_slice(data.as_slice());
            let unused = if sized { 4 - data.length() } else { 0 };
            let command = specifier << 5 | unused << 2 | 2 | u8::from(sized);
            addressed(command, address, u32::from_le_bytes(number))
        }
        Content::Segmented(size) => {
            let command = specifier << 5 | u8::from(size.is_some());
            addressed(command, address, size.unwrap_or(0))
        }
    }
}
