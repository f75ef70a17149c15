//! `gap` with an FMU as the plant: of both versions, written in C apart from our laws, well behaved and otherwise.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{fixture, seepd, stderr, stdout};
use serde_json::Value;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Variables of `cylinder.c` in its order: name, causality, unit.
const VARIABLES: [(&str, &str, &str); 8] = [
    ("command_in", "input", "1"),
    ("load", "input", "N"),
    ("cylinder.s", "output", "mm"),
    ("cylinder.v", "output", "m/s"),
    ("valve.gain", "parameter", "m/s"),
    ("valve.lag", "parameter", "s"),
    ("fault", "parameter", "1"),
    ("start", "parameter", "m"),
];

fn description(version: u32) -> String {
    let units = [
        ("1", ""),
        ("N", "kg=\"1\" m=\"1\" s=\"-2\""),
        ("mm", "m=\"1\" factor=\"0.001\""),
        ("m", "m=\"1\""),
        ("m/s", "m=\"1\" s=\"-1\""),
        ("s", "s=\"1\""),
    ];
    let units = units.map(|(name, base)| format!("<Unit name=\"{name}\"><BaseUnit {base}/></Unit>")).concat();
    let variable = |(reference, (name, causality, unit)): (usize, &(&str, &str, &str))| {
        let start = match (*name, *causality) {
            (_, "output") => "",
            ("valve.lag", _) => "start=\"0\" min=\"0\" max=\"0.1\"",
            _ => "start=\"0\"",
        };
        let common = format!("name=\"{name}\" valueReference=\"{reference}\" causality=\"{causality}\"");
        match version {
            2 => format!("<ScalarVariable {common}><Real unit=\"{unit}\" {start}/></ScalarVariable>"),
            _ => format!("<Float64 {common} unit=\"{unit}\" {start}/>"),
        }
    };
    let variables: String = VARIABLES.iter().enumerate().map(variable).collect();
    let token = if version == 2 { "guid" } else { "instantiationToken" };
    format!(
        "<fmiModelDescription fmiVersion=\"{version}.0\" modelName=\"Cylinder\" {token}=\"cylinder\">\
         <UnitDefinitions>{units}</UnitDefinitions><CoSimulation modelIdentifier=\"cylinder\"/>\
         <ModelVariables>{variables}</ModelVariables></fmiModelDescription>"
    )
}

/// The model compiled and packed.
fn fmu(folder: &Path, version: u32) -> PathBuf {
    let library = folder.join(format!("cylinder{version}.so"));
    let define = if version == 3 { "-DFMI3" } else { "-DFMI2" };
    let source = fixture("fmu/cylinder.c");
    let compiled = Command::new("cc")
        .args(["-O2", "-shared", "-fPIC", "-w", define, "-o", text_of(&library), text_of(&source), "-lm"])
        .status();
    assert!(compiled.unwrap().success());
    let place = if version == 2 { "linux64".to_owned() } else { format!("{}-linux", std::env::consts::ARCH) };
    let file = folder.join(format!("cylinder{version}.fmu"));
    let mut archive = ZipWriter::new(File::create(&file).unwrap());
    let options = SimpleFileOptions::default();
    archive.start_file("modelDescription.xml", options).unwrap();
    archive.write_all(description(version).as_bytes()).unwrap();
    archive.start_file(format!("binaries/{place}/cylinder.so"), options).unwrap();
    archive.write_all(&fs::read(library).unwrap()).unwrap();
    archive.finish().unwrap();
    file
}

/// The plant file that maps it.
fn plant(folder: &Path, fmu: &Path, change: impl Fn(String) -> String) -> PathBuf {
    let text = format!(
        r#"
kind = "simulator"
stroke_m = 0.5
[fmu]
file = "{}"
inputs = {{ command = "command_in", load = "load" }}
outputs = {{ position = "cylinder.s", velocity = "cylinder.v" }}
start_position = "start"
timeout_s = 20
set = {{ fault = 0 }}
[parameters]
"valve.gain" = {{ start = 0.6 }}
[controller]
kp = 8.0
ki = 12.0
period_s = 0.005
[cycle]
period_s = 4.0
load = []
moves = [
    {{ name = "out", from_s = 0.2, to_s = 1.4, to_m = 0.3 }},
    {{ name = "back", from_s = 2.2, to_s = 3.4, to_m = 0.1 }},
]
"#,
        fmu.file_name().unwrap().to_str().unwrap()
    );
    let file = folder.join("cylinder.toml");
    fs::write(&file, change(text)).unwrap();
    file
}

