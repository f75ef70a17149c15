//! `gap` with a simulator of the user's: a program in another language, well behaved and otherwise.

#![expect(clippy::disallowed_methods, reason = "a program that hangs is given up in its time")]

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::support::{fixture, seepd, stderr, stdout};
use seepd_sim::cycle::{DriveSample, Schedule};
use seepd_sim::electric::ElectricAxis;
use serde_json::Value;

/// Whether there is a Python to be a user's simulator; where there is none these tests are left out, and say so.
fn python() -> bool {
    let there = Command::new("python3").arg("--version").output().is_ok_and(|output| output.status.success());
    if !there {
        let _ = writeln!(std::io::stderr(), "skipped: no python3 here");
    }
    there
}

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The documents' simulator with its file, in a folder of its own, the file changed.
fn simulator(folder: &Path, change: impl Fn(String) -> String) -> PathBuf {
    fs::copy(fixture("../../docs/simulator.py"), folder.join("simulator.py")).unwrap();
    let file = folder.join("simulator.toml");
    fs::write(&file, change(fs::read_to_string(fixture("../../docs/simulator.toml")).unwrap())).unwrap();
    file
}

/// Its program by its whole path, by which a process is found.
fn by_whole_path(folder: &Path, text: &str) -> String {
    text.replace("\"simulator.py\"", &format!("\"{}\"", text_of(&folder.join("simulator.py"))))
}

/// A log of the electric axis, which is written apart from the documents' simulator, with a friction.
fn log(folder: &Path, friction_n: f64) -> PathBuf {
    log_with(folder, friction_n, 0.0)
}

/// The same with a force that is always there.
fn log_with(folder: &Path, friction_n: f64, weight_n: f64) -> PathBuf {
    let plant = fs::read_to_string(fixture("../../docs/electric-axis.toml")).unwrap();
    let mut axis = ElectricAxis::from_toml(&plant).unwrap();
    axis.plant.mass_kg *= 1.04;
    axis.effects.entry("coulomb_friction".into()).or_default().insert("force_n".into(), friction_n);
    axis.effects.entry("force_offset".into()).or_default().insert("force_n".into(), weight_n);
    let ticks = (axis.cycle.period_s / axis.controller.period_s).round() as usize;
    let schedule = Schedule::new(&axis.cycle, axis.controller.period_s, Vec::new());
    let drive: Vec<DriveSample> = schedule.take(4 * ticks).collect();
    let mut text = String::from("t_s,command,demand,position\n");
    axis.follow(&drive, |tick, record| {
        let time_s = tick as f64 * 1e-3;
        text += &format!("{time_s:.3},{},{},{}\n", record.command, drive[tick].demand_m, record.position_m);
    });
    let log = folder.join("axis.csv");
    fs::write(&log, text).unwrap();
    log
}

fn diagnosis(log: &Path, plant: &Path, more: &[&str]) -> Value {
    let mut arguments = vec!["gap", text_of(log), "--plant", text_of(plant), "--json", "-"];
    arguments.extend(more);
    serde_json::from_str(&stdout(&seepd(arguments))).unwrap()
}

fn notes(found: &Value) -> String {
    found["notes"].as_array().unwrap().iter().map(|note| format!("{}\n", note.as_str().unwrap())).collect()
}

/// No process runs whose arguments name that folder.
fn nothing_is_left(folder: &Path) -> bool {
    let processes = fs::read_dir("/proc").unwrap().filter_map(Result::ok);
    let mut lines = processes.filter_map(|process| fs::read(process.path().join("cmdline")).ok());
    !lines.any(|line| String::from_utf8_lossy(&line).contains(text_of(folder)))
}

#[test]
fn a_program_of_the_users_is_diagnosed_by_its_own_effects() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let plant = simulator(folder.path(), |text| text);
    let emitted = folder.path().join("as-it-is.toml");
    let log = log(folder.path(), 20.4);
    let found = diagnosis(&log, &plant, &["--emit-plant", text_of(&emitted)]);
    assert_eq!(found["chosen"], serde_json::json!(["guide_friction"]), "{found}");
    let friction = &found["effects"][0];
    assert!((friction["parameters"]["friction_n"].as_f64().unwrap() / 20.4 - 1.0).abs() < 0.02, "{friction}");
    assert!(found["shrink"]["of_removable"].as_f64().unwrap() > 0.9, "{}", found["shrink"]);
    let mass = &found["retuned"]["mass_kg"];
    assert!(mass["nominal"].as_f64().unwrap() > 95.0, "{mass}");
    let told = notes(&found);
    assert!(told.contains("the simulator ran ") && told.contains("not tried, since "), "{told}");
    // The file of the machine as it is can be diagnosed against in its turn: nothing is left.
    let again = diagnosis(&log, &emitted, &[]);
    assert!(["no_gap", "parameters"].contains(&again["verdict"].as_str().unwrap()), "{again}");
    assert!(stdout(&seepd(["check", text_of(&emitted)])).contains("simulator"));
}

