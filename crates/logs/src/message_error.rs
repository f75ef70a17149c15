//! Why a message does not decode.

use super::fields::{DEEPEST, ValueError};
use super::protobuf_wire::WireError;

/// Why a message cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MessageError {
    /// It is not JSON, or a wanted field in it is no number; both with the place in the text.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// It is shorter than what stands before every CDR message.
    #[error("{bytes} bytes are not a CDR message")]
    NotCdr {
        /// Its length, bytes.
        bytes: usize,
    },
    /// It is not what its schema says.
    #[error("does not fit its schema: {0}")]
    Misfit(#[from] Box<Misfit>),
}

/// Where a message is not what its schema says, or what it is wanted for.
///
/// It goes up in a box, so that what each value of a message returns fits in a register. Where values are taken, none is made for `ok_or`,
/// which would drop it for each value that is good: a call, for a type that contains itself.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Misfit {
    /// A field, or what is in it, does not fit.
    #[error("{field}: {misfit}")]
    In {
        /// Name of the field.
        field: String,
        /// What does not fit in it.
        #[source]
        misfit: Box<Misfit>,
    },
    /// A field is not what it is wanted for.
    #[error(transparent)]
    Value(ValueError),
    /// It is not in protobuf's wire format.
    #[error(transparent)]
    Wire(WireError),
    /// What CDR has in the place of a value is none.
    #[error(transparent)]
    Cdr(re_cdr::Error),
    /// CDR that is not read: parameter lists, XCDR 2.
    #[error("CDR representation {code} is not read; plain CDR is 0 or 1")]
    Representation {
        /// Second byte of the message.
        code: u8,
    },
    /// Arrays of messages of empty arrays, which take no bytes, would be walked without end.
    #[error("it has far more fields than bytes")]
    Endless,
    /// Messages lie in messages without end, or as good as that.
    #[error("lies more than {DEEPEST} messages deep")]
    TooDeep,
    /// The same, where the definition names the message.
    #[error("`{message}` lies more than {DEEPEST} messages deep")]
    MessageTooDeep {
        /// Name of the message's type.
        message: String,
    },
    /// A text is not UTF-8.
    #[error("is not text")]
    NotText,
    /// A value cannot be of the type that the schema gives its field.
    #[error("has another type on the wire than in the schema")]
    OtherType,
    /// A map's key cannot be of the type that the schema gives it.
    #[error("the key of a map is not one")]
    NotAKey,
    /// The definition refers to a message that is not in it.
    #[error("`{message}` is not defined")]
    Undefined {
        /// The message's type.
        message: String,
    },
    /// An array would be longer than its message.
    #[error("{count} elements in {bytes} bytes")]
    LongArray {
        /// Elements that it is to have.
        count: usize,
        /// Bytes that are left.
        bytes: usize,
    },
    /// Texts of 16-bit characters.
    #[error("wstring is not read")]
    WideText,
}

impl Misfit {
    /// The same, in a field.
    #[cold]
    pub(super) fn in_field(self: Box<Self>, field: &str) -> Box<Self> {
        Box::new(Misfit::In { field: field.into(), misfit: self })
    }
}

impl From<ValueError> for Box<Misfit> {
    #[cold]
    fn from(error: ValueError) -> Self {
        Box::new(Misfit::Value(error))
    }
}

impl From<WireError> for Box<Misfit> {
    #[cold]
    fn from(error: WireError) -> Self {
        Box::new(Misfit::Wire(error))
    }
}

impl From<re_cdr::Error> for Box<Misfit> {
    #[cold]
    fn from(error: re_cdr::Error) -> Self {
        Box::new(Misfit::Cdr(error))
    }
}