/// A log of the same kind of machine, its gain off by 3 %, with a dead band of its valve and a friction on its load: laws written here.
fn log(folder: &Path, band: f64, friction_n: f64) -> PathBuf {
    let (dt, mut x, mut v, mut integral, mut noise) = (0.005f64, 0.1, 0.0f64, 0.0, 1u64);
    let mut random = || {
        // Marsaglia's xorshift; twelve of them make a normal deviate.
        let mut next = || {
            noise ^= noise << 13;
            noise ^= noise >> 7;
            noise ^= noise << 17;
            noise as f64 / u64::MAX as f64
        };
        (0..12).map(|_| next()).sum::<f64>() - 6.0
    };
    let smooth = |t: f64, from: f64, to: f64| {
        let s = ((t - from) / (to - from)).clamp(0.0, 1.0);
        s * s * s * (10.0 + s * (6.0 * s - 15.0))
    };
    let mut text = String::from("t_s,command,demand,position\n");
    for tick in 0..800 * 13 {
        let t = f64::from(tick) * dt;
        let demand = 0.1 + 0.2 * smooth(t % 4.0, 0.2, 1.4) - 0.2 * smooth(t % 4.0, 2.2, 3.4);
        let error: f64 = demand - x;
        integral += 12.0 * dt * error;
        let u: f64 = (8.0 * error + integral).clamp(-1.0, 1.0);
        if t >= 4.0 {
            text += &format!("{t:.3},{},{demand},{}\n", u + 5e-4 * random(), x + 5e-6 * random());
        }
        let opening = if u.abs() > band { u - band.copysign(u) } else { 0.0 };
        for _ in 0..20 {
            let force = -1e-6 * friction_n * (v / 5e-3).tanh();
            v += dt / 20.0 * (1.03 * 0.6 * opening + force - v) / 0.03;
            x += dt / 20.0 * v;
        }
    }
    let log = folder.join("log.csv");
    fs::write(&log, text).unwrap();
    log
}

fn diagnosis(log: &Path, plant: &Path) -> Value {
    let arguments = ["gap", text_of(log), "--plant", text_of(plant), "--json", "-"];
    serde_json::from_str(&stdout(&seepd(arguments))).unwrap()
}

/// No process runs that hosts an FMU for a program that was started here.
fn nothing_is_left() -> bool {
    let own = format!("{}\0fmu-host", env!("CARGO_BIN_EXE_seepd"));
    let orphaned = |process: &fs::DirEntry| {
        let line = fs::read(process.path().join("cmdline")).unwrap_or_default();
        let status = fs::read_to_string(process.path().join("status")).unwrap_or_default();
        String::from_utf8_lossy(&line).contains(&own) && status.contains("PPid:\t1\n")
    };
    !fs::read_dir("/proc").unwrap().filter_map(Result::ok).any(|process| orphaned(&process))
}

#[test]
fn a_dead_band_is_found_with_fmus_of_both_versions() {
    let folder = tempfile::tempdir().unwrap();
    let log = log(folder.path(), 0.04, 0.0);
    let mut bands = Vec::new();
    for version in [2, 3] {
        let plant = plant(folder.path(), &fmu(folder.path(), version), |text| text);
        let found = diagnosis(&log, &plant);
        assert_eq!(found["chosen"], serde_json::json!(["valve_deadband"]), "{found}");
        bands.push(found["effects"][0]["parameters"]["half_width"].as_f64().unwrap());
    }
    assert!((bands[0] / 0.04 - 1.0).abs() < 0.05 && bands[0].to_bits() == bands[1].to_bits(), "{bands:?}");
}

