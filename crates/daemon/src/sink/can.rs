//! CAN frames that tell an axis's condition, for the controller and its panel.

use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::net::UnixDatagram;
use std::sync::Arc;
use std::time::Duration;

use nix::sys::socket::{MsgFlags, send};
use seepd_logs::can::bit_field::BitField;
use seepd_logs::can::{Content, Frame, Identifier, linux};
use seepd_logs::identifier;
use seepd_model::causes::Cause;
use seepd_monitor::cause::course::Severity;
use seepd_monitor::event::Flag;
use socketcan::{CanFdSocket, CanFilter, Socket, SocketOptions};
use tokio::sync::watch;

use crate::config::{CanOutConfig, CanValue};
use crate::failure::{Code, Failure};
use crate::hub::{AxisStatus, Hub};

/// Wait before an interface that is not there is looked for again.
const RETRY: Duration = Duration::from_millis(500);
/// A period for frames that go out after cycles only.
const NEVER: Duration = Duration::from_secs(86_400);

/// A frame's layout.
#[derive(Debug, Clone)]
pub struct Layout {
    identifier: Identifier,
    length: usize,
    fields: Vec<(CanValue, BitField)>,
}

impl Layout {
    /// The configured layout.
    ///
    /// # Errors
    /// [`Failure`] where a field does not fit.
    pub fn new(config: &CanOutConfig) -> Result<Self, Failure> {
        let wrong = |what| Failure::new(Code::Configuration, what);
        Ok(Layout {
            identifier: identifier(config.id, config.extended)?,
            length: config.length,
            fields: config.places().map_err(wrong)?,
        })
    }

    /// The frame that tells a condition.
    pub fn frame(&self, status: &AxisStatus, counter: u64) -> Frame {
        let mut data = vec![0u8; self.length];
        for (value, place) in &self.fields {
            match number(*value, status, counter) {
                Some(number) if *value == CanValue::Counter => place.write_raw(&mut data, number as u64),
                Some(number) => place.write(&mut data, number),
                None => place.write_raw(&mut data, u64::MAX),
            };
        }
        let mut frame = Frame::new(self.identifier, Content::Data);
        for byte in data {
            frame.push(byte);
        }
        frame
    }
}

/// What a field says; `None` where there is no estimate.
fn number(value: CanValue, status: &AxisStatus, counter: u64) -> Option<f64> {
    let known = status.flag != Flag::NoEstimate;
    match value {
        CanValue::Flag => Some(code(status.flag)),
        CanValue::Latched => Some(status.latched.map_or(0.0, code)),
        CanValue::Stale => Some(f64::from(u8::from(status.stale))),
        CanValue::LeakFlowLpm => status.leak_flow_lpm.filter(|_| known),
        CanValue::LeakAreaM2 => status.leak_area_m2.filter(|_| known),
        CanValue::LowM2 => status.interval90_m2.filter(|_| known).map(|interval| interval[0]),
        CanValue::HighM2 => status.interval90_m2.filter(|_| known).map(|interval| interval[1]),
        CanValue::HasCondition => Some(f64::from(u8::from(condition_code(status) > 0))),
        CanValue::Condition => Some(f64::from(condition_code(status))),
        CanValue::ConditionSeverity => Some(severity_code(status)),
        CanValue::ConditionShare => status.conditions.first().map(|one| (one.size / one.matters_from).abs()),
        CanValue::Cycle => status.cycle.map(|cycle| cycle as f64),
        CanValue::Counter => Some(counter as f64),
    }
}

/// Code of what has changed, but cannot be named (yet).
const WITHOUT_NAME: u8 = 15;

/// Code of the cause beside the seal that is surest.
fn condition_code(status: &AxisStatus) -> u8 {
    let of_cause = |cause: Cause| Cause::ALL.iter().position(|known| *known == cause);
    match status.conditions.first() {
        Some(first) => of_cause(first.kind.cause).and_then(|code| u8::try_from(code).ok()),
        None => Some(if status.condition.is_some() { WITHOUT_NAME } else { 0 }),
    }
    .unwrap_or(WITHOUT_NAME)
}

/// How much what has changed matters; what has no name may.
fn severity_code(status: &AxisStatus) -> f64 {
    let matters = status.conditions.iter().any(|one| one.severity == Severity::Matters);
    match condition_code(status) {
        0 => 0.0,
        _ if matters => 2.0,
        _ => 1.0,
    }
}

const fn code(flag: Flag) -> f64 {
    match flag {
        Flag::NoEstimate => 0.0,
        Flag::Healthy => 1.0,
        Flag::Watch => 2.0,
        Flag::Leak => 3.0,
        Flag::Severe => 4.0,
    }
}

/// Name of such a sink.
pub fn sink_name(config: &CanOutConfig) -> String {
    format!("can {} {:X}", config.interface, config.id)
}

