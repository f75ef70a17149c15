//! The second reading of a log, which fills the columns.

use std::collections::{BTreeMap, HashMap};
use std::io::Read;

use mcap::records::op;

use super::grid::{Grid, Place};
use super::unit::unit_in_name;
use super::{Column, TimeColumn, Wanted};
use crate::can::Identifier;
use crate::can::dbc::{CanSignal, Dbc, Reading};
use crate::can::logged::{FrameLog, Interface, LoggedFrame};
use crate::decode::{DECODERS_BYTES, Decoder, decoder_bytes};
use crate::error::LogError;
use crate::fields::Paths;
use crate::mcap::{MESSAGE_HEADER_BYTES, channel_id, log_time_ns};
use crate::mcap_file::{ChannelRecord, Schemas};
use crate::mdf::{MdfFile, MdfFrames};
use crate::record_log::RecordLog;
use crate::survey::FIELDS_KEPT;
use crate::table::{Table, number};
use crate::table_time::{TablePlace, TableTime};

/// A value is held over so many periods of its own topic.
const HELD_PERIODS: f64 = 2.5;

/// See the [module](self).
pub(super) struct Filling {
    grid: Grid,
    columns: Vec<Column>,
    rates_hz: Vec<f64>,
}

/// A topic's columns by their fields' paths.
type Places = HashMap<String, usize>;

/// A signal of a CAN frame, and its column.
type FrameColumn = (CanSignal, usize);

/// The channels of an MCAP log that have columns.
#[derive(Default)]
struct Channels {
    schemas: Schemas,
    /// Bytes that the decoders may take.
    decoder_bytes: usize,
    of_id: BTreeMap<u16, Channel>,
}

struct Channel {
    decoder: Decoder,
    places: Places,
    /// The cell that it last gave values to.
    newest: Option<usize>,
}

impl Channels {
    fn announce(&mut self, record: &[u8], places_of: impl Fn(&str) -> Places) {
        let Some(channel) = ChannelRecord::parse(record) else { return };
        let places = places_of(&channel.topic);
        if places.is_empty() || self.of_id.contains_key(&channel.id) {
            return;
        }
        let schema = self.schemas.get(channel.schema_id);
        self.decoder_bytes += schema.map_or(0, decoder_bytes);
        if let Ok(decoder) = Decoder::new(&channel.encoding, schema)
            && self.decoder_bytes <= DECODERS_BYTES
        {
            self.of_id.insert(channel.id, Channel { decoder, places, newest: None });
        }
    }
}

impl Channel {
    fn take(&mut self, message: &[u8], cell: usize, columns: &mut [Column]) {
        // One message a cell is enough, and spares decoding where a log is thinned.
        if self.newest.replace(cell) == Some(cell) {
            return;
        }
        let mut paths = Paths::new(|path: &str, value: f64| {
            if let Some(index) = self.places.get(path) {
                set(&mut columns[*index].values, cell, value);
            }
        });
        // What was read of a damaged message stands; the survey has told of it.
        let _ = self.decoder.visit(message, &mut paths);
    }
}

impl Filling {
    pub(super) fn new(grid: Grid, wanted: Vec<Wanted>) -> Self {
        let rates_hz = wanted.iter().map(|wanted| wanted.rate_hz).collect();
        let column = |Wanted { topic, field, .. }| {
            let unit = unit_in_name(&field);
            Column { topic, field, unit, values: Vec::new() }
        };
        Filling { grid, columns: wanted.into_iter().map(column).collect(), rates_hz }
    }

    fn places_of(&self, topic: &str) -> Places {
        let of_topic = self.columns.iter().enumerate().filter(|(_, column)| column.topic == topic);
        // Two channels or columns may have one name: the first is meant.
        of_topic.rev().map(|(index, column)| (column.field.clone(), index)).collect()
    }

