#![doc = include_str!("../README.md")]

pub mod side_file;

use std::fmt;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, Deserializer};

/// Why a TOML file cannot be read into its structure.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// A key that the structure does not have.
    #[error("line {line}: {unknown}")]
    UnknownKey {
        /// Line, from 1.
        line: usize,
        /// The key, with those that there are.
        #[source]
        unknown: UnknownKey,
    },
    /// Not TOML, a value of the wrong type, or a key that is missing.
    #[error("line {line}: {message}")]
    Toml {
        /// Line, from 1.
        line: usize,
        /// What the parser says, in one line.
        message: String,
    },
}

impl FormatError {
    /// The line of the error, from 1.
    pub fn line(&self) -> usize {
        match self {
            FormatError::UnknownKey { line, .. } | FormatError::Toml { line, .. } => *line,
        }
    }
}

/// A key that does not exist: "unknown key `a`; did you mean `b`?", or the list of all where nothing is near.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownKey {
    /// The key as it was written.
    pub key: String,
    /// Those that exist.
    pub known: Vec<String>,
}

impl UnknownKey {
    /// That key, beside those that exist.
    pub fn new(key: &str, known: &[&str]) -> Self {
        UnknownKey { key: key.to_owned(), known: known.iter().map(|name| (*name).to_owned()).collect() }
    }

    /// The known key that it is most like, if it is like one.
    pub fn nearest(&self) -> Option<&str> {
        nearest(&self.key, self.known.iter().map(String::as_str))
    }
}

impl fmt::Display for UnknownKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.nearest() {
            Some(name) => write!(f, "unknown key `{}`; did you mean `{name}`?", self.key),
            None => write!(f, "unknown key `{}`; known are {}", self.key, self.known.join(", ")),
        }
    }
}

impl std::error::Error for UnknownKey {}

/// The words of a name in small letters, between other characters and at large letters, each with the byte at which it begins: `cylPos_mm` is
/// cyl, pos and mm.
pub fn words(name: &str) -> Vec<(usize, String)> {
    let mut words: Vec<(usize, String)> = Vec::new();
    let mut before = ' ';
    for (at, letter) in name.char_indices() {
        if letter.is_alphanumeric() {
            let begins = !before.is_alphanumeric() || (letter.is_uppercase() && before.is_lowercase());
            match words.last_mut() {
                Some((_, word)) if !begins => word.extend(letter.to_lowercase()),
                _ => words.push((at, letter.to_lowercase().collect())),
            }
        }
        before = letter;
    }
    words
}

/// Reads a TOML text; an unknown key is answered with the nearest known one.
///
/// # Errors
/// [`FormatError`] with the line.
pub fn parse_toml<T: DeserializeOwned>(text: &str) -> Result<T, FormatError> {
    toml::from_str(text).map_err(|error| FormatError::new(text, &error, &[]))
}

/// Takes a TOML text apart that holds several structures side by side at its top, each with keys of its own.
///
/// # Errors
/// [`FormatError`] with the line where it is no TOML.
pub fn parse_toml_parts(text: &str) -> Result<TomlParts<'_>, FormatError> {
    let table = DeTable::parse(text).map_err(|error| FormatError::new(text, &error, &[]))?;
    Ok(TomlParts { text, table, taken: Vec::new() })
}

/// What is left of such a text. See [`parse_toml_parts`].
pub struct TomlParts<'t> {
    text: &'t str,
    table: Spanned<DeTable<'t>>,
    taken: Vec<&'static str>,
}

impl TomlParts<'_> {
    /// The structure that is made of these keys.
    ///
    /// # Errors
    /// [`FormatError`] with the line.
    pub fn take<T: DeserializeOwned>(&mut self, keys: &[&'static str]) -> Result<T, FormatError> {
        let mut part = DeTable::new();
        for key in keys {
            part.extend(self.table.get_mut().remove_entry(*key));
        }
        self.taken.extend(keys);
        let part = Spanned::new(self.table.span(), part);
        T::deserialize(Deserializer::from(part)).map_err(|error| FormatError::new(self.text, &error, &[]))
    }

    /// The structure that is made of all other keys; one that is unknown may be a taken one misspelt.
    ///
    /// # Errors
    /// [`FormatError`] with the line.
    pub fn take_rest<T: DeserializeOwned>(self) -> Result<T, FormatError> {
        T::deserialize(Deserializer::from(self.table))
            .map_err(|error| FormatError::new(self.text, &error, &self.taken))
    }
}

impl FormatError {
    /// The error with its line; an unknown key may be meant for one of the `others` too.
    fn new(text: &str, error: &toml::de::Error, others: &[&str]) -> Self {
        let at = error.span().map_or(0, |span| span.start.min(text.len()));
        let line = 1 + text.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count();
        match unknown_field(error.message(), others) {
            Some(unknown) => FormatError::UnknownKey { line, unknown },
            None => FormatError::Toml {
                line,
                message: error.message().lines().next().unwrap_or_default().to_owned(),
            },
        }
    }
}

/// The key of serde's "unknown field `a`, expected one of `b`, `c`, …", beside these and the `others`.
fn unknown_field(message: &str, others: &[&str]) -> Option<UnknownKey> {
    let (unknown, rest) = message.strip_prefix("unknown field `")?.split_once('`')?;
    let known: Vec<&str> = rest.split('`').skip(1).step_by(2).chain(others.iter().copied()).collect();
    Some(UnknownKey::new(unknown, &known))
}

/// The known name that the unknown one is most like (Jaro–Winkler similarity), if it is like one.
///
/// ```
/// use seepd_settings::nearest;
///
/// assert_eq!(nearest("preasure", ["flow", "pressure"].into_iter()), Some("pressure"));
/// assert_eq!(nearest("zzz", ["flow", "pressure"].into_iter()), None);
/// ```
pub fn nearest<'k>(unknown: &str, known: impl Iterator<Item = &'k str>) -> Option<&'k str> {
    known
        .map(|name| (strsim::jaro_winkler(&unknown.to_lowercase(), &name.to_lowercase()), name))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(likeness, _)| *likeness > 0.7)
        .map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Table {
        valve_gain: f64,
        #[serde(default)]
        mass_kg: f64,
    }

    #[test]
    fn names_are_words_whatever_divides_them() {
        let of = |name: &str| words(name).into_iter().map(|(_, word)| word).collect::<Vec<_>>();
        assert_eq!(of("cylPos_mm"), ["cyl", "pos", "mm"]);
        assert_eq!(words("Öl.Druck A"), [(0, "öl".into()), (4, "druck".into()), (10, "a".into())]);
        assert!(of("-_").is_empty());
    }

    #[test]
    fn unknown_key_is_answered_with_line_and_nearest() {
        let error = parse_toml::<Table>("valve_gain = 1.0\nmas_kg = 2.0\n").unwrap_err();
        assert_eq!(error.to_string(), "line 2: unknown key `mas_kg`; did you mean `mass_kg`?");
    }

    #[test]
    fn far_key_is_answered_with_the_list() {
        let error = parse_toml::<Table>("valve_gain = 1.0\nzzz = 2.0\n").unwrap_err();
        assert_eq!(error.to_string(), "line 2: unknown key `zzz`; known are valve_gain, mass_kg");
    }

    #[test]
    fn wrong_type_is_told_in_one_line() {
        let error = parse_toml::<Table>("valve_gain = \"much\"\n").unwrap_err();
        assert_eq!(error.line(), 1);
        assert!(matches!(&error, FormatError::Toml { message, .. } if !message.contains('\n')), "{error}");
    }
}
