//! `seepd demo --live`: a press whose seal wears, watched by the daemon.

use clap::Args;

use crate::cli::Outcome;
use crate::failure::Failure;
use crate::journal;
use crate::live::demo::{self, LiveDemo};
use crate::sink::terminal;

/// How the press is shown.
#[derive(Debug, Args)]
pub struct LiveDemoArguments {
    /// Show the press at work on the dashboard instead, until Ctrl-C; nothing is left behind
    #[arg(long, conflicts_with_all = ["folder", "cycles", "force"])]
    pub live: bool,
    /// Times faster than real time; 1 is the press's own pace
    #[arg(long, requires = "live", default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..=1000), value_name = "N")]
    speed: u16,
    /// Port of the dashboard, 0 for any; absent: 8600, or any where that is taken
    #[arg(long, requires = "live", value_name = "PORT")]
    port: Option<u16>,
}

/// Runs the press until Ctrl-C.
///
/// # Errors
/// [`Failure`] where the port is taken, or there is no temporary folder.
pub fn run(arguments: &LiveDemoArguments, seed: u64) -> Result<Outcome, Failure> {
    let _journal = journal::begin("warn")?;
    let demo = LiveDemo { speed: f64::from(arguments.speed), seed, port: arguments.port };
    let tell = |address| {
        let text = format!(
            "http://{address}/ shows a simulated press, {} times faster than real time; Ctrl-C ends it\n",
            demo.speed
        );
        terminal::print(text.as_bytes())
    };
    super::run::runtime()?.block_on(demo::run(&demo, tell))?;
    Ok(Outcome::Good)
}