/// Searches that begin at either of two effects end with both: one explanation, and nothing for a test to tell.
#[test]
fn two_effects_in_either_order_are_one_explanation() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let plant = simulator(folder.path(), |text| text);
    let found = diagnosis(&log_with(folder.path(), 20.4, 8.0), &plant, &["--next-test"]);
    assert_eq!(found["chosen"].as_array().map(Vec::len), Some(2), "{found}");
    let sorted = |name: &Value| {
        let mut effects: Vec<&str> = name.as_str().unwrap().split(" + ").collect();
        effects.sort_unstable();
        effects.join(" + ")
    };
    match found["next_test"]["explanations"].as_array() {
        Some(explanations) => {
            let names: std::collections::BTreeSet<String> =
                explanations.iter().map(|explanation| sorted(&explanation[0])).collect();
            assert_eq!(names.len(), explanations.len(), "{explanations:?}");
        }
        None => assert!(notes(&found).contains("no test is proposed"), "{found}"),
    }
}

#[test]
fn what_may_be_simulated_is_kept_to() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let plant = simulator(folder.path(), |text| text);
    let found = diagnosis(&log(folder.path(), 20.4), &plant, &["--simulations", "60"]);
    let told = notes(&found);
    assert!(told.contains("was used up before the search had ended"), "{told}");
    let runs =
        told.lines().find_map(|line| line.strip_prefix("the simulator ran ")?.split(' ').next()).unwrap();
    // What had begun is ended, and the held-out cycles are simulated: a third of an unbounded search of some 600.
    assert!(runs.parse::<usize>().unwrap() < 200, "{told}");
}

/// A run that fails is a run that failed.
#[test]
fn a_simulator_that_crashes_now_and_then_costs_these_runs() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let plant = simulator(folder.path(), |text| by_whole_path(folder.path(), &text));
    let script = folder.path().join("simulator.py");
    let text = fs::read_to_string(&script).unwrap();
    let crash = "    if friction > 50.0:\n        import os\n        os._exit(7)\n    h = period_s / STEPS\n";
    fs::write(&script, text.replace("    h = period_s / STEPS\n", crash)).unwrap();
    let found = diagnosis(&log(folder.path(), 20.4), &plant, &[]);
    let told = notes(&found);
    assert!(told.contains("runs failed") && told.contains("exit status 7"), "{told}");
    assert_eq!(found["chosen"], serde_json::json!(["guide_friction"]), "{found}");
    assert!(nothing_is_left(folder.path()));
}

#[test]
fn simulators_that_do_not_answer_are_told_in_a_line() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = log(folder.path(), 0.0);
    let script = folder.path().join("simulator.py");
    let answers = [
        ("import sys; sys.exit('no licence')", "the simulator ended (exit status 1); it said: no licence"),
        ("for line in sys.stdin: print('ready', flush=True)", "the simulator's answer is not JSON"),
        ("for line in sys.stdin: print('{\"position\": [0.0]}', flush=True)", "has no `command`"),
        (
            "for line in sys.stdin: print('{\"position\": [0.0], \"command\": [0.0]}', flush=True)",
            "the simulator's `command` has 1 values; the run has 6240",
        ),
        (
            "for line in sys.stdin: print('{\"error\": \"no solver\"}', flush=True)",
            "the simulator says: no solver",
        ),
        (
            "for line in sys.stdin:\n n = len(json.loads(line)['demand'])\n \
             print(json.dumps({'command': [None] * n, 'position': [0.0] * n}), flush=True)",
            "the simulator's `command` is no number at 0.000 s",
        ),
        ("import time\nfor line in sys.stdin: time.sleep(3600)", "did not answer within 0.5 s"),
        ("import os; os.kill(os.getpid(), 11)", "the simulator ended (SIGSEGV)"),
        ("os = __import__('os'); os.close(1); sys.stdin.read()", "it closed its output"),
    ];
    for (answer, expected) in answers {
        let plant = simulator(folder.path(), |text| {
            // Whoever sleeps is given up soon; the others have time to start beside other tests.
            let time = if answer.contains("sleep") { "timeout_s = 0.5" } else { "timeout_s = 20" };
            by_whole_path(folder.path(), &text).replace("timeout_s = 60", time)
        });
        fs::write(&script, format!("import json, sys\n{answer}\n")).unwrap();
        let begin = Instant::now();
        let output = seepd(["gap", text_of(&log), "--plant", text_of(&plant)]);
        assert_eq!(output.status.code(), Some(78), "{answer}: {}", stderr(&output));
        let told = stderr(&output);
        assert!(told.contains(expected) && told.lines().count() == 1, "{answer}: {told}");
        assert!(begin.elapsed() < Duration::from_secs(30), "{answer}");
    }
    assert!(nothing_is_left(folder.path()));
}

