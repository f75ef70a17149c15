//! Which fields of a message are wanted, and what was found of them.
//!
//! A message is shown to a [`FieldVisitor`] part by part, and what nobody asks for is passed over: no message is built, so
//! that none can take more memory than its own bytes.

use seepd_signals::Signal;

use crate::mapping::{SignalMapping, ToSi};

/// Parts of a field path that are followed; real ones have five or so.
pub(crate) const DEEPEST: usize = 32;

/// Fields and elements that a message may make one look at, besides one for each of its bytes: some take no bytes.
pub(super) const FREE_STEPS: usize = 1 << 16;

/// A part of a field path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step<'s> {
    /// A field's name, or a map's key.
    Key(&'s str),
    /// An element of an array.
    Index(usize),
}

/// Longest path of a field that is told, bytes.
pub(super) const LONGEST_PATH: usize = 256;
/// Elements of an array that are told; long arrays are images and clouds of points, not signals.
const ELEMENTS_TOLD: usize = 16;

/// Why what stands in a field cannot be what it is wanted for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum ValueError {
    /// The time is not finite.
    #[error("the time is not a number")]
    NoTime,
    /// A text is in the place of a number.
    #[error("`{begin}` is not a number")]
    NotANumber {
        /// The text, or its beginning.
        begin: String,
    },
}

/// What is shown a message's numbers, from its top down.
pub(crate) trait FieldVisitor {
    /// Goes down a step; `false`, and stays, where nothing below it is wanted.
    fn enter(&mut self, step: Step<'_>) -> bool;

    /// Goes back up.
    fn leave(&mut self);

    /// A number here.
    ///
    /// # Errors
    /// [`ValueError`] where it cannot be what it is wanted for.
    fn number(&mut self, value: f64) -> Result<(), ValueError>;

    /// A text here.
    ///
    /// # Errors
    /// [`ValueError`] where a number is wanted, and it is none.
    fn text(&mut self, text: &str) -> Result<(), ValueError>;
}

/// What a field is for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Target {
    /// A signal, with its way to SI.
    Signal { signal: Signal, to_si: ToSi },
    /// The time in seconds, or a stamp's seconds.
    Seconds,
    /// A stamp's nanoseconds.
    Nanoseconds,
}

#[derive(Debug, Clone, PartialEq)]
enum OwnedStep {
    Key(String),
    Index(usize),
}

impl OwnedStep {
    fn is(&self, step: Step<'_>) -> bool {
        match (self, step) {
            (OwnedStep::Key(own), Step::Key(other)) => own == other,
            (OwnedStep::Index(own), Step::Index(other)) => *own == other,
            _ => false,
        }
    }
}

/// The fields that are wanted of a message, as a tree along their paths.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct FieldTree {
    children: Vec<(OwnedStep, FieldTree)>,
    targets: Vec<Target>,
}

/// Why fields cannot be looked for together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum PathError {
    /// A path is longer than those of messages are.
    #[error("{key} is a path of {parts} parts; at most {DEEPEST} are followed")]
    TooDeep {
        /// Key of the mapping that has it.
        key: String,
        /// Parts of the path.
        parts: usize,
    },
    /// Two signals of a topic take their one time from two fields.
    #[error(
        "signals.{signal}.time is `{time}`, but signals.{other}.time, on the same topic, is `{other_time}`; a message has one time: \
         name it once"
    )]
    TwoTimes {
        /// The one signal.
        signal: &'static str,
        /// Where its time is.
        time: String,
        /// The other signal.
        other: &'static str,
        /// Where its time is.
        other_time: String,
    },
}

/// What a message held, in the order of the fields in it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Picked {
    /// Signals in SI.
    pub values: Vec<(Signal, f64)>,
    seconds_ns: Option<i64>,
    nanoseconds_ns: Option<i64>,
}

impl Picked {
    /// Time, ns, where the message holds it.
    pub(crate) fn time_ns(&self) -> Option<i64> {
        let parts = [self.seconds_ns, self.nanoseconds_ns];
        parts.into_iter().flatten().reduce(i64::saturating_add)
    }

    fn clear(&mut self) {
        self.values.clear();
        (self.seconds_ns, self.nanoseconds_ns) = (None, None);
    }
}

