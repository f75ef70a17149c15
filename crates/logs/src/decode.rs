//! Message encodings: JSON, protobuf by the descriptor set in the schema, CDR by the ROS 2 message definition in the
//! schema. Each shows a message's fields to a visitor, so that field paths mean the same in every encoding.

use super::fields::{FieldTree, FieldVisitor, Picked};
use super::json;
use super::mcap_file::SchemaRecord;
use super::message_error::MessageError;
use super::protobuf::ProtobufMessage;
use super::ros::RosMessage;
use super::schema_error::SchemaError;

/// Longest schema that is read, bytes; those with every comment of every file in them have some hundred thousand.
pub(super) const LONGEST_SCHEMA: usize = 1 << 20;

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
    /// [`SchemaError`]: an encoding that is not read, or a schema that does not parse.
    pub(crate) fn new(encoding: &str, schema: Option<&SchemaRecord>) -> Result<Self, SchemaError> {
        match (encoding, schema) {
            ("json", _) => Ok(Decoder::Json),
            ("protobuf" | "cdr", Some(schema)) if schema.data.len() > LONGEST_SCHEMA => {
                Err(SchemaError::TooLong { bytes: schema.data.len() })
            }
            ("protobuf", Some(schema)) if schema.encoding == "protobuf" => {
                ProtobufMessage::parse(&schema.name, &schema.data).map(Decoder::Protobuf)
            }
            ("cdr", Some(schema)) if schema.encoding == "ros2msg" => {
                RosMessage::parse(&schema.name, &schema.data).map(|message| Decoder::Cdr(Box::new(message)))
            }
            ("protobuf" | "cdr", Some(schema)) => {
                Err(SchemaError::OtherKind { encoding: encoding.into(), schema: schema.encoding.clone() })
            }
            ("protobuf" | "cdr", None) => Err(SchemaError::Missing { encoding: encoding.into() }),
            _ => Err(SchemaError::Encoding { encoding: encoding.into() }),
        }
    }

    /// Picks the wanted fields out of a message.
    ///
    /// # Errors
    /// [`MessageError`]: the message does not fit its schema, or a wanted field is no number.
    pub(crate) fn pick(
        &self,
        fields: &FieldTree,
        message: &[u8],
        picked: &mut Picked,
    ) -> Result<(), MessageError> {
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
    /// [`MessageError`]: the message does not fit its schema, or a wanted field is no number.
    pub(crate) fn visit(&self, message: &[u8], visitor: &mut impl FieldVisitor) -> Result<(), MessageError> {
        match self {
            Decoder::Json => json::visit(message, visitor),
            Decoder::Protobuf(definition) => definition.visit(message, visitor),
            Decoder::Cdr(definition) => definition.visit(message, visitor),
        }
    }
}

#[cfg(test)]
mod tests {
    use seepd_signals::Signal;

    use super::*;
    use crate::fuzzing::Walk;
    use crate::mapping::SignalMapping;

