//! What an FMU of ours has in its folder of resources: which model it is, and the model's own file.

use std::fs;
use std::path::Path;

use seepd_settings::parse_toml;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::simulation::ModelError;

/// Name of the file that says which model it is.
const HEAD: &str = "fmu.toml";

/// What is simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Subject {
    /// The hydraulic press.
    Press,
    /// The electric positioning axis.
    ElectricAxis,
    /// The leak monitor.
    Monitor,
}

impl Subject {
    /// Name of the library in the archive, a C identifier.
    pub const fn identifier(self) -> &'static str {
        match self {
            Subject::Press => "seepd_press",
            Subject::ElectricAxis => "seepd_electric_axis",
            Subject::Monitor => "seepd_monitor",
        }
    }

    /// The model's file among the resources.
    const fn file(self) -> &'static str {
        match self {
            Subject::Press | Subject::ElectricAxis => "plant.toml",
            Subject::Monitor => "model.json",
        }
    }
}

/// Where the controller of a plant is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// In the model, which takes a demand.
    Inside,
    /// With whoever steps the model, which takes a command.
    Outside,
}

/// The head's content.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    subject: Subject,
    controller: Placement,
    token: String,
}

/// What an FMU's folder of resources holds.
#[derive(Debug, Clone)]
pub struct Resources {
    /// What is simulated.
    pub subject: Subject,
    /// Where its controller is; a monitor has none.
    pub placement: Placement,
    /// The model's own file: a plant file or a trained model.
    pub text: String,
    token: String,
}

impl Resources {
    /// Resources of a model.
    pub fn new(subject: Subject, placement: Placement, text: String) -> Self {
        let token = token(subject, placement, &text);
        Resources { subject, placement, text, token }
    }

    /// Reads the folder of an unpacked FMU.
    ///
    /// # Errors
    /// [`ModelError::File`] and [`ModelError::Head`].
    pub fn read(folder: &Path) -> Result<Self, ModelError> {
        let read = |name: &str| {
            let file = folder.join(name);
            fs::read_to_string(&file).map_err(|error| ModelError::File { file, error })
        };
        let head: Head = parse_toml(&read(HEAD)?).map_err(ModelError::Head)?;
        let text = read(head.subject.file())?;
        Ok(Resources { subject: head.subject, placement: head.controller, text, token: head.token })
    }

    /// What the tool that instantiates the model has to show: it tells that description and resources belong together.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// The files, by their names in the folder.
    pub(crate) fn files(&self) -> [(&'static str, String); 2] {
        let (subject, controller) = (self.subject, self.placement);
        let head = Head { subject, controller, token: self.token.clone() };
        // A head of three names can be written.
        [(HEAD, toml::to_string(&head).unwrap_or_default()), (subject.file(), self.text.clone())]
    }
}

/// A hash of what the model is, in the form in which tools expect a GUID.
fn token(subject: Subject, placement: Placement, text: &str) -> String {
    let head = format!("{} {placement:?} {}\n", subject.identifier(), env!("CARGO_PKG_VERSION"));
    let hash = Sha256::new().chain_update(head).chain_update(text).finalize();
    let hex: String = hash.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    let parts = [&hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..]];
    format!("{{{}}}", parts.join("-"))
}
