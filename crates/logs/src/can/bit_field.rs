//! Where a number is in a frame's data, and how it becomes a physical value.

use serde::{Deserialize, Serialize};

use super::MOST_BYTES;

/// How a field's bits are numbered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ByteOrder {
    /// Intel: the first bit is the lowest, higher bits follow in higher bytes.
    #[default]
    LittleEndian,
    /// Motorola: the first bit is the highest, lower bits follow in higher bytes.
    BigEndian,
}

/// What the bits stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// An integer from 0.
    #[default]
    Unsigned,
    /// An integer in two's complement.
    Signed,
    /// IEEE 754, 32 bits.
    Float32,
    /// IEEE 754, 64 bits.
    Float64,
}

/// Why there can be no such field. Each message is the rest of a sentence about the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BitFieldError {
    /// Its encoding has no number of so many bits.
    #[error("has {bits} bits; {encoding:?} has {least} … {most}")]
    Size {
        /// Size, bits.
        bits: usize,
        /// Encoding.
        encoding: Encoding,
        /// Fewest bits of the encoding.
        least: usize,
        /// Most bits of the encoding.
        most: usize,
    },
    /// No frame is that long.
    #[error("ends beyond byte {MOST_BYTES}, the last byte of the longest frame")]
    BeyondFrame,
    /// Factor or offset are not finite.
    #[error("has a factor or an offset that is not a number")]
    NotANumber,
}

/// A number in a frame's data; value = raw · factor + offset.
///
/// Bit 8 b + i is bit i of byte b, 0 being a byte's lowest, in both byte orders: as DBC files count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BitField {
    start_bit: usize,
    bits: usize,
    order: ByteOrder,
    encoding: Encoding,
    factor: f64,
    offset: f64,
}

impl BitField {
    /// Checks a field's place and size.
    ///
    /// # Errors
    /// [`BitFieldError`].
    pub fn new(
        start_bit: usize,
        bits: usize,
        order: ByteOrder,
        encoding: Encoding,
        factor: f64,
        offset: f64,
    ) -> Result<Self, BitFieldError> {
        let size = match encoding {
            Encoding::Unsigned | Encoding::Signed => 1..=64,
            Encoding::Float32 => 32..=32,
            Encoding::Float64 => 64..=64,
        };
        if !size.contains(&bits) {
            return Err(BitFieldError::Size { bits, encoding, least: *size.start(), most: *size.end() });
        }
        let field = BitField { start_bit, bits, order, encoding, factor, offset };
        if start_bit >= 8 * MOST_BYTES || field.least_bytes() > MOST_BYTES {
            return Err(BitFieldError::BeyondFrame);
        }
        if !factor.is_finite() || !offset.is_finite() {
            return Err(BitFieldError::NotANumber);
        }
        Ok(field)
    }

    /// The field's first bit along the way in which its bits follow each other.
    fn first(&self) -> usize {
        match self.order {
            ByteOrder::LittleEndian => self.start_bit,
            ByteOrder::BigEndian => self.start_bit - self.start_bit % 8 + 7 - self.start_bit % 8,
        }
    }

    /// Bytes that a frame must have to hold the field.
    pub fn least_bytes(&self) -> usize {
        (self.first() + self.bits).div_ceil(8)
    }

    /// The field's bits as an integer; `None` for a frame that is too short.
    pub fn raw(&self, data: &[u8]) -> Option<u64> {
        let first = self.first();
        let bytes = data.get(first / 8..self.least_bytes())?;
        // At most nine bytes hold 64 bits.
        let (skipped, all) = (first % 8, 8 * bytes.len());
        let wide = match self.order {
            ByteOrder::LittleEndian => {
                bytes.iter().rev().fold(0u128, |wide, byte| wide << 8 | u128::from(*byte)) >> skipped
            }
            ByteOrder::BigEndian => {
                bytes.iter().fold(0u128, |wide, byte| wide << 8 | u128::from(*byte))
                    >> (all - skipped - self.bits)
            }
        };
        Some((wide & ((1u128 << self.bits) - 1)) as u64)
    }

    /// Size, bits.
    pub fn bits(&self) -> usize {
        self.bits
    }

    /// Writes the field's bits into `data` and leaves all others; `false`, and nothing written, where it is too short.
    pub fn write_raw(&self, data: &mut [u8], raw: u64) -> bool {
        let first = self.first();
        let Some(bytes) = data.get_mut(first / 8..self.least_bytes()) else { return false };
        let (skipped, all) = (first % 8, 8 * bytes.len());
        let mask = (1u128 << self.bits) - 1;
        let shift = match self.order {
            ByteOrder::LittleEndian => skipped,
            ByteOrder::BigEndian => all - skipped - self.bits,
        };
        let (value, mask) = ((u128::from(raw) & mask) << shift, mask << shift);
        for (index, byte) in bytes.iter_mut().enumerate() {
            let place = match self.order {
                ByteOrder::LittleEndian => 8 * index,
                ByteOrder::BigEndian => all - 8 - 8 * index,
            };
            *byte = (*byte & !((mask >> place) as u8)) | (value >> place) as u8;
        }
        true
    }

    /// Writes a physical value, rounded, and held to what the bits can say; `false` where `data` is too short.
    pub fn write(&self, data: &mut [u8], value: f64) -> bool {
        let number = (value - self.offset) / self.factor;
        let raw = match self.encoding {
            // Float to integer casts saturate, and make 0 of what is no number.
            Encoding::Unsigned => (number.round() as u64).min(u64::MAX >> (64 - self.bits)),
            Encoding::Signed => {
                let most = i64::MAX >> (64 - self.bits);
                (number.round() as i64).clamp(-most - 1, most) as u64
            }
            Encoding::Float32 => u64::from((number as f32).to_bits()),
            Encoding::Float64 => number.to_bits(),
        };
        self.write_raw(data, raw)
    }

