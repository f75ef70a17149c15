//! ASAM MDF 4: measured signals, and the frames of a bus.
//!
//! What is read: records sorted or mixed, fixed and varying lengths, data plain, zipped (also by column of bytes) or zstd, in lists;
//! conversions by number; files that were never closed. What is not: data stored by column (4.2), formulas, arrays, MDF 3. Of the crates
//! for it, `mdf4-rs` 0.6 needs a newer compiler and holds the whole file, and `asammdf` 0.1 reads whole channels.

mod block;
mod channel;
mod frames;
mod records;
mod signals;
mod stream;

use std::io;

use block::{Block, Blocks};
use channel::{Channel, Kind};
pub(crate) use frames::MdfFrames;
use records::{Layout, Records};
pub(crate) use signals::MdfSource;

use crate::error::LogError;
use crate::opened::Anywhere;

/// Data groups and channel groups that are read.
const MOST_GROUPS: usize = 4096;
/// Channels that are read in all.
const MOST_CHANNELS: usize = 1 << 16;
/// What converts a log of an older version.
const CONVERT_OLD: &str = "pip install asammdf; python3 -c \"import sys; from asammdf import MDF; MDF(sys.argv[1]).convert('4.10').save('log.mf4')\" LOG";
/// What converts a log that is laid out in a way that is not read.
const CONVERT: &str = "pip install asammdf; python3 -c \"import sys; from asammdf import MDF; MDF(sys.argv[1]).export('csv', 'log.csv', \
                       single_time_base=True)\" LOG";

/// See the [module](self).
pub(crate) struct MdfFile<'i> {
    blocks: Blocks<'i>,
    pub(crate) name: String,
    /// Time that the groups' times count from, ns since 1970.
    start_ns: i64,
    unfinished: bool,
    groups: Vec<DataGroup>,
    notes: Vec<String>,
}

/// Records that are stored together.
struct DataGroup {
    data: u64,
    id_bytes: usize,
    channel_groups: Vec<ChannelGroup>,
}

/// Records of one kind.
pub(crate) struct ChannelGroup {
    /// What a mapping calls it.
    pub(crate) topic: String,
    at: u64,
    layout: Layout,
    /// Bytes of a record before the bits that say what in it is none.
    data_bytes: usize,
    /// Records, where the file says how many.
    count: Option<u64>,
    channels: Vec<Channel>,
}

impl<'i> MdfFile<'i> {
    /// Reads what describes the data.
    ///
    /// # Errors
    /// [`LogError`] where it cannot be read, or is of another version.
    pub(crate) fn new(input: Anywhere<'i>, name: &str) -> Result<Self, LogError> {
        let reading = |error| LogError::reading(name, error);
        let mut blocks = Blocks::new(input).map_err(reading)?;
        let mut head = [0; 64];
        blocks.read(0, &mut head).map_err(reading)?;
        let version = u16::from_le_bytes([head[28], head[29]]);
        if !(400..500).contains(&version) {
            let what = format!(
                "this is an MDF log of version {}.{:02}, and version 4 is read; convert it: {CONVERT_OLD}",
                version / 100,
                version % 100
            );
            return Err(LogError::data(name, what));
        }
        let unfinished = head.starts_with(b"UnFinMF ");
        let header = blocks.block(64, &[b"HD"]).map_err(reading)?;
        let header =
            header.ok_or_else(|| LogError::data(name, "this is an MDF log, but its header is damaged"))?;
        let mut file = MdfFile {
            blocks,
            name: name.into(),
            start_ns: i64::try_from(header.u64(0)).unwrap_or(0),
            unfinished,
            groups: Vec::new(),
            notes: Vec::new(),
        };
        file.read_groups(header.link(0)).map_err(reading)?;
        if unfinished {
            file.notes.push("the log was never closed; it was read up to its end".into());
        }
        Ok(file)
    }

    fn read_groups(&mut self, first: u64) -> io::Result<()> {
        let (mut at, mut channels, mut groups) = (first, 0, 0);
        while at != 0 {
            let Some(block) = self.blocks.block(at, &[b"DG"])? else {
                self.notes.push(format!(
                    "the description of data at byte {at} is damaged; what it leads to was left out"
                ));
                return Ok(());
            };
            let mut group = DataGroup {
                data: block.link(2),
                id_bytes: usize::from(block.u8(0)),
                channel_groups: Vec::new(),
            };
            let mut next = block.link(1);
            while next != 0 && groups < MOST_GROUPS {
                groups += 1;
                let Some(block) = self.blocks.block(next, &[b"CG"])? else {
                    self.notes.push(format!("the description of a group at byte {next} is damaged"));
                    break;
                };
                group.channel_groups.push(self.channel_group(next, &block, groups, &mut channels)?);
                next = block.link(0);
            }
            self.groups.push(group);
            at = block.link(0);
            if self.groups.len() == MOST_GROUPS || groups == MOST_GROUPS {
                self.notes.push(format!("only the first {MOST_GROUPS} groups were read"));
                return Ok(());
            }
        }
        Ok(())
    }

