//! A configuration text, looked up by key.
//!
//! In the plain TOML tables: the controller's own parser is one of the things that are checked
//! here.

use nalgebra::Vector3;
use toml::{Table, Value};

use super::VerifyError;

/// A parsed configuration text and its name.
pub(super) struct Document {
    file: &'static str,
    table: Table,
}

impl Document {
    /// Takes any TOML; what is missing shows only where a key is looked up.
    ///
    /// # Errors
    /// [`VerifyError::Malformed`] with the parser's message.
    pub(super) fn parse(file: &'static str, text: &str) -> Result<Self, VerifyError> {
        let table = text
            .parse()
            .map_err(|error: toml::de::Error| VerifyError::Malformed {
                file,
                reason: error.message().to_owned(),
            })?;
        Ok(Self { file, table })
    }

    /// The text as one entry, whose keys are dotted paths.
    pub(super) fn root(&self) -> Entry<'_> {
        Entry {
            file: self.file,
            place: String::new(),
            table: &self.table,
        }
    }
}

/// A table in a text.
pub(super) struct Entry<'a> {
    file: &'static str,
    /// What stands before its keys in messages, such as `arm.0.`; empty of the root.
    place: String,
    table: &'a Table,
}

impl<'a> Entry<'a> {
    /// The error for a `key` that is missing or says something else than it should.
    pub(super) fn missing(&self, key: &str) -> VerifyError {
        VerifyError::Malformed {
            file: self.file,
            reason: format!("`{}{key}` is missing or of another type", self.place),
        }
    }

    /// What is at a dotted path, whatever its type.
    fn value(&self, key: &str) -> Option<&'a Value> {
        let mut parts = key.split('.');
        let first = self.table.get(parts.next()?)?;
        parts.try_fold(first, |here, part| here.get(part))
    }

    /// Whether there is anything under `key`.
    pub(super) fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    /// A finite number; an integer counts. Keys that nobody looks up are passed over: to refuse
    /// them is the controller's affair.
    ///
    /// # Errors
    /// [`VerifyError::Malformed`] if it is missing, no number or not finite.
    pub(super) fn number(&self, key: &str) -> Result<f64, VerifyError> {
        let value = self.value(key).and_then(number);
        value.ok_or_else(|| self.missing(key))
    }

    /// Three numbers in an array, of which integers count as well.
    ///
    /// # Errors
    /// [`VerifyError::Malformed`] for another length, another type or a number that is not finite.
    pub(super) fn vector(&self, key: &str) -> Result<Vector3<f64>, VerifyError> {
        let value = self.value(key).and_then(vector);
        value.ok_or_else(|| self.missing(key))
    }

    pub(super) fn text(&self, key: &str) -> Result<&'a str, VerifyError> {
        let value = self.value(key).and_then(Value::as_str);
        value.ok_or_else(|| self.missing(key))
    }

    /// The tables of an array of tables; none if there is no such array.
    pub(super) fn list(&self, key: &str) -> Result<Vec<Entry<'a>>, VerifyError> {
        let Some(value) = self.value(key) else {
            return Ok(Vec::new());
        };
        let list = value.as_array().ok_or_else(|| self.missing(key))?;
        list.iter()
            .enumerate()
            .map(|(index, value)| match value.as_table() {
                Some(table) => Ok(Entry {
                    file: self.file,
                    place: format!("{key}.{index}."),
                    table,
                }),
                None => Err(self.missing(key)),
            })
            .collect()
    }
}

/// A finite number; TOML's integers count.
#[expect(clippy::cast_precision_loss, reason = "limits are small numbers")]
fn number(value: &Value) -> Option<f64> {
    value
        .as_float()
        .or_else(|| value.as_integer().map(|whole| whole as f64))
        .filter(|number| number.is_finite())
}

fn vector(value: &Value) -> Option<Vector3<f64>> {
    let [x, y, z] = value.as_array()?.as_slice() else {
        return None;
    };
    Some(Vector3::new(number(x)?, number(y)?, number(z)?))
}
