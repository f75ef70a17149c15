//! Channels: where in a record a value stands, and what it means.

use std::io;

use super::block::{Block, Blocks};

/// How many conversions within conversions are followed.
const DEEPEST: usize = 4;

/// What kind of channel it is, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A value in the record.
    Value,
    /// Bytes elsewhere, of which the record has the place.
    Elsewhere,
    /// The time, in the record or counted.
    Time { counted: bool },
    /// Of no use here.
    Other,
}

/// How a value is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Unsigned,
    Signed,
    Float,
    Bytes,
}

/// A channel of a group.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) kind: Kind,
    /// Block with the bytes that are elsewhere.
    pub(super) data: u64,
    encoding: Encoding,
    big_endian: bool,
    bit_offset: u32,
    byte_offset: usize,
    bits: u32,
    /// Bit behind the record's data that says that the value is none.
    invalid_bit: Option<usize>,
    never_valid: bool,
    conversion: Conversion,
}

/// From raw values to values.
#[derive(Debug, Clone, PartialEq)]
enum Conversion {
    None,
    Linear {
        offset: f64,
        factor: f64,
    },
    Rational([f64; 6]),
    /// Pairs of raw value and value, in order; between them straight lines or the nearest.
    Table {
        pairs: Vec<[f64; 2]>,
        straight: bool,
    },
    /// Lower and upper bound, value; and the value of all others.
    Ranges {
        ranges: Vec<[f64; 3]>,
        other: f64,
    },
    /// States with names beside numbers: raw values that have no name are converted so.
    Named {
        raw: Vec<[f64; 2]>,
        rest: Box<Conversion>,
    },
    /// A formula or other things that are not evaluated.
    NotRead,
}

impl Channel {
    /// Reads a CN block.
    pub(super) fn read(blocks: &mut Blocks<'_>, block: &Block) -> io::Result<Self> {
        let (kind, sync) = (block.u8(0), block.u8(1));
        let data_type = block.u8(2);
        let flags = block.u32(12);
        let encoding = match data_type {
            0 | 1 => Encoding::Unsigned,
            2 | 3 => Encoding::Signed,
            4 | 5 => Encoding::Float,
            _ => Encoding::Bytes,
        };
        let kind = match kind {
            0 | 5 | 6 => Kind::Value,
            1 => Kind::Elsewhere,
            2 | 3 if sync == 1 => Kind::Time { counted: kind == 3 },
            _ => Kind::Other,
        };
        let conversion_block = block.link(4);
        let conversion = Conversion::read(blocks, conversion_block, 0)?;
        let mut unit = blocks.text(block.link(6))?;
        if unit.is_empty()
            && let Some(conversion) = blocks.block(conversion_block, &[b"CC"])?
        {
            unit = blocks.text(conversion.link(1))?;
        }
        Ok(Channel {
            name: blocks.text(block.link(2))?,
            unit,
            kind,
            data: block.link(5),
            encoding,
            big_endian: matches!(data_type, 1 | 3 | 5),
            bit_offset: u32::from(block.u8(3) & 7),
            byte_offset: block.u32(4) as usize,
            bits: block.u32(8),
            invalid_bit: (flags & 2 != 0).then(|| block.u32(16) as usize),
            never_valid: flags & 1 != 0,
            conversion,
        })
    }

    /// Whether it has numbers that are read.
    pub(super) fn is_number(&self) -> bool {
        self.kind == Kind::Value && self.encoding != Encoding::Bytes && self.conversion != Conversion::NotRead
    }

    /// Whether it has numbers, but by a formula that is not evaluated.
    pub(super) fn has_formula(&self) -> bool {
        self.kind == Kind::Value && self.conversion == Conversion::NotRead
    }

    /// The raw value of a record whose data has so many bytes; signed and floating ones are given as their number.
    pub(super) fn raw(&self, record: &[u8], data_bytes: usize) -> Option<f64> {
        if self.never_valid || self.invalid_bit.is_some_and(|bit| is_set(record, data_bytes, bit)) {
            return None;
        }
        let bits = self.whole(record)?;
        Some(match self.encoding {
            Encoding::Unsigned => bits as f64,
            Encoding::Signed => {
                let unused = 64 - self.bits;
                ((bits << unused) as i64 >> unused) as f64
            }
            Encoding::Float if self.bits == 32 => f64::from(f32::from_bits(bits as u32)),
            Encoding::Float if self.bits == 64 => f64::from_bits(bits),
            Encoding::Float if self.bits == 16 => half(bits as u16),
            Encoding::Float | Encoding::Bytes => return None,
        })
    }

    /// The value of a record.
    pub(super) fn value(&self, record: &[u8], data_bytes: usize) -> Option<f64> {
        self.conversion.apply(self.raw(record, data_bytes)?)
    }

    /// The time of the record of a number, s.
    pub(super) fn time_s(&self, record: &[u8], data_bytes: usize, number: u64) -> Option<f64> {
        let raw = match self.kind {
            Kind::Time { counted: true } => number as f64,
            _ => self.raw(record, data_bytes)?,
        };
        self.conversion.apply(raw)
    }

    /// The bits as a number, whatever they mean.
    pub(super) fn whole(&self, record: &[u8]) -> Option<u64> {
        if self.bits == 0 || self.bits > 64 {
            return None;
        }
        let count = ((self.bit_offset + self.bits).div_ceil(8)) as usize;
        let bytes = record.get(self.byte_offset..self.byte_offset.checked_add(count)?)?;
        let all = if self.big_endian {
            bytes.iter().fold(0u128, |all, byte| all << 8 | u128::from(*byte))
        } else {
            bytes.iter().rev().fold(0u128, |all, byte| all << 8 | u128::from(*byte))
        };
        Some((all >> self.bit_offset) as u64 & (u64::MAX >> (64 - self.bits)))
    }