impl FieldTree {
    /// The tree of a topic's mappings.
    ///
    /// # Errors
    /// [`PathError`]: a path is too deep, or two of the mappings find the message's one time in two places.
    pub(crate) fn of<'c>(
        mappings: impl Iterator<Item = (Signal, &'c SignalMapping)>,
    ) -> Result<Self, PathError> {
        let mut tree = FieldTree::default();
        let mut timed: Option<(Signal, &str)> = None;
        for (signal, mapping) in mappings {
            let key = format!("signals.{}", signal.name());
            let to_si = mapping.to_si(signal, "");
            tree.add(&format!("{key}.field"), &mapping.field, Target::Signal { signal, to_si })?;
            if mapping.time.is_empty() {
                continue;
            }
            let (first, time) = *timed.get_or_insert((signal, &mapping.time));
            if time != mapping.time {
                return Err(PathError::TwoTimes {
                    signal: signal.name(),
                    time: mapping.time.clone(),
                    other: first.name(),
                    other_time: time.to_owned(),
                });
            }
            // A number of seconds, or a stamp of seconds and nanoseconds, as ROS and protobuf have it.
            let key = format!("{key}.time");
            tree.add(&key, time, Target::Seconds)?;
            for (part, target) in [
                ("sec", Target::Seconds),
                ("seconds", Target::Seconds),
                ("nanosec", Target::Nanoseconds),
                ("nanos", Target::Nanoseconds),
            ] {
                tree.add(&key, &format!("{time}.{part}"), target)?;
            }
        }
        Ok(tree)
    }

    fn add(&mut self, key: &str, path: &str, target: Target) -> Result<(), PathError> {
        let parts = steps(path).count();
        if parts > DEEPEST {
            return Err(PathError::TooDeep { key: key.into(), parts });
        }
        let mut node = self;
        for step in steps(path) {
            let at = match node.children.iter().position(|(known, _)| *known == step) {
                Some(at) => at,
                None => {
                    node.children.push((step, FieldTree::default()));
                    node.children.len() - 1
                }
            };
            node = &mut node.children[at].1;
        }
        if !node.targets.contains(&target) {
            node.targets.push(target);
        }
        Ok(())
    }

    /// What puts the wanted fields of a message into `picked`, which is emptied first.
    pub(crate) fn picker<'t>(&'t self, picked: &'t mut Picked) -> Picker<'t> {
        picked.clear();
        Picker { path: [self; DEEPEST + 1], depth: 0, picked }
    }

    /// Whether the command is wanted of these messages.
    pub(crate) fn wants_command(&self) -> bool {
        let is_command = |target: &Target| matches!(target, Target::Signal { signal: Signal::Command, .. });
        self.targets.iter().any(is_command) || self.children.iter().any(|(_, child)| child.wants_command())
    }
}

/// `a.b[2].c` → a, b, 2, c.
fn steps(path: &str) -> impl Iterator<Item = OwnedStep> {
    path.split(['.', '[']).filter(|part| !part.is_empty()).map(|part| {
        match part.strip_suffix(']').and_then(|index| index.parse().ok()) {
            Some(index) => OwnedStep::Index(index),
            None => OwnedStep::Key(part.to_owned()),
        }
    })
}

/// Picks a tree's fields out of a message.
pub(crate) struct Picker<'t> {
    /// From the tree's root to the place at hand; what lies beyond `depth` means nothing.
    path: [&'t FieldTree; DEEPEST + 1],
    depth: usize,
    picked: &'t mut Picked,
}

impl FieldVisitor for Picker<'_> {
    fn enter(&mut self, step: Step<'_>) -> bool {
        let child = self.path[self.depth].children.iter().find(|(known, _)| known.is(step));
        // A tree is no deeper than the path has room for.
        let (Some((_, tree)), Some(place)) = (child, self.path.get_mut(self.depth + 1)) else { return false };
        *place = tree;
        self.depth += 1;
        true
    }

    fn leave(&mut self) {
        self.depth = self.depth.saturating_sub(1);
    }

    fn number(&mut self, value: f64) -> Result<(), ValueError> {
        for target in &self.path[self.depth].targets {
            match target {
                Target::Signal { signal, to_si } => {
                    self.picked.values.push((*signal, to_si.of(value)));
                }
                _ if !value.is_finite() => return Err(ValueError::NoTime),
                Target::Seconds => self.picked.seconds_ns = Some((value * 1e9).round() as i64),
                Target::Nanoseconds => self.picked.nanoseconds_ns = Some(value.round() as i64),
            }
        }
        Ok(())
    }

    fn text(&mut self, text: &str) -> Result<(), ValueError> {
        if self.path[self.depth].targets.is_empty() {
            return Ok(());
        }
        match text.parse() {
            Ok(value) => self.number(value),
            Err(_) => Err(ValueError::NotANumber { begin: text.chars().take(40).collect() }),
        }
    }
}

/// Tells every number of a message with its path.
pub(crate) struct Paths<F> {
    take: F,
    path: String,
    /// Of the path, before each step into it.
    lengths: Vec<usize>,
}

impl<F: FnMut(&str, f64)> Paths<F> {
    /// Tells them to `take`.
    pub(crate) fn new(take: F) -> Self {
        Paths { take, path: String::new(), lengths: Vec::new() }
    }
}

