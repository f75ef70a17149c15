//! What the whole-program tests share: running the program and reading its JSON lines.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A press of another bore with a cycle of 7.02 s: nothing that the embedded model knows.
pub(crate) const OTHER_PRESS: &str = "
[plant]
cap_area_m2 = 0.00503
annulus_area_m2 = 0.00345
[cycle]
period_s = 7.02
[[cycle.moves]]
name = \"extend\"
from_s = 0.4
to_s = 1.9
to_m = 0.3
[[cycle.moves]]
name = \"retract\"
from_s = 4.0
to_s = 5.6
to_m = 0.1
";

/// A fixture's path.
pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures").join(name)
}

/// An empty folder that the tests of one file share. It belongs to a static, which is never dropped: a temporary folder would stay behind
/// after each run, while this one is emptied by the next.
pub(crate) fn shared_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).expect("a folder of an earlier run");
    }
    std::fs::create_dir_all(&folder).expect("a folder for tests");
    folder
}

/// Runs the program.
pub(crate) fn seepd<A: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = A>) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seepd"))
        .args(arguments)
        .env_remove("NO_COLOR")
        .output()
        .expect("seepd starts")
}

/// Standard output of a run that must succeed.
pub(crate) fn stdout(output: &Output) -> String {
    assert!(output.status.success(), "{}", stderr(output));
    String::from_utf8(output.stdout.clone()).expect("UTF-8")
}

/// Standard error.
pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Names of the program's commands, as its help lists them.
pub(crate) fn commands() -> Vec<String> {
    let help = stdout(&seepd(["--help"]));
    let list = help.split("Commands:\n").nth(1).and_then(|rest| rest.split("\n\n").next()).expect("commands");
    let names = list.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    names
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect()
}

/// Simulates a log, in the place of one that is there.
pub(crate) fn simulate(out: &Path, more: &[&str]) {
    let mut arguments = vec!["simulate", "--force", "--out", out.to_str().expect("UTF-8")];
    arguments.extend(more);
    stdout(&seepd(arguments));
}

/// The JSON lines of a replay.
pub(crate) fn replay(log: &Path, more: &[&str]) -> Vec<Value> {
    let mut arguments = vec!["replay", "--json", log.to_str().expect("UTF-8")];
    arguments.extend(more);
    stdout(&seepd(arguments)).lines().map(|line| serde_json::from_str(line).expect("a JSON line")).collect()
}

/// The estimates of a replay's cycles.
pub(crate) fn estimates(lines: &[Value]) -> Vec<f64> {
    lines.iter().filter_map(|line| line["cycle"].as_u64().and(line["leak_area_m2"].as_f64())).collect()
}

/// The reasons of a replay's rejected cycles.
pub(crate) fn reasons(lines: &[Value]) -> Vec<String> {
    lines
        .iter()
        .filter(|line| line["schema"] == "seepd.cycle/1")
        .filter_map(|line| line["reason"].as_str().map(str::to_owned))
        .collect()
}

/// The summary of a replay.
pub(crate) fn summary(lines: &[Value]) -> &Value {
    let last = lines.last().expect("a summary");
    assert_eq!(last["schema"], "seepd.summary/1");
    last
}

/// An MCAP of a command a millisecond.
pub(crate) fn mcap_of(options: mcap::WriteOptions, commands: impl IntoIterator<Item = f64>) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut writer = options.create(&mut bytes).unwrap();
    let schema = writer.add_schema("seepd.Signals", "jsonschema", b"{}").unwrap();
    let channel_id = writer.add_channel(schema, "/axis/signals", "json", &Default::default()).unwrap();
    for (sequence, command) in (0..).zip(commands) {
        let time = u64::from(sequence) * 1_000_000;
        let header =
            mcap::records::MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, format!("{{\"command\":{command}}}").as_bytes()).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

/// Python with these packages, if they are here. They are looked for, not loaded: some take seconds.
pub(crate) fn python(packages: &str) -> Option<Command> {
    const LOOK: &str = "import importlib.util as u, sys; sys.exit(any(not u.find_spec(p.strip()) for p in sys.argv[1].split(',')))";
    let check = Command::new("python3").args(["-c", LOOK, packages]).output();
    let here = check.is_ok_and(|output| output.status.success());
    if !here {
        let _ = writeln!(std::io::stderr(), "skipped: no Python with the package {packages}");
    }
    here.then(|| Command::new("python3"))
}
