//! What is no FMU that can be used is refused in a sentence, before anything of it is loaded.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::io::{Cursor, Write};

use seepd_fmi::{Fmu, ModelDescription};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

const CO_SIMULATION: &str = "<CoSimulation modelIdentifier=\"axis\"/>";

fn description(version: &str, inside: &str) -> String {
    format!(
        "<fmiModelDescription fmiVersion=\"{version}\" modelName=\"axis\" guid=\"g\">{inside}</fmiModelDescription>"
    )
}

/// An archive of these files.
fn archive(files: &[(&str, &str)]) -> Cursor<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        archive.start_file(*name, SimpleFileOptions::default()).unwrap();
        archive.write_all(content.as_bytes()).unwrap();
    }
    archive.finish().unwrap()
}

fn refused(files: &[(&str, &str)]) -> String {
    Fmu::read(archive(files)).unwrap_err().to_string()
}

#[test]
fn archives_that_are_none_or_leave_their_folder() {
    let good = description("2.0", CO_SIMULATION);
    assert!(Fmu::read(archive(&[("modelDescription.xml", &good)])).is_ok());
    assert!(
        Fmu::read(Cursor::new(b"no archive".to_vec())).unwrap_err().to_string().starts_with("not an FMU")
    );
    let whole = archive(&[("modelDescription.xml", &good)]).into_inner();
    let half = Cursor::new(whole[..whole.len() / 2].to_vec());
    assert!(Fmu::read(half).unwrap_err().to_string().starts_with("not an FMU"));
    assert_eq!(refused(&[("readme.txt", "")]), "not an FMU: the archive has no modelDescription.xml");
    for outside in ["../../evil.so", "binaries/../../../evil.so"] {
        let told = refused(&[("modelDescription.xml", &good), (outside, "x")]);
        assert_eq!(told, format!("the FMU holds a file outside of its folder: `{outside}`"));
        let folder = std::env::temp_dir().join(format!("seepd-fmi-refused-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        assert!(Fmu::unpack(archive(&[(outside, "x")]), &folder).is_err());
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0, "{outside}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

/// A name from the root is taken from the folder.
#[test]
fn absolute_names_stay_in_the_folder() {
    let folder = std::env::temp_dir().join(format!("seepd-fmi-absolute-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    Fmu::unpack(archive(&[("/seepd-evil", "x")]), &folder).unwrap();
    assert!(folder.join("seepd-evil").exists() && !std::path::Path::new("/seepd-evil").exists());
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn links_are_not_followed() {
    let mut linked = ZipWriter::new(Cursor::new(Vec::new()));
    linked.add_symlink("resources", "/etc", SimpleFileOptions::default()).unwrap();
    let told = Fmu::read(linked.finish().unwrap()).unwrap_err().to_string();
    assert_eq!(told, "the FMU holds a file outside of its folder: `resources`");
}

#[test]
fn descriptions_of_other_kinds() {
    let told = |text: &str| ModelDescription::parse(text).unwrap_err().to_string();
    assert_eq!(told(&description("1.0", CO_SIMULATION)), "the FMU is of FMI 1.0; 2.0 and 3.0 are read");
    assert!(
        told(&description("2.0", "<ModelExchange modelIdentifier=\"axis\"/>"))
            .contains("export it as a co-simulation")
    );
    let path = told(&description("3.0", "<CoSimulation modelIdentifier=\"../../evil\"/>"));
    assert!(path.contains("`../../evil` is not a name of letters"), "{path}");
    assert!(told("<html/>").contains("begins with `html`"));
    assert!(told("<fmiModelDescription").starts_with("modelDescription.xml: "));
    let entities =
        "<!DOCTYPE x [<!ENTITY a \"b\">]><fmiModelDescription fmiVersion=\"2.0\">&a;</fmiModelDescription>";
    assert!(told(entities).starts_with("modelDescription.xml: "));
    let nameless = format!(
        "{CO_SIMULATION}<ModelVariables>\n<ScalarVariable valueReference=\"1\"><Real/></ScalarVariable></ModelVariables>"
    );
    assert_eq!(told(&description("2.0", &nameless)), "modelDescription.xml: line 2: a variable has no name");
    let huge = format!(
        "{CO_SIMULATION}<ModelVariables><ScalarVariable name=\"x\" valueReference=\"99999999999\"><Real/></ScalarVariable></ModelVariables>"
    );
    assert!(told(&description("2.0", &huge)).contains("has no valueReference"));
}

/// An archive makes little of them.
#[test]
fn a_description_of_millions_of_nodes_is_refused() {
    let text = description("2.0", &"<a/>".repeat(2_000_000));
    assert_eq!(refused(&[("modelDescription.xml", &text)]), "modelDescription.xml: nodes limit reached");
}