#[test]
fn a_friction_is_found_at_the_load() {
    let folder = tempfile::tempdir().unwrap();
    let plant = plant(folder.path(), &fmu(folder.path(), 2), |text| text);
    let found = diagnosis(&log(folder.path(), 0.0, 3000.0), &plant);
    // Where a force adds to the speed as an opening does, a friction is a dead band: both are told, each with its value.
    let alike = ["coulomb_friction", "stribeck_friction", "valve_deadband"];
    assert!(alike.contains(&found["chosen"][0].as_str().unwrap()), "{found}");
    let effects = found["effects"].as_array().unwrap();
    let friction = effects.iter().find(|effect| effect["effect"] == "coulomb_friction").unwrap();
    assert!(friction["equivalent"].as_array().unwrap().contains(&"valve_deadband".into()), "{friction}");
    let force_n = friction["parameters"]["force_n"].as_f64().unwrap();
    assert!((force_n / 3000.0 - 1.0).abs() < 0.05, "{force_n}");
}

#[test]
fn faulty_models_are_told_in_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let (log, fmu) = (log(folder.path(), 0.04, 0.0), fmu(folder.path(), 2));
    let faults = [
        (1, "the simulator ended (SIGSEGV)"),
        (2, "did not answer within 2.0 s"),
        (4, "DoStep returned Error"),
        (5, "`position` is no number at"),
        (6, "the simulator ended (exit status 3)"),
        (7, "the simulator ended (SIGABRT)"),
        (8, "the simulator ended (SIGABRT)"),
    ];
    for (fault, expected) in faults {
        let plant = plant(folder.path(), &fmu, |text| {
            let text = text.replace("fault = 0", &format!("fault = {fault}"));
            if fault == 2 { text.replace("timeout_s = 20", "timeout_s = 2") } else { text }
        });
        let output = seepd(["gap", text_of(&log), "--plant", text_of(&plant)]);
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(78), "{fault}: {told}");
        assert!(told.contains(expected) && told.lines().count() == 1, "{fault}: {told}");
    }
    // One that prints, and one that cannot be reset, are diagnosed all the same.
    for fault in [3, 9] {
        let plant = plant(folder.path(), &fmu, |text| text.replace("fault = 0", &format!("fault = {fault}")));
        let found = diagnosis(&log, &plant);
        assert_eq!(found["chosen"], serde_json::json!(["valve_deadband"]), "{fault}: {found}");
    }
    assert!(nothing_is_left());
}

/// Whether the kernel keeps processes to rules of their own (system call 444 with the flag that asks for the version).
fn knows_landlock(folder: &Path) -> bool {
    let (source, program) = (folder.join("asks.c"), folder.join("asks"));
    let text = "#include <unistd.h>\n#include <sys/syscall.h>\nint main(void) { return syscall(444, 0, 0, 1) < 4; }\n";
    fs::write(&source, text).unwrap();
    let compiled = Command::new("cc").args(["-o", text_of(&program), text_of(&source)]).status();
    assert!(compiled.unwrap().success());
    Command::new(program).status().unwrap().success()
}

/// A model may write in the folder that it was unpacked to, which goes afterwards, and nowhere else.
#[test]
fn a_model_writes_in_its_own_folder_alone() {
    let folder = tempfile::tempdir().unwrap();
    let plant = plant(folder.path(), &fmu(folder.path(), 2), |text| text.replace("fault = 0", "fault = 10"));
    let log = log(folder.path(), 0.04, 0.0);
    let (outside, temporary) = (folder.path().join("outside"), folder.path().join("temporary"));
    fs::create_dir(&temporary).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_seepd"))
        .args(["gap", text_of(&log), "--plant", text_of(&plant), "--simulations", "20"])
        .env("SEEPD_TEST_OUTSIDE", &outside)
        .env("TMPDIR", &temporary)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(fs::read_dir(&temporary).unwrap().count(), 0);
    if knows_landlock(folder.path()) {
        assert!(!outside.exists());
    } else {
        let _ = writeln!(std::io::stderr(), "skipped: this kernel has no landlock");
    }
}

