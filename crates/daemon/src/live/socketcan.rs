//! Samples from a Linux CAN interface.
//!
//! The kernel filters the frames, stamps them and counts those that it had to drop. An interface that goes down, is
//! deleted and comes back is taken up again by itself, and so is another one that has got its name.

use std::fs;
use std::io::{self, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::net;
use std::time::Duration;

use nix::cmsg_space;
use nix::errno::Errno;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt, sockopt};
use nix::sys::time::TimeSpec;
use seepd_logs::can::Frame;
use seepd_logs::can::decode::FrameDecoder;
use seepd_logs::can::linux::{self, FD_BYTES};
use seepd_logs::can::logged::FrameError;
use seepd_logs::frame_decoder;
use seepd_signals::Sample;
use socketcan::{CanFdSocket, CanFilter, Socket, SocketOptions};
use tokio::net::UnixDatagram;

use super::source::Input;
use crate::clock::{self, Clock, Stamps};
use crate::config::AxisConfig;
use crate::failure::Failure;
use crate::hub::{SourceHealth, SourceState};

/// Longest wait before the caller hears that nothing has come.
const IDLE: Duration = Duration::from_millis(250);
/// On a busy bus the kernel gathers frames for so long: waking for each one costs more than reading it.
const NAP: Duration = Duration::from_millis(2);
/// A bus is busy until so many naps brought nothing.
const EMPTY_NAPS: u32 = 10;
/// Wait before an interface that is not there is looked for again.
const RETRY: Duration = Duration::from_millis(500);
/// Frames that are read at one waking.
const AT_ONCE: usize = 1024;
/// Classes of error frames that are counted (all of linux/can/error.h).
const ALL_ERRORS: u32 = 0x1fff_ffff;

/// See the [module](self).
pub struct CanSource {
    place: String,
    receive_buffer_bytes: usize,
    decoder: FrameDecoder,
    port: Option<FramePort>,
    clock: Clock,
    health: SourceHealth,
    opened: u64,
    /// When the port's interface was last seen under its name.
    seen: tokio::time::Instant,
    /// Drops that sockets before this one had reported.
    dropped_before: u64,
}

impl CanSource {
    /// Prepares for the axis's interface, which need not be there yet, and for frames at the model's rate, Hz.
    ///
    /// # Errors
    /// [`Failure`] where the mapping is none of frames.
    pub fn new(config: &AxisConfig, rate_hz: Option<f64>, clock: Clock) -> Result<Self, Failure> {
        let place = config.source.can.clone().unwrap_or_default();
        let decoder = frame_decoder(&config.log_mapping())?;
        // Without a model nobody knows the rate that a counter stands for, and stamps must do.
        let decoder = match rate_hz {
            Some(rate_hz) => decoder.timed_by_counter(rate_hz),
            None => decoder,
        };
        Ok(CanSource {
            receive_buffer_bytes: config.source.receive_buffer_bytes,
            decoder,
            port: None,
            clock,
            health: SourceHealth { name: place.clone(), ..SourceHealth::default() },
            place,
            opened: 0,
            seen: clock::instant(),
            dropped_before: 0,
        })
    }

    /// Waits for frames and appends the samples that they complete.
    pub(super) async fn read(&mut self, samples: &mut Vec<Sample>) -> Input {
        if self.port.is_none() {
            match FramePort::open(&self.place, &self.decoder, self.receive_buffer_bytes) {
                Ok(port) => {
                    self.port = Some(port);
                    self.opened += 1;
                    self.health.reopened = self.opened - 1;
                    self.health.detail = None;
                }
                Err(error) => {
                    let why = opening(&self.place, &error);
                    tokio::time::sleep(RETRY).await;
                    return self.down(why);
                }
            }
        }
        if self.seen.elapsed() > IDLE {
            self.seen = clock::instant();
            if self.port.as_ref().is_some_and(|port| port.index != interface_index(&self.place)) {
                return self.lose(&io::Error::other("another interface has its name now, or none"));
            }
        }
        let Some(port) = &mut self.port else { return Input::Idle };
        if port.more {
            return self.drain(samples);
        }
        if port.empty_naps < EMPTY_NAPS {
            tokio::time::sleep(NAP).await;
            return self.drain(samples);
        }
        match tokio::time::timeout(IDLE, port.readable()).await {
            Err(_) => {
                // An interface that goes away wakes nobody who waits for frames.
                if let Ok(Some(error)) = port.socket.take_error() {
                    return self.lose(&error);
                }
                if self.health.state == SourceState::Down && is_up(&self.place) {
                    self.health.state = SourceState::Silent;
                    self.health.detail = None;
                }
                return if self.health.state == SourceState::Down {
                    Input::Down(self.health.detail.clone().unwrap_or_default())
                } else {
                    Input::Idle
                };
            }
            Ok(Err(error)) => return self.lose(&error),
            Ok(Ok(())) => {}
        }
        self.drain(samples)
    }

