//! Diagnostic messages of SAE J1939: active trouble codes (DM1) every second and when they change, those that were active (DM2) for who
//! asks, on a raw CAN socket. The address is claimed first, and given up to a name that comes before.

mod diagnostics;
mod frames;

use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use nix::sys::socket::{MsgFlags, recv};
use seepd_logs::can::{Frame, linux};
use socketcan::{CanFdSocket, CanFilter, Socket, SocketOptions};
use tokio::io::Interest;
use tokio::net;
use tokio::sync::watch;
use tokio::time::{Instant, sleep, sleep_until};

use self::diagnostics::Memory;
use self::frames::{ACKNOWLEDGEMENT, ADDRESS_CLAIMED, DM1, DM2, GLOBAL, NULL, Said, broadcast, frame, heard};
use crate::clock;
use crate::config::J1939Config;
use crate::hub::{AxisStatus, Hub};
use crate::journal::Warnings;
use crate::sink::can;

/// DM1 comes this often.
const EVERY: Duration = Duration::from_secs(1);
/// Between two packets of a long message: 50 … 200 ms (J1939-21, 5.10.3).
const BETWEEN_PACKETS: Duration = Duration::from_millis(50);
/// After a claim nothing is sent for so long (J1939-81, 4.2.2.1).
const CONTENTION: Duration = Duration::from_millis(250);
/// Answers have this distance; requests between two of them are left out and counted.
const BETWEEN_ANSWERS: Duration = Duration::from_millis(100);
/// Wait before an interface that is not there is looked for again.
const RETRY: Duration = Duration::from_millis(500);
/// Frames with the parameter groups of requests and claims.
const FILTERS: [(u32, u32); 2] = [(0x80ea_0000, 0x80ff_0000), (0x80ee_0000, 0x80ff_0000)];

/// Name of such a sink.
pub fn sink_name(config: &J1939Config) -> String {
    format!("j1939 {} {:02X}", config.interface, config.address)
}

/// An axis that speaks on a bus.
pub struct Speaker {
    config: J1939Config,
    axis: String,
    name: String,
    hub: Arc<Hub>,
    memory: Memory,
    port: Option<net::UnixDatagram>,
    sent: u64,
    dropped: u64,
    answered_at: Option<Instant>,
    /// The name that has the address instead.
    lost_to: Option<u64>,
    warnings: Warnings,
}

impl Speaker {
    /// One that has said nothing yet.
    pub fn new(config: J1939Config, axis: String, hub: Arc<Hub>) -> Self {
        Speaker {
            name: sink_name(&config),
            config,
            axis,
            hub,
            memory: Memory::default(),
            port: None,
            sent: 0,
            dropped: 0,
            answered_at: None,
            lost_to: None,
            warnings: Warnings::new(clock::instant()),
        }
    }

    /// Speaks until told to stop.
    pub async fn run(mut self, mut stop: watch::Receiver<bool>) {
        tokio::select! {
            () = self.speak() => {}
            _ = stop.changed() => {}
        }
    }

    async fn speak(&mut self) {
        loop {
            let spoken = match self.open().await {
                Ok(()) => self.speak_on_port().await,
                Err(error) => Err(error),
            };
            if let Err(error) = spoken {
                self.dropped += 1;
                self.port = None;
                self.complain(&error.to_string());
            }
            sleep(RETRY).await;
        }
    }

    /// Opens the interface and claims the address.
    async fn open(&mut self) -> io::Result<()> {
        self.port = Some(open(&self.config.interface)?);
        self.claim()?;
        sleep(CONTENTION).await;
        Ok(())
    }

    fn claim(&mut self) -> io::Result<()> {
        self.send(&frame(ADDRESS_CLAIMED, self.config.address, GLOBAL, &self.config.name().to_le_bytes()))
    }

