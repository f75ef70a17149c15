//! A simulator of the user's as the plant of a diagnosis: its file, its program, and what its runs came to.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use seepd_fmi::{Fmu, Version};
use seepd_gap::SimulatedAxis;
use seepd_settings::side_file;
use seepd_simulator::{Budget, SimulatorAxis, SimulatorSpec, Simulators, proposal};

use crate::cli::{Outcome, start_words};
use crate::failure::{Code, Failure};
use crate::sink::plain::one_line;
use crate::sink::terminal::print;

/// What a user's simulator may be asked.
#[derive(Debug, Args)]
pub struct SimulatorArguments {
    /// Program that simulates, in the place of the plant file's [process] command; split at spaces
    #[arg(long, value_name = "COMMAND", requires = "plant")]
    simulator: Option<String>,
    /// FMU that simulates, in the place of the plant file's [fmu] file
    #[arg(long, value_name = "FILE", requires = "plant", conflicts_with = "simulator")]
    fmu: Option<PathBuf>,
    /// Most runs of a simulator of your own: the search then ends with what it has
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    simulations: Option<u32>,
    /// Longest search with a simulator of your own, minutes
    #[arg(long, value_name = "M", value_parser = minutes)]
    minutes: Option<f64>,
}

fn minutes(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1e5 => Ok(value),
        _ => Err("minutes are a positive number, such as 10 or 0.5".into()),
    }
}

impl SimulatorArguments {
    /// The option that names a simulator.
    fn option(&self) -> Option<&'static str> {
        let simulator = self.simulator.as_ref().map(|_| "--simulator");
        simulator.or(self.fmu.as_ref().map(|_| "--fmu"))
    }

    /// The axis of a plant file of `kind = "simulator"`, if it is one, after a first run that shows whether the simulator answers.
    ///
    /// # Errors
    /// [`Failure`] for the file, and for a simulator that does not give an answer.
    pub fn axis(&self, plant: Option<&Path>) -> Result<Option<SimulatorAxis>, Failure> {
        let Some(path) = plant else { return Ok(None) };
        let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
        if !SimulatorSpec::is_kind(&text) {
            return match self.option() {
                Some(option) => Err(misplaced(option, "with kind = \"simulator\"", path)),
                None => Ok(None),
            };
        }
        let mut spec =
            SimulatorSpec::from_toml(&text).map_err(|error| Failure::configuration(path, error))?;
        match (&self.simulator, &mut spec.process) {
            (Some(command), Some(process)) => {
                process.command = command.split_whitespace().map(str::to_owned).collect();
            }
            (Some(_), None) => return Err(misplaced("--simulator", "with [process]", path)),
            (None, _) => {}
        }
        match (&self.fmu, &mut spec.fmu) {
            (Some(file), Some(fmu)) => fmu.file.clone_from(file),
            (Some(_), None) => return Err(misplaced("--fmu", "with [fmu]", path)),
            (None, _) => {}
        }
        let folder = match (self.option().is_some(), path.parent()) {
            // What is named on the command line is meant from there.
            (false, Some(folder)) if folder != Path::new("") => folder.to_owned(),
            _ => ".".into(),
        };
        let budget = Budget {
            runs: self.simulations.map(|runs| runs as usize),
            time: self.minutes.map(|minutes| Duration::from_secs_f64(60.0 * minutes)),
        };
        let mut host = start_words()?;
        host.push("fmu-host".into());
        let axis = SimulatorAxis::new(spec, Simulators::new(folder, host, budget));
        axis.tried().map_err(|error| Failure::configuration(path, error))?;
        Ok(Some(axis))
    }
}

/// An option that a plant file has no place for.
fn misplaced(option: &str, wanted: &str, path: &Path) -> Failure {
    Failure::new(Code::Usage, format!("{option} needs a plant file {wanted}; {} is none", path.display()))
}

/// Whether a file is an FMU, by its name.
pub fn is_fmu(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("fmu"))
}

/// Shows what an FMU has, and prints the plant file that would map it. Nothing of it is run.
///
/// # Errors
/// [`Failure`] for what is no FMU.
pub fn inspect(path: &Path) -> Result<Outcome, Failure> {
    let file = File::open(path).map_err(|error| Failure::reading(path, &error))?;
    let fmu = Fmu::read(file).map_err(|error| Failure::data(format!("{}: {error}", path.display())))?;
    let description = &fmu.description;
    let version = match description.version {
        Version::Two => "2.0",
        Version::Three => "3.0",
    };
    let mut text = format!(
        "{}: FMI {version}, co-simulation, for {}\n",
        one_line(&description.name),
        fmu.platforms.join(", ")
    );
    if description.needs_tool {
        text += "it says that it needs the tool that made it\n";
    }
    if let Some(step_s) = description.fixed_step_s {
        text +=
            &format!("its solver has a fixed step of {step_s} s: a tick must be a whole multiple of it\n");
    }
    text.push('\n');
    text.extend(proposal::overview(description).lines().map(|line| one_line(line) + "\n"));
    // Nobody reads the overview where standard error is closed; the plant file still counts.
    let _ = std::io::stderr().write_all(format!("{text}\n").as_bytes());
    print(proposal::plant_file(&path.display().to_string(), description).as_bytes())?;
    Ok(Outcome::Good)
}

/// Hosts an FMU for `gap`: started by it, not by people.
#[derive(Debug, Args)]
pub struct FmuHostArguments {}

/// Runs the host.
///
/// # Errors
/// [`Failure`] where whoever asks cannot be answered.
pub fn host() -> Result<Outcome, Failure> {
    seepd_simulator::fmu::serve()
        .map_err(|error| Failure::new(Code::Io, format!("hosting an FMU: {error}")))?;
    Ok(Outcome::Good)
}

/// What there is to say of the runs, and of what had no port.
pub fn notes(axis: &SimulatorAxis) -> Vec<String> {
    let counts = axis.simulators().counts();
    let mut notes = vec![format!(
        "the simulator ran {} times, {:.3} s each on average; {} further answers were known already",
        counts.runs,
        counts.seconds / counts.runs.max(1) as f64,
        counts.repeated
    )];
    if let Some(first) = counts.first_failure {
        notes
            .push(format!("{} of these runs failed and count as far off; the first: {first}", counts.failed));
    }
    if axis.is_spent() {
        notes.push(
            "what may be simulated was used up before the search had ended: probabilities are less certain than they look"
                .into(),
        );
    }
    for (port, effects) in axis.spec().without_port() {
        notes.push(format!("not tried, since {}: {}", port.wanted(), effects.join(", ")));
    }
    notes
}
