//! Configuration files: TOML parsed once, checked once, and errors that name file, line, key and
//! allowed range.

use std::ops::Range;
use std::path::Path;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::files;

/// Most bytes of a configuration file.
const SIZE_MAX: u64 = 1 << 20;

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
    #[error("{path}: cannot be read")]
    Unreadable {
        /// The file.
        path: String,
        /// The system's reason.
        #[source]
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
    /// What a value names can't be used.
    #[error("{path}:{line}: {key} = {value}: {reason}")]
    Refused {
        /// The file.
        path: String,
        /// Line, from 1.
        line: usize,
        /// Dotted key.
        key: String,
        /// The value as text.
        value: String,
        /// Why.
        reason: String,
    },
    /// A key that is to be changed is not in the text.
    #[error("{path} has no key {key}; there {} {known}", if .known.contains(", ") { "are" } else { "is" })]
    NoKey {
        /// The file.
        path: String,
        /// Dotted key.
        key: String,
        /// Keys at the place where it goes wrong.
        known: String,
    },
}

impl Source {
    /// Reads `path`, a file of at most 1 MiB.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`].
    pub fn read(path: &str) -> Result<Self, ConfigError> {
        let unreadable = |source| ConfigError::Unreadable {
            path: path.to_owned(),
            source,
        };
        let text = files::read_text(Path::new(path), "a configuration", SIZE_MAX);
        let text = text.map_err(unreadable)?;
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

    /// The same text with `value` at the dotted `key`, which must be in it already; lines stay
    /// where they are. A value that is no TOML is taken for a string.
    ///
    /// # Errors
    /// [`ConfigError::NoKey`] if the text has no such value, [`ConfigError::Malformed`] if it is no
    /// TOML.
    pub fn with(&self, key: &str, value: &str) -> Result<Self, ConfigError> {
        let document = DeTable::parse(&self.text).map_err(|error| ConfigError::Malformed {
            path: self.path.clone(),
            line: error.span().map_or(1, |span| self.line_at(span.start)),
            message: error.message().to_owned(),
        })?;
        let no_key = |known: Vec<String>| ConfigError::NoKey {
            path: self.path.clone(),
            key: key.to_owned(),
            known: known.join(", "),
        };
        let table = DeValue::Table(document.get_ref().clone());
        let (mut here, mut at) = (&table, 0..0);
        for part in key.split('.') {
            let next = child(here, part).ok_or_else(|| no_key(children(here)))?;
            (here, at) = (next.get_ref(), next.span());
        }
        // A table, or several under headers of their own, is no value that stands in one place.
        let in_place = self
            .text
            .get(at.clone())
            .is_some_and(|text| DeTable::parse(&format!("value = {text}")).is_ok());
        if matches!(here, DeValue::Table(_)) || !in_place {
            let inside = children(here).into_iter();
            return Err(no_key(inside.map(|name| format!("{key}.{name}")).collect()));
        }
        let mut text = self.text.clone();
        text.replace_range(at, &as_toml(value));
        Ok(Self {
            path: format!("{} with {key} = {value}", self.path),
            text,
        })
    }

    /// The same text with the lines `more`, a table's, in that table or else at its end, if there
    /// is nothing at the dotted `key`; lines of no table come before all.
    #[must_use]
    pub fn or_with(self, key: &str, more: &str) -> Self {
        let document = DeTable::parse(&self.text).ok();
        let found = document.is_some_and(|document| {
            let mut parts = key.split('.');
            let first = parts.next().and_then(|part| document.get_ref().get(part));
            let last = parts.try_fold(first, |here, part| {
                here.map(|here| child(here.get_ref(), part))
            });
            last.flatten().is_some()
        });
        if found {
            return self;
        }
        if !more.starts_with('[') {
            let text = format!("{more}{}", self.text);
            return Self { text, ..self };
        }
        let (table, keys) = more.split_once('\n').unwrap_or((more, ""));
        let mut lines = self.text.split_inclusive('\n');
        let mut end = 0;
        let has_table = lines.any(|line| {
            end += line.len();
            line.split('#').next().unwrap_or(line).trim() == table
        });
        let mut text = self.text;
        if has_table && !text[..end].ends_with('\n') {
            text.push('\n');
            end += 1;
        }
        if has_table {
            text.insert_str(end, keys);
        } else {
            text = format!("{}\n{more}", text.trim_end());
        }
        Self { text, ..self }
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
        toml::from_str(&self.text).map_err(|error| {
            let span = error.span();
            let reason = error.message();
            let message = match span.as_ref().and_then(|span| self.key_at(span)) {
                Some(key) => format!("{key}: {reason}"),
                None => reason.to_owned(),
            };
            ConfigError::Malformed {
                path: self.path.clone(),
                line: span.map_or(1, |span| self.line_at(span.start)),
                message,
            }
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
        let allowed = format!("[{}, {}]", number_text(low), number_text(high));
        Err(self.out_of_range(key, &number_text(value), &allowed))
    }

    /// The error for `value` at the dotted `key`, whose indices count from 0
    /// (`forbidden.0.radius_m`).
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

    /// The error for what `value`, a file, say, at the dotted `key` names: it is there, or not, but
    /// it can't be used.
    #[must_use]
    pub fn refused(&self, key: &str, value: &str, reason: &str) -> ConfigError {
        ConfigError::Refused {
            path: self.path.clone(),
            line: self.line_of(key),
            key: key.to_owned(),
            value: value.to_owned(),
            reason: reason.to_owned(),
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

    /// Dotted key of the smallest value that covers `span`; none if only the whole document does.
    fn key_at(&self, span: &Range<usize>) -> Option<String> {
        let document = DeTable::parse(&self.text).ok()?;
        let mut best = None;
        for (key, value) in document.get_ref() {
            smallest_cover(key.get_ref(), value, span, &mut best);
        }
        best.map(|(_, key)| key)
    }

    /// Line of the deepest part of `key` that is in the text; 1 if none is.
    fn line_of(&self, key: &str) -> usize {
        let Ok(document) = DeTable::parse(&self.text) else {
            return 1;
        };
        let mut offset = 0;
        let mut parts = key.split('.');
        let Some(mut here) = parts.next().and_then(|part| document.get_ref().get(part)) else {
            return 1;
        };
        loop {
            offset = offset.max(here.span().start);
            let next = parts.next().and_then(|part| child(here.get_ref(), part));
            let Some(next) = next else {
                return self.line_at(offset);
            };
            here = next;
        }
    }
}

/// What `part`, a key or an index, names in `value`.
fn child<'a, 'i>(value: &'a DeValue<'i>, part: &str) -> Option<&'a Spanned<DeValue<'i>>> {
    match value {
        DeValue::Table(table) => table.get(part),
        DeValue::Array(array) => part.parse().ok().and_then(|index: usize| array.get(index)),
        DeValue::String(_)
        | DeValue::Integer(_)
        | DeValue::Float(_)
        | DeValue::Boolean(_)
        | DeValue::Datetime(_) => None,
    }
}

/// What can follow `value` in a dotted key.
fn children(value: &DeValue<'_>) -> Vec<String> {
    match value {
        DeValue::Table(table) => table.keys().map(|key| key.get_ref().to_string()).collect(),
        DeValue::Array(array) => (0..array.len()).map(|index| index.to_string()).collect(),
        DeValue::String(_)
        | DeValue::Integer(_)
        | DeValue::Float(_)
        | DeValue::Boolean(_)
        | DeValue::Datetime(_) => vec!["none in it".to_owned()],
    }
}

/// `value` if it is one TOML value in one line, without a comment, else a string of it.
fn as_toml(value: &str) -> String {
    let alone = format!("value = {value}");
    let is_one = !value.contains('\n')
        && DeTable::parse(&alone).is_ok_and(|table| {
            let all = table.get_ref().get("value");
            table.get_ref().len() == 1 && all.is_some_and(|all| all.span().end == alone.len())
        });
    if is_one {
        value.to_owned()
    } else {
        toml::Value::String(value.to_owned()).to_string()
    }
}

/// `value` as a person reads it: very large and very small magnitudes with an exponent.
#[must_use]
pub fn number_text(value: f64) -> String {
    let magnitude = value.abs();
    let plain = magnitude < 1e9 && (magnitude > 1e-9 || magnitude <= 0.0);
    if plain || !value.is_finite() {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// Keeps in `best` the length and the dotted key of the smallest value, from `value` at `key` down,
/// that covers `span`.
///
/// A table's own span may be no more than its header, so its values are looked at in any case.
fn smallest_cover(
    key: &str,
    value: &Spanned<DeValue<'_>>,
    span: &Range<usize>,
    best: &mut Option<(usize, String)>,
) {
    let own = value.span();
    let covers = own.start <= span.start && span.end <= own.end;
    if covers && best.as_ref().is_none_or(|(length, _)| own.len() <= *length) {
        *best = Some((own.len(), key.to_owned()));
    }
    match value.get_ref() {
        DeValue::Table(table) => {
            for (name, inner) in table {
                smallest_cover(&format!("{key}.{}", name.get_ref()), inner, span, best);
            }
        }
        DeValue::Array(array) => {
            for (index, inner) in array.iter().enumerate() {
                smallest_cover(&format!("{key}.{index}"), inner, span, best);
            }
        }
        DeValue::String(_)
        | DeValue::Integer(_)
        | DeValue::Float(_)
        | DeValue::Boolean(_)
        | DeValue::Datetime(_) => {}
    }
}

#[cfg(test)]
mod tests {
    use std::error::Error;

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

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Nested {
        #[expect(dead_code, reason = "only its type matters")]
        limits: Sample,
        #[expect(dead_code, reason = "only its type matters")]
        regions: Vec<[f64; 2]>,
    }

    #[test]
    fn value_of_the_wrong_type_is_named_by_its_dotted_key() {
        let refused = |text: &str| {
            Source::embedded("c.toml", text)
                .parse::<Nested>()
                .unwrap_err()
                .to_string()
        };
        assert!(
            refused("regions = []\n\n[limits]\nspeed_m_s = \"x\"\n")
                .starts_with("c.toml:4: limits.speed_m_s: invalid type: string \"x\""),
        );
        assert!(
            refused("regions = [\n  [1.0, 2.0],\n  [1.0, true],\n]\n[limits]\nspeed_m_s = 1.0\n")
                .starts_with("c.toml:3: regions.1.1: invalid type: boolean"),
        );
        assert!(
            refused("regions = []\nlimits = { speed_m_s = [] }\n")
                .starts_with("c.toml:2: limits.speed_m_s: invalid type"),
        );
    }

    #[test]
    fn a_value_is_changed_where_it_is_and_nothing_else() {
        let text = "# speeds\na = 1\n[limits] # two\nspeed_m_s = 0.25 # slow\nspaces = [1, [2, 3]]\n[[arm]]\nname = \"x\"\n";
        let source = Source::embedded("c.toml", text);
        let set =
            |key: &str, value: &str| source.with(key, value).map(|with| with.text().to_owned());
        let replaced = |from: &str, to: &str| text.replace(from, to);
        assert_eq!(
            set("limits.speed_m_s", "0.5").unwrap(),
            replaced("0.25", "0.5")
        );
        assert_eq!(
            set("limits.spaces.1.0", "7").unwrap(),
            replaced("[2, 3]", "[7, 3]")
        );
        assert_eq!(
            set("limits.spaces", "[]").unwrap(),
            replaced("[1, [2, 3]]", "[]")
        );
        assert_eq!(
            set("arm.0.name", "left").unwrap(),
            replaced("\"x\"", "\"left\"")
        );
        let hash = set("arm.0.name", "\"a # b\"").unwrap();
        assert_eq!(hash, replaced("\"x\"", "\"a # b\""));
        assert!(source.with("arm", "[]").is_err());
        assert!(source.with("arm.0", "{}").is_err());
        // Neither a second key nor a comment can be smuggled in.
        let smuggled = set("a", "2\nb = 3").unwrap();
        assert!(
            smuggled.contains("a = \"\"\"") || smuggled.contains("a = \"2\\nb"),
            "{smuggled}"
        );
        let with = source.with("limits.speed_m_s", "9").unwrap();
        let refused = with
            .check_range("limits.speed_m_s", 9.0, 0.0, 1.0)
            .unwrap_err();
        assert_eq!(
            refused.to_string(),
            "c.toml with limits.speed_m_s = 9:4: limits.speed_m_s = 9 is outside [0, 1]"
        );
    }

    #[test]
    fn a_key_that_is_not_there_is_refused_with_those_that_are() {
        let source = Source::embedded("c.toml", "a = 1\n[limits]\nspeed = 2\nforce = 3\n");
        let refused = |key| source.with(key, "1").unwrap_err().to_string();
        assert_eq!(
            refused("limit.speed"),
            "c.toml has no key limit.speed; there are a, limits"
        );
        assert_eq!(
            refused("limits.sped"),
            "c.toml has no key limits.sped; there are force, speed"
        );
        assert_eq!(
            refused("limits"),
            "c.toml has no key limits; there are limits.force, limits.speed"
        );
        assert_eq!(refused("a.b"), "c.toml has no key a.b; there is none in it");
    }

    #[test]
    fn unreadable_file_tells_its_cause_once() {
        let error = Source::read("no/such.toml").unwrap_err();
        assert_eq!(error.to_string(), "no/such.toml: cannot be read");
        assert!(error.source().is_some());
    }

    #[test]
    fn extreme_numbers_are_short() {
        let source = Source::embedded("a.toml", "x = 1e300\n");
        let message = |value| {
            source
                .check_range("x", value, 1e-12, 1.5)
                .unwrap_err()
                .to_string()
        };
        assert_eq!(
            message(1e300),
            "a.toml:1: x = 1e300 is outside [1e-12, 1.5]"
        );
        assert!(message(-2.5e-20).contains("x = -2.5e-20 is"));
        assert!(message(0.0).contains("x = 0 is"));
        assert!(message(7500.0).contains("x = 7500 is"));
        assert!(message(f64::INFINITY).contains("x = inf is"));
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
