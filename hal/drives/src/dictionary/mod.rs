//! The object dictionary of an emulated drive: every value that a client can read or write over the
//! bus.
//!
//! [`table`] lists the objects, [`trocar_canopen::index`] names those that the node itself uses,
//! [`eds`] writes them down as an electronic data sheet. What depends on the node's state (a
//! mapping that may not change now) is the node's to refuse.

pub mod eds;
pub mod object;
pub mod table;

use object::{Access, DataType, Mapping, Object, Preset};
use trocar_canopen::NodeId;
use trocar_canopen::bytes::{Bytes, TEXT_MAX};
use trocar_canopen::cia301::{AbortCode, Address};

/// A node's values, sorted by address: a look-up is a binary search.
#[derive(Clone, Debug)]
pub struct Dictionary {
    cells: Vec<Cell>,
}

/// A sub-index with its present value. `low` and `high` bound numbers; `preset` is what a reset
/// restores.
#[derive(Clone, Copy, Debug)]
struct Cell {
    address: Address,
    kind: DataType,
    access: Access,
    mapping: Mapping,
    low: i64,
    high: i64,
    preset: Value,
    value: Value,
}

/// The value of a sub-index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Value {
    Number(i64),
    Text(Bytes),
}

impl Dictionary {
    /// The dictionary with `objects` at their presets for `node`.
    #[must_use]
    pub fn new(objects: &[Object], node: NodeId) -> Self {
        let mut cells: Vec<Cell> = objects
            .iter()
            .flat_map(|object| object.entries.iter())
            .map(|entry| {
                let preset = match entry.preset {
                    Preset::Number(number) => Value::Number(number),
                    Preset::PerNode(base) => Value::Number(base + i64::from(node.raw())),
                    Preset::Text(text) => Value::Text(Bytes::truncated(text.as_bytes())),
                };
                Cell {
                    address: entry.address,
                    kind: entry.kind,
                    access: entry.access,
                    mapping: entry.mapping,
                    low: entry.low,
                    high: entry.high,
                    preset,
                    value: preset,
                }
            })
            .collect();
        cells.sort_by_key(|cell| cell.address);
        Self { cells }
    }

    /// Where the sub-index is among the cells, which are sorted. 0602 0000h if there is no such
    /// object, 0609 0011h if no such sub-index.
    fn position(&self, address: Address) -> Result<usize, AbortCode> {
        self.cells
            .binary_search_by_key(&address, |cell| cell.address)
            .map_err(|place| {
                // The neighbours tell whether at least the index exists.
                let near = [place.checked_sub(1), Some(place)];
                let known = near
                    .into_iter()
                    .flatten()
                    .filter_map(|place| self.cells.get(place))
                    .any(|cell| cell.address.index == address.index);
                if known {
                    AbortCode::NO_SUB_INDEX
                } else {
                    AbortCode::NO_OBJECT
                }
            })
    }

    /// What a client reads.
    ///
    /// # Errors
    /// The code to abort with: no such object, or one that cannot be read.
    pub fn read(&self, address: Address) -> Result<Bytes, AbortCode> {
        let cell = &self.cells[self.position(address)?];
        if cell.access == Access::WriteOnly {
            return Err(AbortCode::WRITE_ONLY);
        }
        Ok(match cell.value {
            Value::Number(number) => cell.kind.encode(number),
            Value::Text(text) => text,
        })
    }

    /// The number that a client's `data` would write to `address`; none for a text, which may hold
    /// anything.
    ///
    /// # Errors
    /// The code to abort with: no such object, a read-only one, another length, or a value out of
    /// its range.
    pub fn check(&self, address: Address, data: &[u8]) -> Result<Option<i64>, AbortCode> {
        let cell = &self.cells[self.position(address)?];
        if matches!(cell.access, Access::ReadOnly | Access::Constant) {
            return Err(AbortCode::READ_ONLY);
        }
        if cell.kind == DataType::Text {
            return if data.len() <= TEXT_MAX {
                Ok(None)
            } else {
                Err(AbortCode::TOO_LONG)
            };
        }
        let number = cell.kind.decode(data)?;
        if number > cell.high {
            return Err(AbortCode::TOO_HIGH);
        }
        if number < cell.low {
            return Err(AbortCode::TOO_LOW);
        }
        Ok(Some(number))
    }

