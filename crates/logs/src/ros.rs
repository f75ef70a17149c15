//! ROS 2 messages: CDR by the `ros2msg` definition in the log's schema, shown to a visitor as they are read.
//!
//! The definition's grammar is `re_ros_msg`'s, the primitives on the wire are `re_cdr`'s. The walk along the definition is
//! here: it looks how much there is before it believes a length, how deep it is before it follows a type, and how far it has
//! gone.

use std::collections::HashMap;

use re_cdr::{BigEndian, CdrEndian, CdrReader, LittleEndian};
use re_ros_msg::message_spec::{
    ArraySize, BuiltInType, ComplexType, MessageSpecification, Type, message_package,
};
use re_ros_msg::{MessageSchema, is_schema_separator};

use super::fields::{DEEPEST, FREE_STEPS, FieldVisitor, Step};
use super::message_error::{MessageError, Misfit};
use super::schema_error::SchemaError;

/// A ROS 2 message's definition with those that it refers to.
pub(crate) struct RosMessage {
    spec: MessageSpecification,
    dependencies: HashMap<String, MessageSpecification>,
}

/// Bytes before a CDR message: representation and options (DDS-XTypes 1.3, 7.6.3.1.2).
const ENCAPSULATION_BYTES: usize = 4;

impl RosMessage {
    /// Reads a definition.
    ///
    /// # Errors
    /// [`SchemaError`]: it is not text, or does not parse.
    pub(crate) fn parse(name: &str, definition: &[u8]) -> Result<Self, SchemaError> {
        let text = std::str::from_utf8(definition).map_err(|_| SchemaError::NotText)?;
        let parsed = MessageSchema::parse(name, &without_literals(text))
            .map_err(|error| SchemaError::Definition { what: format!("{error:#}").replace('\n', " ") })?;
        let dependencies =
            parsed.dependencies.into_iter().map(|spec| (short_name(&spec.name), spec)).collect();
        Ok(RosMessage { spec: parsed.spec, dependencies })
    }

    /// Shows a message to a visitor.
    ///
    /// # Errors
    /// [`MessageError`]: the message does not fit its definition, or a wanted field is no number.
    pub(crate) fn visit(&self, message: &[u8], visitor: &mut impl FieldVisitor) -> Result<(), MessageError> {
        let (encapsulation, body) = message
            .split_at_checked(ENCAPSULATION_BYTES)
            .ok_or(MessageError::NotCdr { bytes: message.len() })?;
        // The second byte is the representation: plain CDR, big or little endian.
        match encapsulation[1] {
            0 => self.walk(CdrReader::<BigEndian>::new(body), visitor)?,
            1 => self.walk(CdrReader::<LittleEndian>::new(body), visitor)?,
            code => return Err(MessageError::Misfit(Misfit::Representation { code }.into())),
        }
        Ok(())
    }

    fn walk<B: CdrEndian>(
        &self,
        reader: CdrReader<'_, B>,
        visitor: &mut impl FieldVisitor,
    ) -> Result<(), Box<Misfit>> {
        let steps = reader.remaining() + FREE_STEPS;
        Walk { definition: self, reader, steps }.message(&self.spec, Some(visitor), 0)
    }

    fn resolve(&self, scope: &MessageSpecification, ty: &ComplexType) -> Option<&MessageSpecification> {
        let package = match ty {
            ComplexType::Absolute { .. } => None,
            ComplexType::Relative { .. } => message_package(&scope.name),
        };
        let name = name_of(ty);
        let full_name = package.map_or(name.clone(), |package| format!("{package}/{name}"));
        self.dependencies.get(&short_name(&full_name))
    }
}

/// A type's name, as definitions write it.
fn name_of(ty: &ComplexType) -> String {
    match ty {
        ComplexType::Absolute { package, name } => format!("{package}/{name}"),
        ComplexType::Relative { name } => name.clone(),
    }
}

