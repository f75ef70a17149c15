//! Why a frame cannot be read.

/// Why there is no frame where one should be. Each message follows the place of the frame in its log; those about a frame of Linux are the
/// rest of a sentence.
///
/// No variant holds a value: where a whole log is damaged, nothing is made for each of its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// A line has no words.
    #[error("it is empty")]
    Empty,
    /// A line is longer than that of any frame.
    #[error("it is longer than a frame can be")]
    TooLong,
    /// It ends before its frame does.
    #[error("it is cut short")]
    CutShort,
    /// A line is neither a frame nor of a kind that the header has.
    #[error("it is neither a frame nor a header")]
    UnknownLine,
    /// An object's header is shorter than that of a frame, or longer than the object.
    #[error("its header is cut short")]
    HeaderCutShort,
    /// A line ends after the interface.
    #[error("it has no frame")]
    FrameMissing,
    /// A line ends amid what stands before the data.
    #[error("its frame is cut short")]
    FrameCutShort,
    /// Nothing parts the identifier from the data.
    #[error("its frame has no `#`")]
    SeparatorMissing,
    /// Nothing follows the `##` of a CAN FD frame.
    #[error("its FD frame has no flags")]
    FlagsMissing,
    /// It has the size of neither frame of Linux, classic or FD.
    #[error("has neither 16 nor 72 bytes")]
    Size,

    /// A record has no time, or one that is none of a measurement.
    #[error("its time is missing")]
    TimeMissing,
    /// A line does not begin with `(`, a time and `)`.
    #[error("it does not begin with a time in parentheses")]
    TimeNotInParentheses,
    /// The time is no number, or one that 64 bits of nanoseconds cannot hold.
    #[error("its time is not a number of seconds")]
    TimeNotSeconds,
    /// The same, where a log counts milliseconds; or its header tells of no time.
    #[error("its time is not a number of ms")]
    TimeNotMilliseconds,
    /// The same, where a log counts microseconds.
    #[error("its time is not a number of µs")]
    TimeNotMicroseconds,
    /// The time is not that of a clock.
    #[error("its time is not h:m:s:ms")]
    TimeNotOfClock,

    /// A line ends after the time.
    #[error("it names no interface")]
    InterfaceMissing,
    /// The interface has a longer name than Linux allows.
    #[error("its interface's name is too long")]
    InterfaceTooLong,
    /// What stands for the logger's channel is too long for a number.
    #[error("its channel is not a number")]
    ChannelNotNumber,
    /// What stands for the bus is too long for a number.
    #[error("its bus is not a number")]
    BusNotNumber,

    /// A record is too short for an identifier.
    #[error("its identifier is missing")]
    IdentifierMissing,
    /// The header tells of no column with the identifier.
    #[error("it has no identifier")]
    IdentifierColumnMissing,
    /// The identifier is no hexadecimal number of 32 bits at most.
    #[error("its identifier is not hexadecimal")]
    IdentifierNotHexadecimal,
    /// The identifier is no number of the base that the header tells.
    #[error("its identifier is not a number")]
    IdentifierNotNumber,
    /// The same, where a log may have names instead, which only its database explains.
    #[error("its identifier is not a number, but perhaps a name")]
    IdentifierPerhapsName,
    /// The number of digits tells neither 11 nor 29 bits; or three digits are more than 11 bits.
    #[error("its identifier has neither 3 nor 8 digits")]
    IdentifierDigits,
    /// The identifier has more bits than frames of its kind, or the kind is none.
    #[error("its identifier is none of CAN")]
    IdentifierNotOfCan,

    /// The length is none that frames have, or is longer than the data of its record.
    #[error("its length is none of a frame")]
    Length,
    /// The same, in a frame of Linux: more than it has room for, or between the lengths of CAN FD.
    #[error("has a wrong length code")]
    LengthCode,
    /// A record's data are not in the log.
    #[error("its data is missing")]
    DataMissing,
    /// There are fewer data bytes than its length says.
    #[error("its data is cut short")]
    DataCutShort,
    /// There are half a byte's digits, or more bytes than a frame of its kind has.
    #[error("its data is cut short or too long")]
    DataCutShortOrTooLong,
    /// A data byte has other signs than hexadecimal digits.
    #[error("its data is not hexadecimal")]
    DataNotHexadecimal,
    /// A data byte is no number of the log's base up to 255.
    #[error("its data is not bytes")]
    DataNotBytes,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_takes_one_byte() {
        assert_eq!(size_of::<FrameError>(), 1);
    }
}
