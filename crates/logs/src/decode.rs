//! Message encodings: JSON, protobuf by the descriptor set in the schema, CDR by the ROS 2 message definition in the
//! schema. Each shows a message's fields to a visitor, so that field paths mean the same in every encoding.

use super::fields::{FieldTree, FieldVisitor, Picked};
use super::json;
use super::mcap_file::SchemaRecord;
use super::protobuf::ProtobufMessage;
use super::ros::RosMessage;

/// Longest schema that is read, bytes; those with every comment of every file in them have some hundred thousand.
const LONGEST_SCHEMA: usize = 1 << 20;

/// What the decoders of one log may take, bytes as [`decoder_bytes`] estimates them.
pub(crate) const DECODERS_BYTES: usize = 32 << 20;

/// What a schema's decoder takes at most, bytes: a line of a ROS 2 definition becomes a field, or a type, of some hundred; of a
/// protobuf schema little more than names is kept.
pub(crate) fn decoder_bytes(schema: &SchemaRecord) -> usize {
    let bytes = schema.data.len();
    match &*schema.encoding {
        "ros2msg" => bytes + 256 * schema.data.iter().filter(|byte| **byte == b'\n').count(),
        _ => 8 * bytes,
    }
}

/// What reads a channel's messages.
pub(crate) enum Decoder {
    /// JSON text.
    Json,
    /// Protobuf, by its message's type.
    Protobuf(ProtobufMessage),
    /// CDR, by its message's definition.
    Cdr(Box<RosMessage>),
}

impl Decoder {
    /// The decoder for a channel of that message encoding and schema.
    ///
    /// # Errors
    /// One line: an encoding that is not read, or a schema that does not parse.
    pub(crate) fn new(encoding: &str, schema: Option<&SchemaRecord>) -> Result<Self, String> {
        match (encoding, schema) {
            ("json", _) => Ok(Decoder::Json),
            ("protobuf" | "cdr", Some(schema)) if schema.data.len() > LONGEST_SCHEMA => Err(format!(
                "has a schema of {} bytes; this version reads schemas up to {LONGEST_SCHEMA}",
                schema.data.len()
            )),
            ("protobuf", Some(schema)) if schema.encoding == "protobuf" => {
                ProtobufMessage::parse(&schema.name, &schema.data).map(Decoder::Protobuf)
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
    pub(crate) fn pick(&self, fields: &FieldTree, message: &[u8], picked: &mut Picked) -> Result<(), String> {
        let result = self.visit(message, &mut fields.picker(picked));
        match (self, &result) {
            (Decoder::Json, Err(_)) => match json::mended(message) {
                Some(mended) => json::visit(&mended, &mut fields.picker(picked)),
                None => result,
            },
            _ => result,
        }
    }

    /// Shows a message to a visitor.
    ///
    /// # Errors
    /// One line: the message does not fit its schema, or a wanted field is no number.
    pub(crate) fn visit(&self, message: &[u8], visitor: &mut impl FieldVisitor) -> Result<(), String> {
        match self {
            Decoder::Json => json::visit(message, visitor),
            Decoder::Protobuf(definition) => definition.visit(message, visitor),
            Decoder::Cdr(definition) => definition.visit(message, visitor),
        }
    }
}
