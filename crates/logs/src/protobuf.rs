//! Protobuf messages by the descriptor set in the log's schema, shown to a visitor as they are read.
//!
//! Read here because a reflection crate builds the message with every default that its schema knows: a type that contains
//! itself has defaults without end, which 258 bytes are enough for. Of a schema only the types are kept that the message
//! leads to, of a message nothing.
//!
//! **Absent is absent, unless the format says 0.** A field with presence (proto2, proto3 `optional`, a member of a `oneof`, a
//! message) that is not on the wire was not set, and nothing is made of it. A proto3 number without presence is left
//! out by its writer exactly where it is 0, so there absent *is* 0.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};

use super::fields::{DEEPEST, FREE_STEPS, FieldVisitor, Step};
use super::message_error::{MessageError, Misfit};
use super::protobuf_wire::{Value, Wire, WireError};
use super::schema_error::{DescriptorError, SchemaError};

/// Types, and fields of all types, that a schema may define; large ones have some thousand.
pub(super) const MOST_DEFINED: usize = 16_384;
/// Longest full name of a type, bytes.
const LONGEST_NAME: usize = 512;

/// A message's type with those that it refers to.
#[derive(Debug)]
pub(crate) struct ProtobufMessage {
    /// The first is the message's own.
    types: Vec<MessageType>,
}

#[derive(Debug, Default)]
struct MessageType {
    fields: BTreeMap<u32, Field>,
    /// An entry of a map: a key and a value.
    is_map_entry: bool,
}

#[derive(Debug)]
struct Field {
    name: String,
    kind: Kind,
    repeated: bool,
    /// Whether the field is 0 where it is absent.
    implicit: bool,
}

/// What a field holds, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Double,
    Float,
    /// Whole numbers by their wire formats.
    Signed64,
    Unsigned64,
    Signed32,
    Unsigned32,
    ZigZag,
    Fixed64,
    Fixed32,
    SignedFixed64,
    SignedFixed32,
    Bool,
    Text,
    Bytes,
    /// A message, by its place among the types.
    Message(usize),
}

impl ProtobufMessage {
    /// Reads a descriptor set (`google.protobuf.FileDescriptorSet`) as far as the message of that name leads.
    ///
    /// # Errors
    /// [`SchemaError`]: the set does not parse, does not define the message, or defines more than is believed.
    pub(crate) fn parse(name: &str, set: &[u8]) -> Result<Self, SchemaError> {
        let mut defined = BTreeMap::new();
        index(set, &mut defined)?;
        if !defined.contains_key(name) {
            return Err(SchemaError::NotDefined { message: name.into() });
        }
        let mut places = HashMap::from([(name.to_owned(), 0)]);
        let mut order = vec![name.to_owned()];
        let (mut types, mut fields) = (Vec::new(), 0);
        while let Some(name) = order.get(types.len()).cloned() {
            let mut place_of = |full_name: &str| {
                *places.entry(full_name.to_owned()).or_insert_with(|| {
                    order.push(full_name.to_owned());
                    order.len() - 1
                })
            };
            let message = message_type(&name, &defined, &mut place_of)
                .map_err(|error| SchemaError::Descriptor { message: name, error })?;
            fields += message.fields.len();
            if fields > MOST_DEFINED {
                return Err(SchemaError::TooManyFields);
            }
            types.push(message);
        }
        Ok(ProtobufMessage { types })
    }

    /// Shows a message to a visitor.
    ///
    /// # Errors
    /// [`MessageError::Misfit`]: the message does not fit its schema, or a wanted field is no number.
    pub(crate) fn visit(&self, message: &[u8], visitor: &mut impl FieldVisitor) -> Result<(), MessageError> {
        let mut walk = Walk { types: &self.types, visitor, steps: message.len() + FREE_STEPS };
        Ok(walk.message(0, message, 0)?)
    }
}

/// A message's definition, and whether its file gives numbers no presence.
struct Defined<'s> {
    body: &'s [u8],
    implicit: bool,
}

/// Finds the definitions of a descriptor set by their full names.
fn index<'s>(set: &'s [u8], defined: &mut BTreeMap<String, Defined<'s>>) -> Result<(), DescriptorError> {
    for file in Wire(set).bodies(1) {
        let file = file?;
        let (mut package, mut syntax, mut features) = (&b""[..], &b""[..], None);
        let mut wire = Wire(file);
        while let Some((number, value)) = wire.next()? {
            match (number, value) {
                (2, Value::Bytes(text)) => package = text,
                (12, Value::Bytes(text)) => syntax = text,
                (8, Value::Bytes(options)) => features = presence(options, 50)?.or(features),
                _ => {}
            }
        }
        // In editions presence is a feature, which is explicit unless a file or a field says otherwise.
        let implicit = syntax == b"proto3" || features == Some(IMPLICIT);
        for body in Wire(file).bodies(4) {
            index_message(package, body?, implicit, defined, 0)?;
        }
    }
    Ok(())
}

