//! The SDO client of bring-up: of each node one transfer at a time, with a time limit.

use super::super::link::Bus;
use super::BringUpError;
use super::exchange::{Exchange, alone};
use super::timed::TIMEOUT_NS;
use crate::bytes::Bytes;
use crate::cia301::sdo::{Content, Expedited, Request, Response, Segment};
use crate::cia301::{AbortCode, Address, Cob};
use crate::{Frame, NodeId};

impl<B: Bus> Exchange<'_, B> {
    async fn call(
        &self,
        line: u8,
        node: NodeId,
        address: Address,
        request: Request,
    ) -> Result<Response, BringUpError> {
        let frame = |request: Request| Frame::new(Cob::SdoRequest(node).id(), request.emit());
        self.transfer_turn(line).await;
        self.send(line, frame(request)).await?;
        let pick = |frame: &Frame| {
            (frame.id == Cob::SdoResponse(node).id())
                .then(|| Response::parse(frame.data()).ok())
                .flatten()
        };
        match self.expect(line, TIMEOUT_NS, pick).await? {
            Some(Response::Abort(_, code)) => Err(BringUpError::Refused {
                node,
                address,
                code,
            }),
            Some(answer) => Ok(answer),
            None => {
                let abort = Request::Abort(address, AbortCode::TIMEOUT);
                self.send(line, frame(abort)).await?;
                Err(BringUpError::NoAnswer { node, address })
            }
        }
    }

    /// As [`read`].
    pub(super) async fn read(
        &self,
        line: u8,
        node: NodeId,
        address: Address,
    ) -> Result<Bytes, BringUpError> {
        let confused = BringUpError::Confused { node, address };
        let request = Request::Upload(address);
        match self.call(line, node, address, request).await? {
            Response::Upload(at, Content::Expedited(data)) if at == address => {
                Ok(Bytes::truncated(data.data()))
            }
            Response::Upload(at, Content::Segmented(_)) if at == address => {
                let (mut all, mut toggle) = (Bytes::truncated(&[]), false);
                loop {
                    let request = Request::UploadSegment(toggle);
                    let answer = self.call(line, node, address, request).await?;
                    let Response::UploadSegment(segment) = answer else {
                        return Err(confused);
                    };
                    if segment.toggle() != toggle || !all.extend(segment.data()) {
                        return Err(confused);
                    }
                    if segment.is_last() {
                        return Ok(all);
                    }
                    // Or a node could go on for ever.
                    if segment.data().is_empty() {
                        return Err(confused);
                    }
                    toggle = !toggle;
                }
            }
            Response::Download(_)
            | Response::DownloadSegment(_)
            | Response::Upload(..)
            | Response::UploadSegment(_)
            | Response::Abort(..) => Err(confused),
        }
    }

    /// As [`read_number`].
    pub(super) async fn read_number(
        &self,
        line: u8,
        node: NodeId,
        address: Address,
    ) -> Result<u32, BringUpError> {
        let data = self.read(line, node, address).await?;
        let mut bytes = [0; 4];
        let length = data.as_slice().len();
        if length == 0 || length > bytes.len() {
            return Err(BringUpError::Confused { node, address });
        }
        bytes[..length].copy_from_slice(data.as_slice());
        Ok(u32::from_le_bytes(bytes))
    }

    /// As [`write()`].
    pub(super) async fn write(
        &self,
        line: u8,
        node: NodeId,
        address: Address,
        data: &[u8],
    ) -> Result<(), BringUpError> {
        let confused = BringUpError::Confused { node, address };
        if let Some(short) = Expedited::new(data) {
            let request = Request::Download(address, Content::Expedited(short));
            let answer = self.call(line, node, address, request).await?;
            return if answer == Response::Download(address) {
                Ok(())
            } else {
                Err(confused)
            };
        }
        let size = u32::try_from(data.len()).ok();
        let request = Request::Download(address, Content::Segmented(size));
        self.call(line, node, address, request).await?;
        let (mut rest, mut toggle) = (data, false);
        loop {
            let segment = Segment::first_of(rest, toggle);
            let request = Request::DownloadSegment(segment);
            let answer = self.call(line, node, address, request).await?;
            if answer != Response::DownloadSegment(toggle) {
                return Err(confused);
            }
            if segment.is_last() {
                return Ok(());
            }
            rest = &rest[segment.data().len()..];
            toggle = !toggle;
        }
    }
}

/// Reads an object, in segments if need be.
///
/// # Errors
/// [`BringUpError`]: the node does not answer, refuses or answers nonsense; the bus is off or takes no frame.
pub fn read<B: Bus>(
    bus: &mut B,
    line: u8,
    node: NodeId,
    address: Address,
) -> Result<Bytes, BringUpError> {
    alone(bus, line, async |exchange| {
        exchange.read(line, node, address).await
    })
}

/// Reads a number of up to four bytes, unsigned.
///
/// # Errors
/// [`BringUpError`]: the node does not answer, refuses or answers nonsense; the bus is off or takes no frame.
pub fn read_number<B: Bus>(
    bus: &mut B,
    line: u8,
    node: NodeId,
    address: Address,
) -> Result<u32, BringUpError> {
    alone(bus, line, async |exchange| {
        exchange.read_number(line, node, address).await
    })
}

/// Writes an object, in segments if it has more than four bytes.
///
/// # Errors
/// [`BringUpError`]: the node does not answer, refuses or answers nonsense; the bus is off or takes no frame.
pub fn write<B: Bus>(
    bus: &mut B,
    line: u8,
    node: NodeId,
    address: Address,
    data: &[u8],
) -> Result<(), BringUpError> {
    alone(bus, line, async |exchange| {
        exchange.write(line, node, address, data).await
    })
}
