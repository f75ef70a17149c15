//! The commands as a user runs them.

use std::fs;

use crate::support::{estimates, fixture, reasons, replay, seepd, simulate, stderr, stdout, summary};

fn close(value: f64, expected: f64, share: f64) {
    assert!((value / expected - 1.0).abs() <= share, "{value} {expected}");
}

#[test]
fn demo_leaves_a_log_and_a_self_contained_page_and_tells_when_flags_rose() {
    let folder = tempfile::tempdir().unwrap();
    let text = stdout(&seepd(["demo", "--cycles", "60", "--folder", folder.path().to_str().unwrap()]));
    for flag in ["watch rose in cycle", "leak rose in cycle", "severe rose in cycle"] {
        assert!(text.contains(flag), "{text}");
    }
    let error: f64 = text.split("threshold: ").last().unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(error < 4.0, "{text}");
    let page = fs::read_to_string(folder.path().join("demo.html")).unwrap();
    // Each chart once for desk and paper, once for a phone.
    assert_eq!(
        ["wide", "narrow"].map(|kind| page.matches(&format!("<svg class=\"{kind}\"")).count()),
        [3, 3]
    );
    assert!(page.contains("prefers-color-scheme:dark") && page.contains("@media print"));
    for outside in ["http:", "https:", "src=", "@import", "url("] {
        assert!(!page.contains(outside), "{outside}");
    }
    // The log is one as any other.
    let lines = replay(&folder.path().join("press.mcap"), &[]);
    assert_eq!(summary(&lines)["cycles"], 60);
    assert_eq!(summary(&lines)["highest_flag"], "severe");
}

#[test]
fn replay_estimates_what_simulate_planted() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    // Twice the median error that training reports for each decade, and room for a single machine.
    for (area, share) in [("8e-8", 0.15), ("5e-7", 0.05), ("3e-6", 0.04)] {
        simulate(&log, &["--cycles", "5", "--leak-area", area, "--seed", "3"]);
        let found = estimates(&replay(&log, &[]));
        assert_eq!(found.len(), 5);
        found.iter().for_each(|found| close(*found, area.parse().unwrap(), share));
    }
    simulate(&log, &["--cycles", "5"]);
    assert!(estimates(&replay(&log, &[])).iter().all(|area| *area < 3e-8));
}

/// A plant whose controller is faster than its log is simulated at the log's rate.
#[test]
fn simulate_writes_what_the_plants_log_would_have() {
    let folder = tempfile::tempdir().unwrap();
    let (log, plant) = (folder.path().join("log.mcap"), folder.path().join("plant.toml"));
    std::fs::write(&plant, "[controller]\nlog_every = 4\n").unwrap();
    simulate(&log, &["--cycles", "2", "--plant", plant.to_str().unwrap()]);
    let told = stderr(&seepd(["replay", log.to_str().unwrap()]));
    assert!(told.contains("comes at 250.0 Hz"), "{told}");
}

