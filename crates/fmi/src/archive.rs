//! The archive that an FMU is: what may be in it, and what it has binaries for.

use std::fs::{self, File};
use std::io::{Read, Seek};
use std::path::Path;

use thiserror::Error;
use zip::ZipArchive;
use zip::result::ZipError;

use crate::description::{DescriptionError, ModelDescription, Version};

/// Largest sum of the unpacked sizes that an archive may state, bytes. Simscape's and Dymola's FMUs stay below 100 MB.
pub const MOST_BYTES: u64 = 512 << 20;
/// Largest model description, bytes: that of 100,000 variables has some 30 MB.
const MOST_DESCRIPTION_BYTES: u64 = 64 << 20;
const DESCRIPTION: &str = "modelDescription.xml";

/// Why a file is no FMU that can be used.
#[derive(Debug, Error)]
pub enum FmuError {
    /// Not a zip archive, or a damaged one.
    #[error("not an FMU: {0}")]
    Archive(#[from] ZipError),
    /// An archive without description.
    #[error("not an FMU: the archive has no modelDescription.xml")]
    NoDescription,
    /// A file that would be unpacked outside of its folder.
    #[error("the FMU holds a file outside of its folder: `{0}`")]
    Outside(String),
    /// Too large when unpacked.
    #[error("the FMU has {bytes} bytes when unpacked; at most {MOST_BYTES} are")]
    TooLarge {
        /// What it states.
        bytes: u64,
    },
    /// The description cannot be read from the archive.
    #[error("modelDescription.xml: {0}")]
    Unreadable(std::io::Error),
    /// A file cannot be unpacked.
    #[error("the FMU cannot be unpacked: {0}")]
    Unpacked(std::io::Error),
    /// The description is none.
    #[error(transparent)]
    Description(#[from] DescriptionError),
    /// No binary for a platform.
    #[error("the FMU has no binary for {platform}; it has: {}", listed(.present))]
    NoBinary {
        /// The one that was asked for, by its name in FMI 3.
        platform: String,
        /// Those that there are.
        present: Vec<String>,
    },
}

fn listed(platforms: &[String]) -> String {
    if platforms.is_empty() { "none (only sources, or nothing)".to_owned() } else { platforms.join(", ") }
}

/// An FMU as its archive tells it.
#[derive(Debug, Clone)]
pub struct Fmu {
    /// What it says of itself.
    pub description: ModelDescription,
    /// Platforms that it has a binary for, sorted, by the names of its folders.
    pub platforms: Vec<String>,
    files: Vec<String>,
}

impl Fmu {
    /// Reads an archive's list of files and its description; nothing is unpacked to disk.
    ///
    /// # Errors
    /// [`FmuError`] for what is not an FMU, or would not stay in its folder, or is too large.
    pub fn read<R: Read + Seek>(archive: R) -> Result<Self, FmuError> {
        let mut archive = ZipArchive::new(archive)?;
        let (mut files, mut bytes) = (Vec::new(), 0u64);
        for index in 0..archive.len() {
            let file = archive.by_index_raw(index)?;
            if file.enclosed_name().is_none() || file.is_symlink() {
                return Err(FmuError::Outside(file.name().to_owned()));
            }
            bytes = bytes.saturating_add(file.size());
            files.push(file.name().to_owned());
        }
        if bytes > MOST_BYTES {
            return Err(FmuError::TooLarge { bytes });
        }
        if !files.iter().any(|name| name == DESCRIPTION) {
            return Err(FmuError::NoDescription);
        }
        let mut text = String::new();
        let described = archive.by_name(DESCRIPTION)?;
        // A size that the archive states may be a lie.
        described.take(MOST_DESCRIPTION_BYTES).read_to_string(&mut text).map_err(FmuError::Unreadable)?;
        let description = ModelDescription::parse(&text)?;
        Ok(Fmu { platforms: platforms(&files), description, files })
    }

    /// Unpacks an archive whole into a folder that is there, and makes the folder of resources where it has none: models expect it.
    ///
    /// # Errors
    /// [`FmuError`]; sizes are counted as they come, whatever the archive states.
    pub fn unpack<R: Read + Seek>(archive: R, folder: &Path) -> Result<(), FmuError> {
        let mut archive = ZipArchive::new(archive)?;
        let mut left = MOST_BYTES;
        for index in 0..archive.len() {
            let mut file = archive.by_index(index)?;
            let Some(name) = file.enclosed_name().filter(|_| !file.is_symlink()) else {
                return Err(FmuError::Outside(file.name().to_owned()));
            };
            let place = folder.join(name);
            if file.is_dir() {
                fs::create_dir_all(&place).map_err(FmuError::Unpacked)?;
                continue;
            }
            if let Some(parent) = place.parent() {
                fs::create_dir_all(parent).map_err(FmuError::Unpacked)?;
            }
            let mut unpacked = File::create(&place).map_err(FmuError::Unpacked)?;
            let bytes = std::io::copy(&mut file.by_ref().take(left + 1), &mut unpacked)
                .map_err(FmuError::Unpacked)?;
            left = left.checked_sub(bytes).ok_or(FmuError::TooLarge { bytes: MOST_BYTES + 1 })?;
        }
        fs::create_dir_all(folder.join("resources")).map_err(FmuError::Unpacked)
    }

    /// The place in the archive of the binary for a platform, which is named as in FMI 3, such as `x86_64-linux`.
    ///
    /// # Errors
    /// [`FmuError::NoBinary`], with what there is instead.
    pub fn binary(&self, platform: &str) -> Result<&str, FmuError> {
        let folder = folder(self.description.version, platform);
        let start = format!("binaries/{folder}/{}.", self.description.identifier);
        let found = self.files.iter().find(|name| {
            let rest = name.strip_prefix(&start);
            rest.is_some_and(|ending| ["so", "dll", "dylib"].contains(&ending))
        });
        found.map(String::as_str).ok_or_else(|| FmuError::NoBinary {
            platform: platform.to_owned(),
            present: self.platforms.clone(),
        })
    }
}

/// The folder among an FMU's binaries for a platform that is named as in FMI 3. FMI 2 names platforms by system and width; it has no name
/// for 64-bit ARM, and tools that write such FMUs use FMI 3's.
pub fn folder(version: Version, platform: &str) -> &str {
    match (version, platform) {
        (Version::Two, "x86_64-linux") => "linux64",
        (Version::Two, "x86_64-windows") => "win64",
        (Version::Two, "x86_64-darwin") => "darwin64",
        (_, other) => other,
    }
}

fn platforms(files: &[String]) -> Vec<String> {
    let folder = |name: &String| {
        let (folder, file) = name.strip_prefix("binaries/")?.split_once('/')?;
        (!file.is_empty()).then(|| folder.to_owned())
    };
    let mut all: Vec<String> = files.iter().filter_map(folder).collect();
    all.sort();
    all.dedup();
    all
}
