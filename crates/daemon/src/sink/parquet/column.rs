//! From a JSON object to the columns of a schema, as Dremel lays out what is nested: beside each value stand how much of its path is there
//! (definition level) and at which list it goes on (repetition level).

use std::io;

use parquet::basic::{Repetition, Type as Physical};
use parquet::column::writer::{ColumnWriter, ColumnWriterImpl};
use parquet::data_type::{ByteArray, DataType};
use parquet::errors::ParquetError;
use parquet::schema::types::{ColumnDescriptor, Type};
use serde_json::Value;

/// A column's values that are not yet written.
pub(super) struct Column {
    values: Values,
    definitions: Vec<i16>,
    repetitions: Vec<i16>,
}

enum Values {
    Flags(Vec<bool>),
    Integers(Vec<i64>),
    Numbers(Vec<f64>),
    Texts(Vec<ByteArray>),
}

/// Where in its path a value stands.
#[derive(Clone, Copy, Default)]
struct Levels {
    definition: i16,
    repetition: i16,
    /// Lists around it.
    lists: i16,
}

impl Levels {
    /// The next element of a list of these levels.
    fn of_element(self, index: usize) -> Self {
        let lists = self.lists + 1;
        let repetition = if index == 0 { self.repetition } else { lists };
        Levels { definition: self.definition + 1, repetition, lists }
    }
}

impl Column {
    pub(super) fn new(description: &ColumnDescriptor) -> Self {
        let values = match description.physical_type() {
            Physical::BOOLEAN => Values::Flags(Vec::new()),
            Physical::INT64 => Values::Integers(Vec::new()),
            Physical::DOUBLE => Values::Numbers(Vec::new()),
            _ => Values::Texts(Vec::new()),
        };
        Column { values, definitions: Vec::new(), repetitions: Vec::new() }
    }

    /// Takes a value; whether it is of the column's type.
    fn push(&mut self, value: &Value, levels: Levels) -> bool {
        let taken = match &mut self.values {
            Values::Flags(values) => value.as_bool().map(|value| values.push(value)),
            Values::Integers(values) => value.as_i64().map(|value| values.push(value)),
            Values::Numbers(values) => value.as_f64().map(|value| values.push(value)),
            Values::Texts(values) => value.as_str().map(|value| values.push(value.into())),
        };
        self.push_levels(levels);
        taken.is_some()
    }

    fn push_levels(&mut self, levels: Levels) {
        self.definitions.push(levels.definition);
        self.repetitions.push(levels.repetition);
    }

    /// Values that are held, nulls among them.
    #[cfg(test)]
    pub(super) fn held(&self) -> usize {
        self.definitions.len()
    }

    /// Writes what is held, which is then no longer held.
    pub(super) fn write(&mut self, writer: &mut ColumnWriter<'_>) -> Result<(), ParquetError> {
        let levels = (&*self.definitions, &*self.repetitions);
        match (&mut self.values, writer) {
            (Values::Flags(values), ColumnWriter::BoolColumnWriter(writer)) => {
                hand_over(values, levels, writer)
            }
            (Values::Integers(values), ColumnWriter::Int64ColumnWriter(writer)) => {
                hand_over(values, levels, writer)
            }
            (Values::Numbers(values), ColumnWriter::DoubleColumnWriter(writer)) => {
                hand_over(values, levels, writer)
            }
            (Values::Texts(values), ColumnWriter::ByteArrayColumnWriter(writer)) => {
                hand_over(values, levels, writer)
            }
            _ => Err(ParquetError::General("a column of another type than its schema's".to_owned())),
        }?;
        self.definitions.clear();
        self.repetitions.clear();
        Ok(())
    }
}

/// Writes values with their levels of definition and repetition, and holds none of the values any more.
fn hand_over<T: DataType>(
    values: &mut Vec<T::T>,
    (definitions, repetitions): (&[i16], &[i16]),
    writer: &mut ColumnWriterImpl<'_, T>,
) -> Result<(), ParquetError> {
    writer.write_batch(values, Some(definitions), Some(repetitions))?;
    values.clear();
    Ok(())
}