#[test]
fn replay_lines_follow_the_contract() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "4", "--leak-area", "1e-6", "--start-at", "3"]);
    let lines = replay(&log, &[]);
    assert_eq!(lines.len(), 5);
    let rejected = &lines[0];
    assert_eq!(
        (rejected["flag"].as_str(), rejected["reason"].as_str()),
        (Some("no_estimate"), Some("incomplete"))
    );
    assert!(rejected["leak_area_m2"].is_null() && rejected.get("features").is_none());
    for (index, line) in lines[1..4].iter().enumerate() {
        assert_eq!(line["schema"], "seepd.cycle/1");
        assert_eq!(line["axis"], "axis");
        assert_eq!(line["cycle"], index as u64 + 1);
        // Cycles begin at 7, 17, 27 s of this log; the demand tells to a sample.
        assert!((line["t_start_s"].as_f64().unwrap() - (7.0 + 10.0 * index as f64)).abs() < 2e-3);
        assert!((line["t_end_s"].as_f64().unwrap() - (17.0 + 10.0 * index as f64)).abs() < 0.05);
        let area = line["leak_area_m2"].as_f64().unwrap();
        let interval = line["interval90_m2"].as_array().unwrap();
        assert!(interval[0].as_f64().unwrap() <= area && area <= interval[1].as_f64().unwrap());
        // 0.7 A √(2 · 7 MPa / 870 kg/m³).
        let flow = 0.7 * area * (2.0f64 * 7e6 / 870.0).sqrt() * 60e3;
        close(line["leak_flow_lpm"].as_f64().unwrap(), flow, 1e-12);
        assert_eq!(line["reference_dp_pa"], 7e6);
        assert!(line["features"]["mean"].as_f64().unwrap() < -0.01);
        assert!(line["reason"].is_null());
    }
    let summary = summary(&lines);
    assert_eq!(summary["samples"], 37_000);
    assert_eq!(summary["cycles"], 3);
    assert_eq!(summary["rejected"]["incomplete"], 1);
    assert_eq!(summary["flag"], "severe");
    let at_14 = replay(&log, &["--reference-mpa", "14"]);
    let ratio = at_14[1]["leak_flow_lpm"].as_f64().unwrap() / lines[1]["leak_flow_lpm"].as_f64().unwrap();
    close(ratio, 2f64.sqrt(), 1e-12);
}

#[test]
fn every_compression_and_signal_set_gives_the_same_estimates() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    let mut all = Vec::new();
    for compression in ["zstd", "lz4", "none"] {
        simulate(&log, &["--cycles", "3", "--leak-area", "3e-7", "--compression", compression]);
        all.push(estimates(&replay(&log, &[])));
    }
    simulate(&log, &["--cycles", "3", "--leak-area", "3e-7", "--no-truth"]);
    all.push(estimates(&replay(&log, &[])));
    assert!(all.iter().all(|found| *found == all[0] && found.len() == 3), "{all:?}");
    // Without the demand the start of a cycle is read off the strokes.
    simulate(&log, &["--cycles", "3", "--leak-area", "3e-7", "--command-only"]);
    estimates(&replay(&log, &[])).iter().for_each(|found| close(*found, 3e-7, 0.05));
}

#[test]
fn same_seed_same_log_to_the_byte() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b, c] = ["a", "b", "c"].map(|name| folder.path().join(name));
    let with_seed = |seed: &'static str| {
        ["--cycles", "2", "--load-variation", "0.05", "--noise", "0.003", "--seed", seed]
    };
    simulate(&a, &with_seed("5"));
    simulate(&b, &with_seed("5"));
    simulate(&c, &with_seed("6"));
    assert_eq!(fs::read(&a).unwrap(), fs::read(&b).unwrap());
    assert_ne!(fs::read(&a).unwrap(), fs::read(&c).unwrap());
}

/// Logs by other hands of the machine that has a leak of 1e-6 m²: one written in Python, one as CSV without noise.
#[test]
fn reference_logs_of_others_give_their_leak() {
    let python = estimates(&replay(&fixture("python_written_leak_1e-6.mcap"), &[]));
    assert_eq!(python.len(), 2, "26.5 s from the middle of a cycle hold two whole ones");
    python.iter().for_each(|found| close(*found, 1e-6, 0.03));
    for (file, area) in [("nominal_leak_1e-6.csv", 1e-6), ("nominal_leak_1e-5.csv", 1e-5)] {
        let found = estimates(&replay(&fixture(file), &[]));
        assert_eq!(found.len(), 1);
        close(found[0], area, 0.03);
    }
    assert!(estimates(&replay(&fixture("nominal_leak_0.csv"), &[]))[0] < 3e-8);
}