fn index_message<'s>(
    scope: &[u8],
    body: &'s [u8],
    implicit: bool,
    defined: &mut BTreeMap<String, Defined<'s>>,
    depth: usize,
) -> Result<(), DescriptorError> {
    let own = Wire(body).bodies(1).last().transpose()?.unwrap_or_default();
    let full = if scope.is_empty() { own.to_vec() } else { [scope, b".", own].concat() };
    let full = String::from_utf8(full).map_err(|_| DescriptorError::NotText)?;
    if full.len() > LONGEST_NAME || defined.len() >= MOST_DEFINED || depth > DEEPEST {
        return Err(DescriptorError::TooManyNames);
    }
    for nested in Wire(body).bodies(3) {
        index_message(full.as_bytes(), nested?, implicit, defined, depth + 1)?;
    }
    defined.insert(full, Defined { body, implicit });
    Ok(())
}

/// `FeatureSet.FieldPresence.IMPLICIT`.
const IMPLICIT: u64 = 2;

/// The presence that the features in some options ask for, which are the options' field of that number.
fn presence(options: &[u8], features: u32) -> Result<Option<u64>, WireError> {
    let mut found = None;
    for features in Wire(options).bodies(features) {
        let mut wire = Wire(features?);
        while let Some((number, value)) = wire.next()? {
            if let (1, Value::Varint(presence)) = (number, value) {
                found = Some(presence);
            }
        }
    }
    Ok(found)
}

fn message_type(
    name: &str,
    defined: &BTreeMap<String, Defined<'_>>,
    place_of: &mut impl FnMut(&str) -> usize,
) -> Result<MessageType, DescriptorError> {
    let mut message = MessageType::default();
    let Some(definition) = defined.get(name) else { return Ok(message) };
    for field in Wire(definition.body).bodies(2) {
        let (number, field) = field_of(name, field?, definition.implicit, defined, place_of)?;
        message.fields.insert(number, field);
    }
    // MessageOptions.map_entry.
    for options in Wire(definition.body).bodies(7) {
        let mut wire = Wire(options?);
        while let Some((number, value)) = wire.next()? {
            message.is_map_entry |= number == 7 && value == Value::Varint(1);
        }
    }
    Ok(message)
}

/// A `FieldDescriptorProto`.
fn field_of(
    scope: &str,
    definition: &[u8],
    implicit_in_file: bool,
    defined: &BTreeMap<String, Defined<'_>>,
    place_of: &mut impl FnMut(&str) -> usize,
) -> Result<(u32, Field), DescriptorError> {
    let (mut name, mut type_name) = (&b""[..], &b""[..]);
    let (mut number, mut repeated, mut type_code, mut in_oneof, mut features) = (0, false, 0, false, None);
    let mut wire = Wire(definition);
    while let Some((part, value)) = wire.next()? {
        match (part, value) {
            (1, Value::Bytes(text)) => name = text,
            (3, Value::Varint(value)) => number = value as u32,
            (4, Value::Varint(label)) => repeated = label == 3,
            (5, Value::Varint(code)) => type_code = code,
            (6, Value::Bytes(text)) => type_name = text,
            (8, Value::Bytes(options)) => features = presence(options, 21)?.or(features),
            // A proto3 `optional` is the one member of a `oneof`.
            (9, _) => in_oneof = true,
            _ => {}
        }
    }
    let text =
        |text: &[u8]| std::str::from_utf8(text).map(str::to_owned).map_err(|_| DescriptorError::NotText);
    let (name, type_name) = (text(name)?, text(type_name)?);
    let message = resolve(scope, &type_name, defined);
    let kind = match (type_code, message) {
        (1, _) => Kind::Double,
        (2, _) => Kind::Float,
        (3, _) => Kind::Signed64,
        (4, _) => Kind::Unsigned64,
        (5 | 14, _) => Kind::Signed32,
        (6, _) => Kind::Fixed64,
        (7, _) => Kind::Fixed32,
        (8, _) => Kind::Bool,
        (9, _) => Kind::Text,
        // Without a code the name alone tells messages from enumerations.
        (0 | 10 | 11, Some(message)) => Kind::Message(place_of(&message)),
        (0, None) if !type_name.is_empty() => Kind::Signed32,
        (10 | 11, None) => return Err(DescriptorError::UndefinedType { field: name }),
        (12, _) => Kind::Bytes,
        (13, _) => Kind::Unsigned32,
        (15, _) => Kind::SignedFixed32,
        (16, _) => Kind::SignedFixed64,
        (17 | 18, _) => Kind::ZigZag,
        _ => return Err(DescriptorError::UnknownType { field: name }),
    };
    let is_number = !matches!(kind, Kind::Text | Kind::Bytes | Kind::Message(_));
    let implicit_here = features.map_or(implicit_in_file, |presence| presence == IMPLICIT);
    let implicit = is_number && implicit_here && !repeated && !in_oneof;
    Ok((number, Field { name, kind, repeated, implicit }))
}