/// `pkg/msg/Type` and `pkg/Type` are the same.
fn short_name(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

/// A message on its way to a visitor; what the visitor does not want is walked over without one.
struct Walk<'d, 'm, B: CdrEndian> {
    definition: &'d RosMessage,
    reader: CdrReader<'m, B>,
    /// What may still be looked at.
    steps: usize,
}

impl<'d, B: CdrEndian> Walk<'d, '_, B> {
    fn spend(&mut self) -> Result<(), Box<Misfit>> {
        let Some(left) = self.steps.checked_sub(1) else { return Err(Misfit::Endless.into()) };
        self.steps = left;
        Ok(())
    }

    fn message<V: FieldVisitor>(
        &mut self,
        spec: &'d MessageSpecification,
        mut visitor: Option<&mut V>,
        depth: usize,
    ) -> Result<(), Box<Misfit>> {
        if depth > DEEPEST {
            return Err(Misfit::MessageTooDeep { message: spec.name.clone() }.into());
        }
        for field in &spec.fields {
            self.step(Step::Key(&field.name), visitor.as_deref_mut(), |walk, visitor| {
                walk.value(spec, &field.ty, visitor, depth)
            })
            .map_err(|misfit| misfit.in_field(&field.name))?;
        }
        Ok(())
    }

    /// Walks on, with the visitor where it wants what comes.
    fn step<V: FieldVisitor>(
        &mut self,
        step: Step<'_>,
        visitor: Option<&mut V>,
        walk_on: impl FnOnce(&mut Self, Option<&mut V>) -> Result<(), Box<Misfit>>,
    ) -> Result<(), Box<Misfit>> {
        self.spend()?;
        let Some(visitor) = visitor else { return walk_on(self, None) };
        if !visitor.enter(step) {
            return walk_on(self, None);
        }
        walk_on(self, Some(visitor))?;
        visitor.leave();
        Ok(())
    }

    fn value<V: FieldVisitor>(
        &mut self,
        scope: &'d MessageSpecification,
        ty: &'d Type,
        visitor: Option<&mut V>,
        depth: usize,
    ) -> Result<(), Box<Misfit>> {
        match ty {
            Type::BuiltIn(kind) => self.scalar(kind, visitor),
            Type::Complex(name) => {
                let spec = self
                    .definition
                    .resolve(scope, name)
                    .ok_or_else(|| Misfit::Undefined { message: name_of(name) })?;
                self.message(spec, visitor, depth + 1)
            }
            Type::Array { ty, size } => {
                let count = match size {
                    ArraySize::Fixed(count) => *count,
                    ArraySize::Bounded(_) | ArraySize::Unbounded => self.reader.read_sequence_length()?,
                };
                if count > self.reader.remaining() {
                    return Err(Misfit::LongArray { count, bytes: self.reader.remaining() }.into());
                }
                self.elements(scope, ty, count, visitor, depth)
            }
        }
    }

    fn elements<V: FieldVisitor>(
        &mut self,
        scope: &'d MessageSpecification,
        ty: &'d Type,
        count: usize,
        mut visitor: Option<&mut V>,
        depth: usize,
    ) -> Result<(), Box<Misfit>> {
        if let (None, Type::BuiltIn(kind)) = (&visitor, ty)
            && let Some(size) = size_of(kind)
            && count > 0
        {
            // An image that nobody wants is passed over at once.
            self.reader.align(size)?;
            self.reader.read_bytes(count.saturating_mul(size))?;
            return Ok(());
        }
        for index in 0..count {
            self.step(Step::Index(index), visitor.as_deref_mut(), |walk, visitor| {
                walk.value(scope, ty, visitor, depth + 1)
            })?;
        }
        Ok(())
    }

    fn scalar<V: FieldVisitor>(
        &mut self,
        kind: &BuiltInType,
        visitor: Option<&mut V>,
    ) -> Result<(), Box<Misfit>> {
        let reader = &mut self.reader;
        let number = match kind {
            BuiltInType::Bool => reader.read_bool().map(|bit| f64::from(u8::from(bit))),
            BuiltInType::Byte | BuiltInType::Char | BuiltInType::UInt8 => reader.read_u8().map(f64::from),
            BuiltInType::Int8 => reader.read_i8().map(f64::from),
            BuiltInType::Int16 => reader.read_i16().map(f64::from),
            BuiltInType::UInt16 => reader.read_u16().map(f64::from),
            BuiltInType::Int32 => reader.read_i32().map(f64::from),
            BuiltInType::UInt32 => reader.read_u32().map(f64::from),
            BuiltInType::Int64 => reader.read_i64().map(|value| value as f64),
            BuiltInType::UInt64 => reader.read_u64().map(|value| value as f64),
            BuiltInType::Float32 => reader.read_f32().map(f64::from),
            BuiltInType::Float64 => reader.read_f64(),
            BuiltInType::String(_) => {
                let text = reader.read_str()?;
                return Ok(visitor.map_or(Ok(()), |visitor| visitor.text(text))?);
            }
            BuiltInType::WString(_) => return Err(Misfit::WideText.into()),
        };
        let number = number?;
        Ok(visitor.map_or(Ok(()), |visitor| visitor.number(number))?)
    }
}