/// Lays an object out over the columns of a schema.
///
/// # Errors
/// A required value is missing, or one is of another type than its column.
pub(super) fn lay_out(root: &Type, row: &Value, columns: &mut [Column]) -> io::Result<()> {
    debug_assert_eq!(without_column(root, row), None);
    put_fields(root, row, Levels::default(), columns)
}

/// Puts each field of a group into its columns.
fn put_fields(group: &Type, value: &Value, levels: Levels, mut columns: &mut [Column]) -> io::Result<()> {
    for field in group.get_fields() {
        let (own, rest) = columns.split_at_mut(leaves(field));
        put(field, &value[field.name()], levels, own)?;
        columns = rest;
    }
    Ok(())
}

/// Puts a value, null where it is absent, into the columns of its node.
fn put(node: &Type, value: &Value, mut levels: Levels, columns: &mut [Column]) -> io::Result<()> {
    if node.is_optional() {
        if value.is_null() {
            put_nothing(levels, columns);
            return Ok(());
        }
        levels.definition += 1;
    }
    if node.is_primitive() {
        let taken = columns.iter_mut().all(|column| column.push(value, levels));
        return if taken { Ok(()) } else { Err(misfit(node, value)) };
    }
    match (repeated(node), value) {
        (None, _) => put_fields(node, value, levels, columns),
        (Some(entry), Value::Array(elements)) => {
            put_entries(entry, elements.iter().map(|element| [element]), levels, columns)
        }
        (Some(entry), Value::Object(fields)) => {
            let fields: Vec<_> = fields.iter().map(|(name, value)| (Value::from(&**name), value)).collect();
            put_entries(entry, fields.iter().map(|(name, value)| [name, value]), levels, columns)
        }
        (Some(_), _) => Err(misfit(node, value)),
    }
}

/// Puts the entries of a list or a map, each of which has a value for each field of the repeated group.
fn put_entries<'v, const N: usize>(
    entry: &Type,
    entries: impl ExactSizeIterator<Item = [&'v Value; N]>,
    levels: Levels,
    columns: &mut [Column],
) -> io::Result<()> {
    if entries.len() == 0 {
        put_nothing(levels, columns);
    }
    for (index, values) in entries.enumerate() {
        let mut columns = &mut *columns;
        for (field, value) in entry.get_fields().iter().zip(values) {
            let (own, rest) = columns.split_at_mut(leaves(field));
            put(field, value, levels.of_element(index), own)?;
            columns = rest;
        }
    }
    Ok(())
}

/// Notes in each column that there is nothing beyond these levels.
fn put_nothing(levels: Levels, columns: &mut [Column]) {
    columns.iter_mut().for_each(|column| column.push_levels(levels));
}

/// The repeated group of a list or a map.
fn repeated(node: &Type) -> Option<&Type> {
    let [entry] = node.get_fields() else { return None };
    (entry.get_basic_info().repetition() == Repetition::REPEATED).then_some(entry)
}

/// Columns of a node.
fn leaves(node: &Type) -> usize {
    if node.is_primitive() { 1 } else { node.get_fields().iter().map(|field| leaves(field)).sum() }
}

fn misfit(node: &Type, value: &Value) -> io::Error {
    io::Error::other(format!("the cycle's `{}` is {value}, which its column does not take", node.name()))
}

/// A field of the object, or of an object in it, that no column has.
fn without_column<'v>(group: &Type, value: &'v Value) -> Option<&'v str> {
    let fields = value.as_object()?;
    fields.iter().find_map(|(name, value)| {
        let Some(field) = group.get_fields().iter().find(|field| field.name() == name) else {
            return Some(&**name);
        };
        match (field.is_primitive(), value) {
            (true, _) => None,
            (false, Value::Array(elements)) => {
                let element =
                    repeated(field)?.get_fields().first().filter(|element| !element.is_primitive())?;
                elements.iter().find_map(|value| without_column(element, value))
            }
            (false, _) if repeated(field).is_some() => None,
            (false, _) => without_column(field, value),
        }
    })
}