    fn channel_group(
        &mut self,
        at: u64,
        block: &Block,
        number: usize,
        count: &mut usize,
    ) -> io::Result<ChannelGroup> {
        /// Records that vary in length.
        const VARYING: u16 = 1;
        let flags = block.u16(16);
        let (data_bytes, invalid_bytes) = (block.u32(24) as usize, block.u32(28) as usize);
        let name = self.blocks.text(block.link(2))?;
        let topic = if name.is_empty() { format!("group {number}") } else { name };
        let bytes = (flags & VARYING == 0).then_some(data_bytes.saturating_add(invalid_bytes));
        let mut channels = Vec::new();
        self.channels(block.link(1), &mut channels, count)?;
        let records = block.u64(8);
        Ok(ChannelGroup {
            topic,
            at,
            layout: Layout { id: block.u64(0), bytes },
            data_bytes,
            count: (!self.unfinished).then_some(records),
            channels,
        })
    }

    /// A list of channels, and those that they are composed of.
    fn channels(&mut self, first: u64, channels: &mut Vec<Channel>, count: &mut usize) -> io::Result<()> {
        let mut ahead = vec![first];
        while let Some(at) = ahead.pop() {
            if at == 0 || *count == MOST_CHANNELS {
                continue;
            }
            let Some(block) = self.blocks.block(at, &[b"CN"])? else { continue };
            *count += 1;
            ahead.extend([block.link(0), block.link(1)]);
            channels.push(Channel::read(&mut self.blocks, &block)?);
        }
        Ok(())
    }

    /// Whether it has frames of a bus.
    pub(crate) fn has_frames(&self) -> bool {
        self.channel_groups().any(|group| group.channel(frames::FRAME_ID).is_some())
    }

    /// Whether it has measured signals.
    pub(crate) fn has_signals(&self) -> bool {
        self.channel_groups().any(|group| {
            group.channel(frames::FRAME_ID).is_none() && group.channels.iter().any(Channel::is_number)
        })
    }

    fn channel_groups(&self) -> impl Iterator<Item = &ChannelGroup> {
        self.groups.iter().flat_map(|group| &group.channel_groups)
    }

    fn records(&self, group: usize) -> Records {
        let DataGroup { data, id_bytes, channel_groups } = &self.groups[group];
        let layouts = channel_groups.iter().map(|group| group.layout).collect();
        Records::new(*data, self.unfinished, *id_bytes, layouts)
    }

    /// Hands each record of measured signals, data group by data group, to `take`.
    ///
    /// # Errors
    /// Reading failed.
    pub(crate) fn each_record(&mut self, mut take: impl FnMut(MdfRecord<'_>)) -> io::Result<()> {
        for index in 0..self.groups.len() {
            if self.groups[index].channel_groups.iter().all(|group| group.time().is_none()) {
                continue;
            }
            let mut records = self.records(index);
            let mut numbers = vec![0u64; self.groups[index].channel_groups.len()];
            while let Some((place, _)) = records.next(&mut self.blocks)? {
                let group = &self.groups[index].channel_groups[place];
                let number = numbers[place];
                numbers[place] += 1;
                if group.is_beyond(number) {
                    if self.groups[index].id_bytes == 0 {
                        break;
                    }
                    continue;
                }
                if let Some(time_ns) = group.time_ns(&records.record, number, self.start_ns) {
                    take(MdfRecord { group, topic: (index, place), time_ns, record: &records.record });
                }
            }
            self.note_damage(&records);
        }
        Ok(())
    }

    fn note_damage(&mut self, records: &Records) {
        let damage = records.damage();
        if damage.blocks > 0 {
            let (blocks, at) = (damage.blocks, damage.first_at.unwrap_or_default());
            self.notes.push(format!("{blocks} damaged blocks were left out, the first at byte {at}"));
        }
        if damage.cut {
            self.notes.push("data ends in the middle of a block; it was read up to there".into());
        }
        if let Some(why) = damage.not_read {
            self.notes.push(format!("a part was left out, since {why}; convert it: {CONVERT}"));
        }
    }

    /// What was damaged or left out.
    pub(crate) fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }
}

/// A record of measured signals.
pub(crate) struct MdfRecord<'r> {
    group: &'r ChannelGroup,
    /// Places of its data group and of its channel group.
    pub(crate) topic: (usize, usize),
    pub(crate) time_ns: i64,
    record: &'r [u8],
}

impl MdfRecord<'_> {
    /// What a mapping calls its group.
    pub(crate) fn topic_name(&self) -> &str {
        &self.group.topic
    }

    /// Its numbers: place, name, unit, value.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = (usize, &str, &str, f64)> {
        self.group.channels.iter().enumerate().filter_map(|(place, channel)| {
            let is_number = channel.is_number();
            let value = is_number.then(|| channel.value(self.record, self.group.data_bytes)).flatten()?;
            Some((place, &*channel.name, &*channel.unit, value))
        })
    }
}

impl ChannelGroup {
    /// The channel whose name ends so.
    fn channel(&self, ending: &str) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.name.ends_with(ending))
    }

    fn time(&self) -> Option<&Channel> {
        self.channels.iter().find(|channel| matches!(channel.kind, Kind::Time { .. }))
    }

    /// Whether the file says that there is no such record: what follows fills up a block.
    fn is_beyond(&self, number: u64) -> bool {
        self.count.is_some_and(|count| number >= count)
    }

    fn time_ns(&self, record: &[u8], number: u64, start_ns: i64) -> Option<i64> {
        let time_s = self.time()?.time_s(record, self.data_bytes, number)?;
        // A time that is none of a measurement is one of a damaged record.
        (time_s.abs() < 1e9).then(|| start_ns.saturating_add((time_s * 1e9).round() as i64))
    }
}
