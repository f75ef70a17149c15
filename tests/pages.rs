//! The commands that stand on the site's pages, in the README and in the program's own help: each command line of the program is one that
//! it takes, and those of `RUN` run in a scratch folder.
//!
//! Transcripts (`transcripts.rs`) hold what is printed; here a misspelled option fails, wherever it stands.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::error::ErrorKind;
use seepd::cli::description;

use crate::support::{fixture, seepd, simulate, stdout};

/// Command lines of pages that run, by how they begin, in a folder that has what they read.
const RUN: &[&str] = &[
    "seepd replay press-1.mcap",
    "seepd replay --json --model",
    "seepd replay --html",
    "seepd replay --baseline",
    "seepd replay --csv",
    "seepd replay --quiet --parquet",
    "seepd replay --repairs",
    "seepd learn-baseline --out press-1",
    "seepd repair add seal_replaced",
    "seepd explain",
    "seepd simulate --list-effects",
    "seepd simulate --out sticky.mcap",
    "seepd inspect press-1.mcap",
    "seepd check mine.json",
    "seepd check seepd.toml",
    "seepd evaluate --learn-cycles",
    "seepd bound",
    "seepd export-fmu --out press.fmu",
    "seepd man |",
];

/// Commands whose words are for another program, which has a parser of its own: what stands before them is checked.
const PASSED_ON: &[(&str, &str)] = &[("fleet", "its options are Python's; crates/python/tests has them")];