    pub(super) fn read_records(&mut self, file: &mut dyn RecordLog, name: &str) -> Result<(), LogError> {
        let reading = |error| LogError::reading(name, error);
        let mut channels = Channels::default();
        let mut record = Vec::new();
        while let Some(opcode) = file.next_record(&mut record).map_err(reading)? {
            match opcode {
                op::SCHEMA => channels.schemas.take(&record),
                op::CHANNEL => channels.announce(&record, |topic| self.places_of(topic)),
                op::MESSAGE => {
                    let Some((header, message)) = record.split_at_checked(MESSAGE_HEADER_BYTES) else {
                        continue;
                    };
                    let Some(channel) = channels.of_id.get_mut(&channel_id(header)) else { continue };
                    match self.grid.place(log_time_ns(header)) {
                        Place::End => return Ok(()),
                        Place::In(cell) => channel.take(message, cell, &mut self.columns),
                        Place::Outside => {}
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    pub(super) fn read_csv(
        &mut self,
        input: impl Read,
        name: &str,
        time: &TimeColumn,
    ) -> Result<(), LogError> {
        let mut table =
            Table::new(input, &[&time.column]).map_err(|error| LogError::data(name, error.to_string()))?;
        let places = self.places_of("");
        let of_column: Vec<Option<usize>> =
            table.columns.iter().map(|column| places.get(column).copied()).collect();
        for (index, unit) in of_column.iter().zip(&table.units) {
            if let (Some(index), false) = (index, unit.is_empty()) {
                self.columns[*index].unit = Some(unit.clone());
            }
        }
        let Some(place) = TablePlace::in_column(&table, &time.column, Some(time.unit)) else { return Ok(()) };
        let mut time = TableTime::new(place);
        while let Some(row) = table.next().map_err(|error| LogError::reading(name, error))? {
            let Ok(row) = row else { continue };
            let Ok(time_ns) = time.of_row(row) else { continue };
            match self.grid.place(time_ns) {
                Place::End => return Ok(()),
                Place::Outside => {}
                Place::In(cell) => {
                    for (column, text) in of_column.iter().zip(row.fields()) {
                        if let (Some(index), Some(value)) = (column, number(text)) {
                            set(&mut self.columns[*index].values, cell, value);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    pub(super) fn read_mdf(
        &mut self,
        mut file: MdfFile<'_>,
        name: &str,
        dbc: Option<&Dbc>,
    ) -> Result<(), LogError> {
        let reading = |error| LogError::reading(name, error);
        if file.has_frames() && dbc.is_some() {
            let mut frames = MdfFrames::new(file).map_err(reading)?;
            return self.read_frames(&mut frames, name, dbc);
        }
        let mut places: HashMap<(usize, usize), Vec<Option<usize>>> = HashMap::new();
        file.each_record(|record| {
            let Place::In(cell) = self.grid.place(record.time_ns) else { return };
            let of_topic = places.entry(record.topic).or_default();
            for (place, channel, unit, value) in record.numbers() {
                if of_topic.len() <= place {
                    of_topic.resize(place + 1, None);
                    let found = self.places_of(record.topic_name()).get(channel).copied();
                    if let (Some(index), false) = (found, unit.is_empty()) {
                        self.columns[index].unit = Some(unit.to_owned());
                    }
                    of_topic[place] = found;
                }
                if let Some(index) = of_topic[place] {
                    set(&mut self.columns[index].values, cell, value);
                }
            }
        })
        .map_err(reading)
    }

    pub(super) fn read_frames(
        &mut self,
        frames: &mut dyn FrameLog,
        name: &str,
        dbc: Option<&Dbc>,
    ) -> Result<(), LogError> {
        let mut signals: HashMap<(Interface, Identifier), Vec<FrameColumn>> = HashMap::new();
        while let Some(frame) = frames.next_frame().map_err(|error| LogError::reading(name, error))? {
            let Ok(LoggedFrame { time_ns, interface, frame }) = frame else { continue };
            let key = (interface, frame.identifier);
            let of_frame = match signals.get(&key) {
                Some(of_frame) => of_frame,
                None => {
                    let of_frame = self.signals_of(interface.name(), frame.identifier, dbc);
                    signals.entry(key).or_insert(of_frame)
                }
            };
            match self.grid.place(time_ns) {
                Place::End => return Ok(()),
                Place::Outside => {}
                Place::In(cell) => {
                    for (signal, index) in of_frame {
                        if let Reading::Value(value) = signal.read(&frame) {
                            set(&mut self.columns[*index].values, cell, value);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// The signals of a frame that are wanted, with their columns, whose units the DBC file tells.
    fn signals_of(
        &mut self,
        interface: &[u8],
        identifier: Identifier,
        dbc: Option<&Dbc>,
    ) -> Vec<FrameColumn> {
        let places = self.places_of(&String::from_utf8_lossy(interface));
        let signals = dbc.map(|dbc| dbc.signals_of(identifier, FIELDS_KEPT)).unwrap_or_default();
        let wanted = signals.into_iter().filter_map(|signal| {
            let index = *places.get(&signal.name)?;
            Some((signal, index))
        });
        let wanted: Vec<_> = wanted.collect();
        for (signal, index) in &wanted {
            if !signal.unit.is_empty() {
                self.columns[*index].unit = Some(signal.unit.clone());
            }
        }
        wanted
    }

    /// Time of the first sample, rate, and the columns with values held.
    pub(super) fn finish(mut self) -> (i64, f64, Vec<Column>) {
        let length = self.columns.iter().map(|column| column.values.len()).max().unwrap_or_default();
        for (column, rate_hz) in self.columns.iter_mut().zip(&self.rates_hz) {
            column.values.resize(length, f32::NAN);
            hold(&mut column.values, (HELD_PERIODS * self.grid.rate_hz / rate_hz) as usize);
        }
        (self.grid.start_ns(), self.grid.rate_hz, self.columns)
    }
}

/// Sets a cell; the first value in it stays.
fn set(values: &mut Vec<f32>, cell: usize, value: f64) {
    if values.len() <= cell {
        values.resize(cell + 1, f32::NAN);
    }
    if values[cell].is_nan() {
        values[cell] = value as f32;
    }
}

/// Fills gaps of up to so many cells with the value before them; longer ones as far as that goes.
fn hold(values: &mut [f32], cells: usize) {
    let (mut last, mut age) = (f32::NAN, 0);
    for value in values {
        if value.is_nan() {
            age += 1;
            if age <= cells {
                *value = last;
            }
        } else {
            (last, age) = (*value, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_held_so_long_and_no_longer() {
        let none = f32::NAN;
        let mut values = [none, 1.0, none, none, none, 2.0, none];
        hold(&mut values, 2);
        assert_eq!(
            values.map(|value| if value.is_nan() { -1.0 } else { value }),
            [-1.0, 1.0, 1.0, 1.0, -1.0, 2.0, 2.0]
        );
    }
}
