//! The way to the terminal: all that the program says there passes here, and control characters in it become visible.
//!
//! Names of topics, fields, files and axes come from logs and from others; one with an escape sequence in it could clear the screen, change
//! the title or show another text than the one that is there. What is left as it is: line feeds, tabs, and the program's own colours.

use std::borrow::Cow;
use std::io::{self, Stderr, Stdout, Write};

use super::terminal::COLOURS;

/// Writes with control characters as `\u001b`, which JSON and TOML strings read as the character.
#[derive(Debug)]
pub struct Plain<W>(pub W);

/// Standard output.
pub fn stdout() -> Plain<Stdout> {
    Plain(io::stdout())
}

/// Standard error.
pub fn stderr() -> Plain<Stderr> {
    Plain(io::stderr())
}

/// The text with no control characters, in one line.
pub fn one_line(text: &str) -> Cow<'_, str> {
    if !text.contains(char::is_control) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| if c.is_control() { escape(c) } else { c.to_string() };
    Cow::Owned(text.chars().map(shown).collect())
}

fn escape(c: char) -> String {
    format!("\\u{:04x}", u32::from(c))
}

impl<W: Write> Plain<W> {
    fn write_text(&mut self, mut text: &str) -> io::Result<()> {
        let is_foreign = |c: char| c.is_control() && c != '\n' && c != '\t';
        while let Some(at) = text.find(is_foreign) {
            let (good, rest) = text.split_at(at);
            self.0.write_all(good.as_bytes())?;
            if let Some(colour) = COLOURS.iter().find(|colour| rest.starts_with(**colour)) {
                self.0.write_all(colour.as_bytes())?;
                text = &rest[colour.len()..];
                continue;
            }
            let mut characters = rest.chars();
            let control = characters.next().map_or(String::new(), escape);
            self.0.write_all(control.as_bytes())?;
            text = characters.as_str();
        }
        self.0.write_all(text.as_bytes())
    }
}

impl<W: Write> Write for Plain<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for chunk in bytes.utf8_chunks() {
            self.write_text(chunk.valid())?;
            if !chunk.invalid().is_empty() {
                self.write_text("\u{fffd}")?;
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(text: &[u8]) -> String {
        let mut out = Plain(Vec::new());
        out.write_all(text).unwrap();
        String::from_utf8(out.0).unwrap()
    }

    #[test]
    fn control_characters_become_visible_and_our_colours_stay() {
        assert_eq!(
            plain("a\u{1b}[2Jb\u{9b}31m\r\u{7f}\n\tc°".as_bytes()),
            "a\\u001b[2Jb\\u009b31m\\u000d\\u007f\n\tc°"
        );
        assert_eq!(plain(b"\x1b[1;31msevere\x1b[0m"), "\x1b[1;31msevere\x1b[0m");
        assert_eq!(plain(b"\x1b[38;5;1mx\xff"), "\\u001b[38;5;1mx\u{fffd}");
        assert_eq!(one_line("a\nb"), "a\\u000ab");
    }

    #[test]
    fn what_is_shown_reads_back_as_json() {
        let name = "/plc\u{1b}]0;owned\u{7}\u{9c}";
        let shown = plain(serde_json::to_string(name).unwrap().as_bytes());
        assert!(!shown.contains(char::is_control));
        assert_eq!(serde_json::from_str::<String>(&shown).unwrap(), name);
    }
}
