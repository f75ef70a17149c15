//! What the documents say is what the program does.

use std::fs;
use std::path::{Path, PathBuf};

use seepd::config::{AxisConfig, DaemonConfig};
use seepd_sim::MachineSpec;
use seepd_simulator::SimulatorSpec;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[test]
fn documented_plant_file_is_the_default_in_full() {
    let text = fs::read_to_string(root().join("docs/plant.toml")).unwrap();
    assert_eq!(MachineSpec::from_toml(&text).unwrap(), MachineSpec::default());
    for info in seepd_sim::PlantParameters::ALL {
        assert!(
            text.contains(&format!("\n{} = ", info.key)) && text.contains(&format!("({})", info.symbol)),
            "{}",
            info.key
        );
    }
}

#[test]
fn simulators_of_the_guide_read() {
    let guide = fs::read_to_string(root().join("docs/simulator.md")).unwrap();
    let block = guide.split("```toml").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let example = fs::read_to_string(root().join("docs/simulator.toml")).unwrap();
    let example = SimulatorSpec::from_toml(&example).unwrap();
    let mut spec: toml::Table = toml::from_str(block).unwrap();
    for (key, value) in toml::Table::try_from(&example).unwrap() {
        spec.entry(key).or_insert(value);
    }
    let spec = SimulatorSpec::from_toml(&toml::to_string(&spec).unwrap()).unwrap();
    assert_eq!((spec.stroke_m, spec.full_force_n), (example.stroke_m, 351.5));
    // Its table of laws at the ports names each kind that there is.
    assert_eq!(spec.without_port().len(), 4);
}

#[test]
fn configurations_of_the_guide_read() {
    let guide = fs::read_to_string(root().join("docs/configuration.md")).unwrap();
    let blocks = guide.split("```toml").skip(1).map(|rest| rest.split("```").next().unwrap());
    let configs: Vec<DaemonConfig> = blocks.map(|block| DaemonConfig::parse(block).unwrap()).collect();
    assert_eq!(configs[0].axes[0].alarm, AxisConfig::default().alarm);
    assert_eq!(configs[0].axes[0].signals.len(), 1);
    assert_eq!(configs[1].axes[0].duty_cycles.len(), 1);
    assert!(configs[2].axes[0].is_relative());
    assert_eq!(configs[3].axes.len(), 2);
}

#[test]
fn configuration_of_the_live_guide_and_of_the_package_read() {
    let guide = fs::read_to_string(root().join("docs/live.md")).unwrap();
    let block = guide.split("```toml").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let config = DaemonConfig::parse(block).unwrap();
    assert!(config.sinks.http.is_some() && config.sinks.mqtt.is_some() && config.sinks.recording.is_some());
    assert_eq!(config.sinks.can_out.len(), 1);
    let shipped = fs::read_to_string(root().join("packaging/seepd.toml")).unwrap();
    assert_eq!(DaemonConfig::parse(&shipped).unwrap().axes[0].source.can.as_deref(), Some("can0"));
    // What is commented out there reads too.
    let all: String = shipped.lines().map(uncommented).collect::<Vec<_>>().join("\n");
    let config = DaemonConfig::parse(&all).unwrap_or_else(|message| panic!("{message}: {all}"));
    assert!(config.sinks.mqtt.is_some_and(|mqtt| mqtt.tls) && config.sinks.can_out.len() == 1);
}

/// A line of which a comment that is a key or a table is taken as such.
fn uncommented(line: &str) -> &str {
    match line.strip_prefix("# ") {
        Some(rest) if rest.starts_with('[') || rest.split(' ').nth(1) == Some("=") => rest,
        _ => line,
    }
}

#[test]
fn design_names_every_crate() {
    let design = fs::read_to_string(root().join("DESIGN.md")).unwrap();
    for folder in fs::read_dir(root().join("crates")).unwrap() {
        let name = folder.unwrap().file_name().into_string().unwrap();
        assert!(design.contains(&format!("`crates/{name}`")), "{name}");
    }
}

#[test]
fn changelog_and_commands_page_name_every_command() {
    let changes = fs::read_to_string(root().join("CHANGELOG.md")).unwrap();
    let page = fs::read_to_string(root().join("docs/commands.md")).unwrap();
    let headings: String = page.lines().filter(|line| line.starts_with("## ")).collect();
    for command in crate::support::commands() {
        let name = format!("`seepd {command}`");
        assert!(changes.contains(&name), "{command}");
        assert!(headings.contains(&name), "{command}");
    }
}

/// Files that documents link to exist.
#[test]
fn links_lead_somewhere() {
    let pages = fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let mut links = 0;
    for page in pages.chain(["README.md", "DESIGN.md"].map(|name| root().join(name))) {
        let text = fs::read_to_string(&page).unwrap();
        for target in text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next()) {
            let is_file = !target.is_empty() && !target.contains("://");
            assert!(!is_file || page.with_file_name(target).exists(), "{}: {target}", page.display());
            links += usize::from(is_file);
        }
    }
    assert!(links > 30, "{links}");
}

/// A page that the site's table of contents lacks is no page of the site.
#[test]
fn every_page_is_in_the_table_of_contents() {
    let contents = fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    for entry in fs::read_dir(root().join("docs")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.ends_with(".md") && name != "SUMMARY.md" {
            assert!(contents.contains(&format!("({name})")), "{name}");
        }
    }
}

#[test]
fn reasons_are_documented_as_they_are_explained() {
    let text = fs::read_to_string(root().join("docs/reasons.md")).unwrap();
    let listed = crate::support::stdout(&crate::support::seepd(["explain"]));
    assert!(text == listed, "write it anew: seepd explain > docs/reasons.md");
}

#[test]
fn effects_are_documented_as_the_catalogue_has_them() {
    let text = fs::read_to_string(root().join("docs/effects.md")).unwrap();
    let listed = crate::support::stdout(&crate::support::seepd(["simulate", "--list-effects"]));
    assert!(text == listed, "write it anew: seepd simulate --list-effects > docs/effects.md");
}