#[test]
fn flags_rise_with_a_step_and_every_change_is_an_event() {
    let folder = tempfile::tempdir().unwrap();
    let [log, events, table] = ["log.mcap", "events.mcap", "cycles.csv"].map(|name| folder.path().join(name));
    simulate(&log, &["--cycles", "12", "--leak-step", "2e-7@5", "--command-only"]);
    let arguments = [
        "replay",
        "--json",
        "--fail-on-fault",
        "--mcap",
        events.to_str().unwrap(),
        "--csv",
        table.to_str().unwrap(),
        log.to_str().unwrap(),
    ];
    let output = seepd(arguments);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let flags: Vec<String> = String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap())
        .filter(|line| line["schema"] == "seepd.cycle/1")
        .map(|line| line["flag"].as_str().unwrap().to_owned())
        .collect();
    // The step is seen in cycle 5, and three cycles must agree.
    assert_eq!(flags[..7], ["healthy"; 7]);
    assert_eq!(flags[7..], ["leak"; 5]);
    let rows = fs::read_to_string(&table).unwrap();
    assert_eq!(rows.lines().count(), 13);
    assert!(rows.lines().next().unwrap().starts_with("axis,cycle,t_start_s,"));

    let bytes = fs::read(&events).unwrap();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let on = |topic: &str| -> Vec<serde_json::Value> {
        messages
            .iter()
            .filter(|m| m.channel.topic == topic)
            .map(|m| serde_json::from_slice(&m.data).unwrap())
            .collect()
    };
    assert_eq!(on("/axis/leakage").len(), 12);
    let changes = on("/axis/flags");
    assert_eq!(changes.len(), 2);
    assert_eq!(
        (&changes[0]["flag_from"], &changes[0]["flag_to"]),
        (&"no_estimate".into(), &"healthy".into())
    );
    let raise = &changes[1];
    assert_eq!(
        (&raise["flag_from"], &raise["flag_to"], &raise["cycle"]),
        (&"healthy".into(), &"leak".into(), &7.into())
    );
    assert_eq!(raise["evidence"]["cycles"], 3);
    assert_eq!(raise["evidence"]["threshold_lpm"], 0.6);
    assert!(raise["evidence"]["lowest_lpm"].as_f64().unwrap() >= 0.6);
}

#[test]
fn log_carries_its_provenance_and_truth_apart() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "1", "--seed", "42", "--with", "valve_deadband.half_width=0.02"]);
    let bytes = fs::read(&log).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let topics: Vec<&str> = {
        let mut topics: Vec<&str> = summary.channels.values().map(|channel| channel.topic.as_str()).collect();
        topics.sort_unstable();
        topics
    };
    assert_eq!(topics, ["/axis/signals", "/axis/truth"]);
    let metadata = mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap().metadata;
    assert_eq!(metadata["seed"], "42");
    assert_eq!(metadata["effects"], "valve_deadband.half_width=0.02");
    let attachment = mcap::read::attachment(&bytes, &summary.attachment_indexes[0]).unwrap();
    let plant = seepd_sim::MachineSpec::from_toml(std::str::from_utf8(&attachment.data).unwrap()).unwrap();
    assert_eq!(plant.effects["valve_deadband"]["half_width"], 0.02);
    let first = mcap::MessageStream::new(&bytes).unwrap().next().unwrap().unwrap();
    let message: serde_json::Value = serde_json::from_slice(&first.data).unwrap();
    let mut keys: Vec<&str> = message.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    assert_eq!(keys, ["command", "demand", "load", "p_cap", "p_inlet", "p_rod", "p_supply", "position"]);
}

