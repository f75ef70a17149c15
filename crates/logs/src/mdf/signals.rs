//! Samples from the measured signals of an MDF log.

use std::io;

use seepd_settings::nearest;
use seepd_signals::{Sample, Signal};

use super::records::Records;
use super::{CONVERT, Channel, MdfFile};
use crate::csv::COLUMNS_TOLD;
use crate::error::{LogError, listed};
use crate::mapping::{SignalMapping, ToSi};
use crate::source::Source;

/// Samples from measured signals. Groups have clocks of their own; a command is published with what was known beside it.
pub(crate) struct MdfSource<'i> {
    file: MdfFile<'i>,
    groups: Vec<SignalGroup>,
    held: Sample,
    given: u64,
    without_command: u64,
}

/// A data group with signals of the mapping.
struct SignalGroup {
    index: usize,
    records: Records,
    wanted: Vec<Wanted>,
    numbers: Vec<u64>,
    /// Channel group and time of the record at hand, whose values have not been taken.
    ahead: Option<(usize, i64)>,
    ended: bool,
}

struct Wanted {
    signal: Signal,
    /// Channel group within the data group, and channel.
    place: (usize, usize),
    to_si: ToSi,
}

impl<'i> MdfSource<'i> {
    /// Finds the signals of a mapping. One under its own name may be missing, unless it is the command.
    ///
    /// # Errors
    /// [`LogError`] where there is none of that name.
    pub(crate) fn new(
        file: MdfFile<'i>,
        name: &str,
        mapping: Vec<(Signal, SignalMapping)>,
    ) -> Result<Self, LogError> {
        let mut groups: Vec<SignalGroup> = Vec::new();
        for (signal, place) in mapping {
            let Some((index, of_group, channel)) = file.find(&place) else {
                if place.may_be_missing(signal) {
                    continue;
                }
                return Err(LogError::data(name, file.no_such(&place)));
            };
            let unit = &file.groups[index].channel_groups[of_group].channels[channel].unit;
            let wanted = Wanted { signal, place: (of_group, channel), to_si: place.to_si(signal, unit) };
            match groups.iter_mut().find(|group| group.index == index) {
                Some(group) => group.wanted.push(wanted),
                None => groups.push(SignalGroup {
                    index,
                    records: file.records(index),
                    wanted: vec![wanted],
                    numbers: vec![0; file.groups[index].channel_groups.len()],
                    ahead: None,
                    ended: false,
                }),
            }
        }
        // Of records at one time, that of the command comes last.
        groups.sort_by_key(|group| group.wanted.iter().any(|wanted| wanted.signal == Signal::Command));
        Ok(MdfSource { file, groups, held: Sample::new(0), given: 0, without_command: 0 })
    }

    /// The next sample, if the record that comes next holds a command.
    fn take_record(&mut self) -> io::Result<Option<Option<Sample>>> {
        for group in &mut self.groups {
            group.fill(&mut self.file)?;
        }
        let due = |group: &&mut SignalGroup| group.ahead.map_or(i64::MAX, |(_, time_ns)| time_ns);
        let next = self.groups.iter_mut().filter(|group| group.ahead.is_some()).min_by_key(due);
        let Some(group) = next else { return Ok(None) };
        let Some((place, time_ns)) = group.ahead.take() else { return Ok(None) };
        let channels = &self.file.groups[group.index].channel_groups[place];
        let (mut has_command, mut is_of_command) = (false, false);
        for wanted in group.wanted.iter().filter(|wanted| wanted.place.0 == place) {
            is_of_command |= wanted.signal == Signal::Command;
            let channel = &channels.channels[wanted.place.1];
            let Some(value) = channel.value(&group.records.record, channels.data_bytes) else { continue };
            self.held.set(wanted.signal, wanted.to_si.of(value));
            has_command |= wanted.signal == Signal::Command;
        }
        self.without_command += u64::from(is_of_command && !has_command);
        self.held.time_ns = time_ns;
        self.given += u64::from(has_command);
        Ok(Some(has_command.then_some(self.held)))
    }
}

impl SignalGroup {
    fn fill(&mut self, file: &mut MdfFile<'_>) -> io::Result<()> {
        while self.ahead.is_none() && !self.ended {
            let Some((place, _)) = self.records.next(&mut file.blocks)? else {
                self.ended = true;
                file.note_damage(&self.records);
                return Ok(());
            };
            let group = &file.groups[self.index].channel_groups[place];
            let number = self.numbers[place];
            self.numbers[place] += 1;
            if group.is_beyond(number) {
                self.ended = file.groups[self.index].id_bytes == 0;
                continue;
            }
            if self.wanted.iter().any(|wanted| wanted.place.0 == place) {
                let time_ns = group.time_ns(&self.records.record, number, file.start_ns);
                self.ahead = time_ns.map(|time_ns| (place, time_ns));
            }
        }
        Ok(())
    }
}

impl MdfFile<'_> {
    /// Data group, channel group and channel of a signal.
    fn find(&self, place: &SignalMapping) -> Option<(usize, usize, usize)> {
        let groups = self.groups.iter().enumerate();
        let mut all = groups.flat_map(|(index, group)| {
            group.channel_groups.iter().enumerate().map(move |(of_group, group)| (index, of_group, group))
        });
        all.find_map(|(index, of_group, group)| {
            let fits = place.topic.is_empty() || place.topic == group.topic;
            if !fits || group.time().is_none() {
                return None;
            }
            let is = |channel: &Channel| channel.name == place.field && channel.is_number();
            Some((index, of_group, group.channels.iter().position(is)?))
        })
    }

    fn no_such(&self, place: &SignalMapping) -> String {
        let field = &place.field;
        let all = || self.channel_groups().flat_map(|group| &group.channels);
        if all().any(|channel| channel.name == *field && channel.has_formula()) {
            return format!(
                "the channel `{field}` has a formula, which is not evaluated; convert it: {CONVERT}"
            );
        }
        let names: Vec<&str> =
            all().filter(|channel| channel.is_number()).map(|channel| &*channel.name).collect();
        let hint = match nearest(field, names.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None if self.has_frames() => {
                "it has the frames of a bus: name the DBC file that describes them (dbc, --dbc FILE)".into()
            }
            None => format!("it has {}", listed(&names, COLUMNS_TOLD)),
        };
        let group =
            if place.topic.is_empty() { String::new() } else { format!(" in the group `{}`", place.topic) };
        format!("no channel `{field}`{group}; {hint}")
    }
}

impl Source for MdfSource<'_> {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        loop {
            match self.take_record().map_err(|error| LogError::reading(&self.file.name, error))? {
                Some(None) => {}
                Some(sample) => return Ok(sample),
                None if self.given == 0 => {
                    let notes = self.notes().join("; ");
                    let why = if notes.is_empty() { String::new() } else { format!(" ({notes})") };
                    return Err(LogError::data(&self.file.name, format!("no record has a command{why}")));
                }
                None => return Ok(None),
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let without = (self.without_command > 0).then(|| {
            format!("{} records were left out, since their command is not valid", self.without_command)
        });
        let notes = self.file.notes().into_iter().chain(without);
        notes.map(|note| format!("{}: {note}", self.file.name)).collect()
    }
}
