//! Samples from a bus's log, whatever its format, by the names that a DBC file gives.

use seepd_signals::Sample;

use super::Source;
use crate::can::decode::FrameDecoder;
use crate::can::logged::{FrameError, FrameLog, LoggedFrame};
use crate::error::LogError;

/// Frames after which stamps that share one second are no coincidence.
const STAMPS_LOOKED_AT: u64 = 200;

/// Samples from the frames of a log.
pub struct BusLogSource<'i> {
    name: String,
    frames: Box<dyn FrameLog + Send + 'i>,
    decoder: FrameDecoder,
    stamps: Stamps,
    unreadable: Unreadable,
}

/// Frames that could not be read.
#[derive(Debug, Default)]
pub(crate) struct Unreadable {
    pub(crate) count: u64,
    first: Option<String>,
}

/// Whether the stamps resolve the time between frames.
#[derive(Default)]
struct Stamps {
    frames: u64,
    /// Of these, how many have the stamp of the frame before.
    shared: u64,
    newest_ns: Option<i64>,
    fractions: bool,
}

impl<'i> BusLogSource<'i> {
    /// Reads frames as the decoder takes them.
    pub fn new(frames: Box<dyn FrameLog + Send + 'i>, name: &str, decoder: FrameDecoder) -> Self {
        let (stamps, unreadable) = (Stamps::default(), Unreadable::default());
        BusLogSource { name: name.into(), frames, decoder, stamps, unreadable }
    }

    fn check_stamps(&self) -> Result<(), LogError> {
        let Stamps { frames, shared, fractions, .. } = self.stamps;
        if fractions || shared * 2 < frames || frames < 2 {
            return Ok(());
        }
        Err(LogError::data(
            &self.name,
            format!(
                "its time stamps are whole seconds ({shared} of the first {frames} frames share the stamp of the frame \
             before), so the time between samples is lost; record with `candump -l`, which writes microseconds"
            ),
        ))
    }

    fn nothing_matched(&self) -> LogError {
        let wanted = self.decoder.command_place();
        let too_short = self.decoder.counts().too_short;
        let short = if too_short > 0 {
            format!(", {too_short} of them too short for the mapped signals")
        } else {
            String::new()
        };
        let unreadable = self.unreadable.note().map_or(String::new(), |note| format!("; {note}"));
        LogError::data(
            &self.name,
            format!(
                "no frame carries {wanted}; the log has {} frames{short}; `seepd inspect` lists them{unreadable}",
                self.stamps.frames
            ),
        )
    }
}

impl Unreadable {
    pub(crate) fn take(&mut self, what: FrameError, frames: &dyn FrameLog) {
        self.count += 1;
        self.first.get_or_insert_with(|| format!("{}: {what}", frames.place()));
    }

    pub(crate) fn note(&self) -> Option<String> {
        let first = self.first.as_ref()?;
        let unit = if first.starts_with("line") { "lines" } else { "frames" };
        Some(format!("{} {unit} were left out, the first at {first}", self.count))
    }
}

impl Stamps {
    fn take(&mut self, time_ns: i64) {
        self.frames += 1;
        self.fractions |= time_ns % 1_000_000_000 != 0;
        self.shared += u64::from(self.newest_ns == Some(time_ns));
        self.newest_ns = Some(time_ns);
    }
}

impl Source for BusLogSource<'_> {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        loop {
            let next = self.frames.next_frame().map_err(|error| LogError::reading(&self.name, error))?;
            let sample = match next {
                None => {
                    self.check_stamps()?;
                    return if self.decoder.counts().given == 0 {
                        Err(self.nothing_matched())
                    } else {
                        Ok(None)
                    };
                }
                Some(Ok(LoggedFrame { time_ns, interface, frame })) => {
                    self.stamps.take(time_ns);
                    self.decoder.take(&frame, interface.name(), time_ns)
                }
                Some(Err(what)) => {
                    self.unreadable.take(what, &*self.frames);
                    continue;
                }
            };
            if self.stamps.frames == STAMPS_LOOKED_AT {
                self.check_stamps()?;
            }
            if sample.is_some() {
                return Ok(sample);
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let counts = self.decoder.counts();
        let notes = [
            (counts.too_short, "frames were left out, since they are too short for their signals"),
            (counts.not_available, "frames were left out, since they say that a signal is not available"),
            (counts.remote, "remote frames, which carry no data"),
            (counts.error, "error frames"),
            (counts.missing, "frames lost before the log, by their counter"),
            (counts.repeated, "frames sent twice, or by two senders, by their counter"),
            (counts.jumps, "times that the counter of the frames went back"),
        ];
        let counted = notes.into_iter().filter(|(count, _)| *count > 0);
        let counted = counted.map(|(count, what)| format!("{count} {what}"));
        let notes = self.frames.notes().into_iter().chain(self.unreadable.note()).chain(counted);
        notes.map(|note| format!("{}: {note}", self.name)).collect()
    }
}