#[test]
fn mapping_reads_other_topics_fields_and_units() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let turns = ["--cycles", "3", "--leak-area", "1e-6", "--topic-prefix", "/press/2"];
    simulate(&path("log.mcap"), &turns);
    let plain = estimates(&replay(&path("log.mcap"), &[]));
    let config =
        "axis = \"press-2\"\nmodel = \"model.json\"\n[signals.command]\ntopic = \"/press/2/signals\"\n";
    fs::write(path("seepd.toml"), config).unwrap();
    fs::write(path("model.json"), seepd::EMBEDDED_MODEL).unwrap();
    let lines = replay(&path("log.mcap"), &["--config", path("seepd.toml").to_str().unwrap()]);
    assert_eq!(lines[0]["axis"], "press-2");
    estimates(&lines).iter().zip(&plain).for_each(|(a, b)| close(*a, *b, 0.01));

    // A CSV in percent with other column names, from standard input too.
    let rows = fs::read_to_string(fixture("nominal_leak_1e-6.csv")).unwrap();
    let percent: String = rows
        .lines()
        .enumerate()
        .map(|(number, row)| {
            let fields: Vec<&str> = row.split(',').collect();
            match number {
                0 => "seconds,valve %\n".to_owned(),
                _ => format!("{},{}\n", fields[0], fields[1].parse::<f64>().unwrap() * 100.0),
            }
        })
        .collect();
    fs::write(path("log.csv"), percent).unwrap();
    fs::write(
        path("csv.toml"),
        "time_column = \"seconds\"\n[signals.command]\nfield = \"valve %\"\nscale = 0.01\n",
    )
    .unwrap();
    let found = estimates(&replay(&path("log.csv"), &["--config", path("csv.toml").to_str().unwrap()]));
    close(found[0], 1e-6, 0.03);
}

/// Another press: other areas, mass, stroke, period, strokes and rate. Its cycle is nearly symmetric in time, so that half a
/// period off the strokes look alike.
#[test]
fn another_machine_is_trained_and_read_from_its_plant_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let plant = fixture("other_press.toml").to_str().unwrap().to_owned();
    let small = [
        "--observations",
        "500",
        "--held-out",
        "100",
        "--trials",
        "6",
        "--compared",
        "60",
        "--calibration",
        "60",
        "--causes",
        "0",
    ];
    let trained = seepd(["train", "--plant", &plant, "--out", &path("model.json")].into_iter().chain(small));
    stdout(&trained);
    // Where there is no terminal, lines say how far it is.
    let told = stderr(&trained);
    for stage in ["simulating: ", "searching: ", "comparing: ", "measuring: "] {
        let lines: Vec<&str> =
            told.lines().filter(|line| line.starts_with(&format!("seepd: {stage}"))).collect();
        assert!((1..=21).contains(&lines.len()), "{stage}{told}");
    }
    let log = folder.path().join("log.mcap");
    for (area, command_only) in [("4e-7", false), ("4e-7", true), ("5e-6", true)] {
        let mut more = vec!["--plant", &plant, "--cycles", "8", "--start-at", "2.5", "--leak-area", area];
        more.extend(command_only.then_some("--command-only"));
        simulate(&log, &more);
        let lines = replay(&log, &["--model", &path("model.json")]);
        let found = estimates(&lines);
        assert_eq!((found.len(), reasons(&lines).len()), (7, 1), "{area}: {lines:?}");
        // A model of 500 machines; the interval of this plant at 4e-7 m² is about 10 %.
        found.iter().for_each(|found| close(*found, area.parse().unwrap(), 0.25));
        assert!((lines[1]["t_start_s"].as_f64().unwrap() - 3.5).abs() < 0.1);
    }
}

#[test]
fn logs_in_a_row_are_one_record() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "3", "--command-only"]);
    // The same log again is the same cycles again: rejected, not counted twice.
    let lines = replay(&log, &[log.to_str().unwrap()]);
    assert_eq!(summary(&lines)["cycles"], 3);
    assert_eq!(reasons(&lines), ["duplicate"; 3]);
}

#[test]
fn help_tells_examples_and_exit_codes() {
    let top = stdout(&seepd(["--help"]));
    assert!(top.contains("Exit codes: 0 good, 1 a finding"));
    let commands = crate::support::commands();
    assert!(commands.len() >= 9, "{commands:?}");
    for command in commands {
        let text = stdout(&seepd([&command, "--help"]));
        assert!(text.contains("Example"), "{command}");
    }
    // The list has a line for each; a command's own help explains it.
    let replay = stdout(&seepd(["help", "replay"]));
    for told in [
        "show the leak by cycle, flags and a summary",
        "read one after the other as the record of one machine",
    ] {
        assert_eq!((replay.contains(told), top.contains(told)), (true, told.starts_with("show")), "{told}");
    }
    assert!(stdout(&seepd(["--version"])).starts_with("seepd 0."));
}

