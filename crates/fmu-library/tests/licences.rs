//! What is linked into the library is named in the licences that exported FMUs have.

use std::process::Command;

#[test]
fn every_crate_in_the_library_is_named_with_its_licence() {
    let listed = include_str!("../../fmu/src/third-party.txt");
    let tree = Command::new(env!("CARGO"))
        .args([
            "tree",
            "--offline",
            "-p",
            "seepd-fmu-library",
            "-e",
            "normal,no-proc-macro",
            "--prefix",
            "none",
        ])
        .args(["--format", "{p}|{l}"])
        .output()
        .unwrap();
    assert!(tree.status.success(), "{}", String::from_utf8_lossy(&tree.stderr));
    let mut crates = 0;
    for line in String::from_utf8(tree.stdout).unwrap().lines().filter(|line| !line.starts_with("seepd")) {
        let (package, licence) = line.trim_end_matches(" (*)").split_once('|').unwrap();
        let name = package.split(' ').next().unwrap();
        let wanted = format!("{name:<20} {}", licence.replace('/', " OR "));
        assert!(listed.lines().any(|line| line == wanted), "third-party.txt lacks: {wanted}");
        crates += 1;
    }
    assert!(crates > 20, "{crates}");
}
