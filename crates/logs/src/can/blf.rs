//! Vector's binary log (`.blf`): objects, most of them packed into containers of some 128 KiB.
//!
//! A container that is damaged is lost, and with it the objects that reach into it; the next one is looked for after it.

use std::io::{self, Read};

use flate2::read::ZlibDecoder;

use super::frame_error::FrameError;
use super::logged::{FrameLog, Interface, LoggedFrame, NextFrame};
use super::{Content, Frame, Identifier, MOST_BYTES};
use crate::civil;
use crate::window::{Window, find};

/// First bytes of a log.
pub(crate) const MAGIC: &[u8] = b"LOGG";
/// First bytes of an object.
const OBJECT: &[u8] = b"LOBJ";
/// Magic, size of the header, its version, size of the object, type.
const BASE_BYTES: usize = 16;
/// The base, flags, client, version, time.
const HEADER_BYTES: usize = 32;
/// The base, method, reserved, unpacked size, reserved.
const CONTAINER_HEADER_BYTES: usize = BASE_BYTES + 16;
/// Longest object that is believed, packed or not, bytes.
const LONGEST: usize = 16 << 20;
/// Header of the file: up to the end of the time of the beginning.
const FILE_HEADER_BYTES: usize = 56;

// Types of objects.
const CAN_MESSAGE: u32 = 1;
const CAN_ERROR: u32 = 2;
const CONTAINER: u32 = 10;
const CAN_ERROR_EXT: u32 = 73;
const CAN_MESSAGE_2: u32 = 86;
const CAN_FD_MESSAGE: u32 = 100;
const CAN_FD_MESSAGE_64: u32 = 101;
const CAN_FD_ERROR_64: u32 = 104;

/// Flag of an identifier of 29 bits.
const EXTENDED: u32 = 0x8000_0000;

/// See the [module](self).
pub struct Blf<R> {
    file: Window<R>,
    begin_ns: i64,
    /// Unpacked objects: those before `next` have been read.
    objects: Vec<u8>,
    next: usize,
    /// Bytes are missing before what is unpacked next, which may begin amid an object.
    torn: bool,
    damage: Damage,
}

#[derive(Debug, Default)]
struct Damage {
    containers: u64,
    bytes: u64,
    first_at: Option<u64>,
    cut: bool,
}

/// What comes next in the unpacked objects.
enum Next {
    Frame(Result<LoggedFrame, FrameError>),
    /// An object of another kind.
    Other,
    /// The rest is of an object that goes on in the next container.
    More,
}

