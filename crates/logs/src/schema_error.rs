//! Why a channel's messages cannot be decoded.

use super::decode::LONGEST_SCHEMA;
use super::protobuf::MOST_DEFINED;
use super::protobuf_wire::WireError;

/// Why there is no decoder for a channel. Each message is the rest of a sentence about the channel's topic.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SchemaError {
    /// An encoding that is not read.
    #[error("has the message encoding `{encoding}`; this version reads json, protobuf and cdr")]
    Encoding {
        /// Encoding of the messages.
        encoding: String,
    },
    /// An encoding that is only read with a schema.
    #[error("has {encoding} messages without their schema")]
    Missing {
        /// Encoding of the messages.
        encoding: String,
    },
    /// A schema of a kind that does not go with the messages.
    #[error(
        "has {encoding} messages with a schema in `{schema}`; this version reads protobuf with `protobuf` and cdr with `ros2msg`"
    )]
    OtherKind {
        /// Encoding of the messages.
        encoding: String,
        /// Encoding of the schema.
        schema: String,
    },
    /// A schema that is longer than those of machines are.
    #[error("has a schema of {bytes} bytes; this version reads schemas up to {LONGEST_SCHEMA}")]
    TooLong {
        /// Length of the schema, bytes.
        bytes: usize,
    },
    /// The schemas before it have taken the room that there is for them.
    #[error("is not looked into, since only so many schemas are")]
    NoRoom,
    /// It is no descriptor set.
    #[error("its protobuf schema does not parse: {0}")]
    Descriptors(#[from] DescriptorError),
    /// It is a descriptor set, and the definition of a message in it is none.
    #[error("its protobuf schema does not parse: {message}: {error}")]
    Descriptor {
        /// Full name of the message.
        message: String,
        /// What is wrong with its definition.
        #[source]
        error: DescriptorError,
    },
    /// It is a descriptor set for other messages.
    #[error("its protobuf schema does not define the message `{message}`")]
    NotDefined {
        /// Full name of the message.
        message: String,
    },
    /// More fields than those of machines' schemas.
    #[error("its protobuf schema defines more than {MOST_DEFINED} fields")]
    TooManyFields,
    /// A ROS 2 definition that is not UTF-8.
    #[error("its ros2msg schema is not text")]
    NotText,
    /// A ROS 2 definition that is none.
    #[error("its ros2msg schema does not parse: {what}")]
    Definition {
        /// What its parser says, in one line.
        what: String,
    },
}

/// What is wrong with a protobuf descriptor set.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum DescriptorError {
    /// It is not in protobuf's wire format.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// The name of a message, a field or a type is not UTF-8.
    #[error("a name is not text")]
    NotText,
    /// More names than are believed, or such that messages in messages would make them too long to keep.
    #[error("it defines too many names, or names that are too long or too deep")]
    TooManyNames,
    /// A field refers to a message that is not in the set.
    #[error("the field `{field}` is of a type that it does not define")]
    UndefinedType {
        /// Name of the field.
        field: String,
    },
    /// A field's type is none that protobuf has.
    #[error("the field `{field}` has an unknown type")]
    UnknownType {
        /// Name of the field.
        field: String,
    },
}