    /// Tells and answers until the interface fails.
    async fn speak_on_port(&mut self) -> io::Result<()> {
        let mut changes = self.hub.changes();
        let mut due_at = clock::instant();
        let mut told = Vec::new();
        loop {
            let mut is_due = false;
            tokio::select! {
                said = next(&self.port, self.config.address) => self.heed(said?).await?,
                () = sleep_until(due_at) => is_due = true,
                _ = changes.changed() => {}
            }
            if self.lost_to.is_some() {
                due_at = clock::instant() + EVERY;
                continue;
            }
            let Some(status) = self.look() else {
                due_at = clock::instant() + EVERY;
                continue;
            };
            let data = self.memory.dm1(&status, self.config.spn);
            if is_due || data != told {
                self.tell(DM1, &data).await?;
                told = data;
                due_at = clock::instant() + EVERY;
            }
        }
    }

    /// The axis's condition, which the memory takes note of.
    fn look(&mut self) -> Option<AxisStatus> {
        let status = self.hub.axis(&self.axis)?;
        self.memory.heed(&status);
        Some(status)
    }

    async fn heed(&mut self, said: Said) -> io::Result<()> {
        match said {
            Said::Claim { name } if name < self.config.name() => {
                self.lost_to = Some(name);
                self.complain(&format!("the address belongs to the name {name:016X}, which comes before this one's; choose another"));
                self.send(&frame(ADDRESS_CLAIMED, NULL, GLOBAL, &self.config.name().to_le_bytes()))
            }
            Said::Claim { name } if name == self.config.name() => {
                self.warnings
                    .warn(clock::instant(), &format!("{}: another has the same name {name:016X}", self.name));
                Ok(())
            }
            Said::Claim { .. } => self.limited(Self::claim),
            Said::Request { .. } if self.lost_to.is_some() => Ok(()),
            Said::Request { pgn, from, directed } => {
                if !self.may_answer() {
                    return Ok(());
                }
                self.answer(pgn, from, directed).await
            }
        }
    }

    fn limited(&mut self, answer: impl FnOnce(&mut Self) -> io::Result<()>) -> io::Result<()> {
        if self.may_answer() { answer(self) } else { Ok(()) }
    }

    /// Whether the last answer is long enough ago.
    fn may_answer(&mut self) -> bool {
        let now = clock::instant();
        if self.answered_at.is_some_and(|at| now.duration_since(at) < BETWEEN_ANSWERS) {
            self.dropped += 1;
            return false;
        }
        self.answered_at = Some(now);
        true
    }

    async fn answer(&mut self, pgn: u32, from: u8, directed: bool) -> io::Result<()> {
        let address = self.config.address;
        match (pgn, self.look()) {
            (ADDRESS_CLAIMED, _) => self.claim(),
            (DM1, Some(status)) => self.tell(DM1, &self.memory.dm1(&status, self.config.spn)).await,
            (DM2, Some(status)) => self.tell(DM2, &self.memory.dm2(&status, self.config.spn)).await,
            _ if directed => {
                let [low, middle, high, _] = pgn.to_le_bytes();
                let refusal = [1, 0xff, 0xff, 0xff, from, low, middle, high];
                self.send(&frame(ACKNOWLEDGEMENT, address, GLOBAL, &refusal))
            }
            _ => Ok(()),
        }
    }

    /// Tells everybody, with the standard's distance between packets.
    async fn tell(&mut self, pgn: u32, data: &[u8]) -> io::Result<()> {
        for (number, frame) in broadcast(pgn, self.config.address, data).iter().enumerate() {
            if number > 0 {
                sleep(BETWEEN_PACKETS).await;
            }
            self.send(frame)?;
        }
        Ok(())
    }

    /// Sends a frame; one that finds no room is given up, and the next may find some.
    fn send(&mut self, frame: &Frame) -> io::Result<()> {
        let Some(port) = &self.port else { return Ok(()) };
        match can::write(port, frame) {
            Ok(()) => self.sent += 1,
            Err(error) if is_full(&error) => {
                self.dropped += 1;
                self.complain(&error.to_string());
                return Ok(());
            }
            Err(error) => return Err(error),
        }
        if self.lost_to.is_none() {
            let (sent, dropped) = (self.sent, self.dropped);
            self.hub.update_sink(&self.name, |sink| {
                (sink.good, sink.sent, sink.dropped) = (true, sent, dropped);
                sink.detail = "sending".into();
            });
        }
        Ok(())
    }