/// Sends an axis's frames until told to stop.
pub async fn run(
    config: CanOutConfig,
    layout: Layout,
    axis: String,
    hub: Arc<Hub>,
    mut stop: watch::Receiver<bool>,
) {
    let name = sink_name(&config);
    let mut changes = hub.changes();
    let period = if config.period_s > 0.0 { Duration::from_secs_f64(config.period_s) } else { NEVER };
    let mut ticks = tokio::time::interval(period);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let (mut port, mut counter, mut told) = (None, 0u64, None);
    let mut dropped = 0u64;
    loop {
        let due = tokio::select! {
            _ = stop.changed() => return,
            _ = ticks.tick() => config.period_s > 0.0 || counter == 0,
            _ = changes.changed() => false,
        };
        let Some(status) = hub.axis(&axis) else { continue };
        let condition = (condition_code(&status), severity_code(&status) > 1.0);
        let news = (status.cycle, status.flag, status.latched, status.stale, condition);
        if !due && told == Some(news) {
            continue;
        }
        if port.is_none() {
            port = open(&config.interface).map_err(|error| complain(&hub, &name, &error, dropped)).ok();
        }
        let Some(open) = &port else {
            dropped += 1;
            tokio::time::sleep(RETRY).await;
            continue;
        };
        match write(open, &layout.frame(&status, counter)) {
            Ok(()) => {
                counter += 1;
                told = Some(news);
                hub.update_sink(&name, |sink| {
                    sink.good = true;
                    sink.detail = "sending".into();
                    (sink.sent, sink.dropped) = (counter, dropped);
                });
            }
            Err(error) => {
                dropped += 1;
                // A full queue empties by itself; an interface that went away is opened anew.
                if error.raw_os_error() != Some(nix::errno::Errno::ENOBUFS as i32) {
                    port = None;
                }
                complain(&hub, &name, &error, dropped);
                tokio::time::sleep(RETRY).await;
            }
        }
    }
}

fn complain(hub: &Hub, name: &str, error: &io::Error, dropped: u64) {
    let known = hub.sinks().iter().any(|sink| sink.name == name && !sink.good);
    if !known {
        tracing::warn!("{name}: {error}");
    }
    hub.update_sink(name, |sink| {
        sink.good = false;
        sink.detail = error.to_string();
        sink.dropped = dropped;
    });
}

/// Opens an interface for sending.
///
/// # Errors
/// There is no such interface, or it cannot be opened.
pub fn open(interface: &str) -> io::Result<OwnedFd> {
    match interface.strip_prefix("unix:") {
        Some(path) => {
            let socket = UnixDatagram::unbound()?;
            socket.connect(path)?;
            socket.set_nonblocking(true)?;
            Ok(socket.into())
        }
        None => {
            let socket = CanFdSocket::open(interface)?;
            // It only sends: nothing is to pile up in its receive buffer.
            socket.set_filters::<CanFilter>(&[])?;
            socket.set_nonblocking(true)?;
            socket.as_fd().try_clone_to_owned()
        }
    }
}

/// Sends a frame.
///
/// # Errors
/// The interface is down or gone, or its queue is full.
pub fn write(port: &impl AsRawFd, frame: &Frame) -> io::Result<()> {
    let (bytes, size) = linux::write(frame);
    send(port.as_raw_fd(), &bytes[..size], MsgFlags::MSG_DONTWAIT)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::CanOutField;
    use crate::hub::condition_for_tests;
    use seepd_logs::can::bit_field::{ByteOrder, Encoding};

    #[test]
    fn the_default_frame_tells_flag_flow_and_interval() {
        let layout =
            Layout::new(&CanOutConfig { interface: "can0".into(), ..CanOutConfig::default() }).unwrap();
        let mut status = AxisStatus::new("press", 7e6);
        assert_eq!(layout.frame(&status, 0x102).data(), [0, 2, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]);
        status.flag = Flag::Leak;
        status.latched = Some(Flag::Severe);
        status.stale = true;
        status.leak_flow_lpm = Some(0.6);
        status.interval90_m2 = Some([1e-7, 1e-3]);
        let frame = layout.frame(&status, 3);
        assert_eq!(frame.data(), [0b0110_0011, 3, 0x58, 0x02, 100, 0, 0xff, 0xff]);
        // The bit that was free; all others are as they were.
        status.condition = Some("valve: null shifted, perhaps".into());
        assert_eq!(layout.frame(&status, 3).data(), [0b1110_0011, 3, 0x58, 0x02, 100, 0, 0xff, 0xff]);
    }

    #[test]
    fn a_frame_of_conditions_has_their_code_severity_and_share() {
        let field = |value, start, length, scale| CanOutField {
            value,
            start,
            length,
            order: ByteOrder::LittleEndian,
            encoding: Encoding::Unsigned,
            scale,
        };
        let fields = vec![
            field(CanValue::Condition, 0, 4, 1.0),
            field(CanValue::ConditionSeverity, 4, 2, 1.0),
            field(CanValue::ConditionShare, 8, 16, 0.01),
        ];
        let layout = Layout::new(&CanOutConfig { length: 3, fields, ..CanOutConfig::default() }).unwrap();
        let mut status = AxisStatus::new("press", 7e6);
        assert_eq!(layout.frame(&status, 0).data(), [0, 0xff, 0xff]);
        status.conditions = vec![condition_for_tests()];
        // 1e-12 of 2.08e-12 m³/(s Pa): 0.48.
        assert_eq!(layout.frame(&status, 0).data(), [3 | 1 << 4, 48, 0]);
        status.conditions[0].severity = Severity::Matters;
        assert_eq!(layout.frame(&status, 0).data()[0], 3 | 2 << 4);
        status.conditions.clear();
        status.condition = Some("something has changed".into());
        assert_eq!(layout.frame(&status, 0).data()[0], 15 | 1 << 4);
    }
}