    fn varint(mut value: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        while value >= 0x80 {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
        bytes
    }

    fn number(field: usize, value: usize) -> Vec<u8> {
        [varint(field << 3), varint(value)].concat()
    }

    fn bytes(field: usize, body: impl AsRef<[u8]>) -> Vec<u8> {
        let body = body.as_ref();
        [varint(field << 3 | 2), varint(body.len()), body.to_vec()].concat()
    }

    /// A field of a protobuf message: its name, number, code of its type and that type's name.
    fn field(name: impl AsRef<[u8]>, place: usize, code: usize, kind: &str) -> Vec<u8> {
        bytes(2, [bytes(1, name), number(3, place), number(5, code), bytes(6, kind)].concat())
    }

    /// A descriptor set with a message `M` of these fields, or of other parts of its definition.
    fn set(fields: &[Vec<u8>]) -> Vec<u8> {
        bytes(1, bytes(4, [bytes(1, "M"), fields.concat()].concat()))
    }

    fn schema(name: &str, encoding: &str, data: impl Into<Vec<u8>>) -> SchemaRecord {
        SchemaRecord { id: 1, name: name.into(), encoding: encoding.into(), data: data.into() }
    }

    fn refused(encoding: &str, schema: Option<&SchemaRecord>) -> String {
        Decoder::new(encoding, schema).err().unwrap().to_string()
    }

    fn unreadable(decoder: &Decoder, message: &[u8]) -> String {
        decoder.visit(message, &mut Walk::default()).unwrap_err().to_string()
    }

    #[test]
    fn channels_without_a_decoder_say_why() {
        let long = schema("M", "protobuf", vec![0; LONGEST_SCHEMA + 1]);
        for (encoding, schema, told) in [
            ("ros1", None, "has the message encoding `ros1`; this version reads json, protobuf and cdr"),
            ("cdr", None, "has cdr messages without their schema"),
            (
                "protobuf",
                Some(&schema("M", "ros2msg", "")),
                "has protobuf messages with a schema in `ros2msg`; this version reads protobuf with `protobuf` and cdr with `ros2msg`",
            ),
            (
                "protobuf",
                Some(&long),
                "has a schema of 1048577 bytes; this version reads schemas up to 1048576",
            ),
        ] {
            assert_eq!(refused(encoding, schema), told);
        }
    }

    #[test]
    fn protobuf_schemas_that_cannot_be_used_say_why() {
        let many: Vec<_> = (1..=16_385).map(|place| field("f", place, 1, "")).collect();
        for (set, told) in [
            (vec![0x0e], "its protobuf schema does not parse: 6 is not a wire type"),
            (vec![0x0a, 5], "its protobuf schema does not parse: it is cut short"),
            (vec![0xff; 11], "its protobuf schema does not parse: a number has more than ten bytes"),
            (vec![], "its protobuf schema does not define the message `M`"),
            (
                bytes(1, bytes(4, bytes(1, "N".repeat(513)))),
                "its protobuf schema does not parse: it defines too many names, or names that are too long or too deep",
            ),
            (bytes(1, bytes(4, bytes(1, b"\xff"))), "its protobuf schema does not parse: a name is not text"),
            (set(&[field(b"\xff", 1, 1, "")]), "its protobuf schema does not parse: M: a name is not text"),
            (set(&[vec![0x17]]), "its protobuf schema does not parse: 7 is not a wire type"),
            (set(&[bytes(2, [7])]), "its protobuf schema does not parse: M: 7 is not a wire type"),
            (
                set(&[field("x", 1, 11, ".N")]),
                "its protobuf schema does not parse: M: the field `x` is of a type that it does not define",
            ),
            (
                set(&[field("x", 1, 99, "")]),
                "its protobuf schema does not parse: M: the field `x` has an unknown type",
            ),
            (set(&many), "its protobuf schema defines more than 16384 fields"),
        ] {
            assert_eq!(refused("protobuf", Some(&schema("M", "protobuf", set))), told);
        }
    }

    #[test]
    fn protobuf_messages_that_do_not_fit_say_where() {
        let map = [bytes(1, "Entry"), field("key", 1, 5, ""), field("value", 2, 1, ""), bytes(7, [56, 1])];
        let fields = [
            field("x", 1, 1, ""),
            field("m", 2, 11, ".M"),
            field("s", 3, 9, ""),
            bytes(
                2,
                [bytes(1, "all"), number(3, 4), number(4, 3), number(5, 11), bytes(6, ".M.Entry")].concat(),
            ),
            bytes(3, map.concat()),
        ];
        let decoder = Decoder::new("protobuf", Some(&schema("M", "protobuf", set(&fields)))).unwrap();
        let mut deep = vec![];
        for _ in 0..33 {
            deep = bytes(2, deep);
        }
        for (message, told) in [
            (vec![0x09, 0], "it is cut short".to_owned()),
            (number(1, 1), "x: has another type on the wire than in the schema".into()),
            (bytes(3, b"\xff"), "s: is not text".into()),
            (bytes(2, number(1, 1)), "m: x: has another type on the wire than in the schema".into()),
            (bytes(2, [0x0e]), "m: 6 is not a wire type".into()),
            (bytes(4, bytes(1, "k")), "all: the key of a map is not one".into()),
            (bytes(4, number(2, 1)), "all: has another type on the wire than in the schema".into()),
            (deep, "m: ".repeat(33) + "lies more than 32 messages deep"),
        ] {
            assert_eq!(unreadable(&decoder, &message), format!("does not fit its schema: {told}"));
        }
    }

    #[test]
    fn ros_definitions_that_cannot_be_used_say_why() {
        for (definition, told) in [
            (&b"\xff"[..], "its ros2msg schema is not text"),
            (
                b"float64 = = x\nnonsense",
                "its ros2msg schema does not parse: failed to parse main message spec `p/msg/M`: syntax error: missing name \
                 in line: `nonsense`",
            ),
        ] {
            assert_eq!(refused("cdr", Some(&schema("p/msg/M", "ros2msg", definition))), told);
        }
    }

    #[test]
    fn ros_messages_that_do_not_fit_say_where() {
        let separator = "=".repeat(80);
        let cyclic = format!("N n\n{separator}\nMSG: p/N\nN n");
        let deep = "does not fit its schema: ".to_owned()
            + &"n: ".repeat(33)
            + "`p/N` lies more than 32 messages deep";
        for (definition, message, told) in [
            ("float64 x", &[0, 1][..], "2 bytes are not a CDR message"),
            (
                "float64 x",
                &[0, 7, 0, 0],
                "does not fit its schema: CDR representation 7 is not read; plain CDR is 0 or 1",
            ),
            ("float64 x", &[0, 1, 0, 0, 1], "does not fit its schema: x: unexpected end of input"),
            ("bool x", &[0, 1, 0, 0, 7], "does not fit its schema: x: invalid boolean value: 7"),
            ("string x", &[0, 1, 0, 0, 9, 0, 0, 0], "does not fit its schema: x: unexpected end of input"),
            ("float64[] x", &[0, 1, 0, 0, 9], "does not fit its schema: x: unexpected end of input"),
            ("uint8[] x", &[0, 1, 0, 0, 9, 0, 0, 0, 1], "does not fit its schema: x: 9 elements in 1 bytes"),
            ("wstring x", &[0, 1, 0, 0, 0], "does not fit its schema: x: wstring is not read"),
            ("N x", &[0, 1, 0, 0, 0], "does not fit its schema: x: `N` is not defined"),
            (&cyclic, &[0, 1, 0, 0, 0], &deep),
        ] {
            let schema = schema("p/msg/M", "ros2msg", definition);
            assert_eq!(unreadable(&Decoder::new("cdr", Some(&schema)).unwrap(), message), told);
        }
    }

    #[test]
    fn json_that_does_not_fit_says_where() {
        let mapping = SignalMapping { field: "u".into(), time: "t".into(), ..SignalMapping::default() };
        let tree = FieldTree::of([(Signal::Command, &mapping)].into_iter()).unwrap();
        for (message, told) in [
            (&br#"{"u":"fast"}"#[..], "`fast` is not a number at line 1 column 11"),
            (br#"{"t":null}"#, "the time is not a number at line 1 column 9"),
            (br#"{"u":1"#, "EOF while parsing an object at line 1 column 6"),
            (br#"{"u":1}}"#, "trailing characters at line 1 column 8"),
        ] {
            let error = Decoder::Json.pick(&tree, message, &mut Picked::default()).unwrap_err();
            assert_eq!(error.to_string(), told);
        }
    }
}
