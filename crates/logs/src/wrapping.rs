//! What may be around a log: gzip, zstd, or an encoding of text with two bytes a character.

use std::io::{self, BufReader, Read};

use flate2::read::MultiGzDecoder;

/// What is around a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wrapping {
    Gzip,
    Zstd,
    Utf16Little,
    Utf16Big,
}

/// Largest window of zstd that is believed, as a power of two: 32 MiB, four times what `zstd -19` takes. What asks for more could ask for
/// gigabytes.
const MOST_WINDOW_LOG: u32 = 25;

impl Wrapping {
    /// Tells what is around a log by its first bytes.
    pub(crate) fn of(head: &[u8]) -> Option<Self> {
        let kinds: [(&[u8], Wrapping); 4] = [
            (b"\x1f\x8b\x08", Wrapping::Gzip),
            (b"\x28\xb5\x2f\xfd", Wrapping::Zstd),
            (b"\xff\xfe", Wrapping::Utf16Little),
            (b"\xfe\xff", Wrapping::Utf16Big),
        ];
        kinds.into_iter().find(|(magic, _)| head.starts_with(magic)).map(|(_, kind)| kind)
    }

    /// What is in it, as a stream: memory does not depend on how long that is.
    pub(crate) fn unwrap<'i>(self, input: impl Read + Send + 'i) -> io::Result<Box<dyn Read + Send + 'i>> {
        Ok(match self {
            Wrapping::Gzip => {
                Box::new(Tolerant::new(MultiGzDecoder::new(BufReader::with_capacity(1 << 16, input))))
            }
            Wrapping::Zstd => {
                let mut decoder = zstd::stream::read::Decoder::new(input)?;
                decoder.window_log_max(MOST_WINDOW_LOG)?;
                Box::new(Tolerant::new(decoder))
            }
            Wrapping::Utf16Little => Box::new(Utf16::new(input, u16::from_le_bytes)),
            Wrapping::Utf16Big => Box::new(Utf16::new(input, u16::from_be_bytes)),
        })
    }
}

/// An archive that ends where it is damaged: what was unpacked before counts, and the log in it is one that was cut short.
struct Tolerant<R> {
    input: R,
    given: u64,
    ended: bool,
}

impl<R> Tolerant<R> {
    fn new(input: R) -> Self {
        Tolerant { input, given: 0, ended: false }
    }
}

impl<R: Read> Read for Tolerant<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.ended {
            return Ok(0);
        }
        match self.input.read(buffer) {
            Ok(read) => {
                self.given += read as u64;
                Ok(read)
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted || error.raw_os_error().is_some() => {
                Err(error)
            }
            Err(error) if self.given == 0 => Err(io::Error::new(
                error.kind(),
                format!("the archive around it cannot be unpacked: {error}"),
            )),
            Err(_) => {
                self.ended = true;
                Ok(0)
            }
        }
    }
}

/// Text of two bytes a character as UTF-8.
struct Utf16<R> {
    input: BufReader<R>,
    unit: fn([u8; 2]) -> u16,
    /// A character's first half.
    high: Option<u16>,
    /// What did not fit the reader's buffer.
    ready: [u8; 4],
    from: usize,
    to: usize,
    begun: bool,
}

impl<R: Read> Utf16<R> {
    fn new(input: R, unit: fn([u8; 2]) -> u16) -> Self {
        let input = BufReader::with_capacity(1 << 16, input);
        Utf16 { input, unit, high: None, ready: [0; 4], from: 0, to: 0, begun: false }
    }

    /// The next character; what is none is a replacement.
    fn next_char(&mut self) -> io::Result<Option<char>> {
        loop {
            let mut pair = [0; 2];
            match self.input.read_exact(&mut pair) {
                Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
                other => other?,
            }
            let unit = (self.unit)(pair);
            let high = self.high.take();
            let found = match (high, unit) {
                (None, 0xd800..=0xdbff) => {
                    self.high = Some(unit);
                    continue;
                }
                (None, 0xfeff) if !self.begun => {
                    self.begun = true;
                    continue;
                }
                (None, unit) => char::from_u32(unit.into()),
                (Some(high), unit) => char::decode_utf16([high, unit]).next().and_then(Result::ok),
            };
            self.begun = true;
            return Ok(Some(found.unwrap_or(char::REPLACEMENT_CHARACTER)));
        }
    }
}

impl<R: Read> Read for Utf16<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        while written < buffer.len() {
            if self.from == self.to {
                let Some(next) = self.next_char()? else { break };
                (self.from, self.to) = (0, next.encode_utf8(&mut self.ready).len());
            }
            let count = (self.to - self.from).min(buffer.len() - written);
            buffer[written..written + count].copy_from_slice(&self.ready[self.from..self.from + count]);
            self.from += count;
            written += count;
        }
        Ok(written)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn unwrapped(bytes: &[u8]) -> io::Result<Vec<u8>> {
        let mut content = Vec::new();
        Wrapping::of(bytes).unwrap().unwrap(bytes)?.read_to_end(&mut content).map(|_| content)
    }

    fn gzip(content: &[u8]) -> Vec<u8> {
        let mut writer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        writer.write_all(content).unwrap();
        writer.finish().unwrap()
    }

    #[test]
    fn archives_give_their_content_and_cut_ones_what_they_have() {
        let content: Vec<u8> = (0..500_000u32).flat_map(|n| n.wrapping_mul(n).to_le_bytes()).collect();
        for archive in [gzip(&content), zstd::encode_all(&content[..], 3).unwrap()] {
            assert_eq!(unwrapped(&archive).unwrap(), content);
            let cut = unwrapped(&archive[..archive.len() / 2]).unwrap();
            assert!(cut.len() > content.len() / 4 && content.starts_with(&cut), "{}", cut.len());
        }
        // Several in a row, as loggers append them.
        assert_eq!(unwrapped(&[gzip(b"one, "), gzip(b"two")].concat()).unwrap(), b"one, two");
        let error = unwrapped(b"\x1f\x8b\x08\0 no archive at all").unwrap_err().to_string();
        assert!(error.starts_with("the archive around it cannot be unpacked"), "{error}");
    }

    #[test]
    fn a_window_of_gigabytes_is_refused() {
        let mut writer = zstd::Encoder::new(Vec::new(), 1).unwrap();
        writer.window_log(27).unwrap();
        writer.write_all(&[7; 1000]).unwrap();
        let archive = writer.finish().unwrap();
        assert!(unwrapped(&archive).unwrap_err().to_string().contains("cannot be unpacked"));
    }

    #[test]
    fn text_of_two_bytes_a_character() {
        for (bytes, order) in
            [(u16::to_le_bytes as fn(u16) -> [u8; 2], b"\xff\xfe"), (u16::to_be_bytes, b"\xfe\xff")]
        {
            let text = "Zeit [µs];p\u{1f600}\n";
            let mut encoded = order.to_vec();
            encoded.extend(text.encode_utf16().flat_map(bytes));
            assert_eq!(unwrapped(&encoded).unwrap(), text.as_bytes());
            encoded.extend(bytes(0xdc00));
            assert_eq!(unwrapped(&encoded).unwrap(), format!("{text}\u{fffd}").as_bytes());
        }
    }
}
