//! `seepd export-fmu`: the press, the electric axis and the leak monitor for tools that read FMUs.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use clap::Args;
use seepd_fmi::Version;
use seepd_fmu::{Package, Placement, Platform, Resources, Subject};
use seepd_settings::side_file;
use seepd_sim::MachineSpec;
use seepd_sim::electric::ElectricAxis;
use seepd_simulator::{SimulatorSpec, exported};

use super::simulate::read_plant;
use crate::cli::Outcome;
use crate::failure::{Code, Failure};
use crate::output::{Outputs, OverwriteArguments};
use crate::sink::terminal::print;

/// Write the press, the electric axis or the leak monitor as an FMU
///
/// For co-simulation by FMI 2.0 or 3.0, with the effects of the catalogue and the leak as parameters. A plant takes the command, or with
/// its controller the demand; the monitor takes the command and shows the leak with its interval and the flags.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  seepd export-fmu --out press.fmu\n  seepd export-fmu --fmi 3 --plant press-3.toml --with-controller --out press-3.fmu\n  \
                        seepd export-fmu --monitor press-3.json --out monitor.fmu\n  \
                        seepd export-fmu --library aarch64-linux=libseepd_fmu_library.so --out press.fmu"
)]
pub struct ExportFmuArguments {
    /// FMU to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Plant file, of a press or an electric axis, instead of the nominal press
    #[arg(long, value_name = "FILE")]
    plant: Option<PathBuf>,
    /// The monitor instead of a plant, with this model, or without a file with the one that the program brings
    #[arg(long, value_name = "MODEL", num_args = 0..=1, conflicts_with_all = ["plant", "with_controller", "emit_plant"])]
    #[expect(clippy::option_option, reason = "an option that may be left out, and whose file may be")]
    monitor: Option<Option<PathBuf>>,
    /// With the controller inside, which takes a demand
    #[arg(long)]
    with_controller: bool,
    /// Version of FMI: 2 is read by every tool
    #[arg(long, value_name = "2|3", default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=3))]
    fmi: u8,
    /// The library that goes in, by platform (x86_64-linux, aarch64-linux, x86_64-windows, …); may be repeated [default: the one that lies
    /// beside the program]
    #[arg(long, value_name = "PLATFORM=FILE", value_parser = library)]
    library: Vec<(Platform, PathBuf)>,
    /// Write the plant file with which `gap` takes the FMU for its simulator
    #[arg(long, value_name = "FILE")]
    emit_plant: Option<PathBuf>,
    #[command(flatten)]
    overwrite: OverwriteArguments,
}

fn library(text: &str) -> Result<(Platform, PathBuf), String> {
    let (name, file) = text.split_once('=').ok_or("it is not of the form PLATFORM=FILE")?;
    let platform = Platform::named(name).ok_or_else(|| {
        let known: Vec<&str> = Platform::ALL.iter().map(|platform| platform.name()).collect();
        format!("`{name}` is no platform; there are {}", known.join(", "))
    })?;
    Ok((platform, file.into()))
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] for plant, model, library or output.
pub fn run(arguments: &ExportFmuArguments) -> Result<Outcome, Failure> {
    let model = Exported::read(arguments)?;
    let libraries = libraries(&arguments.library)?;
    let inputs = arguments.plant.iter().chain(arguments.monitor.iter().flatten());
    let inputs = inputs.chain(libraries.iter().map(|(_, file)| file)).map(PathBuf::as_path);
    let mut outputs = Outputs::new(arguments.overwrite, inputs);
    let (out, emit_plant) =
        (outputs.claim(&arguments.out)?, outputs.claim_any(arguments.emit_plant.as_ref())?);
    let version = if arguments.fmi == 2 { Version::Two } else { Version::Three };
    let named = |error| Failure::configuration(model.path(arguments), error);
    let mut package = Package::new(&model.resources, version).map_err(named)?;
    for (platform, file) in &libraries {
        let bytes = fs::read(file).map_err(|error| Failure::reading(file, &error))?;
        let added = package.add_library(*platform, bytes);
        added.map_err(|error| Failure::data(format!("{}: {error}", file.display())))?;
    }
    let archive = package.write(Cursor::new(Vec::new()));
    let archive = archive.map_err(|error| Failure::writing(&arguments.out, error))?;
    if let Some(emit_plant) = emit_plant {
        emit_plant.write(model.plant_file(arguments)?)?;
    }
    out.write(archive.into_inner())?;
    let platforms: Vec<&str> = libraries.iter().map(|(platform, _)| platform.name()).collect();
    let text =
        format!("{}: FMI {}.0, for {}\n", arguments.out.display(), arguments.fmi, platforms.join(", "));
    print(text.as_bytes())?;
    Ok(Outcome::Good)
}