    /// The bytes of a channel that has bytes in the record.
    pub(super) fn bytes<'r>(&self, record: &'r [u8]) -> Option<&'r [u8]> {
        record.get(self.byte_offset..self.byte_offset.checked_add(self.bits as usize / 8)?)
    }
}

fn is_set(record: &[u8], data_bytes: usize, bit: usize) -> bool {
    record.get(data_bytes + bit / 8).is_some_and(|byte| byte >> (bit % 8) & 1 != 0)
}

/// A number of 16 bits.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    let size = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

impl Conversion {
    fn read(blocks: &mut Blocks<'_>, at: u64, depth: usize) -> io::Result<Self> {
        let Some(block) = blocks.block(at, &[b"CC"])? else { return Ok(Conversion::None) };
        if depth > DEEPEST {
            return Ok(Conversion::NotRead);
        }
        const VALUES: usize = 24;
        let count = usize::from(block.u16(6)).min(block.content.len().saturating_sub(VALUES) / 8);
        let value = |index: usize| block.f64(VALUES + 8 * index);
        let pairs = || (0..count / 2).map(|pair| [value(2 * pair), value(2 * pair + 1)]).collect::<Vec<_>>();
        Ok(match block.u8(0) {
            0 => Conversion::None,
            1 => Conversion::Linear { offset: value(0), factor: value(1) },
            2 if count >= 6 => Conversion::Rational(std::array::from_fn(value)),
            kind @ (4 | 5) if count >= 2 => Conversion::Table { pairs: pairs(), straight: kind == 4 },
            6 if count >= 1 => {
                let ranges =
                    (0..(count - 1) / 3).map(|at| [value(3 * at), value(3 * at + 1), value(3 * at + 2)]);
                Conversion::Ranges { ranges: ranges.collect(), other: value(count - 1) }
            }
            // Names of states: the numbers are what is logged; others may have a conversion of their own.
            kind @ (7 | 8) => {
                let rest = block.links.last().copied().unwrap_or(0);
                match blocks.header(rest)?.map(|header| header.id) {
                    Some(id) if id == *b"CC" => Conversion::Named {
                        raw: if kind == 8 { pairs() } else { (0..count).map(|at| [value(at); 2]).collect() },
                        rest: Box::new(Self::read(blocks, rest, depth + 1)?),
                    },
                    _ => Conversion::None,
                }
            }
            _ => Conversion::NotRead,
        })
    }

    fn apply(&self, raw: f64) -> Option<f64> {
        Some(match self {
            Conversion::None => raw,
            Conversion::Linear { offset, factor } => raw * factor + offset,
            Conversion::Rational([a, b, c, d, e, f]) => {
                (a * raw * raw + b * raw + c) / (d * raw * raw + e * raw + f)
            }
            Conversion::Table { pairs, straight } => of_table(pairs, raw, *straight)?,
            Conversion::Ranges { ranges, other } => {
                let found = ranges.iter().find(|[low, high, _]| (*low..=*high).contains(&raw));
                found.map_or(*other, |[_, _, value]| *value)
            }
            Conversion::Named { raw: named, rest } => {
                return if named.iter().any(|[low, high]| (*low..=*high).contains(&raw)) {
                    Some(raw)
                } else {
                    rest.apply(raw)
                };
            }
            Conversion::NotRead => return None,
        })
    }
}

fn of_table(pairs: &[[f64; 2]], raw: f64, straight: bool) -> Option<f64> {
    let [first, last] = [pairs.first()?, pairs.last()?];
    if raw.is_nan() || raw <= first[0] {
        return Some(if raw.is_nan() { raw } else { first[1] });
    }
    let above = pairs.partition_point(|[key, _]| *key < raw);
    let Some([high, high_value]) = pairs.get(above) else { return Some(last[1]) };
    let [low, low_value] = pairs[above - 1];
    if straight {
        return Some(low_value + (raw - low) / (high - low) * (high_value - low_value));
    }
    Some(if raw - low > high - raw || raw == *high { *high_value } else { low_value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conversions_follow_the_standard() {
        let table = vec![[0.0, 10.0], [10.0, 30.0], [20.0, 0.0]];
        for (conversion, raw, value) in [
            (Conversion::Linear { offset: 1.0, factor: 0.5 }, 4.0, 3.0),
            (Conversion::Rational([0.0, 2.0, 1.0, 0.0, 0.0, 4.0]), 3.0, 1.75),
            (Conversion::Table { pairs: table.clone(), straight: true }, 5.0, 20.0),
            (Conversion::Table { pairs: table.clone(), straight: true }, 25.0, 0.0),
            (Conversion::Table { pairs: table.clone(), straight: false }, 6.0, 30.0),
            (Conversion::Table { pairs: table, straight: false }, 4.0, 10.0),
            (Conversion::Ranges { ranges: vec![[0.0, 1.0, 7.0]], other: 9.0 }, 1.0, 7.0),
            (Conversion::Ranges { ranges: vec![[0.0, 1.0, 7.0]], other: 9.0 }, 1.5, 9.0),
        ] {
            assert_eq!(conversion.apply(raw), Some(value), "{conversion:?}");
        }
    }

    #[test]
    fn halves_are_read() {
        for (bits, value) in
            [(0x3c00, 1.0), (0xc000, -2.0), (0x0001, 2f64.powi(-24)), (0x7c00, f64::INFINITY)]
        {
            assert_eq!(half(bits), value);
        }
        assert!(half(0x7e00).is_nan());
    }
}
