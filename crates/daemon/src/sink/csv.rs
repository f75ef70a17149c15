//! Cycles as CSV rows.

use std::io::{self, Write};

use seepd_monitor::event::{CycleLine, Event};

/// Writes the header row at the first cycle with features, then a row a cycle.
pub struct CsvSink<W: Write> {
    writer: csv::Writer<W>,
    names: Vec<String>,
    started: bool,
}

impl<W: Write> CsvSink<W> {
    /// Rows with these features.
    pub fn new(out: W, feature_names: Vec<String>) -> Self {
        CsvSink { writer: csv::Writer::from_writer(out), names: feature_names, started: false }
    }

    /// Writes a cycle; flag events have no row of their own.
    ///
    /// # Errors
    /// Writing failed.
    pub fn write_event(&mut self, event: &Event<'_>) -> io::Result<()> {
        let Event::Cycle(line) = event else { return Ok(()) };
        self.write_header()?;
        self.writer.write_record(self.row(line)).map_err(io::Error::other)
    }

    fn write_header(&mut self) -> io::Result<()> {
        if self.started {
            return Ok(());
        }
        self.started = true;
        let fixed = [
            "axis",
            "cycle",
            "t_start_s",
            "t_end_s",
            "t_start_ns",
            "leak_area_m2",
            "interval90_low_m2",
            "interval90_high_m2",
            "leak_flow_lpm",
            "reference_dp_pa",
            "flag",
            "reason",
            "duty_cycle",
        ];
        let header = fixed.into_iter().chain(self.names.iter().map(String::as_str));
        self.writer.write_record(header).map_err(io::Error::other)
    }

    fn row(&self, line: &CycleLine<'_>) -> Vec<String> {
        let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        let mut row = vec![
            line.axis.to_owned(),
            line.cycle.to_string(),
            line.t_start_s.to_string(),
            line.t_end_s.to_string(),
            line.t_start_ns.to_string(),
            number(line.leak_area_m2),
            number(line.interval90_m2.map(|interval| interval[0])),
            number(line.interval90_m2.map(|interval| interval[1])),
            number(line.leak_flow_lpm),
            line.reference_dp_pa.to_string(),
            line.flag.name().to_owned(),
            line.reason.unwrap_or_default().to_owned(),
            line.duty_cycle.unwrap_or_default().to_owned(),
        ];
        row.extend(
            self.names.iter().map(|name| number(line.features.and_then(|features| features.get(name)))),
        );
        row
    }

    /// Writes what is still buffered, the header too, if there was no cycle; gives back what the rows were written into.
    ///
    /// # Errors
    /// Writing failed.
    pub fn finish(mut self) -> io::Result<W> {
        self.write_header()?;
        self.writer.flush()?;
        self.writer.into_inner().map_err(|error| io::Error::other(error.to_string()))
    }
}
