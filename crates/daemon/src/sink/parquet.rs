//! Cycles as rows of a Parquet file: the fields of `seepd.cycle/1`, typed, the nested ones as lists, maps and groups.
//!
//! A cycle's JSON is laid out by the schema, so that the file has what the line has. Rows are held until a row group is full and are then
//! written: memory does not grow with the record, but for the footer's line on each group.

mod column;
mod schema;

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::SchemaDescriptor;
use seepd_logs::record::knows_date;
use seepd_monitor::event::{CycleLine, Event};
use serde_json::Value;

use column::Column;

/// Rows of a group: at 10 s a cycle three hours, and some MiB while they are held.
const GROUP_ROWS: usize = 1000;

/// Writes a row a cycle.
pub struct ParquetSink<W: Write + Send> {
    writer: SerializedFileWriter<W>,
    schema: Arc<SchemaDescriptor>,
    columns: Vec<Column>,
    rows: usize,
    /// Whether the record's clock knows the date; its first cycle tells.
    dated: Option<bool>,
}

impl<W: Write + Send> ParquetSink<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Writing failed.
    pub fn new(out: W) -> io::Result<Self> {
        let root = schema::cycle().map_err(said)?;
        let schema = Arc::new(SchemaDescriptor::new(root.clone()));
        let columns = schema.columns().iter().map(|column| Column::new(column)).collect();
        let version = KeyValue::new("seepd.schema".to_owned(), "seepd.cycle/1".to_owned());
        let properties = WriterProperties::builder()
            .set_created_by(concat!("seepd ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_key_value_metadata(Some(vec![version]))
            .build();
        let writer = SerializedFileWriter::new(out, root, Arc::new(properties)).map_err(said)?;
        Ok(ParquetSink { writer, schema, columns, rows: 0, dated: None })
    }

    /// Takes a cycle; changes of flag show in the cycles' flags.
    ///
    /// # Errors
    /// Writing failed.
    pub fn write_event(&mut self, event: &Event<'_>) -> io::Result<()> {
        let Event::Cycle(line) = event else { return Ok(()) };
        let row = self.row(line)?;
        column::lay_out(self.schema.root_schema(), &row, &mut self.columns)?;
        self.rows += 1;
        if self.rows == GROUP_ROWS { self.write_group() } else { Ok(()) }
    }

    /// The cycle's line with its dates, where the record has dates.
    fn row(&mut self, line: &CycleLine<'_>) -> io::Result<Value> {
        let mut row = serde_json::to_value(line)?;
        if *self.dated.get_or_insert_with(|| knows_date(line.t_start_ns)) {
            row["t_start"] = line.t_start_ns.into();
            row["t_end"] = line.t_end_ns().into();
        }
        Ok(row)
    }

    fn write_group(&mut self) -> io::Result<()> {
        let mut group = self.writer.next_row_group().map_err(said)?;
        for column in &mut self.columns {
            let Some(mut writer) = group.next_column().map_err(said)? else { break };
            column.write(writer.untyped()).and_then(|()| writer.close()).map_err(said)?;
        }
        group.close().map_err(said)?;
        self.rows = 0;
        Ok(())
    }

    /// Writes the last rows and the footer, and gives back what the file was written into.
    ///
    /// # Errors
    /// Writing failed.
    pub fn finish(mut self) -> io::Result<W> {
        if self.rows > 0 {
            self.write_group()?;
        }
        self.writer.into_inner().map_err(said)
    }
}

/// What the operating system said, where it was asked.
fn said(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(error) => match error.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(error) => io::Error::other(error),
        },
        error => io::Error::other(error),
    }
}

#[cfg(test)]
mod tests;