/// What is inside is shown without running it, and the proposed file is one that `check` takes and that names the variables.
#[test]
fn an_fmu_is_inspected_and_its_plant_file_proposed() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = fmu(folder.path(), 3);
    let output = seepd(["inspect", text_of(&fmu)]);
    let told = stderr(&output);
    assert!(told.contains("FMI 3.0, co-simulation") && told.contains("valve.gain"), "{told}");
    let proposed = stdout(&output);
    for line in [
        "command = \"command_in\"",
        "load = \"load\"",
        "position = \"cylinder.s\"",
        "velocity = \"cylinder.v\"",
    ] {
        assert!(proposed.lines().any(|other| other == line), "{line}\n{proposed}");
    }
    let file = folder.path().join("proposed.toml");
    fs::write(&file, proposed).unwrap();
    assert!(stdout(&seepd(["check", text_of(&file)])).contains("simulator"));
    let output = seepd(["inspect", text_of(&file.with_extension("fmu"))]);
    assert_eq!(output.status.code(), Some(66), "{}", stderr(&output));
}

#[test]
fn files_that_map_no_fmu_are_refused_in_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let (log, fmu) = (log(folder.path(), 0.0, 0.0), fmu(folder.path(), 3));
    fs::write(folder.path().join("junk.fmu"), "no archive").unwrap();
    let mut archive = ZipWriter::new(File::create(folder.path().join("windows.fmu")).unwrap());
    archive.start_file("modelDescription.xml", SimpleFileOptions::default()).unwrap();
    archive.write_all(description(3).as_bytes()).unwrap();
    archive.start_file("binaries/x86_64-windows/cylinder.dll", SimpleFileOptions::default()).unwrap();
    archive.finish().unwrap();
    let changes = [
        ("cylinder3.fmu", "missing.fmu", "No such file"),
        ("cylinder3.fmu", "junk.fmu", "not an FMU"),
        ("cylinder3.fmu", "windows.fmu", "it has: x86_64-windows"),
        ("\"cylinder.s\"", "\"cylinder.ss\"", "did you mean `cylinder.s`?"),
        ("\"command_in\"", "\"valve.gain\"", "fmu.inputs.command"),
        ("\"valve.gain\" =", "\"valve.gian\" =", "did you mean `valve.gain`?"),
        ("\"start\"", "\"strat\"", "fmu.start_position: unknown key `strat`; did you mean `start`?"),
        ("\"start\"", "\"valve.lag\"", "`valve.lag` is in s, and fmu.start_position is asked in m"),
        (
            "\"cylinder.s\"",
            "\"cylinder.v\"",
            "`cylinder.v` is in m/s, and fmu.outputs.position is asked in m",
        ),
        ("command = \"command_in\"", "demand = \"command_in\"", "fmu.inputs has no command"),
        ("position = \"cylinder.s\", ", "", "fmu.outputs has no position"),
        ("[fmu]", "[process]\ncommand = [\"true\"]\nexchange = \"step\"\n[fmu]", "there are two simulators"),
    ];
    for (from, to, expected) in changes {
        let plant = plant(folder.path(), &fmu, |text| {
            assert!(text.contains(from), "{from}");
            text.replacen(from, to, 1)
        });
        for command in
            [vec!["gap", text_of(&log), "--plant", text_of(&plant)], vec!["check", text_of(&plant)]]
        {
            let output = seepd(&command);
            assert_eq!(output.status.code(), Some(78), "{command:?}: {to}: {}", stderr(&output));
            assert!(stderr(&output).contains(expected), "{command:?}: {to}: {}", stderr(&output));
        }
    }
}

/// What the model may do, and the file lets it go beyond, is a remark; a variable of another unit is taken where its scale is said.
#[test]
fn what_a_file_allows_beyond_its_fmu_is_remarked() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = fmu(folder.path(), 3);
    let good = plant(folder.path(), &fmu, |text| text);
    assert!(!stdout(&seepd(["check", text_of(&good)])).contains("remark"));
    let bold = plant(folder.path(), &fmu, |text| {
        text.replace("[parameters]\n", "[parameters]\n\"valve.lag\" = { start = 0.05 }\n")
            .replace("\"cylinder.v\"", "{ variable = \"valve.gain\", scale = 2.0 }")
            .replace("load = \"load\"", "load = { variable = \"command_in\", scale = 5e4 }")
    });
    let told = stdout(&seepd(["check", text_of(&bold)]));
    let remark =
        "remark: parameters: `valve.lag` may become 0.0125 … 0.2, and the model bounds it to 0 … 0.1";
    assert!(told.contains(remark) && told.lines().count() == 2, "{told}");
}
