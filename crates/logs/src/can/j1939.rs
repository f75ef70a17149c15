//! J1939: frames by the number of their parameter group, whoever sends them.
//!
//! An identifier of 29 bits has a priority (3 bits), a page (2), a format (8), a specific part (8: the destination where the format is
//! below 240, else a part of the number) and the source's address (8).

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::Identifier;

const PRIORITY: u32 = 0x1c00_0000;
const SPECIFIC: u32 = 0xff00;
const SOURCE: u32 = 0xff;
const ALL: u32 = 0x1fff_ffff;
/// Formats below have a destination in the place of the number's last part.
const BROADCAST_FORMAT: u32 = 240;
/// The address of who has none; in DBC files it stands for any.
pub(super) const NULL_ADDRESS: u8 = 254;

/// Who sends a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SourceAddress {
    /// One address, 0 … 253.
    Of(u8),
    /// Whoever it is: `*`.
    Any,
}

impl Serialize for SourceAddress {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            SourceAddress::Of(address) => serializer.serialize_u8(*address),
            SourceAddress::Any => serializer.serialize_str("*"),
        }
    }
}

impl<'de> Deserialize<'de> for SourceAddress {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Number(i64),
            Text(String),
        }
        match Written::deserialize(deserializer)? {
            Written::Number(address @ 0..=253) => Ok(SourceAddress::Of(address as u8)),
            Written::Text(text) if text == "*" => Ok(SourceAddress::Any),
            _ => Err(de::Error::custom("a source address is 0 … 253, or \"*\" for any")),
        }
    }
}

/// Which frames are meant: one identifier, or all that share some of its bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameChoice {
    /// The identifier, or one of them.
    pub identifier: Identifier,
    /// Bits of it that must be the same.
    pub mask: u32,
}

impl FrameChoice {
    /// One identifier.
    pub fn one(identifier: Identifier) -> Self {
        FrameChoice { identifier, mask: ALL }
    }

    /// The frames of an identifier's parameter group, whatever their priority and, where there is one, destination.
    pub fn of_group(bits: u32, source: SourceAddress) -> Self {
        let has_destination = (bits >> 16 & 0xff) < BROADCAST_FORMAT;
        let mut mask = ALL & !PRIORITY;
        if has_destination {
            mask &= !SPECIFIC;
        }
        let bits = match source {
            SourceAddress::Of(address) => bits & !SOURCE | u32::from(address),
            SourceAddress::Any => {
                mask &= !SOURCE;
                bits
            }
        };
        FrameChoice { identifier: Identifier::Extended(bits & ALL), mask }
    }

    /// The frames of a parameter group by its number; `None` where there is no such number.
    pub fn of_number(number: u32, source: SourceAddress) -> Option<Self> {
        (number <= 0x3_ffff).then(|| Self::of_group(number << 8, source))
    }

    /// Whether a frame of that identifier is meant.
    pub fn takes(&self, identifier: Identifier) -> bool {
        match (self.identifier, identifier) {
            (Identifier::Standard(a), Identifier::Standard(b)) => a == b,
            (Identifier::Extended(a), Identifier::Extended(b)) => (a ^ b) & self.mask == 0,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_told_by_number_and_source() {
        // Engine controller 1 (61444) of address 0 with priorities 3 and 6, of address 39, and the next group.
        let ids = [0x0cf0_0400, 0x18f0_0400, 0x0cf0_0427, 0x0cf0_0300].map(Identifier::Extended);
        let taken = |choice: FrameChoice| ids.map(|id| choice.takes(id));
        assert_eq!(taken(FrameChoice::one(ids[0])), [true, false, false, false]);
        let number = |source| FrameChoice::of_number(61_444, source).unwrap();
        assert_eq!(taken(number(SourceAddress::Of(0))), [true, true, false, false]);
        assert_eq!(taken(number(SourceAddress::Any)), [true, true, true, false]);
        assert!(!number(SourceAddress::Any).takes(Identifier::Standard(4)));
        // With a format below 240 the part after it is whom the frame is for.
        let to_someone = FrameChoice::of_number(0xef00, SourceAddress::Any).unwrap();
        assert!(to_someone.takes(Identifier::Extended(0x18ef_c034)));
        assert_eq!(FrameChoice::of_number(0x4_0000, SourceAddress::Any), None);
    }
}
