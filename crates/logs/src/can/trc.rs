//! The text log of PEAK's tools (`.trc`), versions 1.0 to 1.3 and 2.x. Each version has its columns; those of 2.x stand in its header.

use super::frame_error::FrameError;
use super::logged::{Interface, LoggedFrame};
use super::words::{bytes_of_code, fixed_point, number, number_u32, push_words, words};
use super::{Content, Frame, Identifier, MOST_BYTES};

/// From 30 December 1899, where the days of a header begin, to 1970, s.
const EPOCH_S: f64 = 25_569.0 * 86_400.0;

/// What a column holds, by the letters of `;$COLUMNS`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    /// Time since the beginning, ms.
    Offset,
    Type,
    Bus,
    Id,
    /// Received or sent.
    Direction,
    /// Length code.
    Code,
    /// Length.
    Bytes,
    /// Number, reserved, or of no use.
    Other,
}

use Column::{Bus, Bytes, Code, Direction, Id, Offset, Other, Type};

/// What the header said.
#[derive(Debug)]
pub(super) struct Trc {
    /// Columns before the data.
    columns: Vec<Column>,
    /// Beginning, ns since 1970; 0 where the header tells none.
    begin_ns: i64,
}

impl Trc {
    pub(super) fn new() -> Self {
        Trc { columns: vec![Other, Offset, Id, Code], begin_ns: 0 }
    }

    /// A line's frame; `None` for the header and for lines that tell of the bus.
    pub(super) fn take(&mut self, line: &[u8]) -> Option<Result<LoggedFrame, FrameError>> {
        let line = line.trim_ascii();
        match line.strip_prefix(b";") {
            Some(header) => {
                self.header(header);
                None
            }
            None if line.is_empty() => None,
            None => self.frame(line).transpose(),
        }
    }

    fn header(&mut self, line: &[u8]) {
        let Some((key, value)) = line.iter().position(|byte| *byte == b'=').map(|at| line.split_at(at))
        else {
            return;
        };
        let value = value[1..].trim_ascii();
        match key.trim_ascii() {
            b"$FILEVERSION" => match value {
                b"1.1" => self.columns = vec![Other, Offset, Direction, Id, Code],
                b"1.2" => self.columns = vec![Other, Offset, Bus, Direction, Id, Code],
                b"1.3" => self.columns = vec![Other, Offset, Bus, Direction, Id, Other, Code],
                _ => {}
            },
            b"$STARTTIME" => {
                let days = std::str::from_utf8(value).ok().and_then(|value| value.parse::<f64>().ok());
                self.begin_ns = days.map_or(0, |days| ((days * 86_400.0 - EPOCH_S) * 1e9) as i64);
            }
            b"$COLUMNS" => {
                let letters = value.split(|byte| *byte == b',').map(<[u8]>::trim_ascii);
                self.columns = letters
                    .take_while(|letter| *letter != b"D")
                    .take(16)
                    .map(|letter| match letter {
                        b"O" => Offset,
                        b"T" => Type,
                        b"B" => Bus,
                        b"I" => Id,
                        b"d" => Direction,
                        b"L" => Code,
                        b"l" => Bytes,
                        _ => Other,
                    })
                    .collect();
            }
            _ => {}
        }
    }

