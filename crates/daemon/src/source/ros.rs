//! ROS 2 messages: CDR by the `ros2msg` definition in the log's schema.
//!
//! The definition's grammar is `re_ros_msg`'s, the primitives on the wire are `re_cdr`'s. The walk along the definition is
//! here: it looks how much there is before it believes a length, and how deep it is before it follows a type
//! (found by fuzzing: a sequence of 4 thousand million elements reserves memory for them).

use std::collections::HashMap;

use re_cdr::{BigEndian, CdrEndian, CdrReader, LittleEndian};
use re_ros_msg::MessageSchema;
use re_ros_msg::message_spec::{
    ArraySize, BuiltInType, ComplexType, MessageSpecification, Type, message_package,
};
use serde_json::{Map, Value};

use super::decode::number;

/// A ROS 2 message's definition with those that it refers to.
pub struct RosMessage {
    spec: MessageSpecification,
    dependencies: HashMap<String, MessageSpecification>,
}

/// Bytes before a CDR message: representation and options (DDS-XTypes 1.3, 7.6.3.1.2).
const ENCAPSULATION_BYTES: usize = 4;
/// Messages within messages that are followed; real ones have five levels or so.
const DEEPEST: usize = 32;

impl RosMessage {
    /// Reads a definition.
    ///
    /// # Errors
    /// One line: the text does not parse.
    pub fn parse(name: &str, definition: &[u8]) -> Result<Self, String> {
        let text =
            std::str::from_utf8(definition).map_err(|_| "its ros2msg schema is not text".to_owned())?;
        let parsed = MessageSchema::parse(name, text)
            .map_err(|error| format!("its ros2msg schema does not parse: {error:#}").replace('\n', " "))?;
        let dependencies =
            parsed.dependencies.into_iter().map(|spec| (short_name(&spec.name), spec)).collect();
        Ok(RosMessage { spec: parsed.spec, dependencies })
    }

    /// The message as a tree of values.
    ///
    /// # Errors
    /// One line: the message does not fit its definition.
    pub fn decode(&self, message: &[u8]) -> Result<Value, String> {
        let (encapsulation, body) = message
            .split_at_checked(ENCAPSULATION_BYTES)
            .ok_or_else(|| format!("{} bytes are no CDR message", message.len()))?;
        // The second byte is the representation: plain CDR, big or little endian.
        match encapsulation[1] {
            0 => self.message(&mut CdrReader::<BigEndian>::new(body), &self.spec, 0),
            1 => self.message(&mut CdrReader::<LittleEndian>::new(body), &self.spec, 0),
            other => Err(format!("CDR representation {other} is not read; plain CDR is 0 or 1")),
        }
        .map_err(|what| format!("does not fit its schema: {what}"))
    }

    fn message<B: CdrEndian>(
        &self,
        reader: &mut CdrReader<'_, B>,
        spec: &MessageSpecification,
        depth: usize,
    ) -> Result<Value, String> {
        if depth > DEEPEST {
            return Err(format!("`{}` lies more than {DEEPEST} messages deep", spec.name));
        }
        let mut fields = Map::new();
        for field in &spec.fields {
            let value = self
                .value(reader, spec, &field.ty, depth)
                .map_err(|what| format!("{}: {what}", field.name))?;
            fields.insert(field.name.clone(), value);
        }
        Ok(Value::Object(fields))
    }

    fn value<B: CdrEndian>(
        &self,
        reader: &mut CdrReader<'_, B>,
        scope: &MessageSpecification,
        ty: &Type,
        depth: usize,
    ) -> Result<Value, String> {
        match ty {
            Type::BuiltIn(kind) => scalar(reader, kind),
            Type::Complex(name) => {
                let spec = self.resolve(scope, name).ok_or_else(|| format!("{name:?} is not defined"))?;
                // A message of constants alone stands for an enumeration, which is its number on the wire.
                match spec.underlying_type_if_enum_like().map_err(|error| error.to_string())? {
                    Some(kind) => scalar(reader, kind),
                    None => self.message(reader, spec, depth + 1),
                }
            }
            Type::Array { ty, size } => {
                let count = match size {
                    ArraySize::Fixed(count) => *count,
                    ArraySize::Bounded(_) | ArraySize::Unbounded => {
                        reader.read_sequence_length().map_err(|error| error.to_string())?
                    }
                };
                if count > reader.remaining() {
                    return Err(format!("{count} elements in {} bytes", reader.remaining()));
                }
                (0..count)
                    .map(|_| self.value(reader, scope, ty, depth + 1))
                    .collect::<Result<_, _>>()
                    .map(Value::Array)
            }
        }
    }

    fn resolve(&self, scope: &MessageSpecification, ty: &ComplexType) -> Option<&MessageSpecification> {
        let full_name = match ty {
            ComplexType::Absolute { package, name } => format!("{package}/{name}"),
            ComplexType::Relative { name } => match message_package(&scope.name) {
                Some(package) => format!("{package}/{name}"),
                None => name.clone(),
            },
        };
        self.dependencies.get(&short_name(&full_name))
    }
}

/// `pkg/msg/Type` and `pkg/Type` are the same.
fn short_name(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

fn scalar<B: CdrEndian>(reader: &mut CdrReader<'_, B>, kind: &BuiltInType) -> Result<Value, String> {
    let value = match kind {
        BuiltInType::Bool => reader.read_bool().map(Value::from),
        BuiltInType::Byte | BuiltInType::Char | BuiltInType::UInt8 => reader.read_u8().map(Value::from),
        BuiltInType::Int8 => reader.read_i8().map(Value::from),
        BuiltInType::Int16 => reader.read_i16().map(Value::from),
        BuiltInType::UInt16 => reader.read_u16().map(Value::from),
        BuiltInType::Int32 => reader.read_i32().map(Value::from),
        BuiltInType::UInt32 => reader.read_u32().map(Value::from),
        BuiltInType::Int64 => reader.read_i64().map(Value::from),
        BuiltInType::UInt64 => reader.read_u64().map(Value::from),
        BuiltInType::Float32 => reader.read_f32().map(|value| number(f64::from(value))),
        BuiltInType::Float64 => reader.read_f64().map(number),
        BuiltInType::String(_) => reader.read_string().map(Value::from),
        BuiltInType::WString(_) => return Err("wstring is not read".into()),
    };
    value.map_err(|error| error.to_string())
}
