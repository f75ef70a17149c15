//! The daemon with a simulated press in the place of a bus: source, pipeline, hub and page are those of a gateway.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use seepd_monitor::repair::{RepairKind, Repaired};
use tokio::net::TcpListener;

use super::press::{Seal, SimulatedPress};
use super::source::{LiveSource, PlayedLog};
use super::{Daemon, ReadyAxis, Signals};
use crate::config::{AxisConfig, BaselineConfig, HttpConfig, Pace, SourceConfig};
use crate::failure::{Code, Failure};
use crate::hub::{Hub, NewRepair, Order, SourceHealth};
use crate::private_folder::PrivateFolder;

/// Name of the press.
const AXIS: &str = "demo press";
/// Who notes the seals that the press gets by itself.
const FITTER: &str = "the demo";
/// Cycles of which its baseline is learned.
const LEARNED_CYCLES: usize = 20;

/// How the press is shown.
#[derive(Debug, Clone, Copy)]
pub struct LiveDemo {
    /// Times faster than real time.
    pub speed: f64,
    /// Seed of noise and load.
    pub seed: u64,
    /// Port of the page on this machine, 0 for any; absent: the daemon's own, or any where that is taken.
    pub port: Option<u16>,
}

/// Runs the press and its monitor until told to stop; `tell` hears the page's address. What they keep is gone afterwards.
///
/// # Errors
/// [`Failure`] where the port is taken, or there is no temporary folder.
pub async fn run(
    demo: &LiveDemo,
    tell: impl FnOnce(SocketAddr) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let folder =
        PrivateFolder::make("demo").map_err(|error| Failure::writing(&std::env::temp_dir(), error))?;
    let mut daemon = Daemon::new(folder.path().to_owned())?;
    let signals = Signals::new()?;
    let listener = listen(demo.port).await?;
    let listen = listener.local_addr().map_err(|error| Failure::new(Code::Io, error.to_string()))?;
    let http = HttpConfig { listen, ..HttpConfig::default() };
    daemon.serve_page(&http, |site, _| site.run(listener))?;
    let seal = Arc::new(Seal::default());
    daemon.start_axis(press(demo, &daemon, &seal)?);
    let fitter = tokio::spawn(look_after(Arc::clone(&daemon.hub), seal));
    tell(listen)?;
    let result = daemon.work(None, signals).await;
    fitter.abort();
    daemon.stop().await;
    result
}

async fn listen(port: Option<u16>) -> Result<TcpListener, Failure> {
    let address = |port| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let usual = address(port.unwrap_or(HttpConfig::default().listen.port()));
    let listener = match TcpListener::bind(usual).await {
        Err(_) if port.is_none() => TcpListener::bind(address(0)).await,
        bound => bound,
    };
    listener.map_err(|error| Failure::new(Code::Io, format!("opening {usual}: {error}")))
}

fn press(demo: &LiveDemo, daemon: &Daemon, seal: &Arc<Seal>) -> Result<ReadyAxis, Failure> {
    let config = AxisConfig {
        axis: AXIS.into(),
        baseline: BaselineConfig { learn_cycles: LEARNED_CYCLES, ..BaselineConfig::default() },
        // Its samples have a time of their own, as a log's.
        source: SourceConfig {
            log: Some("simulated press".into()),
            pace: Pace::Fast,
            ..SourceConfig::default()
        },
        ..AxisConfig::default()
    };
    let health = SourceHealth {
        name: "simulated press".into(),
        detail: Some(format!("{} times faster than real time; noting a new seal below fits one", demo.speed)),
        ..SourceHealth::default()
    };
    let source = SimulatedPress::new(demo.seed, Arc::clone(seal));
    let log = PlayedLog::play(AXIS, || Ok(Box::new(source)), health, Some(demo.speed), daemon.clock)?;
    let duty_cycles = config.load_models()?;
    Ok(ReadyAxis { config, duty_cycles, source: LiveSource::Log(Box::new(log)) })
}

/// Notes the seals that the press has got because the old ones were worn out, and asks for one where somebody else has noted one.
async fn look_after(hub: Arc<Hub>, seal: Arc<Seal>) {
    let mut changes = hub.changes();
    let (mut newest_ns, mut noted) = (None, 0);
    while changes.changed().await.is_ok() {
        let repairs = hub.axis(AXIS).map(|status| status.repairs).unwrap_or_default();
        let is_others = |done: &&Repaired| {
            done.repair.what == RepairKind::SealReplaced && done.repair.who.as_deref() != Some(FITTER)
        };
        let at_ns = repairs.iter().rev().find(is_others).map(|done| done.repair.at_ns);
        if at_ns > newest_ns {
            newest_ns = at_ns;
            seal.asked_for.fetch_add(1, Ordering::Relaxed);
        }
        let renewed = seal.renewed.load(Ordering::Relaxed);
        if renewed > noted {
            let entry = NewRepair {
                what: RepairKind::SealReplaced,
                at: None,
                who: Some(FITTER.into()),
                note: Some("the old one had worn out".into()),
            };
            noted = if hub.order(AXIS, Order::Repair(entry)).is_ok() { renewed } else { noted };
        }
    }
}
