//! The archive that an exported FMU is.

use std::io::{Seek, Write};

use seepd_fmi::Version;
use thiserror::Error;
use zip::ZipWriter;
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;

use crate::description::description;
use crate::resources::Resources;
use crate::simulation::{ModelError, Simulation};

/// A platform that a library is for, by its name in FMI 3.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Platform {
    /// 64-bit x86, Linux.
    X86Linux,
    /// 64-bit ARM, Linux.
    ArmLinux,
    /// 64-bit x86, Windows.
    X86Windows,
    /// 64-bit ARM, macOS.
    ArmDarwin,
    /// 64-bit x86, macOS.
    X86Darwin,
}

/// Beginning of an ELF file of 64 bits, little endian; its machine stands at byte 18.
const ELF: &[u8] = b"\x7fELF\x02\x01";
/// Beginning of a Windows library.
const WINDOWS: &[u8] = b"MZ";
/// Beginning of a macOS library of 64 bits.
const DARWIN: &[u8] = b"\xcf\xfa\xed\xfe";

impl Platform {
    /// Every platform.
    pub const ALL: [Platform; 5] = [
        Platform::X86Linux,
        Platform::ArmLinux,
        Platform::X86Windows,
        Platform::ArmDarwin,
        Platform::X86Darwin,
    ];

    /// Name in FMI 3.
    pub const fn name(self) -> &'static str {
        match self {
            Platform::X86Linux => "x86_64-linux",
            Platform::ArmLinux => "aarch64-linux",
            Platform::X86Windows => "x86_64-windows",
            Platform::ArmDarwin => "aarch64-darwin",
            Platform::X86Darwin => "x86_64-darwin",
        }
    }

    /// The platform of that name.
    pub fn named(name: &str) -> Option<Self> {
        Platform::ALL.into_iter().find(|platform| platform.name() == name)
    }

    const fn ending(self) -> &'static str {
        match self {
            Platform::X86Linux | Platform::ArmLinux => "so",
            Platform::X86Windows => "dll",
            Platform::ArmDarwin | Platform::X86Darwin => "dylib",
        }
    }

    /// Whether a file is a library for it, by its first bytes.
    fn is_of(self, library: &[u8]) -> bool {
        let of_elf = |machine: u8| library.starts_with(ELF) && library.get(18) == Some(&machine);
        match self {
            // Numbers of machines are the ELF specification's: 62 x86-64, 183 AArch64.
            Platform::X86Linux => of_elf(62),
            Platform::ArmLinux => of_elf(183),
            Platform::X86Windows => library.starts_with(WINDOWS),
            Platform::ArmDarwin | Platform::X86Darwin => library.starts_with(DARWIN),
        }
    }
}

/// A file that is no library for its platform.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("it is not a library for {}", .0.name())]
pub struct LibraryError(pub Platform);

/// Licences of what is in the archive.
const LICENCES: [(&str, &str); 3] = [
    ("LICENSE-MIT.txt", include_str!("../../../LICENSE-MIT")),
    ("LICENSE-APACHE.txt", include_str!("../../../LICENSE-APACHE")),
    ("third-party.txt", include_str!("third-party.txt")),
];

/// What goes into an archive.
pub struct Package<'a> {
    resources: &'a Resources,
    version: Version,
    description: String,
    libraries: Vec<(Platform, Vec<u8>)>,
}

impl<'a> Package<'a> {
    /// A package of a model, without libraries.
    ///
    /// # Errors
    /// [`ModelError`] where the resources are of no use.
    pub fn new(resources: &'a Resources, version: Version) -> Result<Self, ModelError> {
        let simulation = Simulation::new(resources)?;
        let description = description(&simulation, resources, version);
        Ok(Package { resources, version, description, libraries: Vec::new() })
    }

    /// Adds a library for a platform.
    ///
    /// # Errors
    /// [`LibraryError`] where it is none.
    pub fn add_library(&mut self, platform: Platform, library: Vec<u8>) -> Result<(), LibraryError> {
        if !platform.is_of(&library) {
            return Err(LibraryError(platform));
        }
        self.libraries.push((platform, library));
        Ok(())
    }

    /// The model description.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Writes the archive; the same content gives the same bytes.
    ///
    /// # Errors
    /// An error of the archive.
    pub fn write<W: Write + Seek>(&self, to: W) -> ZipResult<W> {
        let mut archive = ZipWriter::new(to);
        let plain = SimpleFileOptions::default();
        let mut file = |name: &str, options: SimpleFileOptions, content: &[u8]| {
            archive.start_file(name, options)?;
            archive.write_all(content)?;
            ZipResult::Ok(())
        };
        file("modelDescription.xml", plain, self.description.as_bytes())?;
        for (platform, library) in &self.libraries {
            let folder = seepd_fmi::archive::folder(self.version, platform.name());
            let name =
                format!("binaries/{folder}/{}.{}", self.resources.subject.identifier(), platform.ending());
            file(&name, plain.unix_permissions(0o755), library)?;
        }
        for (name, text) in self.resources.files() {
            file(&format!("resources/{name}"), plain, text.as_bytes())?;
        }
        for (name, text) in LICENCES {
            file(&format!("documentation/licenses/{name}"), plain, text.as_bytes())?;
        }
        archive.finish()
    }
}
