//! What the pages of the site print, the program prints: the commands of each `console` block are run in the order of their page, in one
//! folder, and what they say must be what stands there. A line of `…` stands for any number of lines.

use std::fs;
use std::path::Path;
use std::process::Command;

/// A command with what it is said to print.
struct Spoken<'a> {
    command: &'a str,
    said: Vec<&'a str>,
}

fn transcript(page: &str) -> Vec<Spoken<'_>> {
    let mut spoken: Vec<Spoken<'_>> = Vec::new();
    let blocks = page.split("```console\n").skip(1).filter_map(|rest| rest.split("```").next());
    for line in blocks.flat_map(str::lines) {
        match (line.strip_prefix("$ "), spoken.last_mut()) {
            (Some(command), _) => spoken.push(Spoken { command, said: Vec::new() }),
            (None, Some(last)) => last.said.push(line),
            (None, None) => panic!("a block begins with a command: {line}"),
        }
    }
    spoken
}

/// Whether the lines are those that were said, where `…` leaves some out.
fn agrees(said: &[&str], lines: &[&str]) -> bool {
    match said.split_first() {
        None => lines.is_empty(),
        Some((&"…", rest)) => (0..=lines.len()).any(|from| agrees(rest, &lines[from..])),
        Some((first, rest)) => {
            lines.first().is_some_and(|line| line.trim_end() == first.trim_end()) && agrees(rest, &lines[1..])
        }
    }
}

#[test]
fn lines_are_left_out_by_dots_alone() {
    assert!(agrees(&["a", "…", "d"], &["a", "b", "c", "d"]) && agrees(&["…"], &[]));
    assert!(!agrees(&["a", "d"], &["a", "b", "d"]) && !agrees(&["…", "d"], &["d", "e"]));
}

#[test]
fn the_first_hour_says_what_the_program_says() {
    let folder = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_seepd")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let page =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/first-hour.md")).unwrap();
    let spoken = transcript(&page);
    assert!(spoken.len() >= 7, "{}", spoken.len());
    for Spoken { command, said } in spoken {
        // Notes and progress go to standard error: a terminal shows both.
        let run = Command::new("sh")
            .args(["-c", &format!("{{ {command} ; }} 2>&1")])
            .current_dir(folder.path())
            .env("PATH", &path)
            .output()
            .unwrap();
        let printed = String::from_utf8(run.stdout).unwrap();
        let lines: Vec<&str> = printed.lines().collect();
        assert!(run.status.success() && agrees(&said, &lines), "{command} said\n{printed}");
    }
}
