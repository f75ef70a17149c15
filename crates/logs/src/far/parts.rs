//! A file that is far away, read by parts.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::time::Duration;

use futures_util::TryStreamExt;
use object_store::path::Path;
use object_store::{GetOptions, ObjectStoreExt};

use super::store::{Server, gives_no_parts};

/// Bytes of the first part that is asked for, and of the first after a jump…
const LEAST_PART: u64 = 256 << 10;
/// … and of the longest, where one is read after the other.
const LONGEST_PART: u64 = 8 << 20;

/// A file that is far away: what is asked for is fetched, and the newest part of it held. A server that gives whole files alone is asked for
/// that once, which is kept in a file without a name.
pub(crate) struct Parts {
    server: Server,
    place: Path,
    /// What told this content from others of the name.
    e_tag: Option<String>,
    length: u64,
    at: u64,
    held: Vec<u8>,
    held_from: u64,
    /// All of it, from a server that gives no parts.
    whole: Option<File>,
}

impl Parts {
    /// Asks for the file of an address; a server that is silent for so long has failed.
    ///
    /// # Errors
    /// It is not there, may not be read, or the server does not answer.
    pub(crate) fn open(address: &str, silence: Duration) -> io::Result<Self> {
        let (server, place) = Server::of(address, silence)?;
        let facts = server.wait(|store| store.head(&place))?;
        Ok(Parts {
            server,
            place,
            e_tag: facts.e_tag,
            length: facts.size,
            at: 0,
            held: Vec::new(),
            held_from: 0,
            whole: None,
        })
    }

    /// Bytes in all.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// What is held from where reading stands.
    fn at_hand(&self) -> &[u8] {
        let from = self.at.checked_sub(self.held_from).and_then(|from| usize::try_from(from).ok());
        from.and_then(|from| self.held.get(from..)).unwrap_or_default()
    }

    /// Fetches the part where reading stands: twice as much as the last one where it follows that.
    fn fetch(&mut self) -> io::Result<()> {
        let follows = !self.held.is_empty() && self.at == self.held_from + self.held.len() as u64;
        let bytes = if follows { (2 * self.held.len() as u64).min(LONGEST_PART) } else { LEAST_PART };
        let range = self.at..self.length.min(self.at + bytes);
        let options = GetOptions { range: Some(range.clone().into()), ..GetOptions::default() };
        let answer = self.server.wait(async |store| {
            let answer = store.get_opts(&self.place, options).await?;
            Ok((answer.meta.e_tag.clone(), answer.bytes().await?))
        });
        let (e_tag, part) = match answer {
            Err(error) if error.kind() == io::ErrorKind::Unsupported => {
                self.whole = Some(self.fetch_whole()?);
                return Ok(());
            }
            answer => answer?,
        };
        self.is_the_same(&e_tag)?;
        cut_short_before(range.end, range.start + part.len() as u64)?;
        self.held = part.into();
        self.held_from = range.start;
        Ok(())
    }

    /// Fetches all of it into a file without a name.
    fn fetch_whole(&self) -> io::Result<File> {
        let keeping = |error: io::Error| {
            let what = format!("fetching it whole into {}: {error}", std::env::temp_dir().display());
            io::Error::new(error.kind(), what)
        };
        let mut file = tempfile::tempfile().map_err(keeping)?;
        let (e_tag, written) = self.server.wait(async |store| {
            let answer = store.get(&self.place).await?;
            let e_tag = answer.meta.e_tag.clone();
            let mut parts = answer.into_stream();
            let mut written = 0;
            loop {
                match parts.try_next().await {
                    Ok(Some(part)) => match file.write_all(&part) {
                        Ok(()) => written += part.len() as u64,
                        Err(error) => return Ok((e_tag, Err(error))),
                    },
                    Ok(None) => return Ok((e_tag, Ok(written))),
                    Err(error) if gives_no_parts(&error) => return Ok((e_tag, Ok(written))),
                    Err(error) => return Err(error),
                }
            }
        })?;
        self.is_the_same(&e_tag)?;
        cut_short_before(self.length, written.map_err(keeping)?)?;
        Ok(file)
    }

    fn is_the_same(&self, e_tag: &Option<String>) -> io::Result<()> {
        if *e_tag != self.e_tag {
            return Err(io::Error::other("it was replaced while it was read; read it again"));
        }
        Ok(())
    }
}

/// An error where an answer ends before the byte at which it should.
fn cut_short_before(end: u64, there: u64) -> io::Result<()> {
    if there != end {
        let text = format!("the server's answer is cut short at byte {there}");
        return Err(io::Error::new(io::ErrorKind::UnexpectedEof, text));
    }
    Ok(())
}

impl Read for Parts {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.at >= self.length || buffer.is_empty() {
            return Ok(0);
        }
        if self.whole.is_none() && self.at_hand().is_empty() {
            self.fetch()?;
        }
        if let Some(file) = &mut self.whole {
            file.seek(SeekFrom::Start(self.at))?;
            let count = file.read(buffer)?;
            self.at += count as u64;
            return Ok(count);
        }
        let there = self.at_hand();
        let count = there.len().min(buffer.len());
        buffer[..count].copy_from_slice(&there[..count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Parts {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let to = match to {
            SeekFrom::Start(to) => Some(to),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
        };
        self.at = to.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests;
