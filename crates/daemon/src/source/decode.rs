//! Message encodings: JSON, protobuf by the descriptor set in the schema, CDR by the ROS 2 message definition in the
//! schema.
//!
//! JSON messages are picked from as text. The others are decoded into the same tree of values that a JSON text
//! would give, so that field paths mean the same in every encoding.

use prost_reflect::{DescriptorPool, DynamicMessage, MapKey, MessageDescriptor, ReflectMessage};
use serde_json::{Map, Number, Value};

use super::fields::{FieldTree, Picked};
use super::mcap_file::SchemaRecord;
use super::ros::RosMessage;

/// What turns a channel's messages into values.
pub enum Decoder {
    /// JSON text.
    Json,
    /// Protobuf, by its message's descriptor.
    Protobuf(MessageDescriptor),
    /// CDR, by its message's definition.
    Cdr(Box<RosMessage>),
}

impl Decoder {
    /// The decoder for a channel of that message encoding and schema.
    ///
    /// # Errors
    /// One line: an encoding that is not read, or a schema that does not parse.
    pub fn new(encoding: &str, schema: Option<&SchemaRecord>) -> Result<Self, String> {
        match (encoding, schema) {
            ("json", _) => Ok(Decoder::Json),
            ("protobuf", Some(schema)) if schema.encoding == "protobuf" => {
                let pool = DescriptorPool::decode(schema.data.as_slice())
                    .map_err(|error| format!("its protobuf schema does not parse: {error}"))?;
                let message = pool.get_message_by_name(&schema.name);
                message.map(Decoder::Protobuf).ok_or_else(|| {
                    format!("its protobuf schema does not define the message `{}`", schema.name)
                })
            }
            ("cdr", Some(schema)) if schema.encoding == "ros2msg" => {
                RosMessage::parse(&schema.name, &schema.data).map(|message| Decoder::Cdr(Box::new(message)))
            }
            ("protobuf" | "cdr", Some(schema)) => Err(format!(
                "has {encoding} messages with a schema in `{}`; this version reads protobuf with `protobuf` and cdr with `ros2msg`",
                schema.encoding
            )),
            ("protobuf" | "cdr", None) => Err(format!("has {encoding} messages without their schema")),
            _ => Err(format!(
                "has the message encoding `{encoding}`; this version reads json, protobuf and cdr"
            )),
        }
    }

    /// Picks the wanted fields out of a message.
    ///
    /// # Errors
    /// One line: the message does not fit its schema, or a wanted field is no number.
    pub fn pick(&self, fields: &FieldTree, message: &[u8], picked: &mut Picked) -> Result<(), String> {
        match self {
            Decoder::Json => fields
                .pick(message, picked)
                .or_else(|_| pick_with_nan(fields, message, picked))
                .map_err(|error| error.to_string()),
            _ => fields.pick_value(&self.value(message)?, picked).map_err(|error| error.to_string()),
        }
    }

    /// The whole message as a tree of values; a number that is none is null.
    ///
    /// # Errors
    /// One line: the message does not fit its schema.
    pub fn value(&self, message: &[u8]) -> Result<Value, String> {
        match self {
            Decoder::Json => serde_json::from_slice(message).map_err(|error| error.to_string()),
            Decoder::Protobuf(descriptor) => DynamicMessage::decode(descriptor.clone(), message)
                .map(|message| of_protobuf_message(&message))
                .map_err(|error| format!("does not fit its schema: {error}")),
            Decoder::Cdr(definition) => definition.decode(message),
        }
    }
}

/// Some writers put NaN and Infinity into JSON, which has neither: reads them as null.
#[cold]
fn pick_with_nan(fields: &FieldTree, json: &[u8], picked: &mut Picked) -> Result<(), serde_json::Error> {
    let text = String::from_utf8_lossy(json);
    let mended = text.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null");
    fields.pick(mended.as_bytes(), picked)
}

/// A JSON number; null for one that is none.
pub(crate) fn number(value: f64) -> Value {
    Number::from_f64(value).map_or(Value::Null, Value::Number)
}

fn of_protobuf_message(message: &DynamicMessage) -> Value {
    let fields = message.descriptor().fields().collect::<Vec<_>>();
    let pairs = fields.iter().map(|field| (field.name().to_owned(), of_protobuf(&message.get_field(field))));
    Value::Object(pairs.collect::<Map<_, _>>())
}

fn of_protobuf(value: &prost_reflect::Value) -> Value {
    use prost_reflect::Value as P;
    match value {
        P::Bool(bit) => Value::Bool(*bit),
        P::I32(value) | P::EnumNumber(value) => Value::from(*value),
        P::I64(value) => Value::from(*value),
        P::U32(value) => Value::from(*value),
        P::U64(value) => Value::from(*value),
        P::F32(value) => number(f64::from(*value)),
        P::F64(value) => number(*value),
        P::Message(message) => of_protobuf_message(message),
        P::List(values) => Value::Array(values.iter().map(of_protobuf).collect()),
        P::Map(pairs) => {
            Value::Object(pairs.iter().map(|(key, value)| (key_text(key), of_protobuf(value))).collect())
        }
        P::String(text) => Value::String(text.clone()),
        P::Bytes(_) => Value::Null,
    }
}

fn key_text(key: &MapKey) -> String {
    match key {
        MapKey::Bool(key) => key.to_string(),
        MapKey::I32(key) => key.to_string(),
        MapKey::I64(key) => key.to_string(),
        MapKey::U32(key) => key.to_string(),
        MapKey::U64(key) => key.to_string(),
        MapKey::String(key) => key.clone(),
    }
}