/// A command line, and where it stands.
struct Line {
    place: String,
    text: String,
    /// Whether it stands in a sentence, where what is required may be left out.
    is_mentioned: bool,
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The pages that the summary lists, and the README.
fn pages() -> Vec<PathBuf> {
    let summary = fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    let names = summary.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    names.map(|name| root().join("docs").join(name)).chain([root().join("README.md")]).collect()
}

/// Lines of blocks in a page, a line that goes on put together, and the code in its sentences.
fn lines_of(page: &Path) -> Vec<Line> {
    let (text, name) = (fs::read_to_string(page).unwrap(), page.file_name().unwrap().to_string_lossy());
    let (mut lines, mut begun, mut is_fenced) = (Vec::new(), String::new(), false);
    for (number, line) in text.lines().enumerate() {
        let place = format!("{name}:{}", number + 1);
        if line.trim_start().starts_with("```") {
            is_fenced = !is_fenced;
            continue;
        }
        if is_fenced || line.starts_with("    ") {
            let line = line.trim();
            begun += line.strip_prefix("$ ").unwrap_or(line);
            match begun.strip_suffix('\\') {
                Some(part) => begun = part.to_owned(),
                None => lines.push(Line { place, text: std::mem::take(&mut begun), is_mentioned: false }),
            }
        } else {
            let code = line.split('`').skip(1).step_by(2);
            let mentioned =
                |text: &str| Line { place: place.clone(), text: text.to_owned(), is_mentioned: true };
            lines.extend(code.map(mentioned));
        }
    }
    lines
}

/// The words of each command in a line of a shell: quotes, comments, pipes, redirections, assignments before a command.
fn commands_of(line: &str) -> Vec<Vec<String>> {
    let (mut commands, mut words, mut word) = (Vec::new(), Vec::new(), None::<String>);
    let mut quote = None;
    let mut characters = line.chars().peekable();
    while let Some(c) = characters.next() {
        match (quote, c) {
            (Some(end), c) if c == end => quote = None,
            (Some(_), c) => word.get_or_insert_default().push(c),
            (None, '\'' | '"') => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, c) if c.is_whitespace() => words.extend(word.take()),
            (None, '|' | ';' | '&') => {
                words.extend(word.take());
                commands.push(std::mem::take(&mut words));
            }
            (None, '>') => {
                // What it is written into is no word of the command, nor is the number of what is.
                words.extend(word.take().filter(|word| word.parse::<u8>().is_err()));
                while characters.next_if(|c| c.is_whitespace() || matches!(c, '>' | '&')).is_some() {}
                while characters.next_if(|c| !c.is_whitespace() && !matches!(c, ';' | '|')).is_some() {}
            }
            (None, '$') => {
                // Whatever a loop puts here.
                pass_over_value(&mut characters);
                word.get_or_insert_default().push('1');
            }
            (None, c) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    commands.push(words);
    commands
}

/// Passes over a shell's value after its `$`: a name, or what stands in brackets.
fn pass_over_value(characters: &mut std::iter::Peekable<std::str::Chars<'_>>) {
    let mut open = 0;
    while let Some(c) = characters.peek() {
        match c {
            '(' | '{' => open += 1,
            ')' | '}' if open > 0 => open -= 1,
            c if open > 0 || c.is_alphanumeric() || *c == '_' => {}
            _ => break,
        }
        let closes = matches!(c, ')' | '}');
        characters.next();
        if closes && open == 0 {
            break;
        }
    }
}

/// The program's own words in a command; none where it is another program's.
fn own_words(words: &[String]) -> Option<&[String]> {
    let assigned = |word: &&String| {
        word.split_once('=').is_some_and(|(name, _)| name.chars().all(|c| c.is_ascii_uppercase() || c == '_'))
    };
    let words = &words[words.iter().take_while(assigned).count()..];
    let from = match words.first()?.as_str() {
        "cargo" if words.get(1)? == "run" => {
            let from = words.iter().position(|word| word == "--")?;
            return Some(&words[from..]);
        }
        "sudo" | "do" => 1,
        _ => 0,
    };
    let words = &words[from..];
    let name = words.first()?;
    (name == "seepd" || name.ends_with("/seepd")).then_some(words)
}

/// What is wrong with a command of the program.
fn wrong_with(words: &[String], is_mentioned: bool) -> Option<String> {
    if PASSED_ON.iter().any(|(name, _)| words.get(1).is_some_and(|word| word == name)) {
        return None;
    }
    if words.get(2).is_some_and(|word| word == "COMMAND") {
        return None;
    }
    let error = description().try_get_matches_from(words).err()?;
    let text = error.to_string();
    match error.kind() {
        ErrorKind::InvalidValue if is_mentioned && text.contains("but none was supplied") => None,
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => None,
        ErrorKind::MissingRequiredArgument
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
        | ErrorKind::MissingSubcommand
            if is_mentioned =>
        {
            None
        }
        _ => Some(text.lines().next().unwrap_or_default().to_owned()),
    }
}

/// Examples of the program's own help.
fn examples(command: &clap::Command) -> Vec<Line> {
    let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let lines = help.lines().map(|line| line.trim().trim_start_matches("Example: "));
    let own = lines.filter(|line| line.starts_with("seepd ")).map(|line| Line {
        place: format!("help of {}", command.get_name()),
        text: line.to_owned(),
        is_mentioned: false,
    });
    own.chain(command.get_subcommands().flat_map(examples)).collect()
}

/// All command lines of the program: where they stand, their words, and what a shell takes.
fn all_lines() -> Vec<Line> {
    pages().iter().flat_map(|page| lines_of(page)).chain(examples(&description())).collect()
}

#[test]
fn a_line_of_a_shell_is_understood() {
    let understood = |line: &str| -> Vec<String> {
        commands_of(line).iter().filter_map(|words| own_words(words)).map(|words| words.join("|")).collect()
    };
    assert_eq!(
        understood("candump -l - | seepd replay --note \"M. Huber\" - # as it comes"),
        ["seepd|replay|--note|M. Huber|-"]
    );
    assert_eq!(
        understood("A_B=c seepd inspect x.fmu > plant.toml 2>&1; target/release/seepd man"),
        ["seepd|inspect|x.fmu", "target/release/seepd|man"]
    );
    assert_eq!(understood("cargo run --release -p seepd -- demo"), ["--|demo"]);
    assert!(understood("seepd_logs::open(seepd)").is_empty() && understood("echo seepd replay").is_empty());
    let words = |line: &str| commands_of(line).remove(0);
    assert_eq!(wrong_with(&words("seepd replay --quiet a.mcap"), false), None);
    for wrong in [
        "seepd replay --quite a.mcap",
        "seepd reply a.mcap",
        "seepd replay",
        "seepd train --machines many --out m.json",
    ] {
        assert!(wrong_with(&words(wrong), false).is_some(), "{wrong}");
    }
    assert!(
        wrong_with(&words("seepd replay --quite"), true).is_some()
            && wrong_with(&words("seepd replay"), true).is_none()
    );
}

#[test]
fn every_command_line_of_the_pages_is_one_that_the_program_takes() {
    let (mut checked, mut wrong) = (0, Vec::new());
    for line in all_lines().iter().filter(|line| !line.text.contains('…')) {
        for words in commands_of(&line.text) {
            let Some(words) = own_words(&words) else { continue };
            checked += 1;
            wrong.extend(
                wrong_with(words, line.is_mentioned)
                    .map(|what| format!("{}: {}: {what}", line.place, line.text)),
            );
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    assert!(checked > 350, "{checked} command lines");
}

/// What the lines of `RUN` read.
fn shop(folder: &Path) {
    let place = |name: &str| folder.join(name);
    simulate(&place("monday.mcap"), &["--cycles", "60", "--command-only"]);
    simulate(
        &place("tuesday.mcap"),
        &["--cycles", "60", "--command-only", "--seed", "2", "--leak-area", "1e-8"],
    );
    for name in ["press-1.mcap", "today.mcap", "friday.mcap", "new.mcap"] {
        fs::copy(place("tuesday.mcap"), place(name)).unwrap();
    }
    fs::copy(fixture("nominal_leak_1e-6.csv"), place("press-1.csv")).unwrap();
    for name in ["press-1.json", "press-3.json", "model.json", "mine.json"] {
        fs::copy(root().join("crates/daemon/assets/model.json"), place(name)).unwrap();
    }
    let baseline = place("press-1.baseline.json");
    stdout(&seepd([
        "learn-baseline",
        "--out",
        baseline.to_str().unwrap(),
        place("monday.mcap").to_str().unwrap(),
    ]));
    simulate(&place("rig-1.mcap"), &["--cycles", "80", "--leak-step", "1e-7@60"]);
    fs::write(place("seepd.toml"), "axis = \"press-1\"\n").unwrap();
    fs::copy(root().join("docs/plant.toml"), place("plant.toml")).unwrap();
    fs::write(place("press-1.repairs.toml"), "").unwrap();
}

/// A copy of the shop without what the line is to write.
fn scratch(shop: &Path, words: &[String]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for file in fs::read_dir(shop).unwrap().map(|entry| entry.unwrap().path()) {
        fs::copy(&file, folder.path().join(file.file_name().unwrap())).unwrap();
    }
    let out = words.iter().position(|word| word == "--out").and_then(|at| words.get(at + 1));
    out.iter().for_each(|out| drop(fs::remove_file(folder.path().join(out))));
    folder
}

#[test]
fn command_lines_of_the_pages_run() {
    let shop_folder = tempfile::tempdir().unwrap();
    shop(shop_folder.path());
    let program = Path::new(env!("CARGO_BIN_EXE_seepd")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let (mut run, mut failed) = (vec![0; RUN.len()], Vec::new());
    let mut seen = HashSet::new();
    // What several pages have runs once.
    let runs =
        |line: &&Line| !line.is_mentioned && !line.text.contains("://") && seen.insert(line.text.clone());
    for line in all_lines().iter().filter(runs) {
        let Some(which) = RUN.iter().position(|begin| line.text.starts_with(begin)) else { continue };
        let words = commands_of(&line.text).remove(0);
        assert!(!line.text.contains(" /"), "{}: outside of the scratch folder", line.place);
        let folder = scratch(shop_folder.path(), &words);
        // Of a pipe the program's part alone: what it is read by need not be installed.
        let text = line.text.split(" | ").next().unwrap();
        let output = Command::new("sh")
            .args(["-c", text])
            .current_dir(folder.path())
            .env("PATH", &path)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        if !output.status.success() {
            failed.push(format!("{}: {text}: {said}", line.place));
        }
        run[which] += 1;
    }
    assert!(failed.is_empty(), "\n{}", failed.concat());
    let unused: Vec<_> = RUN.iter().zip(&run).filter(|(_, times)| **times == 0).collect();
    assert!(unused.is_empty(), "no page has {unused:?}");
}
