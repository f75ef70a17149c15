//! `seepd replay`: logs in, leak by cycle out.

mod files;

use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use seepd_logs::record::Clock;
use seepd_logs::{bytes_of, log_name, open_with};
use seepd_monitor::baseline::Baseline;
use seepd_monitor::event::{Event, Flag, Summary};
use seepd_monitor::pipeline::{Monitor, Pipeline};
use seepd_monitor::repair::Repair;
use seepd_signals::Sample;

use files::Files;

use super::reading::{BaselineArguments, ReadingArguments, RepairsArguments};
use crate::advice::advice;
use crate::cli::Outcome;
use crate::config::AxisConfig;
use crate::failure::{Code, Failure};
use crate::html::report::ReportPage;
use crate::output::OverwriteArguments;
use crate::progress::{byte_bar, counting, warn};
use crate::sink::html::HtmlSink;
use crate::sink::json;
use crate::sink::plain::Plain;
use crate::sink::terminal::{self, Colour};

/// Read logs and show the leak by cycle, flags and a summary
///
/// Several logs are read one after the other as the record of one machine; so are those of a folder or of a quoted pattern. A leak is given
/// as the flow that it passes at a stated pressure difference (L/min), and as an area (mm²). JSON, CSV, MCAP and Parquet have SI units.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd replay press-1.mcap\n  seepd replay --json --model model.json press-1.csv | jq .leak_flow_lpm\n  \
                        seepd replay --dbc press.dbc --command AxisStatus.ValveCommand candump.log\n  \
                        seepd replay --config seepd.toml --csv cycles.csv --mcap estimates.mcap monday.mcap tuesday.mcap\n  \
                        seepd replay --html press-1.html monday.mcap tuesday.mcap"
)]
pub struct ReplayArguments {
    /// Logs (MCAP, CSV, candump, ASC, BLF, TRC, MF4 and others), folders or patterns; `-` reads standard input
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    #[command(flatten)]
    reading: ReadingArguments,
    #[command(flatten)]
    baseline: BaselineArguments,
    #[command(flatten)]
    repairs: RepairsArguments,
    /// Print JSON lines: one for each cycle, then the summary
    #[arg(long)]
    json: bool,
    /// Print only the summary
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
    /// Write the cycles as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the cycles and the changes of flag as MCAP (/axis/leakage, /axis/flags)
    #[arg(long, value_name = "FILE")]
    mcap: Option<PathBuf>,
    /// Write the cycles as Parquet, with the columns of the JSON lines
    #[cfg(feature = "parquet")]
    #[arg(long, value_name = "FILE")]
    parquet: Option<PathBuf>,
    /// Write a report as one HTML page
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Pressure difference at which leaks are given as flows, MPa (1 MPa is 10 bar)
    #[arg(long, value_name = "MPA")]
    reference_mpa: Option<f64>,
    /// Exit with 1 if a flag rose above healthy, and with 65 if there were too few estimates for any flag
    #[arg(long)]
    fail_on_fault: bool,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

impl ReplayArguments {
    /// The logs.
    pub fn logs(&self) -> &[PathBuf] {
        &self.logs
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for configuration, model, logs or output.
pub fn run(arguments: &ReplayArguments) -> Result<Outcome, Failure> {
    let mut replay = Replay::begin(arguments)?;
    let files = Files::begin(arguments, &replay.config, &replay.pipeline.config().duty_cycles)?;
    let out = Printer::new(arguments, replay.config.reference_dp_pa);
    let bar = out.progress_bar(&arguments.logs);
    let mut told = Told { files, out };
    let notes = replay.read_logs(&arguments.logs, counting(&bar), &mut told)?;
    bar.finish_and_clear();
    let Told { mut files, mut out } = told;
    let Replayed { summary, advice } = replay.summed_up(arguments.logs.first());
    if let Some((output, record)) = files.html.take() {
        output.write(replay.page(&record, &summary, advice.as_deref()))?;
    }
    files.finish()?;
    for note in notes {
        warn(&note);
    }
    out.summary(&summary, advice.as_deref())?;
    replay.check_rate(&summary)?;
    if !arguments.fail_on_fault {
        return Ok(Outcome::Good);
    }
    match summary.highest_flag {
        Flag::NoEstimate => {
            let rejected =
                if summary.rejected.is_empty() { "none".into() } else { terminal::listed(&summary.rejected) };
            Err(Failure::data(format!(
                "whether there is a fault cannot be told: {} cycles with an estimate are too few for a flag (rejected: {rejected})",
                summary.cycles
            )))
        }
        Flag::Healthy => Ok(Outcome::Good),
        Flag::Watch | Flag::Leak | Flag::Severe => Ok(Outcome::Finding),
    }
}

/// Who hears of a replay.
pub trait Audience {
    /// A log begins.
    fn begin_log(&mut self, _name: &str) {}
    /// A sample is next.
    fn take_sample(&mut self, _sample: &Sample) {}
    /// The pipeline says something.
    ///
    /// # Errors
    /// [`Failure`] that ends the replay.
    fn take_event(&mut self, event: &Event<'_>) -> Result<(), Failure>;
    /// A log has ended; what is to be known of it.
    fn end_log(&mut self, _notes: &[String]) {}
}

/// A machine's record on its way through the pipeline: the replay without what is written of it.
pub struct Replay {
    config: AxisConfig,
    pipeline: Pipeline,
    /// Each duty cycle's baselines so far.
    records: Vec<Vec<Baseline>>,
    repairs: RepairsDue,
}

/// What a replay comes to.
pub struct Replayed {
    /// The last line.
    pub summary: Summary,
    /// What was seen and what to do, where there is no size.
    pub advice: Option<String>,
}

impl Replay {
    /// Reads configuration, models, baselines and the repair log.
    ///
    /// # Errors
    /// [`Failure`] of any of them.
    pub fn begin(arguments: &ReplayArguments) -> Result<Self, Failure> {
        let (mut config, duty_cycles) = arguments.reading.load()?;
        if let Some(mpa) = arguments.reference_mpa {
            if !(0.1..=100.0).contains(&mpa) {
                return Err(Failure::new(
                    Code::Usage,
                    format!("--reference-mpa is {mpa}; it must lie in 0.1 … 100 MPa (1 … 1000 bar)"),
                ));
            }
            config.reference_dp_pa = mpa * 1e6;
        }
        let mut pipeline = Pipeline::new(config.monitor(duty_cycles))?;
        let records = arguments.baseline.apply(&mut pipeline, &config)?;
        let repairs = RepairsDue::new(arguments.repairs.read(&config)?);
        Ok(Replay { config, pipeline, records, repairs })
    }

    /// What watches the record.
    pub fn pipeline(&self) -> &Pipeline {
        &self.pipeline
    }

    /// Reads the logs as one record, to its end; gives what is to be known of them.
    ///
    /// # Errors
    /// [`Failure`] of a log, or of the audience.
    pub fn read_logs(
        &mut self,
        logs: &[PathBuf],
        on_bytes: impl FnMut(u64) + Clone + Send + 'static,
        audience: &mut impl Audience,
    ) -> Result<Vec<String>, Failure> {
        let (mut notes, mut clock) = (Vec::new(), Clock::default());
        let mapping = self.config.log_mapping();
        for path in logs {
            let mut source = open_with(path, &mapping, on_bytes.clone())?;
            let name = log_name(path);
            audience.begin_log(&name);
            clock.begin(path);
            while let Some(mut sample) = source.next_sample()? {
                sample.time_ns = clock.in_one_record(sample.time_ns);
                audience.take_sample(&sample);
                self.take(&sample, audience)?;
            }
            let mut of_log = source.notes();
            of_log.extend(clock.note(&name));
            audience.end_log(&of_log);
            notes.extend(of_log);
        }
        self.end(audience)?;
        Ok(notes)
    }

    /// Takes a sample of the record.
    ///
    /// # Errors
    /// [`Failure`] of the audience.
    #[inline]
    pub fn take(&mut self, sample: &Sample, audience: &mut impl Audience) -> Result<(), Failure> {
        let mut heard = Ok(());
        let mut tell = |event: &Event<'_>| {
            if heard.is_ok() {
                heard = audience.take_event(event);
            }
        };
        while let Some(repair) = self.repairs.next_until(sample.time_ns, &self.pipeline) {
            self.pipeline.repaired(&repair, &mut tell);
        }
        self.pipeline.push(sample, &mut tell);
        heard
    }

    /// Ends the record.
    ///
    /// # Errors
    /// [`Failure`] of the audience.
    pub fn end(&mut self, audience: &mut impl Audience) -> Result<(), Failure> {
        let mut heard = Ok(());
        self.pipeline.finish(&mut |event| {
            if heard.is_ok() {
                heard = audience.take_event(event);
            }
        });
        heard
    }

    /// What it all comes to; `log` is what advice names.
    pub fn summed_up(&self, log: Option<&PathBuf>) -> Replayed {
        let summary = self.pipeline.summary();
        let advice = summary.observed.as_ref().map(|observed| {
            let source = self.config.command_source(log.map(PathBuf::as_path));
            advice(&summary, observed, &self.pipeline.config().duty_cycles, &source)
        });
        Replayed { summary, advice }
    }

    /// Checks that the record was not at another rate than the model's altogether.
    ///
    /// # Errors
    /// [`Failure`] with both rates.
    pub fn check_rate(&self, summary: &Summary) -> Result<(), Failure> {
        if let (Some(rate), Some(monitor)) = (self.pipeline.wrong_rate_hz(), self.pipeline.monitors().first())
            && summary.cycles == 0
        {
            return Err(Failure::data(format!(
                "the command comes at {rate:.1} Hz, the model reads {} Hz: no cycle could be used; train a model for this \
                 rate (`controller.period_s` in the plant file)",
                monitor.model().file().sample_rate_hz
            )));
        }
        Ok(())
    }

    /// The report of the record, as a page.
    fn page(&mut self, record: &HtmlSink, summary: &Summary, advice: Option<&str>) -> String {
        for (record, monitor) in self.records.iter_mut().zip(self.pipeline.monitors()) {
            // One that was learned on the way.
            record.extend(monitor.baseline().filter(|own| record.last() != Some(own)).cloned());
        }
        let monitors = self.pipeline.monitors();
        let names = monitors.iter().map(|monitor| monitor.name().unwrap_or_default().to_owned());
        let baselines: Vec<_> = names.zip(self.records.iter().cloned()).collect();
        let page = ReportPage {
            record,
            summary,
            advice,
            alarm: &self.config.alarm,
            area_m2_per_lpm: 1.0 / self.pipeline.config().flow_lpm(1.0),
            operating_hours_per_year: self.config.operating_hours_per_year,
            energy: &self.config.energy,
            baselines: &baselines,
        };
        page.render()
    }
}

/// What the command tells: on standard output and in files.
struct Told {
    files: Files,
    out: Printer,
}

impl Audience for Told {
    fn begin_log(&mut self, name: &str) {
        if let Some((_, html)) = &mut self.files.html {
            html.begin_log(name);
        }
    }

    #[inline]
    fn take_sample(&mut self, sample: &Sample) {
        if let Some((_, html)) = &mut self.files.html {
            html.take_sample(sample);
        }
    }

    fn take_event(&mut self, event: &Event<'_>) -> Result<(), Failure> {
        self.files.write(event).and_then(|()| self.out.event(event))
    }

    fn end_log(&mut self, notes: &[String]) {
        if let Some((_, html)) = &mut self.files.html {
            html.end_log(notes);
        }
    }
}

/// Entries of the repair log that are still to come.
struct RepairsDue {
    /// The oldest last.
    rest: Vec<Repair>,
    /// Whether a sample has been seen.
    begun: bool,
}

impl RepairsDue {
    fn new(mut repairs: Vec<Repair>) -> Self {
        repairs.reverse();
        RepairsDue { rest: repairs, begun: false }
    }

    /// The next entry up to a time. What was done before the log's first sample, and before the baseline, is no news.
    #[inline]
    fn next_until(&mut self, time_ns: i64, pipeline: &Pipeline) -> Option<Repair> {
        if !self.begun {
            self.begun = true;
            let baselines = pipeline.monitors().iter().filter_map(Monitor::baseline);
            let from_ns = baselines.map(|baseline| baseline.from_ns).fold(time_ns, i64::min);
            self.rest.retain(|repair| repair.at_ns >= from_ns);
        }
        let is_due = self.rest.last().is_some_and(|repair| repair.at_ns <= time_ns);
        if is_due { self.rest.pop() } else { None }
    }
}

/// What a command prints on standard output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Json,
    Lines,
    SummaryOnly,
}

/// Prints events on standard output. A reader that goes away ends the printing, not the work.
struct Printer {
    out: Plain<BufWriter<io::StdoutLock<'static>>>,
    format: Format,
    colour: Colour,
    started: bool,
    listened_to: bool,
    reference_dp_pa: f64,
}

impl Printer {
    fn new(arguments: &ReplayArguments, reference_dp_pa: f64) -> Self {
        let format = match (arguments.json, arguments.quiet) {
            (true, _) => Format::Json,
            (false, true) => Format::SummaryOnly,
            (false, false) => Format::Lines,
        };
        let colour = Colour::detect(io::stdout().is_terminal());
        let out = Plain(BufWriter::new(io::stdout().lock()));
        Printer { out, format, colour, started: false, listened_to: true, reference_dp_pa }
    }