/// What is exported, with its own file.
struct Exported {
    resources: Resources,
    machine: Machine,
}

enum Machine {
    Press(Box<MachineSpec>),
    ElectricAxis(ElectricAxis),
    None,
}

impl Exported {
    fn read(arguments: &ExportFmuArguments) -> Result<Self, Failure> {
        if let Some(model) = &arguments.monitor {
            let json = match model {
                Some(path) => side_file::read(path).map_err(|error| Failure::reading(path, &error))?,
                None => crate::EMBEDDED_MODEL.to_vec(),
            };
            let text = String::from_utf8_lossy(&json).into_owned();
            let resources = Resources::new(Subject::Monitor, Placement::Outside, text);
            return Ok(Exported { resources, machine: Machine::None });
        }
        let placement = if arguments.with_controller { Placement::Inside } else { Placement::Outside };
        let unwritable = |error: seepd_sim::SpecError| Failure::new(Code::Internal, error.to_string());
        if let Some(path) = &arguments.plant {
            let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
            if ElectricAxis::is_kind(&text) {
                let axis =
                    ElectricAxis::from_toml(&text).map_err(|error| Failure::configuration(path, error))?;
                let text = axis.to_toml().map_err(unwritable)?;
                let resources = Resources::new(Subject::ElectricAxis, placement, text);
                return Ok(Exported { resources, machine: Machine::ElectricAxis(axis) });
            }
            if SimulatorSpec::is_kind(&text) {
                let what = "this is a simulator of your own; only a press or an electric axis can be written";
                return Err(Failure::configuration(path, what));
            }
        }
        let spec = read_plant(arguments.plant.as_deref())?;
        let resources = Resources::new(Subject::Press, placement, spec.to_toml().map_err(unwritable)?);
        Ok(Exported { resources, machine: Machine::Press(Box::new(spec)) })
    }

    /// The file to name where something is wrong with the model.
    fn path<'a>(&self, arguments: &'a ExportFmuArguments) -> &'a Path {
        let file = arguments.plant.as_deref().or(arguments.monitor.as_ref().and_then(Option::as_deref));
        file.unwrap_or(match self.machine {
            Machine::None => Path::new("the embedded model"),
            Machine::Press(_) | Machine::ElectricAxis(_) => Path::new("the nominal press"),
        })
    }

    /// The plant file around the FMU.
    fn plant_file(&self, arguments: &ExportFmuArguments) -> Result<String, Failure> {
        // Relative to the plant file, where both are in one folder.
        let (fmu, plant) = (arguments.out.parent(), arguments.emit_plant.as_deref().and_then(Path::parent));
        let file = match arguments.out.file_name().filter(|_| fmu == plant) {
            Some(name) => PathBuf::from(name),
            None => std::path::absolute(&arguments.out)
                .map_err(|error| Failure::writing(&arguments.out, error))?,
        };
        let simulator = match &self.machine {
            Machine::Press(spec) => exported::press(spec, file, arguments.with_controller),
            Machine::ElectricAxis(axis) if arguments.with_controller => exported::electric_axis(axis, file),
            Machine::ElectricAxis(_) | Machine::None => {
                let what = "--emit-plant: the axis's cascaded controller has no place in such a file; add --with-controller";
                return Err(Failure::new(Code::Usage, what));
            }
        };
        simulator.to_toml().map_err(|error| Failure::new(Code::Internal, error.to_string()))
    }
}

/// Name of the library that goes into FMUs, on this system.
fn library_name() -> String {
    format!("{}seepd_fmu_library{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX)
}

/// Places of the library, from the program's folder: where cargo leaves it, beside the program, and where packages put it.
const PLACES: [&str; 3] = ["deps", ".", "../lib/seepd"];

/// The libraries that were named, or the one for this machine.
fn libraries(named: &[(Platform, PathBuf)]) -> Result<Vec<(Platform, PathBuf)>, Failure> {
    if !named.is_empty() {
        return Ok(named.to_vec());
    }
    let program = std::env::current_exe().map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
    let folder = program.parent().unwrap_or(Path::new("."));
    let own = seepd_simulator::fmu::platform();
    let place =
        PLACES.iter().map(|place| folder.join(place).join(library_name())).find(|file| file.is_file());
    match (Platform::named(&own), place) {
        (Some(platform), Some(file)) => Ok(vec![(platform, file)]),
        _ => Err(Failure::new(
            Code::NoInput,
            format!(
                "{}: the library that goes into FMUs is not beside the program: build it (cargo build --release -p seepd-fmu-library) and \
                 name it (--library {own}=target/release/{})",
                library_name(),
                library_name()
            ),
        )),
    }
}
