//! Words of a line, and numbers as CAN logs write them.

use super::frame_error::FrameError;
use super::{Frame, MOST_BYTES};

/// The words of a line.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// A decimal number with a fraction as a whole number of its 10^-`digits`: 1.25 with 3 is 1250. Without a detour over a float, as dates
/// in nanoseconds have 19 digits; what is finer is cut off.
pub(super) fn fixed_point(text: &[u8], digits: u32) -> Option<i64> {
    let point = text.iter().position(|byte| matches!(byte, b'.' | b','));
    let (whole, fraction) = match point {
        Some(at) => (&text[..at], &text[at + 1..]),
        None => (text, &b""[..]),
    };
    if whole.is_empty() || !fraction.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let fraction = &fraction[..fraction.len().min(digits as usize)];
    let scale = 10i64.checked_pow(digits - fraction.len() as u32)?;
    let fraction = if fraction.is_empty() { 0 } else { number(fraction, 10)? } * scale;
    number(whole, 10)?.checked_mul(10i64.checked_pow(digits)?)?.checked_add(fraction)
}

/// A whole number of a base, without a sign.
pub(super) fn number(digits: &[u8], base: u32) -> Option<i64> {
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0i64, |number, byte| {
        let digit = char::from(*byte).to_digit(base)?;
        number.checked_mul(i64::from(base))?.checked_add(i64::from(digit))
    })
}

/// The same where it fits 32 bits.
pub(super) fn number_u32(digits: &[u8], base: u32) -> Option<u32> {
    number(digits, base).and_then(|number| u32::try_from(number).ok())
}

/// Puts so many bytes, a word each, into a frame.
pub(super) fn push_words<'w>(
    frame: &mut Frame,
    words: &mut impl Iterator<Item = &'w [u8]>,
    count: usize,
    base: u32,
) -> Result<(), FrameError> {
    for _ in 0..count {
        let word = words.next().ok_or(FrameError::DataCutShort)?;
        let byte = number(word, base).and_then(|byte| u8::try_from(byte).ok());
        frame.push(byte.ok_or(FrameError::DataNotBytes)?);
    }
    Ok(())
}

/// Bytes of a frame by its length code.
pub(crate) fn bytes_of_code(code: u32) -> Option<usize> {
    const FD: [usize; 7] = [12, 16, 20, 24, 32, 48, MOST_BYTES];
    match code {
        0..=8 => Some(code as usize),
        9..=15 => Some(FD[code as usize - 9]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_to_the_digit() {
        assert_eq!(fixed_point(b"1700000000.123456", 9), Some(1_700_000_000_123_456_000));
        assert_eq!(fixed_point(b"17535.4", 6), Some(17_535_400_000));
        assert_eq!(fixed_point(b"0,5", 9), Some(500_000_000));
        assert_eq!(fixed_point(b"3.1234567891", 9), Some(3_123_456_789));
        assert_eq!(fixed_point(b"7", 9), Some(7_000_000_000));
        for wrong in [&b""[..], b".5", b"-1", b"1e3", b"99999999999999999999", b"1.x", b"1.2.3"] {
            assert_eq!(fixed_point(wrong, 9), None, "{}", String::from_utf8_lossy(wrong));
        }
        assert_eq!(
            (number(b"ff", 16), number(b"ff", 10), number_u32(b"4294967296", 10)),
            (Some(255), None, None)
        );
        assert_eq!([8, 9, 13, 15].map(bytes_of_code), [Some(8), Some(12), Some(32), Some(64)]);
        assert_eq!(bytes_of_code(16), None);
    }
}
