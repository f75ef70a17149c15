//! The files that a replay writes besides standard output.

use std::io;
use std::path::PathBuf;

use seepd_monitor::event::Event;
use seepd_monitor::pipeline::DutyCycle;

use super::ReplayArguments;
use crate::config::AxisConfig;
use crate::failure::Failure;
use crate::output::{Output, OutputFile, Outputs};
use crate::sink::csv::CsvSink;
use crate::sink::html::HtmlSink;
use crate::sink::mcap::EventSink;
#[cfg(feature = "parquet")]
use crate::sink::parquet::ParquetSink;

/// Where events go besides standard output.
pub(super) struct Files {
    /// Those that grow with the record, by their paths as they were given.
    growing: Vec<(PathBuf, Box<dyn Growing>)>,
    /// The page, which is written at the end.
    pub(super) html: Option<(Output, HtmlSink)>,
}

/// A file that takes events as they come.
trait Growing {
    fn write_event(&mut self, event: &Event<'_>) -> io::Result<()>;

    /// Writes what is still held, and what ends the file.
    fn end(self: Box<Self>) -> io::Result<OutputFile>;
}

impl Growing for CsvSink<OutputFile> {
    fn write_event(&mut self, event: &Event<'_>) -> io::Result<()> {
        self.write_event(event)
    }

    fn end(self: Box<Self>) -> io::Result<OutputFile> {
        self.finish()
    }
}

impl Growing for EventSink<OutputFile> {
    fn write_event(&mut self, event: &Event<'_>) -> io::Result<()> {
        self.write_event(event)
    }

    fn end(self: Box<Self>) -> io::Result<OutputFile> {
        self.finish()
    }
}

#[cfg(feature = "parquet")]
impl Growing for ParquetSink<OutputFile> {
    fn write_event(&mut self, event: &Event<'_>) -> io::Result<()> {
        self.write_event(event)
    }

    fn end(self: Box<Self>) -> io::Result<OutputFile> {
        self.finish()
    }
}

impl Files {
    /// Begins the files that were asked for.
    ///
    /// # Errors
    /// [`Failure`] where one may not be written, or cannot be.
    pub(super) fn begin(
        arguments: &ReplayArguments,
        config: &AxisConfig,
        duty_cycles: &[DutyCycle],
    ) -> Result<Self, Failure> {
        let logs = arguments.logs.iter().map(PathBuf::as_path);
        let inputs = logs
            .chain(arguments.reading.files(config))
            .chain(arguments.baseline.file())
            .chain(arguments.repairs.file());
        let mut outputs = Outputs::new(arguments.overwrite, inputs);
        // All are claimed before the first is begun.
        let csv = outputs.claim_any(arguments.csv.as_ref())?;
        let mcap = outputs.claim_any(arguments.mcap.as_ref())?;
        #[cfg(feature = "parquet")]
        let parquet = outputs.claim_any(arguments.parquet.as_ref())?;
        let html = outputs.claim_any(arguments.html.as_ref())?;
        let before_below_lpm = config.alarm.clear_share * config.alarm.watch_lpm;
        let mut files = Files {
            growing: Vec::new(),
            html: html.map(|output| (output, HtmlSink::new(duty_cycles, before_below_lpm))),
        };
        files.grow(csv, |file| Ok(CsvSink::new(file, DutyCycle::feature_names(duty_cycles))))?;
        files.grow(mcap, EventSink::new)?;
        #[cfg(feature = "parquet")]
        files.grow(parquet, ParquetSink::new)?;
        Ok(files)
    }

    /// Begins a file that grows, where it was asked for.
    fn grow<S: Growing + 'static>(
        &mut self,
        output: Option<Output>,
        begin: impl FnOnce(OutputFile) -> io::Result<S>,
    ) -> Result<(), Failure> {
        let Some(output) = output else { return Ok(()) };
        let path = output.path().to_owned();
        let sink = begin(output.create()?).map_err(|error| Failure::writing(&path, error))?;
        self.growing.push((path, Box::new(sink)));
        Ok(())
    }

    /// Writes an event to each.
    ///
    /// # Errors
    /// [`Failure`] where writing failed.
    pub(super) fn write(&mut self, event: &Event<'_>) -> Result<(), Failure> {
        for (path, sink) in &mut self.growing {
            sink.write_event(event).map_err(|error| Failure::writing(path, error))?;
        }
        if let Some((_, sink)) = &mut self.html {
            sink.take_event(event);
        }
        Ok(())
    }

    /// Ends the files and puts them in their places.
    ///
    /// # Errors
    /// [`Failure`] where writing failed.
    pub(super) fn finish(self) -> Result<(), Failure> {
        for (path, sink) in self.growing {
            sink.end().map_err(|error| Failure::writing(&path, error))?.finish()?;
        }
        Ok(())
    }
}
