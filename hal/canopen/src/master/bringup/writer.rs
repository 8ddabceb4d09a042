//! Objects of one node, written and compared.

use super::super::link::Bus;
use super::BringUpError;
use super::exchange::Exchange;
use crate::NodeId;
use crate::bytes::Bytes;
use crate::cia301::{AbortCode, Address};

/// The bit of a COB-ID that is not in use.
pub(super) const INVALID: u32 = 1 << 31;

/// Where to write.
pub(super) struct Writer<'a, 'b, B> {
    pub(super) exchange: &'a Exchange<'b, B>,
    pub(super) line: u8,
    pub(super) node: NodeId,
}

impl<B: Bus> Writer<'_, '_, B> {
    pub(super) async fn read(&self, address: Address) -> Result<Bytes, BringUpError> {
        self.exchange.read(self.line, self.node, address).await
    }

    pub(super) async fn read_number(&self, address: Address) -> Result<u32, BringUpError> {
        self.exchange
            .read_number(self.line, self.node, address)
            .await
    }

    pub(super) async fn put(&self, address: Address, data: &[u8]) -> Result<(), BringUpError> {
        self.exchange
            .write(self.line, self.node, address, data)
            .await
    }

    /// Writes and compares.
    pub(super) async fn set(&self, address: Address, data: &[u8]) -> Result<(), BringUpError> {
        self.put(address, data).await?;
        let found = self.read(address).await?;
        if found.as_slice() == data {
            Ok(())
        } else {
            Err(differs(self.node, address, found.as_slice(), data))
        }
    }

    /// Writes what not every drive has.
    pub(super) async fn set_if_there(
        &self,
        address: Address,
        data: &[u8],
    ) -> Result<(), BringUpError> {
        match self.set(address, data).await {
            Err(BringUpError::Refused { code, .. }) if is_missing(code) => Ok(()),
            other => other,
        }
    }

    /// Writes what may be refused; tells whether there is such an object.
    pub(super) async fn try_put(
        &self,
        address: Address,
        data: &[u8],
    ) -> Result<bool, BringUpError> {
        match self.put(address, data).await {
            Ok(()) => Ok(true),
            Err(BringUpError::Refused { code, .. }) => Ok(!is_missing(code)),
            Err(error) => Err(error),
        }
    }

    /// Takes a PDO out of use, whatever identifier it has; tells whether there is one. `record` is
    /// its sub-index 01h.
    pub(super) async fn switch_off(&self, record: Address) -> Result<bool, BringUpError> {
        self.bits(record, INVALID, INVALID).await
    }

    /// Gives the bits `mask` of a COB-ID the value that they have in `wanted`, and no other bit
    /// another one: while it is in use those may not change. What a drive makes of them thereafter
    /// is its own; they mean nothing then. Tells whether there is such an object.
    pub(super) async fn bits(
        &self,
        address: Address,
        mask: u32,
        wanted: u32,
    ) -> Result<bool, BringUpError> {
        let found = match self.read_number(address).await {
            Ok(found) if found & mask == wanted => return Ok(true),
            Ok(found) => found,
            Err(BringUpError::Refused { code, .. }) if is_missing(code) => return Ok(false),
            Err(error) => return Err(error),
        };
        self.cob(address, mask, found & !mask | wanted).await?;
        Ok(true)
    }

    /// Writes a COB-ID; the bits `mask` of what there is then have to be as they were written.
    pub(super) async fn cob(
        &self,
        address: Address,
        mask: u32,
        written: u32,
    ) -> Result<(), BringUpError> {
        self.put(address, &written.to_le_bytes()).await?;
        let node = self.node;
        let found = self.read_number(address).await?;
        if (found ^ written) & mask == 0 {
            Ok(())
        } else {
            Err(BringUpError::CobId {
                node,
                address,
                written,
                found,
                mask,
            })
        }
    }
}

/// Whether a refusal means that the drive has no such object.
pub(super) fn is_missing(code: AbortCode) -> bool {
    code == AbortCode::NO_OBJECT || code == AbortCode::NO_SUB_INDEX
}

/// A number of up to eight bytes without a sign.
fn plain(data: &[u8]) -> i64 {
    let mut all = [0; 8];
    let length = data.len().min(all.len());
    all[..length].copy_from_slice(&data[..length]);
    i64::from_le_bytes(all)
}

/// What a node has instead of exactly `wanted`.
fn differs(node: NodeId, address: Address, found: &[u8], wanted: &[u8]) -> BringUpError {
    BringUpError::Setting {
        node,
        address,
        found: plain(found),
        least: plain(wanted),
        most: plain(wanted),
    }
}
