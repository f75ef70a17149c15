//! Why a DBC file does not say where a signal is.

use super::bit_field::BitFieldError;
use super::dbc::DEEPEST_MULTIPLEX;

/// Why no signal is found by its name. Each message follows the file's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum LookUpError {
    /// There is none of that name, but one of a similar one.
    #[error("there is no signal `{name}`; did you mean `{near}`?")]
    Misspelt {
        /// Name that was looked for.
        name: String,
        /// The most similar name of the file.
        near: String,
    },
    /// There is none of that name, nor of any other.
    #[error("there is no signal `{name}`; the file has no signals at all")]
    NoSignals {
        /// Name that was looked for.
        name: String,
    },
    /// There is none of that name, nor of a similar one.
    #[error("there is no signal `{name}`; the file has {listed}")]
    Unknown {
        /// Name that was looked for.
        name: String,
        /// The file's signals, as many as one line holds.
        listed: String,
    },
    /// The name without its message is that of several.
    #[error("several messages have a signal `{name}`; write {}", full_names.join(" or "))]
    Ambiguous {
        /// Name that was looked for.
        name: String,
        /// The whole names that it may stand for.
        full_names: Vec<String>,
    },
    /// It is there, and cannot be where the file says.
    #[error("the signal `{name}` {error}")]
    NoPlace {
        /// Name that was looked for.
        name: String,
        /// Why it cannot.
        #[source]
        error: PlaceError,
    },
}

/// Why a signal cannot be where its file says. Each message is the rest of a sentence about the signal.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum PlaceError {
    /// Its message is never sent.
    #[error("is in the message {message}, whose identifier cannot occur on a CAN bus")]
    NoIdentifier {
        /// Message.
        message: String,
    },
    /// No frame has such a field: its own, or that of its multiplexer.
    #[error(transparent)]
    Field(#[from] BitFieldError),
    /// Its message is too short for it.
    #[error("ends in byte {last} of the message {message}, which has {size} bytes")]
    BeyondMessage {
        /// Byte in which it ends, from 1 on.
        last: usize,
        /// Message.
        message: String,
        /// Bytes of the message.
        size: usize,
    },
    /// Nothing says when it is in its message.
    #[error("is multiplexed, but its message has no multiplexer")]
    NoMultiplexer,
    /// Its multiplexers go in circles, or as good as that.
    #[error("is multiplexed by itself, or more than {DEEPEST_MULTIPLEX} levels deep")]
    MultiplexedTooDeep,
}