#[test]
fn files_that_describe_no_simulator_are_refused_in_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let log = log(folder.path(), 0.0);
    let changes: [(&str, &str, &str); 9] = [
        ("command = [\"python3\", \"simulator.py\"]", "command = []", "process.command is empty"),
        ("\"simulator.py\"]", "\"simulator.py\"]\nexchnge = \"run\"", "did you mean `exchange`?"),
        ("\"python3\"", "\"no-such-program\"", "`no-such-program` cannot be started"),
        ("\"position\"]", "\"positon\"]", "did you mean `position`?"),
        ("period_s = 0.001 ", "#", "period_s = 0.001, for instance"),
        ("{ start = 95.1089 }", "{ start = -1.0 }", "a parameter that is not positive needs bounds"),
        ("{ start = 95.1089 }", "{ start = 95.0, bounds = [1.0, 2.0] }", "it must lie within its bounds"),
        ("parameter = \"friction_n\"", "parameter = \"mass_kg\"", "leave it out of [parameters]"),
        ("timeout_s = 60", "timeout_s = -1", "it must be positive"),
    ];
    for (from, to, expected) in changes {
        let plant = simulator(folder.path(), |text| {
            assert!(text.contains(from), "{from}");
            text.replacen(from, to, 1)
        });
        let output = seepd(["gap", text_of(&log), "--plant", text_of(&plant)]);
        assert_eq!(output.status.code(), Some(78), "{to}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{to}: {}", stderr(&output));
    }
    let press = fixture("../../docs/plant.toml");
    let output = seepd(["gap", text_of(&log), "--plant", text_of(&press), "--simulator", "python3 sim.py"]);
    assert_eq!(output.status.code(), Some(64), "{}", stderr(&output));
}

/// A cylinder whose speed follows the valve's opening by a lag, written apart as a machine with a log (its own PID loop and a dead band of
/// its valve) and as a simulator of the plant alone, whose loop is closed by ours.
const STEPPED: &str = r#"
import json, sys

DT, GAIN, LAG = 0.005, 0.6, 0.03

class Plant:
    def __init__(self, x, gain):
        self.x, self.v, self.gain = x, 0.0, gain
    def step(self, opening, dt):
        for _ in range(4):
            self.v += dt / 4 * (self.gain * opening - self.v) / LAG
            self.x += dt / 4 * self.v

def demand(t):
    t = t % 4.0
    ramp = lambda t, a, b: min(max((t - a) / (b - a), 0.0), 1.0)
    smooth = lambda s: s * s * s * (10.0 + s * (6.0 * s - 15.0))
    return 0.1 + 0.2 * smooth(ramp(t, 0.2, 1.4)) - 0.2 * smooth(ramp(t, 2.2, 3.4))

def log(band):
    import random
    random.seed(5)
    plant, integral = Plant(0.1, 1.03 * GAIN), 0.0
    print("t_s,command,demand,position")
    for tick in range(800 * 13):
        t = tick * DT
        error = demand(t) - plant.x
        integral += 12.0 * DT * error
        u = max(-1.0, min(1.0, 8.0 * error + integral))
        if t >= 4.0:
            noise = random.gauss(0.0, 0.0005)
            print(f"{t:.3f},{u + noise:.7f},{demand(t):.7f},{plant.x + random.gauss(0.0, 5e-6):.7f}")
        plant.step((u - band if u > band else u + band if u < -band else 0.0), DT)

def serve():
    plant = None
    for line in sys.stdin:
        message = json.loads(line)
        if "start" in message:
            plant = Plant(message["start"]["demand"], message["start"]["parameters"]["gain"])
        else:
            plant.step(message["step"]["reference"], message["step"]["dt_s"])
        print(json.dumps({"position": plant.x, "velocity": plant.v}), flush=True)

log(float(sys.argv[1])) if len(sys.argv) > 1 else serve()
"#;

const STEPPED_FILE: &str = r#"
kind = "simulator"
stroke_m = 0.5
[process]
command = ["python3", "plant.py"]
exchange = "step"
outputs = ["position"]
load = false
[parameters]
gain = { start = 0.6 }
[controller]
kp = 8.0
ki = 12.0
period_s = 0.005
[cycle]
period_s = 4.0
load = []
moves = [
    { name = "out", from_s = 0.2, to_s = 1.4, to_m = 0.3 },
    { name = "back", from_s = 2.2, to_s = 3.4, to_m = 0.1 },
]
"#;

#[test]
fn a_plant_alone_has_its_loop_closed_and_shows_its_dead_band() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (script, file, log) =
        (folder.path().join("plant.py"), folder.path().join("plant.toml"), folder.path().join("log.csv"));
    fs::write(&script, STEPPED).unwrap();
    fs::write(&file, STEPPED_FILE).unwrap();
    let recorded = Command::new("python3").args([text_of(&script), "0.04"]).output().unwrap();
    fs::write(&log, recorded.stdout).unwrap();
    let found = diagnosis(&log, &file, &["--simulations", "500"]);
    assert_eq!(found["chosen"], serde_json::json!(["valve_deadband"]), "{found}");
    let band = found["effects"][0]["parameters"]["half_width"].as_f64().unwrap();
    assert!((band / 0.04 - 1.0).abs() < 0.05, "{band}");
    assert!(notes(&found).contains("coulomb_friction"), "{}", notes(&found));
}
