//! The frames of a bus that an MDF log has.

use std::io;

use super::records::{Elsewhere, ElsewherePlace, Layout, Records};
use super::{ChannelGroup, Kind, MdfFile};
use crate::can::logged::{FrameError, FrameLog, Interface, LoggedFrame, NextFrame};
use crate::can::words::bytes_of_code;
use crate::can::{Content, Frame, Identifier, MOST_BYTES};

/// End of the name of the channel with a frame's identifier.
pub(super) const FRAME_ID: &str = "CAN_DataFrame.ID";

/// See the [module](self).
pub(crate) struct MdfFrames<'i> {
    file: MdfFile<'i>,
    groups: Vec<FrameGroup>,
    frames: u64,
}

/// A data group with frames.
struct FrameGroup {
    index: usize,
    records: Records,
    /// By channel group.
    layouts: Vec<Option<FrameLayout>>,
    numbers: Vec<u64>,
    /// The frame that comes next.
    ahead: Option<Result<LoggedFrame, FrameError>>,
    ended: bool,
}

/// Where a frame's parts are, as places among the group's channels.
struct FrameLayout {
    content: Content,
    id: usize,
    extended: Option<usize>,
    code: Option<usize>,
    length: Option<usize>,
    data: Option<usize>,
    bus: Option<usize>,
    elsewhere: Option<Elsewhere>,
}

impl<'i> MdfFrames<'i> {
    /// Finds the groups with frames.
    ///
    /// # Errors
    /// Reading failed.
    pub(crate) fn new(file: MdfFile<'i>) -> io::Result<Self> {
        let mut groups = Vec::new();
        for index in 0..file.groups.len() {
            let of_group = &file.groups[index].channel_groups;
            let layouts: Vec<Option<FrameLayout>> =
                of_group.iter().map(|group| frame_layout(&file, index, group)).collect();
            if layouts.iter().any(Option::is_some) {
                let numbers = vec![0; layouts.len()];
                let records = file.records(index);
                groups.push(FrameGroup { index, records, layouts, numbers, ahead: None, ended: false });
            }
        }
        Ok(MdfFrames { file, groups, frames: 0 })
    }
}

fn frame_layout(file: &MdfFile<'_>, index: usize, group: &ChannelGroup) -> Option<FrameLayout> {
    let kinds = [
        ("CAN_DataFrame", Content::Data),
        ("CAN_RemoteFrame", Content::Remote),
        ("CAN_ErrorFrame", Content::Error),
    ];
    let place = |prefix: &str, part: &str| {
        let name = format!("{prefix}.{part}");
        group.channels.iter().position(|channel| channel.name.ends_with(&name))
    };
    let (prefix, content, id) =
        kinds.into_iter().find_map(|(prefix, content)| Some((prefix, content, place(prefix, "ID")?)))?;
    let data = place(prefix, "DataBytes");
    let elsewhere = data.map(|data| &group.channels[data]).filter(|channel| channel.kind == Kind::Elsewhere);
    let elsewhere = elsewhere.map(|channel| {
        let of_group = &file.groups[index];
        let group = of_group.channel_groups.iter().position(|other| other.at == channel.data);
        let layouts: Vec<Layout> = of_group.channel_groups.iter().map(|group| group.layout).collect();
        let place = match group {
            Some(group) => {
                ElsewherePlace::Group { link: of_group.data, id_bytes: of_group.id_bytes, layouts, group }
            }
            None => ElsewherePlace::Data(channel.data),
        };
        Elsewhere::new(place, file.unfinished)
    });
    Some(FrameLayout {
        content,
        id,
        extended: place(prefix, "IDE"),
        code: place(prefix, "DLC"),
        length: place(prefix, "DataLength"),
        data,
        bus: place(prefix, "BusChannel"),
        elsewhere,
    })
}

impl FrameGroup {
    /// Reads the next frame ahead.
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
            let Some(layout) = &mut self.layouts[place] else { continue };
            let record = &self.records.record;
            let Some(time_ns) = group.time_ns(record, number, file.start_ns) else {
                self.ahead = Some(Err(FrameError::TimeMissing));
                continue;
            };
            let frame = layout.frame(group, record, &mut file.blocks)?;
            self.ahead = Some(frame.map(|(interface, frame)| LoggedFrame { time_ns, interface, frame }));
        }
        Ok(())
    }

    /// When the next frame comes; those that cannot be read come at once.
    fn due_ns(&self) -> Option<i64> {
        self.ahead.as_ref().map(|frame| frame.as_ref().map_or(i64::MIN, |frame| frame.time_ns))
    }
}

impl FrameLayout {
    fn frame(
        &mut self,
        group: &ChannelGroup,
        record: &[u8],
        blocks: &mut super::Blocks<'_>,
    ) -> io::Result<Result<(Interface, Frame), FrameError>> {
        let whole = |place: Option<usize>| place.and_then(|place| group.channels[place].whole(record));
        let Some(id) = whole(Some(self.id)) else { return Ok(Err(FrameError::IdentifierMissing)) };
        let bits = (id & 0x1fff_ffff) as u32;
        let extended = whole(self.extended).map_or(id > 0x7ff, |extended| extended != 0);
        let identifier = match (extended, bits) {
            (false, 0..=0x7ff) => Identifier::Standard(bits as u16),
            (true, _) => Identifier::Extended(bits),
            _ => return Ok(Err(FrameError::IdentifierNotOfCan)),
        };
        let interface = whole(self.bus).map_or(Interface::numbered(0), |bus| Interface::numbered(bus as u32));
        let mut frame = Frame::new(identifier, self.content);
        if self.content != Content::Data {
            return Ok(Ok((interface, frame)));
        }
        let length = whole(self.length).and_then(|length| usize::try_from(length).ok());
        let length = length.or_else(|| bytes_of_code(whole(self.code)? as u32));
        let data = match (&mut self.elsewhere, self.data) {
            (Some(elsewhere), Some(data)) => {
                let Some(place) = group.channels[data].whole(record) else {
                    return Ok(Err(FrameError::CutShort));
                };
                elsewhere.at(blocks, place)?
            }
            (None, Some(data)) => group.channels[data].bytes(record),
            _ => None,
        };
        let Some(data) = data else { return Ok(Err(FrameError::DataMissing)) };
        let length = length.unwrap_or(data.len());
        if length > data.len().min(MOST_BYTES) {
            return Ok(Err(FrameError::Length));
        }
        data[..length].iter().for_each(|byte| {
            frame.push(*byte);
        });
        Ok(Ok((interface, frame)))
    }
}

impl FrameLog for MdfFrames<'_> {
    fn next_frame(&mut self) -> NextFrame {
        for group in &mut self.groups {
            group.fill(&mut self.file)?;
        }
        let next = self.groups.iter_mut().filter(|group| group.ahead.is_some());
        let next = next.min_by_key(|group| group.due_ns()).and_then(|group| group.ahead.take());
        self.frames += u64::from(next.is_some());
        Ok(next)
    }

    fn place(&self) -> String {
        format!("frame {}", self.frames)
    }

    fn notes(&self) -> Vec<String> {
        self.file.notes()
    }
}
