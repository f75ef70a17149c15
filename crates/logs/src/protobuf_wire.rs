//! Protobuf's wire format: fields by their numbers, as far as their bytes go.

/// Bytes in protobuf's wire format that are still to be read.
pub(super) struct Wire<'m>(pub(super) &'m [u8]);

/// A field's value on the wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Value<'m> {
    Varint(u64),
    Fixed64(u64),
    Bytes(&'m [u8]),
    Group(&'m [u8]),
    Fixed32(u32),
}

/// Why bytes are not in protobuf's wire format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum WireError {
    /// They end within a field.
    #[error("it is cut short")]
    CutShort,
    /// A number goes on beyond 64 bits.
    #[error("a number has more than ten bytes")]
    LongNumber,
    /// What follows a field's number tells no length that is known.
    #[error("{wire_type} is not a wire type")]
    NoWireType {
        /// What stands in its place.
        wire_type: u8,
    },
}

/// Wire types that begin and end a group.
const GROUP_BEGINS: u8 = 3;
const GROUP_ENDS: u8 = 4;

// Left to itself, the compiler calls the smallest of these for every field, at a fifth more time a message.
impl<'m> Wire<'m> {
    /// The next field's number and value.
    #[inline]
    pub(super) fn next(&mut self) -> Result<Option<(u32, Value<'m>)>, WireError> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let (number, wire_type) = self.tag()?;
        Ok(Some((number, self.value(wire_type)?)))
    }

    /// The bodies of the fields of that number.
    pub(super) fn bodies(mut self, number: u32) -> impl Iterator<Item = Result<&'m [u8], WireError>> {
        std::iter::from_fn(move || {
            loop {
                match self.next() {
                    Ok(Some((found, Value::Bytes(body)))) if found == number => return Some(Ok(body)),
                    Ok(Some(_)) => {}
                    Ok(None) => return None,
                    Err(error) => {
                        self.0 = &[];
                        return Some(Err(error));
                    }
                }
            }
        })
    }

    #[inline(always)]
    fn tag(&mut self) -> Result<(u32, u8), WireError> {
        let tag = self.varint()?;
        Ok(((tag >> 3) as u32, (tag & 7) as u8))
    }

    /// The value of a field whose tag has been read.
    #[inline]
    pub(super) fn value(&mut self, wire_type: u8) -> Result<Value<'m>, WireError> {
        Ok(match wire_type {
            0 => Value::Varint(self.varint()?),
            1 => Value::Fixed64(u64::from_le_bytes(self.fixed()?)),
            2 => {
                let length = usize::try_from(self.varint()?).unwrap_or(usize::MAX);
                Value::Bytes(self.split(length)?)
            }
            GROUP_BEGINS => Value::Group(self.group()?),
            5 => Value::Fixed32(u32::from_le_bytes(self.fixed()?)),
            wire_type => return Err(WireError::NoWireType { wire_type }),
        })
    }

    #[inline(always)]
    fn varint(&mut self) -> Result<u64, WireError> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let (byte, rest) = self.0.split_first().ok_or(WireError::CutShort)?;
            self.0 = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(WireError::LongNumber)
    }

    #[inline(always)]
    fn split(&mut self, length: usize) -> Result<&'m [u8], WireError> {
        let (bytes, rest) = self.0.split_at_checked(length).ok_or(WireError::CutShort)?;
        self.0 = rest;
        Ok(bytes)
    }

    #[inline(always)]
    fn fixed<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let (bytes, rest) = self.0.split_first_chunk().ok_or(WireError::CutShort)?;
        self.0 = rest;
        Ok(*bytes)
    }

    /// What is in a group, to its end; groups within it are passed over without recursion.
    fn group(&mut self) -> Result<&'m [u8], WireError> {
        let begin = self.0;
        let mut open = 1;
        loop {
            let before = self.0.len();
            let (_, wire_type) = self.tag()?;
            match wire_type {
                GROUP_BEGINS => open += 1,
                GROUP_ENDS => open -= 1,
                other => {
                    self.value(other)?;
                }
            }
            if open == 0 {
                return Ok(&begin[..begin.len() - before]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_every_wire_type() {
        let bytes = [
            0x08, 0x96, 0x01, 0x12, 1, 7, 0x1b, 0x08, 1, 0x1c, 0x25, 1, 0, 0, 0, 0x29, 2, 0, 0, 0, 0, 0, 0, 0,
        ];
        let mut wire = Wire(&bytes);
        let mut found = Vec::new();
        while let Some(field) = wire.next().unwrap() {
            found.push(field);
        }
        let expected = [
            (1, Value::Varint(150)),
            (2, Value::Bytes(&[7])),
            (3, Value::Group(&[8, 1])),
            (4, Value::Fixed32(1)),
            (5, Value::Fixed64(2)),
        ];
        assert_eq!(found, expected);
        // Cut anywhere within a field, it is an error or the fields before.
        for cut in 0..bytes.len() {
            let mut wire = Wire(&bytes[..cut]);
            let mut count = 0;
            while let Ok(Some(field)) = wire.next() {
                assert_eq!(field, expected[count]);
                count += 1;
            }
        }
        assert!(Wire(&[0xff; 11]).next().is_err() && Wire(&[0x0e]).next().is_err());
    }
}
