//! What is read of an FMU, and what is refused with which sentence.

use std::io::{Cursor, Write};

use seepd_fmi::{Causality, Fmu, FmuError, Version};
use zip::ZipWriter;
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;

const AXIS_3: &str = r#"<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="Axis" instantiationToken="{3}">
  <CoSimulation modelIdentifier="axis" needsExecutionTool="true" fixedInternalStepSize="1e-4"/>
  <UnitDefinitions>
    <Unit name="mm"><BaseUnit m="1" factor="1e-3"/></Unit>
    <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>
  </UnitDefinitions>
  <TypeDefinitions><Float64Type name="Length" unit="mm" min="0" max="250"/></TypeDefinitions>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent"/>
    <Float64 name="u" valueReference="1" causality="input" start="0" min="-1" max="1"/>
    <Float64 name="s" valueReference="2" causality="output" declaredType="Length" max="200" description="piston"/>
    <Float64 name="k" valueReference="3" causality="parameter" start="2.5e-8" min="-1e60" max="1E+60"/>
    <Int32 name="mode" valueReference="4" causality="parameter" start="1"/>
    <Float64 name="n" valueReference="5" causality="structuralParameter" start="4"/>
  </ModelVariables>
</fmiModelDescription>"#;

const AXIS_2: &str = r#"<fmiModelDescription fmiVersion="2.0" modelName="Axis" guid="{2}">
  <CoSimulation modelIdentifier="axis"/>
  <TypeDefinitions><SimpleType name="Length"><Real unit="mm" min="0"/></SimpleType></TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="s" valueReference="2" causality="output"><Real declaredType="Length"/></ScalarVariable>
    <ScalarVariable name="on" valueReference="2" causality="input"><Boolean start="false"/></ScalarVariable>
  </ModelVariables>
</fmiModelDescription>"#;

fn archive(files: &[(&str, &str)]) -> ZipResult<ZipWriter<Cursor<Vec<u8>>>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, text) in files {
        archive.start_file(*name, SimpleFileOptions::default())?;
        archive.write_all(text.as_bytes())?;
    }
    Ok(archive)
}

fn read(files: &[(&str, &str)]) -> Result<Fmu, FmuError> {
    Fmu::read(archive(files)?.finish()?)
}

fn refusal(files: &[(&str, &str)]) -> String {
    read(files).map_or_else(|error| error.to_string(), |_| "it was read".to_owned())
}

#[test]
fn variables_of_fmi_3_have_causality_unit_start_and_bounds() {
    let description = read(&[("modelDescription.xml", AXIS_3)]).unwrap().description;
    assert_eq!((description.version, description.token.as_str()), (Version::Three, "{3}"));
    assert_eq!(description.fixed_step_s, Some(1e-4));
    assert!(description.needs_tool);
    let told: Vec<_> = description
        .variables
        .iter()
        .map(|variable| (variable.name.as_str(), variable.reference, variable.causality, variable.bounds))
        .collect();
    // An integer is passed over; a bound of the variable's own goes before its type's; 1e60 is none.
    assert_eq!(
        told,
        [
            ("time", 0, Causality::Other, (None, None)),
            ("u", 1, Causality::Input, (Some(-1.0), Some(1.0))),
            ("s", 2, Causality::Output, (Some(0.0), Some(200.0))),
            ("k", 3, Causality::Parameter, (None, None)),
            ("n", 5, Causality::StructuralParameter, (None, None)),
        ]
    );
    let piston = description.variable("s").unwrap();
    assert_eq!(piston.description, "piston");
    let unit = description.unit_of(piston).unwrap();
    assert_eq!((unit.factor, unit.offset, unit.exponents), (1e-3, 0.0, [0, 1, 0, 0, 0, 0, 0, 0]));
    assert_eq!(description.variable("k").unwrap().start, Some(2.5e-8));
    assert_eq!(description.unit_of(description.variable("k").unwrap()), None);
}

#[test]
fn variables_of_fmi_2_take_units_and_bounds_of_their_type() {
    let description = read(&[("modelDescription.xml", AXIS_2)]).unwrap().description;
    assert_eq!((description.version, description.token.as_str()), (Version::Two, "{2}"));
    assert_eq!(description.variables.len(), 1);
    let piston = &description.variables[0];
    assert_eq!((piston.unit.as_deref(), piston.bounds), (Some("mm"), (Some(0.0), None)));
    // Its relation to SI is not stated.
    assert_eq!(description.unit_of(piston), None);
}

