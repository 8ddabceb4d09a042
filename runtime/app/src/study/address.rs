//! Addresses: the first 80 bits of the SHA-256 of everything that makes a cell.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::digest::hexadecimal;

/// Hexadecimal digits of an address.
const DIGITS: usize = 20;

/// The address of a cell: the same inputs give the same, any other input another.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Address(String);

impl Address {
    /// The address of what `recipe` says.
    ///
    /// The recipe is hashed as JSON with sorted keys, so that the order of a struct's fields does
    /// not matter.
    #[must_use]
    pub fn of(recipe: &serde_json::Value) -> Self {
        let mut hash = Sha256::new();
        add(&mut hash, recipe);
        Self(hexadecimal(hash)[..DIGITS].to_owned())
    }

    /// As text: 20 hexadecimal digits.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The first digits, for lines that people read.
    #[must_use]
    pub fn short(&self) -> &str {
        self.0.get(..8).unwrap_or(&self.0)
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// Adds `fields` by the order of their keys.
fn add_fields(hash: &mut Sha256, fields: &serde_json::Map<String, serde_json::Value>) {
    let mut sorted: Vec<_> = fields.iter().collect();
    sorted.sort_by_key(|(key, _)| key.as_str());
    for (key, value) in sorted {
        add_text(hash, key);
        add(hash, value);
    }
}

/// Adds `value` in a form in which no two values look the same.
fn add(hash: &mut Sha256, value: &serde_json::Value) {
    match value {
        serde_json::Value::Object(fields) => {
            hash.update(b"{");
            add_fields(hash, fields);
            hash.update(b"}");
        }
        serde_json::Value::Array(items) => {
            hash.update(b"[");
            for item in items {
                add(hash, item);
            }
            hash.update(b"]");
        }
        serde_json::Value::String(text) => add_text(hash, text),
        serde_json::Value::Null | serde_json::Value::Bool(_) | serde_json::Value::Number(_) => {
            hash.update(value.to_string());
            hash.update(b";");
        }
    }
}

fn add_text(hash: &mut Sha256, text: &str) {
    hash.update(format!("\"{}:", text.len()));
    hash.update(text);
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn order_of_keys_does_not_matter_and_every_value_does() {
        let one = Address::of(&json!({"a": 1, "b": ["x", null]}));
        assert_eq!(one, Address::of(&json!({"b": ["x", null], "a": 1})));
        assert_eq!(one.as_str().len(), DIGITS);
        for other in [
            json!({"a": 2, "b": ["x", null]}),
            json!({"a": 1, "b": ["x"]}),
            json!({"a": 1, "b": "x"}),
            json!({"a": "1", "b": ["x", null]}),
            json!({"ab": 1, "": ["x", null]}),
        ] {
            assert_ne!(one, Address::of(&other), "{other}");
        }
    }
}
