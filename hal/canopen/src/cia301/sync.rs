//! SYNC, which synchronises process data, with or without a counter.
//!
//! CiA 301, section 7.2.5.3, figures 26 and 27; 1019h in table 62.

use crate::frame::exactly;
use crate::{CanId, Frame, Payload, WireError};

/// Greatest value of the counter and of 1019h.
pub const COUNTER_MAX: u8 = 240;

/// Bytes of a SYNC, whatever they hold.
#[derive(Clone, Copy, Debug)]
pub struct SyncView<'a>(pub &'a [u8]);

impl SyncView<'_> {
    /// The counter, none in a SYNC without.
    ///
    /// # Errors
    /// [`WireError`] for more than one byte or a counter outside 1 to 240.
    pub fn counter(&self) -> Result<Option<u8>, WireError> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let [counter] = exactly(self.0)?;
        if counter == 0 || counter > COUNTER_MAX {
            return Err(WireError::Value {
                field: "SYNC counter",
                value: counter.into(),
            });
        }
        Ok(Some(counter))
    }
}

/// A SYNC. The counter is 1 to 240.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sync {
    counter: Option<u8>,
}

impl Sync {
    /// A SYNC without a counter.
    pub const PLAIN: Self = Self { counter: None };

    /// A SYNC with `counter`, none outside 1 to 240.
    #[must_use]
    pub fn counted(counter: u8) -> Option<Self> {
        (1..=COUNTER_MAX).contains(&counter).then_some(Self {
            counter: Some(counter),
        })
    }

    /// The counter.
    #[must_use]
    pub const fn counter(self) -> Option<u8> {
        self.counter
    }

    /// What the data bytes of a SYNC mean.
    ///
    /// # Errors
    /// See [`SyncView::counter`].
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        SyncView(data).counter().map(|counter| Self { counter })
    }

    /// The frame, under `id`.
    #[must_use]
    pub fn emit(self, id: CanId) -> Frame {
        let payload = self
            .counter
            .map_or(Payload::EMPTY, |counter| Payload::truncated(&[counter]));
        Frame::new(id, payload)
    }
}