/// Bytes of a number, which it is also aligned to.
fn size_of(kind: &BuiltInType) -> Option<usize> {
    Some(match kind {
        BuiltInType::Byte | BuiltInType::Char | BuiltInType::UInt8 | BuiltInType::Int8 => 1,
        BuiltInType::Int16 | BuiltInType::UInt16 => 2,
        BuiltInType::Int32 | BuiltInType::UInt32 | BuiltInType::Float32 => 4,
        BuiltInType::Int64 | BuiltInType::UInt64 | BuiltInType::Float64 => 8,
        // Of truth values each byte is looked at; texts tell their own length.
        BuiltInType::Bool | BuiltInType::String(_) | BuiltInType::WString(_) => return None,
    })
}

/// What a message without fields, or of constants alone, has on the wire: a structure in C has a member, and ROS 2 sends it.
const ONLY_MEMBER: &str = "uint8 structure_needs_at_least_one_member\n";

/// The definition without comments, constants and default values, which say nothing of where the fields lie, and with the member that a
/// message without fields has. The crate's parser of literals panics on a lone quotation mark (found by fuzzing).
fn without_literals(definition: &str) -> String {
    let mut fields = String::with_capacity(definition.len() + ONLY_MEMBER.len());
    let mut is_empty = true;
    for line in definition.lines() {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_whitespace();
        match (words.next(), words.next(), words.next()) {
            (Some(_), Some(name), next)
                if name.contains('=') || next.is_some_and(|next| next.starts_with('=')) => {}
            (Some(kind), Some(name), _) => {
                is_empty &= kind == "MSG:";
                fields.extend([kind, " ", name]);
            }
            _ => {
                if is_schema_separator(line) && std::mem::replace(&mut is_empty, true) {
                    fields.push_str(ONLY_MEMBER);
                }
                fields.push_str(line);
            }
        }
        fields.push('\n');
    }
    if is_empty {
        fields.push_str(ONLY_MEMBER);
    }
    fields
}

#[cfg(test)]
mod tests {
    use seepd_signals::Signal;

    use super::*;
    use crate::fields::{FieldTree, Picked};
    use crate::mapping::SignalMapping;

    #[test]
    fn literals_are_left_out_and_fields_stay() {
        let separator = "=".repeat(80);
        let definition = format!(
            "# a=b\nint8 LOW=-1\nstring<=9 NAME = \"a # b\"\nstring<=9 name 'x=y' # of the press\nfloat64[2] data [1, 2]\n\
             string lone '\nstring[] lone_too [']\nHeader header#no=constant\n{separator}\nMSG: std_msgs/Header\nstring frame_id \"\""
        );
        let fields = without_literals(&definition);
        let lines: Vec<&str> = fields.lines().filter(|line| !line.is_empty()).collect();
        let expected = [
            "string<=9 name",
            "float64[2] data",
            "string lone",
            "string[] lone_too",
            "Header header",
            &separator,
            "MSG: std_msgs/Header",
            "string frame_id",
        ];
        assert_eq!(lines, expected);
        let message = RosMessage::parse("press/Axis", definition.as_bytes()).unwrap();
        assert_eq!(message.spec.fields.len(), 5);
    }

    /// Bytes of an independent implementation: rosbags 0.11, `serialize_cdr`, with a `Mode` of constants alone and `std_msgs/Empty`.
    #[test]
    fn reference_messages_without_fields_are_a_byte() {
        let separator = "=".repeat(80);
        let definition = format!(
            "Mode mode\nstd_msgs/Empty nothing\nfloat32 command\n{separator}\nMSG: press/Mode\nuint8 OFF=0\nuint8 ON=1\n\
             {separator}\nMSG: std_msgs/Empty\n"
        );
        let message = RosMessage::parse("press/msg/Axis", definition.as_bytes()).unwrap();
        let mapping = SignalMapping { field: "command".into(), ..SignalMapping::default() };
        let tree = FieldTree::of([(Signal::Command, &mapping)].into_iter()).unwrap();
        let mut picked = Picked::default();
        message.visit(&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x3f], &mut tree.picker(&mut picked)).unwrap();
        assert_eq!(picked.values, [(Signal::Command, 0.5)]);
    }
}
