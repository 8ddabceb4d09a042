//! Configuration files: TOML parsed once, checked once, and errors that name file, line, key and allowed range.

use std::fs;

use serde::de::DeserializeOwned;

/// A configuration text and where it came from.
#[derive(Clone, Debug)]
pub struct Source {
    path: String,
    text: String,
}

/// What is wrong with a configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{path}: cannot be read: {source}")]
    Unreadable {
        /// The file.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The text is no TOML, or a key is unknown, missing or of the wrong type.
    #[error("{path}:{line}: {message}")]
    Malformed {
        /// The file.
        path: String,
        /// Line, from 1.
        line: usize,
        /// The parser's reason, which names the key.
        message: String,
    },
    /// A value is outside its range.
    #[error("{path}:{line}: {key} = {value} is outside {allowed}")]
    OutOfRange {
        /// The file.
        path: String,
        /// Line, from 1.
        line: usize,
        /// Dotted key.
        key: String,
        /// The value as text.
        value: String,
        /// The allowed range as text.
        allowed: String,
    },
}

impl Source {
    /// Reads `path`.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`].
    pub fn read(path: &str) -> Result<Self, ConfigError> {
        let text = fs::read_to_string(path).map_err(|source| ConfigError::Unreadable {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            text,
        })
    }

    /// A text that is built into the program, under the path it has in the repository.
    #[must_use]
    pub fn embedded(path: &str, text: &str) -> Self {
        Self {
            path: path.to_owned(),
            text: text.to_owned(),
        }
    }

    /// The text itself, for the log.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Parses the text; `T` should deny unknown fields.
    ///
    /// # Errors
    /// [`ConfigError::Malformed`].
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        toml::from_str(&self.text).map_err(|error| ConfigError::Malformed {
            path: self.path.clone(),
            line: error.span().map_or(1, |span| self.line_at(span.start)),
            message: error.message().to_owned(),
        })
    }

    /// Checks that `value`, found at the dotted `key`, lies in `low..=high`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`], also for NaN.
    pub fn check_range(
        &self,
        key: &str,
        value: f64,
        low: f64,
        high: f64,
    ) -> Result<(), ConfigError> {
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(self.out_of_range(key, &value.to_string(), &format!("[{low}, {high}]")))
    }

    /// The error for `value` at the dotted `key`, whose indices count from 0 (`forbidden.0.radius_m`).
    #[must_use]
    pub fn out_of_range(&self, key: &str, value: &str, allowed: &str) -> ConfigError {
        ConfigError::OutOfRange {
            path: self.path.clone(),
            line: self.line_of(key),
            key: key.to_owned(),
            value: value.to_owned(),
            allowed: allowed.to_owned(),
        }
    }

    fn line_at(&self, offset: usize) -> usize {
        self.text
            .bytes()
            .take(offset)
            .filter(|&byte| byte == b'\n')
            .count()
            + 1
    }

    /// Line of the deepest part of `key` that is in the text; 1 if none is.
    fn line_of(&self, key: &str) -> usize {
        let Ok(document) = toml::de::DeTable::parse(&self.text) else {
            return 1;
        };
        let mut offset = 0;
        let mut parts = key.split('.');
        let Some(mut here) = parts.next().and_then(|part| document.get_ref().get(part)) else {
            return 1;
        };
        loop {
            offset = offset.max(here.span().start);
            let next = parts.next().and_then(|part| match here.get_ref() {
                toml::de::DeValue::Table(table) => table.get(part),
                toml::de::DeValue::Array(array) => {
                    part.parse().ok().and_then(|index: usize| array.get(index))
                }
                toml::de::DeValue::String(_)
                | toml::de::DeValue::Integer(_)
                | toml::de::DeValue::Float(_)
                | toml::de::DeValue::Boolean(_)
                | toml::de::DeValue::Datetime(_) => None,
            });
            let Some(next) = next else {
                return self.line_at(offset);
            };
            here = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Sample {
        #[expect(dead_code, reason = "only its presence matters")]
        speed_m_s: f64,
    }

    #[test]
    fn unknown_key_is_named_with_its_line() {
        let source = Source::embedded("a.toml", "speed_m_s = 0.1\nsped = 2\n");
        let message = source.parse::<Sample>().unwrap_err().to_string();
        assert!(
            message.starts_with("a.toml:2: ") && message.contains("sped"),
            "{message}"
        );
    }

    #[test]
    fn range_error_points_into_nested_tables_and_arrays() {
        let source = Source::embedded(
            "a.toml",
            "[[region]]\nradius_m = 1.0\n\n[[region]]\nradius_m = -2.0\n",
        );
        let message = source
            .check_range("region.1.radius_m", -2.0, 0.0, 1.0)
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            "a.toml:5: region.1.radius_m = -2 is outside [0, 1]"
        );
    }

    #[test]
    fn nan_is_out_of_every_range() {
        let source = Source::embedded("a.toml", "x = nan\n");
        assert!(source.check_range("x", f64::NAN, 0.0, 1.0).is_err());
    }
}