    fn complain(&mut self, why: &str) {
        self.warnings.warn(clock::instant(), &format!("{}: {why}", self.name));
        let (sent, dropped) = (self.sent, self.dropped);
        self.hub.update_sink(&self.name, |sink| {
            (sink.good, sink.sent, sink.dropped) = (false, sent, dropped);
            sink.detail = why.to_owned();
        });
    }
}

fn is_full(error: &io::Error) -> bool {
    error.raw_os_error() == Some(nix::errno::Errno::ENOBUFS as i32)
        || error.kind() == io::ErrorKind::WouldBlock
}

/// Reads a frame of the bus as it comes from a socket; whether it concerns the address.
#[cfg(fuzzing)]
pub fn concerns(bytes: &[u8], address: u8) -> bool {
    linux::parse(bytes).ok().and_then(|frame| heard(&frame, address)).is_some()
}

/// What is said next that concerns the address; never, where there is no port.
async fn next(port: &Option<net::UnixDatagram>, address: u8) -> io::Result<Said> {
    let Some(port) = port else { return std::future::pending().await };
    loop {
        let mut bytes = [0; linux::FD_BYTES];
        port.readable().await?;
        let mut read = || Ok(recv(port.as_raw_fd(), &mut bytes, MsgFlags::MSG_DONTWAIT)?);
        let length = match port.try_io(Interest::READABLE, &mut read) {
            Ok(length) => length,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            Err(error) => return Err(error),
        };
        let said = linux::parse(&bytes[..length]).ok().and_then(|frame| heard(&frame, address));
        if let Some(said) = said {
            return Ok(said);
        }
    }
}

/// Opens an interface for diagnostic messages, requests and claims. The runtime waits for any socket as it does for one of this kind.
fn open(interface: &str) -> io::Result<net::UnixDatagram> {
    match interface.strip_prefix("unix:") {
        Some(path) => {
            // It has a name of its own, so that it can be answered.
            static OPENED: AtomicU64 = AtomicU64::new(0);
            let number = OPENED.fetch_add(1, Ordering::Relaxed);
            let own = SocketAddr::from_abstract_name(format!("seepd-j1939-{}-{number}", std::process::id()))?;
            let socket = UnixDatagram::bind_addr(&own)?;
            socket.connect(path)?;
            socket.set_nonblocking(true)?;
            net::UnixDatagram::from_std(socket)
        }
        None => {
            let socket = CanFdSocket::open(interface)?;
            socket.set_filters(&FILTERS.map(|(id, mask)| CanFilter::new(id, mask)))?;
            socket.set_nonblocking(true)?;
            net::UnixDatagram::from_std(socket.as_fd().try_clone_to_owned()?.into())
        }
    }
}

/// Claims the address, and sends a DM1 with the red lamp and the leak's number in the mode 31, "condition exists", which no leak gives.
///
/// # Errors
/// In words, why it could not be sent.
pub async fn test(config: &J1939Config) -> Result<String, String> {
    let words = |error: io::Error| error.to_string();
    let port = open(&config.interface).map_err(words)?;
    let [low, middle, high, _] = config.spn.to_le_bytes();
    let data = [0b1_0000, 0xff, low, middle, high << 5 | 31, 127];
    let send = |frame: &Frame| can::write(&port, frame).map_err(words);
    send(&frame(ADDRESS_CLAIMED, config.address, GLOBAL, &config.name().to_le_bytes()))?;
    sleep(CONTENTION).await;
    broadcast(DM1, config.address, &data).iter().try_for_each(send)?;
    Ok(format!("DM1 sent from address {:02X}: red lamp, SPN {} with FMI 31", config.address, config.spn))
}