    fn drain(&mut self, samples: &mut Vec<Sample>) -> Input {
        let before = samples.len();
        let Some(port) = &mut self.port else { return Input::Idle };
        port.stamps.look(&self.clock);
        port.more = true;
        let frames_before = self.health.frames;
        for _ in 0..AT_ONCE {
            match port.receive() {
                Ok(Some((frame, stamp_ns))) => {
                    self.health.frames += 1;
                    match frame {
                        Ok(frame) => {
                            let time_ns = port.stamps.time_ns(stamp_ns);
                            samples.extend(self.decoder.take(&frame, port.interface.as_bytes(), time_ns));
                        }
                        Err(_) => self.health.malformed += 1,
                    }
                }
                Ok(None) => {
                    port.more = false;
                    break;
                }
                Err(error) => {
                    port.more = false;
                    return self.lose(&error);
                }
            }
        }
        let nothing = self.health.frames == frames_before;
        port.empty_naps = if nothing { port.empty_naps.saturating_add(1) } else { 0 };
        self.health.dropped_in_socket = self.dropped_before + u64::from(port.dropped);
        if samples.len() == before {
            return Input::Idle;
        }
        self.health.state = SourceState::Receiving;
        self.health.detail = None;
        Input::Samples
    }

    /// An interface that went down keeps its socket, which works again once it is up; one that was deleted does not.
    fn lose(&mut self, error: &io::Error) -> Input {
        let down = error.raw_os_error() == Some(Errno::ENETDOWN as i32);
        if !down && let Some(port) = self.port.take() {
            self.dropped_before += u64::from(port.dropped);
        }
        let why = if down { format!("{} is down", self.place) } else { format!("{}: {error}", self.place) };
        self.down(why)
    }

    fn down(&mut self, why: String) -> Input {
        self.health.state = SourceState::Down;
        self.health.detail = Some(why.clone());
        Input::Down(why)
    }

    /// Condition and counts.
    pub fn health(&self) -> SourceHealth {
        let counts = self.decoder.counts();
        SourceHealth {
            samples: counts.given,
            missing_by_counter: counts.missing,
            repeated: counts.repeated,
            counter_jumps: counts.jumps,
            too_short: counts.too_short,
            remote: counts.remote,
            error: counts.error,
            ..self.health.clone()
        }
    }
}

/// What opening an interface said, with what to do.
fn opening(place: &str, error: &io::Error) -> String {
    match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::ENODEV) => format!("there is no interface {place} yet; waiting for it"),
        Some(Errno::EAFNOSUPPORT) => {
            format!("{place} cannot be opened: this kernel has no CAN sockets (load the module can_raw)")
        }
        _ => format!("{place} cannot be opened: {error}"),
    }
}

/// Whether an interface is up (`IFF_UP` of its flags).
fn is_up(place: &str) -> bool {
    let flags = interface_fact(place, "flags").unwrap_or_default();
    u32::from_str_radix(flags.trim_start_matches("0x"), 16).is_ok_and(|flags| flags & 1 != 0)
}

/// The kernel's number of an interface, which a socket stays with whatever its name becomes; none where there is no such interface.
fn interface_index(place: &str) -> Option<u32> {
    interface_fact(place, "ifindex")?.parse().ok()
}

/// What the kernel tells of an interface.
fn interface_fact(place: &str, fact: &str) -> Option<String> {
    let text = fs::read_to_string(format!("/sys/class/net/{place}/{fact}")).ok()?;
    Some(text.trim().to_owned())
}

/// A socket that gives frames.
pub(crate) struct FramePort {
    /// Known to the runtime only while it waits on a quiet bus: on a busy one it would wake for each frame. That it is a Unix
    /// socket's type matters to nothing that is used here.
    socket: net::UnixDatagram,
    /// Interface of the frames, for mappings that name one.
    interface: String,
    /// The kernel's number of it; none for a socket of another kind.
    index: Option<u32>,
    control: Vec<u8>,
    stamps: Stamps,
    /// Whether the last reading stopped before the end.
    more: bool,
    /// Looks in a row that found nothing.
    empty_naps: u32,
    /// Frames that the kernel has dropped since the socket was opened.
    dropped: u32,
}