    /// Writes what [`Self::check`] finds in order.
    ///
    /// # Errors
    /// See [`Self::check`].
    pub fn write(&mut self, address: Address, data: &[u8]) -> Result<(), AbortCode> {
        let value = match self.check(address, data)? {
            Some(number) => Value::Number(number),
            None => Value::Text(Bytes::truncated(data)),
        };
        let place = self.position(address)?;
        self.cells[place].value = value;
        Ok(())
    }

    /// The number at `address`, 0 if there is none. For the node itself: access rights do not
    /// apply.
    #[must_use]
    pub fn get(&self, address: Address) -> i64 {
        match self.position(address).map(|place| self.cells[place].value) {
            Ok(Value::Number(number)) => number,
            Ok(Value::Text(_)) | Err(_) => 0,
        }
    }

    /// The same as a `T`, which holds whatever the object's type in the table can.
    ///
    /// # Panics
    /// If it does not: then the table gives the object another type.
    #[must_use]
    #[expect(clippy::expect_used, reason = "the table bounds what an object holds")]
    pub fn get_as<T: TryFrom<i64>>(&self, address: Address) -> T {
        T::try_from(self.get(address))
            .ok()
            .expect("the object's type is the table's")
    }

    /// Sets the number at `address`, as near as its type can hold it. For the node itself.
    pub fn set(&mut self, address: Address, number: i64) {
        if let Ok(place) = self.position(address) {
            let cell = &mut self.cells[place];
            if cell.kind != DataType::Text {
                let (low, high) = cell.kind.range();
                cell.value = Value::Number(number.clamp(low, high));
            }
        }
    }

    /// Narrows what may be written to `address`, and takes `preset` for its value now and after a
    /// reset.
    pub fn restrict(&mut self, address: Address, low: i64, high: i64, preset: i64) {
        if let Ok(place) = self.position(address) {
            let cell = &mut self.cells[place];
            cell.low = low;
            cell.high = high;
            cell.preset = Value::Number(preset);
            cell.value = cell.preset;
        }
    }

    /// Length in bits of the object at `address` if process data that go `direction` may hold it.
    ///
    /// # Errors
    /// The code to abort with.
    pub fn mappable(&self, address: Address, direction: Mapping) -> Result<u8, AbortCode> {
        let dummy = DataType::dummy(address);
        if let Some(kind) = dummy.filter(|_| direction == Mapping::Receive) {
            return Ok(kind.bits());
        }
        let cell = &self.cells[self.position(address)?];
        if cell.mapping == direction {
            Ok(cell.kind.bits())
        } else {
            Err(AbortCode::NOT_MAPPABLE)
        }
    }

    /// The number at `address` in the bytes of its type, for process data.
    #[must_use]
    pub fn encode(&self, address: Address) -> Bytes {
        match self.position(address).map(|place| &self.cells[place]) {
            Ok(cell) => match cell.value {
                Value::Number(number) => cell.kind.encode(number),
                Value::Text(text) => text,
            },
            Err(_) => Bytes::truncated(&[]),
        }
    }

    /// Every value of `area` back to its preset.
    pub fn reset(&mut self, area: Area) {
        for cell in &mut self.cells {
            if area == Area::All || (0x1000..0x2000).contains(&cell.address.index) {
                cell.value = cell.preset;
            }
        }
    }

    /// Makes the present values of everything that a client can write the presets.
    pub fn store(&mut self) {
        for cell in &mut self.cells {
            if cell.access == Access::ReadWrite {
                cell.preset = cell.value;
            }
        }
    }

    /// All addresses, in order.
    pub fn addresses(&self) -> impl Iterator<Item = Address> + '_ {
        self.cells.iter().map(|cell| cell.address)
    }
}

/// What a reset concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Area {
    /// Everything.
    All,
    /// 1000h to 1FFFh.
    Communication,
}

#[cfg(test)]
mod tests;