#[test]
fn a_binary_is_found_by_each_versions_name_of_the_platform() {
    let files = |description| {
        [
            ("modelDescription.xml", description),
            ("binaries/linux64/axis.so", ""),
            ("binaries/x86_64-linux/other.so", ""),
            ("binaries/x86_64-linux/axis.so", ""),
            ("binaries/win64/axis.dll", ""),
        ]
    };
    let two = read(&files(AXIS_2)).unwrap();
    assert_eq!(two.binary("x86_64-linux").unwrap(), "binaries/linux64/axis.so");
    let three = read(&files(AXIS_3)).unwrap();
    assert_eq!(three.binary("x86_64-linux").unwrap(), "binaries/x86_64-linux/axis.so");
    assert_eq!(
        three.binary("aarch64-linux").unwrap_err().to_string(),
        "the FMU has no binary for aarch64-linux; it has: linux64, win64, x86_64-linux"
    );
    let sources = read(&[("modelDescription.xml", AXIS_2), ("sources/axis.c", "")]).unwrap();
    assert_eq!(
        sources.binary("x86_64-linux").unwrap_err().to_string(),
        "the FMU has no binary for x86_64-linux; it has: none (only sources, or nothing)"
    );
}

#[test]
fn junk_and_half_an_archive_are_refused() {
    let whole = archive(&[("modelDescription.xml", AXIS_2)]).unwrap().finish().unwrap().into_inner();
    for bytes in [b"no archive".as_slice(), &whole[..whole.len() / 2], &[]] {
        assert!(matches!(Fmu::read(Cursor::new(bytes)), Err(FmuError::Archive(_))));
    }
    assert_eq!(refusal(&[("readme.txt", "")]), "not an FMU: the archive has no modelDescription.xml");
}

#[test]
fn files_outside_of_the_folder_are_refused() {
    for name in ["../evil.so", "binaries/../../evil.so"] {
        let refused = refusal(&[("modelDescription.xml", AXIS_2), (name, "")]);
        assert_eq!(refused, format!("the FMU holds a file outside of its folder: `{name}`"));
    }
    let mut linked = archive(&[("modelDescription.xml", AXIS_2)]).unwrap();
    linked.add_symlink("resources/all", "/", SimpleFileOptions::default()).unwrap();
    assert!(
        matches!(Fmu::read(linked.finish().unwrap()), Err(FmuError::Outside(name)) if name == "resources/all")
    );
}

#[test]
fn an_archive_that_unpacks_to_a_gigabyte_is_refused_before_it_is() {
    let mut archive = archive(&[("modelDescription.xml", AXIS_2)]).unwrap();
    archive.start_file("resources/zeros", SimpleFileOptions::default()).unwrap();
    let zeros = vec![0u8; 1 << 20];
    for _ in 0..513 {
        archive.write_all(&zeros).unwrap();
    }
    let refused = Fmu::read(archive.finish().unwrap()).unwrap_err();
    let bytes = (513 << 20) + AXIS_2.len() as u64;
    assert!(matches!(refused, FmuError::TooLarge { bytes: stated } if stated == bytes), "{refused}");
}

#[test]
fn what_a_description_must_not_say_is_refused_with_a_sentence() {
    let changed = |from: &str, to: &str| {
        assert!(AXIS_2.contains(from), "{from}");
        refusal(&[("modelDescription.xml", &AXIS_2.replace(from, to))])
    };
    assert_eq!(changed("\"2.0\"", "\"1.0\""), "the FMU is of FMI 1.0; 2.0 and 3.0 are read");
    assert_eq!(
        changed("CoSimulation", "ModelExchange"),
        "the FMU is not for co-simulation; export it as a co-simulation FMU with its solver inside"
    );
    assert_eq!(
        changed("modelIdentifier=\"axis\"", "modelIdentifier=\"../../axis\""),
        "the FMU's modelIdentifier `../../axis` is not a name of letters, digits and underscores"
    );
    assert_eq!(
        changed("name=\"s\" valueReference=\"2\"", "name=\"s\""),
        "modelDescription.xml: line 5: a variable has no valueReference"
    );
    assert_eq!(
        changed("fmiModelDescription", "ssd"),
        "modelDescription.xml begins with `ssd`, not with fmiModelDescription"
    );
    assert!(changed("</ModelVariables>", "").starts_with("modelDescription.xml: "));
    // Entities could grow without end.
    let with_type = format!("<!DOCTYPE x [<!ENTITY a \"aa\">]>{AXIS_2}");
    assert!(refusal(&[("modelDescription.xml", &with_type)]).contains("DTD"));
}