    fn frame(&self, line: &[u8]) -> Result<Option<LoggedFrame>, FrameError> {
        let mut words = words(line);
        let (mut time_ns, mut id, mut length) = (None, None, None);
        let (mut interface, mut content) = (Interface::numbered(1), Content::Data);
        for column in &self.columns {
            let word = words.next().ok_or(FrameError::CutShort)?;
            match column {
                Offset => time_ns = fixed_point(word, 6),
                Id => id = Some(word),
                Bus => interface = Interface::new(word).ok_or(FrameError::BusNotNumber)?,
                Code => length = number_u32(word, 10).and_then(bytes_of_code),
                Bytes => length = number(word, 10).and_then(|bytes| usize::try_from(bytes).ok()),
                // Warnings, errors and events of the bus stand where the direction of a frame does.
                Direction if !matches!(word, b"Rx" | b"Tx" | b"RX" | b"TX") => return Ok(None),
                Type => match word {
                    b"DT" | b"FD" | b"FB" | b"FE" | b"BI" => {}
                    b"RR" => content = Content::Remote,
                    b"ER" => content = Content::Error,
                    _ => return Ok(None),
                },
                Direction | Other => {}
            }
        }
        let time_ns = time_ns.ok_or(FrameError::TimeNotMilliseconds)?;
        let id = id.ok_or(FrameError::IdentifierColumnMissing)?;
        // A line of the bus's state in version 1.0.
        if id.eq_ignore_ascii_case(b"FFFFFFFF") {
            return Ok(None);
        }
        let bits = number_u32(id, 16).ok_or(FrameError::IdentifierNotHexadecimal)?;
        let identifier = match (id.len() > 4, bits) {
            (false, 0..=0x7ff) => Identifier::Standard(bits as u16),
            (true, 0..=0x1fff_ffff) => Identifier::Extended(bits),
            _ => return Err(FrameError::IdentifierNotOfCan),
        };
        let length = length.filter(|length| *length <= MOST_BYTES).ok_or(FrameError::Length)?;
        let mut frame = Frame::new(identifier, content);
        if content == Content::Data {
            let mut data = words.peekable();
            if data.peek().is_some_and(|word| word.eq_ignore_ascii_case(b"RTR")) {
                frame.content = Content::Remote;
            } else {
                push_words(&mut frame, &mut data, length, 16)?;
            }
        }
        Ok(Some(LoggedFrame { time_ns: self.begin_ns.saturating_add(time_ns), interface, frame }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame, or the message of its error.
    type Found = Result<(i64, u8, Identifier, Content, Vec<u8>), String>;

    fn frames(text: &str) -> Vec<Found> {
        let mut trc = Trc::new();
        let lines = text.lines().filter_map(|line| trc.take(line.as_bytes()));
        lines
            .map(|line| {
                line.map_err(|error| error.to_string()).map(|LoggedFrame { time_ns, interface, frame }| {
                    (time_ns, interface.name()[0], frame.identifier, frame.content, frame.data().to_vec())
                })
            })
            .collect()
    }

    /// The same frame in every version's columns, as PEAK's description of the format has them.
    #[test]
    fn every_version_has_its_columns() {
        let expected =
            |bus: u8| [Ok((1_059_900_000, bus, Identifier::Standard(0x300), Content::Data, vec![0, 0x5f]))];
        for (text, bus) in [
            ("; comment\n     1)      1059.9  0300  2  00 5F", b'1'),
            (";$FILEVERSION=1.1\n     1)      1059.9  Rx         0300  2  00 5F", b'1'),
            (";$FILEVERSION=1.2\n     1)      1059.900 2  Rx         0300  2  00 5F", b'2'),
            (";$FILEVERSION=1.3\n     1)      1059.900 2  Rx        0300 -  2    00 5F", b'2'),
            (
                ";$FILEVERSION=2.0\n;$COLUMNS=N,O,T,I,d,l,D\n     1      1059.900 DT     0300 Rx 2  00 5F",
                b'1',
            ),
            (
                ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n     1      1059.900 DT 2     0300 Rx -  2    00 5F",
                b'2',
            ),
        ] {
            assert_eq!(frames(text), expected(bus), "{text}");
        }
    }

    #[test]
    fn events_remote_frames_fd_and_damage() {
        let found = frames(
            ";$FILEVERSION=2.1\n;$STARTTIME=25569.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n 1 0.0 ST 1 - Rx - 4 00 00 00 00\n\
             2 1.5 RR 1 18EFC034 Tx - 8\n 3 2.0 FB 1 0100 Rx - 9 01 02 03 04 05 06 07 08 09 0A 0B 0C\n\
             4 x DT 1 0100 Rx - 1 00\n5 3.0 DT 1 0100 Rx - 2 00\n6 3.0 DT 1\n",
        );
        let ns = |ns: i64| 43_200_000_000_000 + ns;
        assert_eq!(
            found,
            [
                Ok((ns(1_500_000), b'1', Identifier::Extended(0x18ef_c034), Content::Remote, vec![])),
                Ok((ns(2_000_000), b'1', Identifier::Standard(0x100), Content::Data, (1..=12).collect())),
                Err("its time is not a number of ms".into()),
                Err("its data is cut short".into()),
                Err("it is cut short".into()),
            ]
        );
    }
}