impl<R: Read> Blf<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// It cannot be read, or is none.
    pub fn new(input: R) -> io::Result<Self> {
        let mut file = Window::new(input);
        let head = file.look(FILE_HEADER_BYTES)?;
        let size = if head.len() < FILE_HEADER_BYTES { 0 } else { number(head, 4) as usize };
        if !head.starts_with(MAGIC) || !(FILE_HEADER_BYTES..=4096).contains(&size) {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "its header is none of a BLF log"));
        }
        let begin_ns = system_time(&head[40..56]).unwrap_or(0);
        file.look(size)?;
        file.take(size);
        Ok(Blf { file, begin_ns, objects: Vec::new(), next: 0, torn: false, damage: Damage::default() })
    }

    /// Unpacks the file's next object behind those that are there; `false` at the end.
    fn unpack_next(&mut self) -> io::Result<bool> {
        self.objects.drain(..self.next);
        self.next = 0;
        loop {
            let base = self.file.look(BASE_BYTES)?;
            if base.len() < BASE_BYTES {
                // A few zeros after the last object fill it up to a multiple of four.
                self.damage.cut |= base.iter().any(|byte| *byte != 0) || !self.objects.is_empty();
                return Ok(false);
            }
            let (size, kind) = (number(base, 8) as usize, number(base, 12));
            if !base.starts_with(OBJECT) || !(BASE_BYTES..=LONGEST).contains(&size) {
                self.resynchronise()?;
                continue;
            }
            let at = self.file.at();
            let object = self.file.look(size)?;
            if object.len() < size {
                // What was lost at the end may be a length that is wrong: then objects follow.
                if find(&object[BASE_BYTES..], OBJECT).is_some() {
                    self.resynchronise()?;
                    continue;
                }
                self.damage.cut = true;
                return Ok(false);
            }
            let unpacked = if kind == CONTAINER {
                unpack(&object[..size], &mut self.objects)
            } else {
                self.objects.extend_from_slice(&object[..size]);
                true
            };
            self.file.take(size);
            self.skip_padding(size % 4)?;
            if unpacked {
                return Ok(true);
            }
            self.damage.containers += 1;
            self.tear(at);
        }
    }

    /// Bytes are missing here.
    fn tear(&mut self, at: u64) {
        self.damage.first_at.get_or_insert(at);
        self.objects.clear();
        self.torn = true;
    }

    /// Zeros may follow an object whose size is no multiple of four, as many as the remainder.
    fn skip_padding(&mut self, most: usize) -> io::Result<()> {
        let zeros = self.file.look(most)?.iter().take(most).take_while(|byte| **byte == 0).count();
        self.file.take(zeros);
        Ok(())
    }

    /// Looks for the next object after something that is none.
    fn resynchronise(&mut self) -> io::Result<()> {
        self.tear(self.file.at());
        let mut passed = 1;
        loop {
            let there = self.file.look(passed + 4096)?;
            let rest = there.get(passed..).unwrap_or_default();
            let found = find(rest, OBJECT);
            let ended = there.len() < passed + 4096;
            passed += found.unwrap_or(rest.len().saturating_sub(OBJECT.len() - 1));
            let passed_now = if found.is_none() && ended { there.len() } else { passed };
            self.file.take(passed_now);
            self.damage.bytes += passed_now as u64;
            if found.is_some() || ended {
                return Ok(());
            }
            passed = 0;
        }
    }

    fn next_object(&mut self) -> Next {
        let rest = &self.objects[self.next..];
        // Objects are filled up to a multiple of four, or are not; damage leaves the rest of one.
        let reach = if self.torn { rest.len() } else { rest.len().min(8) };
        let Some(begin) = find(&rest[..reach], OBJECT) else {
            if rest.len() < 8 {
                return Next::More;
            }
            self.damage.first_at.get_or_insert(self.file.at());
            self.damage.bytes += rest.len() as u64;
            self.torn = true;
            self.next = self.objects.len();
            return Next::More;
        };
        let object = &rest[begin..];
        if object.len() < BASE_BYTES {
            self.next += begin;
            return Next::More;
        }
        let (size, kind) = (number(object, 8) as usize, number(object, 12));
        if !(BASE_BYTES..=LONGEST).contains(&size) {
            self.damage.first_at.get_or_insert(self.file.at());
            self.next += begin + OBJECT.len();
            self.torn = true;
            return Next::Other;
        }
        if object.len() < size {
            self.next += begin;
            return Next::More;
        }
        self.torn = false;
        self.next += begin + size;
        self.frame(&self.objects[self.next - size..self.next], kind).map_or(Next::Other, Next::Frame)
    }

    /// An object's frame; `None` for other kinds.
    fn frame(&self, object: &[u8], kind: u32) -> Option<Result<LoggedFrame, FrameError>> {
        let is_frame = matches!(
            kind,
            CAN_MESSAGE
                | CAN_MESSAGE_2
                | CAN_FD_MESSAGE
                | CAN_FD_MESSAGE_64
                | CAN_ERROR
                | CAN_ERROR_EXT
                | CAN_FD_ERROR_64
        );
        if !is_frame {
            return None;
        }
        let header_bytes = usize::from(u16::from_le_bytes([object[4], object[5]]));
        if object.len() < HEADER_BYTES || !(HEADER_BYTES..=object.len()).contains(&header_bytes) {
            return Some(Err(FrameError::HeaderCutShort));
        }
        let ticks = u64::from_le_bytes(std::array::from_fn(|index| object[24 + index]));
        let tick_ns = if number(object, 16) == 1 { 10_000 } else { 1 };
        let since_ns = i64::try_from(ticks).unwrap_or(i64::MAX).saturating_mul(tick_ns);
        let time_ns = self.begin_ns.saturating_add(since_ns);
        let frame = frame_of(&object[header_bytes..], kind);
        Some(frame.map(|(channel, frame)| LoggedFrame {
            time_ns,
            interface: Interface::numbered(channel),
            frame,
        }))
    }
}