/// The full name of the message that a type's name means: from the top with a leading dot, else from the scope outwards.
fn resolve(scope: &str, name: &str, defined: &BTreeMap<String, Defined<'_>>) -> Option<String> {
    if let Some(full) = name.strip_prefix('.') {
        return defined.contains_key(full).then(|| full.to_owned());
    }
    if name.len() > LONGEST_NAME {
        return None;
    }
    let mut scope = Some(scope);
    while let Some(outer) = scope {
        let full = format!("{outer}.{name}");
        if defined.contains_key(&full) {
            return Some(full);
        }
        scope = outer.rsplit_once('.').map(|(outer, _)| outer);
    }
    defined.contains_key(name).then(|| name.to_owned())
}

/// A message on its way to a visitor.
struct Walk<'t, 'v, V> {
    types: &'t [MessageType],
    visitor: &'v mut V,
    /// What may still be looked at.
    steps: usize,
}

impl<V: FieldVisitor> Walk<'_, '_, V> {
    fn spend(&mut self) -> Result<(), Box<Misfit>> {
        let Some(left) = self.steps.checked_sub(1) else { return Err(Misfit::Endless.into()) };
        self.steps = left;
        Ok(())
    }

    fn message(&mut self, at: usize, body: &[u8], depth: usize) -> Result<(), Box<Misfit>> {
        if depth > DEEPEST {
            return Err(Misfit::TooDeep.into());
        }
        let types = self.types;
        let Some(message) = types.get(at) else { return Ok(()) };
        let mut elements: BTreeMap<u32, usize> = BTreeMap::new();
        let mut parts: BTreeMap<u32, Cow<'_, [u8]>> = BTreeMap::new();
        let mut wire = Wire(body);
        while let Some((number, value)) = wire.next()? {
            let Some(field) = message.fields.get(&number) else { continue };
            if !self.visitor.enter(Step::Key(&field.name)) {
                continue;
            }
            self.spend()?;
            let element = elements.entry(number).or_default();
            match (field.kind, value) {
                (Kind::Message(_), Value::Bytes(part) | Value::Group(part)) if !field.repeated => {
                    // One that comes in parts is all of them, one after the other.
                    parts
                        .entry(number)
                        .and_modify(|parts| parts.to_mut().extend_from_slice(part))
                        .or_insert(Cow::Borrowed(part));
                }
                (kind, value) => self
                    .field(kind, field.repeated, value, element, depth)
                    .map_err(|misfit| misfit.in_field(&field.name))?,
            }
            self.visitor.leave();
        }
        for (number, part) in parts {
            let Some((Kind::Message(at), name)) = message.fields.get(&number).map(|f| (f.kind, &f.name))
            else {
                continue;
            };
            if self.visitor.enter(Step::Key(name)) {
                self.message(at, &part, depth + 1).map_err(|misfit| misfit.in_field(name))?;
                self.visitor.leave();
            }
        }
        let absent =
            message.fields.iter().filter(|(number, field)| field.implicit && !elements.contains_key(number));
        for (_, field) in absent {
            self.spend()?;
            if self.visitor.enter(Step::Key(&field.name)) {
                self.visitor.number(0.0)?;
                self.visitor.leave();
            }
        }
        Ok(())
    }

    /// A field that the visitor has entered; `element` counts those of a repeated one.
    fn field(
        &mut self,
        kind: Kind,
        repeated: bool,
        value: Value<'_>,
        element: &mut usize,
        depth: usize,
    ) -> Result<(), Box<Misfit>> {
        match (kind, value) {
            (Kind::Message(at), Value::Bytes(body) | Value::Group(body)) => {
                match self.types.get(at).is_some_and(|message| message.is_map_entry) {
                    true => self.map_entry(at, body, depth),
                    false => self.element(element, |walk| walk.message(at, body, depth + 1)),
                }
            }
            (Kind::Text, Value::Bytes(text)) => {
                let text = std::str::from_utf8(text).map_err(|_| Misfit::NotText)?;
                match repeated {
                    true => self.element(element, |walk| Ok(walk.visitor.text(text)?)),
                    false => Ok(self.visitor.text(text)?),
                }
            }
            (Kind::Bytes, Value::Bytes(_)) => Ok(()),
            (_, Value::Bytes(packed)) if repeated => {
                let mut packed = Wire(packed);
                while !packed.0.is_empty() {
                    let value = packed.value(kind.wire_type())?;
                    self.element(element, |walk| walk.number(kind, value))?;
                }
                Ok(())
            }
            (_, value) if repeated => self.element(element, |walk| walk.number(kind, value)),
            (_, value) => self.number(kind, value),
        }
    }