#[test]
fn inspect_proposes_a_mapping_that_replay_reads() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    simulate(&path("log.mcap"), &["--cycles", "2", "--leak-area", "1e-6", "--topic-prefix", "/press/7"]);
    let plain = estimates(&replay(&path("log.mcap"), &[]));
    let output = seepd(["inspect", path("log.mcap").to_str().unwrap()]);
    assert!(
        stderr(&output)
            .contains("/press/7/signals (json, seepd.Signals): 20000 messages at 1000.0 Hz over 20.0 s")
    );
    fs::write(path("seepd.toml"), stdout(&output)).unwrap();
    let read = replay(&path("log.mcap"), &["--config", path("seepd.toml").to_str().unwrap()]);
    assert_eq!(estimates(&read), plain);
}

#[test]
fn inspect_tells_units_by_their_size_gaps_and_never_guesses_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.csv");
    let mut text = String::from("t_s,valve_percent,cylinder.pos_mm,p_cap_bar,target_mm,leak_flow\n");
    for row in (0..3000).filter(|row| !(1000..1500).contains(row)) {
        let phase = (f64::from(row) * 0.01).sin();
        text += &format!(
            "{},{},{},{},{},{}\n",
            f64::from(row) * 1e-3,
            40.0 * phase,
            200.0 + 150.0 * phase,
            90.0 + 20.0 * phase,
            200.0 + 151.0 * phase,
            phase
        );
    }
    fs::write(&log, text).unwrap();
    let found: serde_json::Value =
        serde_json::from_str(&stdout(&seepd(["inspect", "--json", log.to_str().unwrap()]))).unwrap();
    let topic = &found["topics"][0];
    assert_eq!((topic["messages"].as_u64(), topic["gaps"].as_u64()), (Some(2500), Some(1)));
    assert!((topic["longest_gap_s"].as_f64().unwrap() - 0.501).abs() < 1e-6);
    for (signal, field, scale) in [
        ("command", "valve_percent", 0.01),
        ("position", "cylinder.pos_mm", 1e-3),
        ("demand", "target_mm", 1e-3),
        ("p_cap", "p_cap_bar", 1e5),
    ] {
        assert_eq!(
            (&found["mapping"][signal]["field"], &found["mapping"][signal]["scale"]),
            (&field.into(), &scale.into())
        );
    }
    assert_eq!(found["mapping"].as_object().unwrap().len(), 4);
}

#[test]
fn inspect_lists_logs_that_replay_does_not_read() {
    let text =
        stderr(&seepd(["inspect", fixture("mcap/generated/axis_zstd_truncated.mcap").to_str().unwrap()]));
    assert!(text.contains("/axis/sample (json, axis.Sample): 1205 messages at 1000.0 Hz"), "{text}");
    assert!(text.contains("ends at byte 42868"), "{text}");
}

#[test]
fn check_tells_good_files_from_wrong_ones() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let model = file("model.json", seepd::EMBEDDED_MODEL);
    let plant = file("plant.toml", b"[plant]\nmass_kg = 300.0\n[effects.command_delay]\ndelay_s = 0.004\n");
    let config = file("seepd.toml", b"model = \"model.json\"\n[signals.command]\ntopic = \"/a\"\n");
    let trees = seepd_model::Model::from_json(seepd::EMBEDDED_MODEL).unwrap().ensemble().trees();
    let text = stdout(&seepd(["check", &model, &plant, &config]));
    assert!(
        text.contains(&format!("good model: {trees} trees"))
            && text.contains("effects: command_delay")
            && text.contains("1 mapped signals"),
        "{text}"
    );
    let wrong = file("wrong.toml", b"[controller]\nkp = 12.0\nperid_s = 0.001\n");
    let lost = file("lost.toml", b"model = \"nowhere.json\"\n");
    let output = seepd(["check", "--json", &wrong, &plant, &lost]);
    assert_eq!(output.status.code(), Some(78));
    assert!(
        stderr(&output).contains("wrong.toml: line 3: unknown key `perid_s`; did you mean `period_s`?"),
        "{}",
        stderr(&output)
    );
    assert!(stderr(&output).contains("nowhere.json"));
    let good: Vec<bool> = String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["good"].as_bool().unwrap())
        .collect();
    assert_eq!(good, [false, true, false]);
}