    /// A bar over the logs' bytes, where lines on a terminal do not show the progress themselves.
    fn progress_bar(&self, logs: &[PathBuf]) -> ProgressBar {
        if self.format == Format::Lines && io::stdout().is_terminal() {
            return ProgressBar::hidden();
        }
        byte_bar(logs.iter().map(|log| bytes_of(log)).sum(), "replaying")
    }

    fn event(&mut self, event: &Event<'_>) -> Result<(), Failure> {
        let result = match self.format {
            Format::SummaryOnly => Ok(()),
            // Programs read a line a cycle; the flags are in them.
            Format::Json => match event {
                Event::Cycle(_) => json::write_event(&mut self.out, event),
                Event::Flag(_) | Event::Notice(_) => Ok(()),
            },
            Format::Lines => self.line(event),
        };
        self.heed(result)
    }

    fn line(&mut self, event: &Event<'_>) -> io::Result<()> {
        if !self.started {
            self.started = true;
            terminal::write_header(&mut self.out, self.reference_dp_pa)?;
        }
        terminal::write_event(&mut self.out, event, self.colour)
    }

    fn summary(&mut self, summary: &Summary, advice: Option<&str>) -> Result<(), Failure> {
        let result = match self.format {
            Format::Json => json::write_summary(&mut self.out, summary, advice),
            Format::Lines | Format::SummaryOnly => {
                terminal::write_summary(&mut self.out, summary, advice, self.colour)
            }
        };
        let result = result.and_then(|()| self.out.flush());
        self.heed(result)
    }

    fn heed(&mut self, result: io::Result<()>) -> Result<(), Failure> {
        match result {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                self.listened_to = false;
                self.format = Format::SummaryOnly;
                Ok(())
            }
            Err(_) if !self.listened_to => Ok(()),
            other => other.map_err(|error| Failure::writing(Path::new("standard output"), error)),
        }
    }
}