    /// Takes the next element of a repeated field, if it is wanted.
    fn element(
        &mut self,
        element: &mut usize,
        take: impl FnOnce(&mut Self) -> Result<(), Box<Misfit>>,
    ) -> Result<(), Box<Misfit>> {
        let index = *element;
        *element += 1;
        if self.visitor.enter(Step::Index(index)) {
            self.spend()?;
            take(self)?;
            self.visitor.leave();
        }
        Ok(())
    }

    fn number(&mut self, kind: Kind, value: Value<'_>) -> Result<(), Box<Misfit>> {
        let Some(number) = kind.number(value) else { return Err(Misfit::OtherType.into()) };
        Ok(self.visitor.number(number)?)
    }

    /// An entry of a map: its value, under its key's text.
    fn map_entry(&mut self, at: usize, body: &[u8], depth: usize) -> Result<(), Box<Misfit>> {
        let fields = self.types.get(at).map(|entry| (entry.fields.get(&1), entry.fields.get(&2)));
        let Some((Some(key_field), Some(value_field))) = fields else { return Ok(()) };
        let (mut key, mut entry) = (None, None);
        let mut wire = Wire(body);
        while let Some((number, value)) = wire.next()? {
            match number {
                1 => key = Some(value),
                2 => entry = Some(value),
                _ => {}
            }
        }
        // Neither is written where it is its type's default.
        let key = match key {
            Some(key) => key_text(key_field.kind, key).ok_or(Misfit::NotAKey)?,
            None if key_field.kind == Kind::Text => String::new(),
            None if key_field.kind == Kind::Bool => "false".into(),
            None => "0".into(),
        };
        if self.visitor.enter(Step::Key(&key)) {
            self.spend()?;
            match (value_field.kind, entry) {
                (Kind::Message(at), entry) => match entry {
                    Some(Value::Bytes(body)) => self.message(at, body, depth + 1)?,
                    _ => self.message(at, &[], depth + 1)?,
                },
                (Kind::Text | Kind::Bytes, None) => {}
                (_, None) => self.visitor.number(0.0)?,
                (kind, Some(value)) => self.field(kind, false, value, &mut 0, depth)?,
            }
            self.visitor.leave();
        }
        Ok(())
    }
}

fn key_text(kind: Kind, value: Value<'_>) -> Option<String> {
    match (kind, value) {
        (Kind::Text, Value::Bytes(text)) => std::str::from_utf8(text).ok().map(str::to_owned),
        (Kind::Bool, Value::Varint(bit)) => Some((bit != 0).to_string()),
        (Kind::Unsigned64, Value::Varint(key)) | (Kind::Fixed64, Value::Fixed64(key)) => {
            Some(key.to_string())
        }
        (Kind::Signed64, Value::Varint(key)) | (Kind::SignedFixed64, Value::Fixed64(key)) => {
            Some((key as i64).to_string())
        }
        // The others are exact as numbers, up to zigzag keys of more than 53 bits.
        _ => kind.number(value).map(|number| number.to_string()),
    }
}

impl Kind {
    /// The wire type of an element that is packed.
    fn wire_type(self) -> u8 {
        match self {
            Kind::Double | Kind::Fixed64 | Kind::SignedFixed64 => 1,
            Kind::Float | Kind::Fixed32 | Kind::SignedFixed32 => 5,
            _ => 0,
        }
    }

    fn number(self, value: Value<'_>) -> Option<f64> {
        Some(match (self, value) {
            (Kind::Double, Value::Fixed64(bits)) => f64::from_bits(bits),
            (Kind::Float, Value::Fixed32(bits)) => f64::from(f32::from_bits(bits)),
            (Kind::Signed64, Value::Varint(bits)) | (Kind::SignedFixed64, Value::Fixed64(bits)) => {
                bits as i64 as f64
            }
            (Kind::Unsigned64, Value::Varint(bits)) | (Kind::Fixed64, Value::Fixed64(bits)) => bits as f64,
            (Kind::Signed32, Value::Varint(bits)) => f64::from(bits as i32),
            (Kind::Unsigned32, Value::Varint(bits)) => f64::from(bits as u32),
            (Kind::ZigZag, Value::Varint(bits)) => ((bits >> 1) as i64 ^ -((bits & 1) as i64)) as f64,
            (Kind::Fixed32, Value::Fixed32(bits)) => f64::from(bits),
            (Kind::SignedFixed32, Value::Fixed32(bits)) => f64::from(bits as i32),
            (Kind::Bool, Value::Varint(bits)) => f64::from(u8::from(bits != 0)),
            _ => return None,
        })
    }
}