#[test]
fn completions_and_manual_pages_know_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = stdout(&seepd(["completions", shell]));
        assert!(script.contains("replay") && script.contains("reference-mpa"), "{shell}");
    }
    stdout(&seepd(["man", "--folder", folder.path().to_str().unwrap()]));
    for command in ["demo", "simulate", "train", "replay", "inspect", "check"] {
        let page = fs::read_to_string(folder.path().join(format!("seepd-{command}.1"))).unwrap();
        assert!(page.contains(".TH") && page.contains("Example"), "{command}");
    }
    assert!(stdout(&seepd(["man"])).contains("seepd"));
}

#[test]
fn no_colour_reaches_a_file() {
    let text = stdout(&seepd(["replay", fixture("python_written_leak_1e-6.mcap").to_str().unwrap()]));
    assert!(!text.contains('\u{1b}'));
    assert!(text.contains("L/min at 70 bar") && text.contains("mm²") && !text.contains(" m²"));
}

/// A daemon's file with several axes: offline commands read the one that is named, and none that is not.
#[test]
fn several_axes_are_chosen_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (log, config) = (path("log.mcap"), path("seepd.toml"));
    simulate(
        &folder.path().join("log.mcap"),
        &["--cycles", "24", "--leak-area", "1e-6", "--topic-prefix", "/press/2"],
    );
    let axes = "state_dir = \"state\"\n\
        [[axes]]\naxis = \"press-1\"\n[axes.signals.command]\ntopic = \"/press/1/signals\"\n\
        [[axes]]\naxis = \"press-2\"\nreference_dp_pa = 1e7\n[axes.signals.command]\ntopic = \"/press/2/signals\"\n\
        [axes.signals.position]\ntopic = \"/press/2/signals\"\n";
    fs::write(&config, axes).unwrap();
    let lines = replay(&folder.path().join("log.mcap"), &["--config", &config, "--axis", "press-2"]);
    assert_eq!((&lines[0]["axis"], &lines[0]["reference_dp_pa"]), (&"press-2".into(), &1e7.into()));
    assert_eq!(estimates(&lines).len(), 24);
    let baseline = path("baseline.json");
    for command in [vec!["replay"], vec!["evaluate"], vec!["gap"], vec!["learn-baseline", "--out", &baseline]]
    {
        for (axis, told) in [
            (&[][..], "choose one with --axis: press-1, press-2"),
            (&["--axis", "press-3"], "has no axis `press-3`; it has press-1, press-2"),
        ] {
            let output = seepd(command.iter().chain(&["--config", &config, &log]).chain(axis));
            assert_eq!((output.status.code(), output.stdout.len()), (Some(64), 0), "{command:?}");
            assert!(stderr(&output).contains(told), "{command:?}: {}", stderr(&output));
        }
    }
    stdout(&seepd(["learn-baseline", "--out", &baseline, "--config", &config, "--axis", "press-2", &log]));
    let learned: serde_json::Value = serde_json::from_slice(&fs::read(&baseline).unwrap()).unwrap();
    assert_eq!(learned["axis"], "press-2");
    // One axis's baseline is not another's, unless it was learned without a name.
    let other = seepd(["replay", "--config", &config, "--axis", "press-1", "--baseline", &baseline, &log]);
    assert_eq!(other.status.code(), Some(78));
    assert!(stderr(&other).contains("is the baseline of axis press-2, not of press-1"), "{}", stderr(&other));
    let unnamed = fs::read_to_string(&baseline).unwrap().replace("\"press-2\"", "\"axis\"");
    fs::write(&baseline, unnamed).unwrap();
    let more = ["--config", &config, "--axis", "press-2", "--baseline", &baseline];
    assert!(replay(&folder.path().join("log.mcap"), &more)[0]["response_m2"].is_f64());
    // The name of the only axis may be given, and must be right.
    let one = path("one.toml");
    fs::write(&one, "axis = \"press-2\"\n[signals.command]\ntopic = \"/press/2/signals\"\n").unwrap();
    assert_eq!(replay(&folder.path().join("log.mcap"), &["--config", &one, "--axis", "press-2"]).len(), 25);
    assert_eq!(seepd(["replay", "--config", &one, "--axis", "press-1", &log]).status.code(), Some(64));
}

