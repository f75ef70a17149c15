//! Conditions as InfluxDB's line protocol: a datagram an axis after each cycle and every few seconds, for Telegraf, InfluxDB 1 and others
//! that listen on UDP. Nothing waits: a datagram that does not go out is counted, and the next one has the newest condition.

use std::fmt::Write;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use seepd_monitor::event::Flag;
use tokio::net::{UdpSocket, lookup_host};
use tokio::sync::watch;

use crate::clock;
use crate::config::InfluxConfig;
use crate::hub::{AxisStatus, Hub};
use crate::journal::Warnings;
use crate::sink::sizes::{Size, sizes};

/// Its name among the sinks.
pub const SINK: &str = "influx";
/// Events that may wait while a datagram is sent.
const EVENTS: usize = 256;

/// Sends until told to stop.
pub async fn run(config: InfluxConfig, hub: Arc<Hub>, mut stop: watch::Receiver<bool>) {
    let mut events = hub.subscribe(EVENTS);
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(config.period_s));
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut warnings = Warnings::new(clock::instant());
    let mut socket = None;
    loop {
        let axes = tokio::select! {
            _ = stop.changed() => return,
            Some(event) = events.recv() => hub.axis(&event.axis).into_iter().collect(),
            _ = ticks.tick() => {
                // A name may lead elsewhere by now.
                socket = None;
                hub.axes()
            }
        };
        for axis in axes {
            let line = line(&config.measurement, &axis, clock::wall_ns());
            let sent = send(&mut socket, &config, line.as_bytes()).await;
            hub.update_sink(SINK, |sink| {
                sink.good = sent.is_ok();
                sink.sent += u64::from(sent.is_ok());
                sink.dropped += u64::from(sent.is_err());
                sink.detail = match &sent {
                    Ok(()) => format!("udp://{}", config.udp),
                    Err(error) => format!("udp://{}: {error}", config.udp),
                };
            });
            if let Err(error) = sent {
                socket = None;
                warnings.warn(clock::instant(), &format!("influx: {}: {error}", config.udp));
            }
        }
    }
}

/// Sends a marked line, under another measurement than the machine's.
///
/// # Errors
/// In words, why it did not go out.
pub async fn test(config: &InfluxConfig, axis: &str) -> Result<String, String> {
    let measurement = format!("{}_test", config.measurement);
    let line = line(&measurement, &AxisStatus::new(axis, 7e6), clock::wall_ns());
    send(&mut None, config, line.as_bytes())
        .await
        .map_err(|error| format!("udp://{}: {error}", config.udp))?;
    Ok(format!("a line of {measurement} went to udp://{}, which confirms nothing", config.udp))
}

async fn send(socket: &mut Option<UdpSocket>, config: &InfluxConfig, line: &[u8]) -> io::Result<()> {
    let socket = match socket {
        Some(socket) => socket,
        None => socket.insert(connect(&config.udp).await?),
    };
    socket.send(line).await.map(drop)
}

async fn connect(place: &str) -> io::Result<UdpSocket> {
    let no_address = || io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    let address = lookup_host(place).await?.next().ok_or_else(no_address)?;
    let socket = UdpSocket::bind(if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" }).await?;
    socket.connect(address).await?;
    Ok(socket)
}

/// An axis's condition as a line; without an estimate it has no fields of the leak. Without a time the receiver takes its own.
fn line(measurement: &str, axis: &AxisStatus, time_ns: Option<i64>) -> String {
    let mut text = format!("{},axis={} ", escaped(measurement), escaped(&axis.axis));
    let code = |flag: Option<Flag>| flag.map_or(0, |flag| flag as u8);
    // Writing to a String does not fail.
    let _ = write!(
        text,
        "flag=\"{}\",flag_code={}i,latched_code={}i,acknowledged={},stale={},cycles={}i",
        axis.flag.name(),
        code(Some(axis.flag)),
        code(axis.latched),
        axis.acknowledged,
        axis.stale,
        axis.cycles
    );
    for Size { name, value, .. } in sizes(axis) {
        if let Some(value) = value {
            let _ = write!(text, ",{name}={value:e}");
        }
    }
    if let Some(time_ns) = time_ns {
        let _ = write!(text, " {time_ns}");
    }
    text.push('\n');
    text
}

/// A measurement's or a tag's text; names have no line breaks.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        if [',', ' ', '='].contains(&c) {
            escaped.push('\\');
        }
        escaped.push(c);
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_the_leak_only_where_there_is_an_estimate() {
        let mut status = AxisStatus::new("Press 1", 7e6);
        status.leak_flow_lpm = Some(0.5);
        status.interval90_m2 = Some([9e-8, 1.1e-7]);
        let without = "seepd,axis=Press\\ 1 flag=\"no_estimate\",flag_code=0i,latched_code=0i,acknowledged=false,stale=false,cycles=0i\n";
        assert_eq!(line("seepd", &status, None), without);
        status.flag = Flag::Watch;
        let with = line("sea,p=d", &status, Some(1_700_000_000_000_000_000));
        assert_eq!(
            with,
            "sea\\,p\\=d,axis=Press\\ 1 flag=\"watch\",flag_code=2i,latched_code=0i,acknowledged=false,stale=false,cycles=0i,\
             leak_flow_lpm=5e-1,leak_area_low_m2=9e-8,leak_area_high_m2=1.1e-7 1700000000000000000\n"
        );
    }
}