    /// The physical value; `None` for a frame that is too short.
    pub fn value(&self, data: &[u8]) -> Option<f64> {
        let raw = self.raw(data)?;
        let number = match self.encoding {
            Encoding::Unsigned => raw as f64,
            Encoding::Signed => {
                let unused = 64 - self.bits;
                ((raw << unused) as i64 >> unused) as f64
            }
            Encoding::Float32 => f64::from(f32::from_bits(raw as u32)),
            Encoding::Float64 => f64::from_bits(raw),
        };
        Some(number * self.factor + self.offset)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn field(start_bit: usize, bits: usize, order: ByteOrder, encoding: Encoding) -> BitField {
        BitField::new(start_bit, bits, order, encoding, 1.0, 0.0).unwrap()
    }

    /// Bit by bit along the definition, as slow as it is plain.
    fn raw_by_bits(data: &[u8], start_bit: usize, bits: usize, order: ByteOrder) -> Option<u64> {
        let mut at = start_bit;
        let mut raw = 0u64;
        for index in 0..bits {
            let bit = u64::from(data.get(at / 8)? >> (at % 8) & 1);
            match order {
                ByteOrder::LittleEndian => {
                    raw |= bit << index;
                    at += 1;
                }
                ByteOrder::BigEndian => {
                    raw = raw << 1 | bit;
                    at = if at.is_multiple_of(8) { at + 15 } else { at - 1 };
                }
            }
        }
        Some(raw)
    }

    proptest! {
        #[test]
        fn property_fields_are_their_bits(
            data in prop::collection::vec(any::<u8>(), 0..=64),
            start_bit in 0usize..512,
            bits in 1usize..=64,
            little in any::<bool>(),
        ) {
            let order = if little { ByteOrder::LittleEndian } else { ByteOrder::BigEndian };
            if let Ok(field) = BitField::new(start_bit, bits, order, Encoding::Unsigned, 1.0, 0.0) {
                prop_assert_eq!(field.raw(&data), raw_by_bits(&data, start_bit, bits, order));
            }
        }
    }

    proptest! {
        #[test]
        fn property_what_is_written_is_read_and_the_rest_stays(
            data in prop::collection::vec(any::<u8>(), 64..=64),
            start_bit in 0usize..512,
            bits in 1usize..=64,
            raw in any::<u64>(),
            little in any::<bool>(),
        ) {
            let order = if little { ByteOrder::LittleEndian } else { ByteOrder::BigEndian };
            if let Ok(field) = BitField::new(start_bit, bits, order, Encoding::Unsigned, 1.0, 0.0) {
                let mut written = data.clone();
                prop_assert!(field.write_raw(&mut written, raw));
                prop_assert_eq!(field.raw(&written), Some(raw & (u64::MAX >> (64 - bits))));
                let before = field.raw(&data).unwrap_or_default();
                prop_assert!(field.write_raw(&mut written, before));
                prop_assert_eq!(written, data);
            }
        }
    }

    #[test]
    fn values_are_held_to_what_the_bits_can_say() {
        let tenth = |encoding| BitField::new(0, 8, ByteOrder::LittleEndian, encoding, 0.1, 0.0).unwrap();
        let round_trip = |encoding, value| {
            let mut data = [0u8; 1];
            assert!(tenth(encoding).write(&mut data, value));
            tenth(encoding).raw(&data).unwrap()
        };
        assert_eq!(round_trip(Encoding::Unsigned, 1.26), 13);
        assert_eq!(round_trip(Encoding::Unsigned, -1.0), 0);
        assert_eq!(round_trip(Encoding::Unsigned, 1e9), 255);
        assert_eq!(round_trip(Encoding::Signed, -1e9), 0x80);
        assert_eq!(round_trip(Encoding::Signed, f64::NAN), 0);
        assert!(!tenth(Encoding::Unsigned).write(&mut [], 1.0));
    }

    #[test]
    fn signs_floats_factors_and_offsets() {
        let data = [0xfe, 0xff, 0x00, 0x00, 0x20, 0x41, 0, 0];
        assert_eq!(field(0, 16, ByteOrder::LittleEndian, Encoding::Signed).value(&data), Some(-2.0));
        assert_eq!(field(0, 16, ByteOrder::LittleEndian, Encoding::Unsigned).value(&data), Some(65534.0));
        assert_eq!(field(7, 16, ByteOrder::BigEndian, Encoding::Signed).value(&data), Some(-257.0));
        assert_eq!(field(16, 32, ByteOrder::LittleEndian, Encoding::Float32).value(&data), Some(10.0));
        let scaled = BitField::new(0, 8, ByteOrder::LittleEndian, Encoding::Signed, 0.5, 3.0).unwrap();
        assert_eq!(scaled.value(&data), Some(2.0));
    }

    #[test]
    fn impossible_fields_are_refused_and_short_frames_give_nothing() {
        let try_new =
            |start, bits, encoding| BitField::new(start, bits, ByteOrder::LittleEndian, encoding, 1.0, 0.0);
        assert!(try_new(0, 0, Encoding::Unsigned).is_err());
        assert!(try_new(0, 65, Encoding::Unsigned).is_err());
        assert!(try_new(500, 16, Encoding::Unsigned).is_err());
        assert!(try_new(usize::MAX, 1, Encoding::Unsigned).is_err());
        assert!(try_new(0, 16, Encoding::Float32).is_err());
        assert_eq!(field(0, 16, ByteOrder::LittleEndian, Encoding::Signed).value(&[1]), None);
    }
}