/// Unpacks a container behind the objects that are there; whether it could be.
fn unpack(object: &[u8], objects: &mut Vec<u8>) -> bool {
    let Some((header, packed)) = object.split_at_checked(CONTAINER_HEADER_BYTES) else { return false };
    let (method, size) = (u16::from_le_bytes([header[16], header[17]]), number(header, 24) as usize);
    if size > LONGEST || objects.len() > LONGEST {
        return false;
    }
    let before = objects.len();
    let whole = match method {
        0 => {
            objects.extend_from_slice(packed);
            true
        }
        2 => {
            // One byte more than it should have, to notice that.
            let read = ZlibDecoder::new(packed).take(size as u64 + 1).read_to_end(objects);
            read.is_ok_and(|read| read == size)
        }
        _ => false,
    };
    if !whole {
        objects.truncate(before);
    }
    whole
}

/// Channel and frame of what follows an object's header.
fn frame_of(content: &[u8], kind: u32) -> Result<(u32, Frame), FrameError> {
    let short = |bytes: usize| content.get(..bytes).map(|_| ()).ok_or(FrameError::CutShort);
    short(8)?;
    let channel = match kind {
        CAN_FD_MESSAGE_64 | CAN_FD_ERROR_64 => u32::from(content[0]),
        _ => u32::from(u16::from_le_bytes([content[0], content[1]])),
    };
    let (identifier, content_kind, data) = match kind {
        CAN_MESSAGE | CAN_MESSAGE_2 => {
            let length = usize::from(content[3]).min(8);
            let data = content.get(8..8 + length).ok_or(FrameError::CutShort)?;
            (number(content, 4), remote(content[2]), data)
        }
        CAN_FD_MESSAGE => {
            short(20)?;
            let data = content.get(20..20 + usize::from(content[14])).ok_or(FrameError::CutShort)?;
            (number(content, 4), remote(content[2]), data)
        }
        CAN_FD_MESSAGE_64 => {
            short(40)?;
            let flags = number(content, 12);
            let data = content.get(40..40 + usize::from(content[2])).ok_or(FrameError::CutShort)?;
            let kind = if flags & 0x10 != 0 { Content::Remote } else { Content::Data };
            (number(content, 4), kind, data)
        }
        _ => (0, Content::Error, &[][..]),
    };
    if data.len() > MOST_BYTES {
        return Err(FrameError::Length);
    }
    let bits = identifier & 0x1fff_ffff;
    let identifier = match identifier & EXTENDED {
        0 if bits > 0x7ff => return Err(FrameError::IdentifierNotOfCan),
        0 => Identifier::Standard(bits as u16),
        _ => Identifier::Extended(bits),
    };
    let mut frame = Frame::new(identifier, content_kind);
    if content_kind == Content::Data {
        data.iter().for_each(|byte| {
            frame.push(*byte);
        });
    }
    Ok((channel, frame))
}

fn remote(flags: u8) -> Content {
    if flags & 0x80 != 0 { Content::Remote } else { Content::Data }
}

fn number(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|index| bytes[at + index]))
}

/// A SYSTEMTIME of Windows: year, month, day of the week, day, hour, minute, second, millisecond; ns since 1970.
fn system_time(bytes: &[u8]) -> Option<i64> {
    let of = |index: usize| i64::from(u16::from_le_bytes([bytes[2 * index], bytes[2 * index + 1]]));
    civil::of_numbers((of(0), of(1), of(3)), (of(4), of(5), of(6)), of(7) * 1_000_000)
}

impl<R: Read> FrameLog for Blf<R> {
    fn next_frame(&mut self) -> NextFrame {
        loop {
            match self.next_object() {
                Next::Frame(frame) => return Ok(Some(frame)),
                Next::Other => {}
                Next::More if self.unpack_next()? => {}
                Next::More => return Ok(None),
            }
        }
    }

    fn place(&self) -> String {
        format!("byte {}", self.file.at())
    }

    fn notes(&self) -> Vec<String> {
        let Damage { containers, bytes, first_at, cut } = self.damage;
        let mut notes = Vec::new();
        if let Some(at) = first_at {
            notes.push(format!(
                "{containers} damaged containers and {bytes} damaged bytes between objects were left out, the first near byte {at}"
            ));
        }
        if cut {
            let at = self.file.at();
            notes.push(format!(
                "the log ends near byte {at} in the middle of its data; it was read up to there"
            ));
        }
        notes
    }
}