impl FramePort {
    fn open(place: &str, decoder: &FrameDecoder, receive_buffer_bytes: usize) -> io::Result<Self> {
        let filters: Vec<CanFilter> = decoder
            .choices()
            .into_iter()
            .map(|choice| {
                CanFilter::new(linux::identifier_word(choice.identifier), linux::filter_mask(choice))
            })
            .collect();
        Self::open_filtered(place, Some(&filters), receive_buffer_bytes)
    }

    /// Opens an interface, with filters or for all frames.
    pub(crate) fn open_filtered(
        place: &str,
        filters: Option<&[CanFilter]>,
        receive_buffer_bytes: usize,
    ) -> io::Result<Self> {
        let index = interface_index(place);
        let fd = match place.strip_prefix("unix:") {
            Some(path) => datagram_socket(path)?,
            None => {
                let socket = CanFdSocket::open(place)?;
                if let Some(filters) = filters {
                    socket.set_filters(filters)?;
                }
                socket.set_error_filter(ALL_ERRORS)?;
                socket.set_nonblocking(true)?;
                socket.as_fd().try_clone_to_owned()?
            }
        };
        // The system may allow less, and a socket without stamps or drop counts still gives frames.
        let _ = setsockopt(&fd, sockopt::RcvBuf, &receive_buffer_bytes);
        let _ = setsockopt(&fd, sockopt::ReceiveTimestampns, &true);
        let _ = setsockopt(&fd, sockopt::RxqOvfl, &1);
        Ok(FramePort {
            socket: net::UnixDatagram::from(fd),
            interface: place.to_owned(),
            index,
            control: cmsg_space!(TimeSpec, u32),
            stamps: Stamps::default(),
            more: false,
            empty_naps: EMPTY_NAPS,
            dropped: 0,
        })
    }

    /// Waits until there is a frame.
    async fn readable(&self) -> io::Result<()> {
        UnixDatagram::from_std(self.socket.try_clone()?)?.readable().await
    }

    /// The next frame that is there, with its stamp; `None` where there is none.
    #[expect(clippy::type_complexity, reason = "a frame or what is wrong with it, and when it came")]
    fn receive(&mut self) -> io::Result<Option<(Result<Frame, FrameError>, Option<i64>)>> {
        let mut bytes = [0u8; FD_BYTES];
        let mut parts = [IoSliceMut::new(&mut bytes)];
        let fd = self.socket.as_raw_fd();
        let received = recvmsg::<()>(fd, &mut parts, Some(&mut self.control), MsgFlags::MSG_DONTWAIT);
        let message = match received {
            Ok(message) => message,
            Err(Errno::EAGAIN | Errno::EINTR) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let size = message.bytes;
        let mut stamp_ns = None;
        for control in message.cmsgs().into_iter().flatten() {
            match control {
                ControlMessageOwned::ScmTimestampns(stamp) => {
                    let seconds = stamp.tv_sec().saturating_mul(1_000_000_000);
                    stamp_ns = Some(seconds.saturating_add(stamp.tv_nsec()));
                }
                ControlMessageOwned::RxqOvfl(dropped) => self.dropped = dropped,
                _ => {}
            }
        }
        Ok(Some((linux::parse(&bytes[..size.min(FD_BYTES)]), stamp_ns)))
    }

    /// Waits for frames until they stop or the time is over; for a look at a bus.
    pub(crate) async fn listen(
        &mut self,
        clock: &Clock,
        time: Duration,
        mut take: impl FnMut(&Frame, i64),
    ) -> io::Result<()> {
        let listening = async {
            loop {
                self.readable().await?;
                self.stamps.look(clock);
                while let Some((frame, stamp_ns)) = self.receive()? {
                    if let Ok(frame) = frame {
                        take(&frame, self.stamps.time_ns(stamp_ns));
                    }
                }
                tokio::time::sleep(NAP).await;
            }
        };
        tokio::time::timeout(time, listening).await.unwrap_or(Ok(()))
    }
}

fn datagram_socket(path: &str) -> io::Result<OwnedFd> {
    // A socket of an earlier run is in the way; what is no socket is not ours to remove.
    match fs::symlink_metadata(path) {
        Ok(facts) if std::os::unix::fs::FileTypeExt::is_socket(&facts.file_type()) => fs::remove_file(path)?,
        _ => {}
    }
    let socket = net::UnixDatagram::bind(path)?;
    socket.set_nonblocking(true)?;
    Ok(socket.into())
}