impl<F: FnMut(&str, f64)> FieldVisitor for Paths<F> {
    fn enter(&mut self, step: Step<'_>) -> bool {
        let length = self.path.len();
        let long = match step {
            Step::Key(key) => length + key.len() > LONGEST_PATH,
            Step::Index(index) => index >= ELEMENTS_TOLD,
        };
        if long || self.lengths.len() == DEEPEST {
            return false;
        }
        self.lengths.push(length);
        match step {
            Step::Key(key) if length == 0 => self.path.push_str(key),
            Step::Key(key) => {
                self.path.push('.');
                self.path.push_str(key);
            }
            Step::Index(index) => self.path.push_str(&format!("[{index}]")),
        }
        true
    }

    fn leave(&mut self) {
        self.path.truncate(self.lengths.pop().unwrap_or_default());
    }

    fn number(&mut self, value: f64) -> Result<(), ValueError> {
        (self.take)(&self.path, value);
        Ok(())
    }

    fn text(&mut self, _text: &str) -> Result<(), ValueError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::json;
    use crate::message_error::MessageError;

    fn tree(mappings: &[(Signal, SignalMapping)]) -> Result<FieldTree, PathError> {
        FieldTree::of(mappings.iter().map(|(signal, mapping)| (*signal, mapping)))
    }

    fn mapping(field: &str, scale: f64, time: &str) -> SignalMapping {
        SignalMapping { field: field.into(), scale, time: time.into(), ..SignalMapping::default() }
    }

    fn pick(tree: &FieldTree, json: &[u8], picked: &mut Picked) -> Result<(), MessageError> {
        json::visit(json, &mut tree.picker(picked))
    }

    #[test]
    fn nested_paths_and_indices_are_scaled() {
        let tree = tree(&[
            (Signal::Command, mapping("axis.valve[1]", 0.01, "stamp")),
            (Signal::PCap, mapping("axis.p", 1e5, "")),
        ])
        .unwrap();
        let mut picked = Picked::default();
        let json = br#"{"x":[1,{"y":2}],"stamp":7.5,"axis":{"valve":[3,25,4],"p":80}}"#;
        pick(&tree, json, &mut picked).unwrap();
        assert_eq!(picked.values, [(Signal::Command, 0.25), (Signal::PCap, 8e6)]);
        assert_eq!(picked.time_ns(), Some(7_500_000_000));
        assert!(tree.wants_command());
    }

    #[test]
    fn null_is_not_a_number_and_text_is_refused() {
        let tree = tree(&[(Signal::Command, mapping("command", 1.0, ""))]).unwrap();
        let mut picked = Picked::default();
        pick(&tree, br#"{"command":null}"#, &mut picked).unwrap();
        assert!(picked.values[0].1.is_nan());
        let error = pick(&tree, br#"{"command":"fast"}"#, &mut picked).unwrap_err().to_string();
        assert!(error.contains("`fast` is not a number"), "{error}");
        assert!(pick(&tree, b"{\"command\":0.1", &mut picked).is_err());
    }

    #[test]
    fn a_message_has_one_time() {
        let two = [
            (Signal::Command, mapping("command", 1.0, "stamp")),
            (Signal::Position, mapping("position", 1.0, "received")),
        ];
        let error = tree(&two).unwrap_err().to_string();
        assert_eq!(
            error,
            "signals.position.time is `received`, but signals.command.time, on the same topic, is `stamp`; a message has one time: \
             name it once"
        );
        // Said twice, by a mapping and by a message, it is still one.
        let same = [two[0].clone(), (Signal::Position, mapping("position", 1.0, "stamp"))];
        let mut picked = Picked::default();
        pick(&tree(&same).unwrap(), br#"{"stamp":1.5,"command":0,"stamp":1.5}"#, &mut picked).unwrap();
        assert_eq!(picked.time_ns(), Some(1_500_000_000));
        pick(&tree(&same).unwrap(), br#"{"stamp":{"sec":3,"nanosec":7}}"#, &mut picked).unwrap();
        assert_eq!(picked.time_ns(), Some(3_000_000_007));
        let error = pick(&tree(&same).unwrap(), br#"{"stamp":null,"command":0}"#, &mut picked)
            .unwrap_err()
            .to_string();
        assert!(error.contains("the time is not a number"), "{error}");
    }

    #[test]
    fn a_path_of_200_000_parts_is_refused() {
        let deep = [(Signal::Command, mapping(&"a.".repeat(200_000), 1.0, ""))];
        assert_eq!(
            tree(&deep).unwrap_err().to_string(),
            "signals.command.field is a path of 200000 parts; at most 32 are followed"
        );
        let fits = [(Signal::Command, mapping(&["a"; DEEPEST].join("."), 1.0, ""))];
        let json = format!("{}1{}", r#"{"a":"#.repeat(DEEPEST), "}".repeat(DEEPEST));
        let mut picked = Picked::default();
        pick(&tree(&fits).unwrap(), json.as_bytes(), &mut picked).unwrap();
        assert_eq!(picked.values, [(Signal::Command, 1.0)]);
    }
}