/// A stroke that never comes: nothing is known of a fault, and a program that asks is not told that there is none.
#[test]
fn fail_on_fault_is_not_satisfied_without_a_flag() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    let ask = |more: &[&str]| {
        simulate(&log, more);
        let output = seepd(["replay", "--quiet", "--fail-on-fault", log.to_str().unwrap()]);
        (output.status.code(), stderr(&output))
    };
    let (code, told) = ask(&["--cycles", "1", "--start-at", "4"]);
    assert_eq!((code, told.lines().count()), (Some(65), 1), "{told}");
    assert!(
        told.contains("cannot be told: 0 cycles with an estimate") && told.contains("incomplete"),
        "{told}"
    );
    // Two estimates above a threshold are too few to raise a flag, and are no health.
    let (code, told) = ask(&["--cycles", "2", "--leak-area", "1e-6"]);
    assert_eq!(code, Some(65));
    assert!(told.contains("2 cycles with an estimate are too few"), "{told}");
    assert_eq!(ask(&["--cycles", "3", "--leak-area", "1e-6"]).0, Some(1));
    assert_eq!(ask(&["--cycles", "2"]).0, Some(0));
}

/// A configuration that maps nothing is remarked on, and one whose log lacks what it maps is wrong.
#[test]
fn check_holds_the_mapping_beside_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("seepd.toml");
    simulate(&folder.path().join("log.mcap"), &["--cycles", "1"]);
    let check = |text: &str| {
        fs::write(&config, text).unwrap();
        seepd(["check", config.to_str().unwrap()])
    };
    assert!(stdout(&check("[alarm]\nleak_lpm = 0.5\n")).contains("remark: axis axis: no signal is mapped"));
    let mapped =
        |field: &str| format!("[source]\nlog = \"log.mcap\"\n[signals.command]\nfield = \"{field}\"\n");
    assert!(!stdout(&check(&mapped("command"))).contains("remark"));
    let output = check(&mapped("valve"));
    assert_eq!(output.status.code(), Some(78));
    assert!(
        stderr(&output).contains("axis axis: ") && stderr(&output).contains("valve"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn explain_tells_what_helps_and_knows_what_was_meant() {
    let text = stdout(&seepd(["explain", "out", "of", "range"]));
    assert!(text.starts_with("## `out_of_range`\n") && text.contains("per cent `scale = 0.01`"), "{text}");
    let unknown = seepd(["explain", "unlike_trainig"]);
    assert_eq!(unknown.status.code(), Some(64));
    assert!(stderr(&unknown).contains("did you mean `unlike_training`?"), "{}", stderr(&unknown));
}

/// Files as Windows' PowerShell writes them with `>`.
#[test]
fn a_plant_and_a_configuration_in_utf_16_are_what_they_are_in_utf_8() {
    let folder = tempfile::tempdir().unwrap();
    let utf_16 = |name: &str, text: &str| {
        let units = text.encode_utf16().flat_map(u16::to_le_bytes);
        let path = folder.path().join(name);
        fs::write(&path, [0xff, 0xfe].into_iter().chain(units).collect::<Vec<u8>>()).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let plant = utf_16("plant.toml", &fs::read_to_string(fixture("other_press.toml")).unwrap());
    let config =
        utf_16("seepd.toml", "[signals.command] # Δ\ntopic = \"/axis/signals\"\nfield = \"command\"\n");
    let text = stdout(&seepd(["check", &plant, &config]));
    assert!(text.contains("good plant") && text.contains("good configuration"), "{text}");
}
