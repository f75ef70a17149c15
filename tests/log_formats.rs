//! Logs that people have: one machine's signals in every format give the same estimates, and other implementations read the same from them.

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use seepd_logs::LogMapping;
use seepd_signals::Signal;
use serde_json::Value;

use crate::support::{estimates, replay, seepd, simulate, stderr, stdout};

/// Command and demand in one frame of 29 bits, whose unit is per cent.
const DBC: &str = r#"VERSION ""

BU_: PLC

BO_ 2565864481 AxisStatus: 8 PLC
 SG_ ValveCommand : 0|32@1- (0.000001,0) [-100|100] "%" Vector__XXX
 SG_ PositionDemand : 32|32@1- (0.00001,0) [0|1000] "mm" Vector__XXX
"#;
/// Parameter group 61440 + 1 … of the address 33.
const ID: u32 = 2_565_864_481 & 0x1fff_ffff;
/// A machine's log, and what it gives.
struct Machine {
    folder: PathBuf,
    /// Time since the beginning in µs, command, demand in m.
    rows: Vec<(u64, f64, f64)>,
    estimates: Vec<f64>,
}

impl Machine {
    fn get() -> &'static Self {
        static MACHINE: OnceLock<Machine> = OnceLock::new();
        MACHINE.get_or_init(|| {
            let folder = crate::support::shared_folder("log_formats");
            let log = folder.join("machine.mcap");
            simulate(&log, &["--cycles", "3", "--leak-area", "1e-6"]);
            fs::write(folder.join("press.dbc"), DBC).unwrap();
            let mut source = seepd_logs::open(&log, &LogMapping::default()).unwrap();
            let mut rows = Vec::new();
            while let Some(sample) = source.next_sample().unwrap() {
                let [command, demand] =
                    [Signal::Command, Signal::Demand].map(|signal| sample.get(signal).unwrap());
                rows.push((rows.len() as u64 * 1000, command, demand));
            }
            let estimates = estimates(&replay(&log, &[]));
            assert_eq!(estimates.len(), 3);
            Machine { folder, rows, estimates }
        })
    }

    fn place(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        fs::write(self.place(name), content).unwrap();
        self.place(name)
    }

    /// Time in µs and the eight bytes of each frame.
    fn frames(&self) -> impl Iterator<Item = (u64, [u8; 8])> {
        self.rows.iter().map(|(micros, command, demand)| {
            let command = ((command * 1e8).round() as i32).to_le_bytes();
            let demand = ((demand * 1e8).round() as i32).to_le_bytes();
            (*micros, std::array::from_fn(|at| if at < 4 { command[at] } else { demand[at - 4] }))
        })
    }

    /// Replays a log; its estimates must be those of the machine.
    fn check(&self, log: &Path, arguments: &[&str]) {
        let found = estimates(&replay(log, arguments));
        assert_eq!(found.len(), self.estimates.len(), "{}", log.display());
        for (found, expected) in found.iter().zip(&self.estimates) {
            // Frames and tables resolve a millionth of full command.
            assert!(
                (found - expected).abs() <= 1e-3 * expected,
                "{}: {found}, not {expected}",
                log.display()
            );
        }
    }

    /// The same of a bus's log, by the names and units of the DBC file alone.
    fn check_frames(&self, log: &Path) {
        let config = self.write(
            "frames.toml",
            "dbc = \"press.dbc\"\n[signals.command]\nfield = \"ValveCommand\"\n[signals.demand]\nfield = \"PositionDemand\"\n",
        );
        self.check(log, &["--config", text_of(&config)]);
        let read = seepd_logs::frames(log).map(|mut frames| {
            std::iter::from_fn(move || frames.next_frame().unwrap())
                .inspect(|frame| assert!(frame.is_ok()))
                .count()
        });
        assert_eq!(read.unwrap(), self.rows.len(), "{}", log.display());
    }
}

fn text_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X} ")).collect::<String>().trim_end().to_owned()
}

fn lines(machine: &Machine, header: &str, line: impl Fn(usize, u64, [u8; 8]) -> String) -> String {
    let mut text = header.to_owned();
    for (number, (micros, bytes)) in machine.frames().enumerate() {
        writeln!(text, "{}", line(number, micros, bytes)).unwrap();
    }
    text
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut writer = GzEncoder::new(Vec::new(), Compression::fast());
    writer.write_all(content).unwrap();
    writer.finish().unwrap()
}

fn asc(machine: &Machine) -> String {
    lines(
        machine,
        "date Tue Nov 14 22:13:20.000 2023\nbase hex  timestamps absolute\n",
        |_, micros, bytes| format!("{:11.6} 1  {ID:X}x  Rx  d 8 {}", micros as f64 / 1e6, hex(&bytes)),
    )
}

#[test]
fn logs_of_buses_in_text_give_the_same_estimates() {
    let machine = Machine::get();
    machine.check_frames(&machine.write("a.asc", asc(machine)));
    let trc = ";$FILEVERSION=2.1\n;$STARTTIME=45244.9259259259\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n";
    let trc = lines(machine, trc, |number, micros, bytes| {
        format!("{:7} {:13.3} DT 1 {ID:08X} Rx - 8 {}", number + 1, micros as f64 / 1e3, hex(&bytes))
    });
    machine.check_frames(&machine.write("a.trc", trc));
    let old = lines(machine, ";  PCAN-View\n", |number, micros, bytes| {
        format!("{:6}) {:9.1} {ID:08X} 8 {}", number + 1, micros as f64 / 1e3, hex(&bytes))
    });
    machine.check_frames(&machine.write("old.trc", old));
    let savvycan =
        lines(machine, "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n", |_, micros, bytes| {
            format!("{micros},{ID:08X},true,Rx,0,8,{},", hex(&bytes).replace(' ', ","))
        });
    machine.check_frames(&machine.write("savvycan.csv", savvycan));
    let busmaster = "***BUSMASTER Ver 2.4.0***\n***START DATE AND TIME 14:11:2023 23:59:50:000***\n***HEX***\n***SYSTEM MODE***\n";
    let busmaster = lines(machine, busmaster, |_, micros, bytes| {
        // Over midnight.
        let tenths = (86_390 * 10_000 + micros / 100) % (86_400 * 10_000);
        let [hour, minute, second] = [tenths / 36_000_000, tenths / 600_000 % 60, tenths / 10_000 % 60];
        format!(
            "{hour:02}:{minute:02}:{second:02}:{:04} Rx 1 0x{ID:08X} x 8 {}",
            tenths % 10_000,
            hex(&bytes)
        )
    });
    machine.check_frames(&machine.write("busmaster.log", busmaster));
}

/// Objects in containers whose bounds they cross, as Vector's tools write them.
fn blf(machine: &Machine, packed: bool) -> Vec<u8> {
    let mut objects = Vec::new();
    for (micros, bytes) in machine.frames() {
        objects.extend_from_slice(b"LOBJ");
        for half in [32u16, 1] {
            objects.extend(half.to_le_bytes());
        }
        for word in [48u32, 86, 2] {
            objects.extend(word.to_le_bytes());
        }
        objects.extend([0; 4]);
        objects.extend((micros * 1000).to_le_bytes());
        objects.extend([1, 0, 0, 8]);
        objects.extend((ID | 0x8000_0000).to_le_bytes());
        objects.extend(bytes);
    }
    let mut log = b"LOGG".to_vec();
    log.extend(144u32.to_le_bytes());
    log.resize(40, 0);
    // 14 November 2023, a Tuesday, 22:13:20.
    for half in [2023u16, 11, 2, 14, 22, 13, 20, 0] {
        log.extend(half.to_le_bytes());
    }
    log.resize(144, 0);
    for part in objects.chunks(100_001) {
        let content = if packed {
            let mut writer = ZlibEncoder::new(Vec::new(), Compression::fast());
            writer.write_all(part).unwrap();
            writer.finish().unwrap()
        } else {
            part.to_vec()
        };
        log.extend_from_slice(b"LOBJ");
        for half in [16u16, 1] {
            log.extend(half.to_le_bytes());
        }
        log.extend((32 + content.len() as u32).to_le_bytes());
        log.extend(10u32.to_le_bytes());
        log.extend(if packed { 2u16 } else { 0 }.to_le_bytes());
        log.extend([0; 6]);
        log.extend((part.len() as u32).to_le_bytes());
        log.extend([0; 4]);
        log.extend_from_slice(&content);
        log.resize(log.len() + content.len() % 4, 0);
    }
    log
}

#[test]
fn a_blf_log_gives_the_same_estimates_and_a_damaged_one_loses_what_is_damaged() {
    let machine = Machine::get();
    for (name, packed) in [("packed.blf", true), ("stored.blf", false)] {
        machine.check_frames(&machine.write(name, blf(machine, packed)));
    }
    // A bit flips in the second cycle: its container is lost, and with it that cycle alone.
    let mut log = blf(machine, true);
    let middle = log.len() / 2;
    log[middle] ^= 0x10;
    let log = machine.write("damaged.blf", log);
    let config = machine.place("frames.toml");
    let output = seepd(["replay", "--json", "--config", text_of(&config), text_of(&log)]);
    let lines: Vec<Value> = stdout(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let found = estimates(&lines);
    assert_eq!(found.len(), 2, "{}", stderr(&output));
    assert!(stderr(&output).contains("1 damaged containers"), "{}", stderr(&output));
    let cut = blf(machine, true);
    let log = machine.write("cut.blf", &cut[..cut.len() * 9 / 10]);
    let output = seepd(["replay", "--json", "--config", text_of(&config), text_of(&log)]);
    assert!(
        stderr(&output).contains("in the middle of its data; it was read up to there"),
        "{}",
        stderr(&output)
    );
}

/// Every way that people have the same table.
#[test]
fn tables_of_scopes_controllers_and_spreadsheets_give_the_same_estimates() {
    let machine = Machine::get();
    let stamp = |micros: u64| {
        let at_s = 80_000 + micros / 1_000_000;
        let [hour, minute, second] = [at_s / 3600, at_s / 60 % 60, at_s % 60];
        format!("{hour:02}:{minute:02}:{second:02}.{:06}", micros % 1_000_000)
    };
    let table = |header: &str, row: &dyn Fn(usize, u64, f64) -> String| {
        let rows = machine.rows.iter().enumerate();
        rows.fold(header.to_owned(), |text, (number, (micros, command, _))| {
            text + &row(number, *micros, *command) + "\n"
        })
    };
    let comma = |value: f64| format!("{value:.8}").replace('.', ",");
    let check = |name: &str, content: Vec<u8>, config: &str| {
        let config = machine.write("table.toml", config);
        machine.check(&machine.write(name, content), &["--config", text_of(&config)]);
    };
    let valve = "[signals.command]\nfield = \"Ventil\"\nunit = \"%\"\n";
    let german = table("Anlage;Presse 7\nDatum;14.11.2023\n\nZeit;Ventil\ns;%\n", &|_, micros, command| {
        format!("{};{}", comma(micros as f64 / 1e6), comma(command * 100.0))
    });
    check("german.csv", german.clone().into_bytes(), &format!("time_column = \"Zeit\"\n{valve}"));
    let utf16: Vec<u8> =
        [0xff, 0xfe].into_iter().chain(german.encode_utf16().flat_map(u16::to_le_bytes)).collect();
    check("utf16.csv", utf16, &format!("time_column = \"Zeit\"\n{valve}"));
    let dated = table("Zeit\tVentil\n", &|_, micros, command| {
        format!("2023-11-14 {}\t{:.6}", stamp(micros), command * 100.0)
    });
    check("dated.tsv", dated.into_bytes(), &format!("time_column = \"Zeit\"\n{valve}"));
    let parted = table("Date,Time,Ventil\n", &|_, micros, command| {
        format!("14.11.2023,{},{:.6}", stamp(micros), command * 100.0)
    });
    check("parted.csv", parted.into_bytes(), &format!("time_column = \"Time\"\n{valve}"));
    let scope =
        table("TIME,CH1\n(us),(V)\n\n", &|_, micros, command| format!("{micros},{:.8}", command * 10.0));
    check(
        "scope.csv",
        scope.into_bytes(),
        "time_column = \"TIME\"\n[signals.command]\nfield = \"CH1\"\nscale = 0.1\n",
    );
    let bare = table("", &|_, micros, command| format!("{:.3},{command:.8}", micros as f64 / 1e3));
    check(
        "bare.csv",
        bare.into_bytes(),
        "time_column = \"1\"\ntime_unit = \"ms\"\n[signals.command]\nfield = \"2\"\n",
    );
    let rated = table("Ventil\n", &|_, _, command| format!("{:.8}", -command));
    check(
        "rated.csv",
        rated.into_bytes(),
        "sample_rate_hz = 1000\n[signals.command]\nfield = \"Ventil\"\ninvert = true\n",
    );
    // Four rows share a stamp: a controller's clock of 4 ms.
    let coarse =
        table("Zeit,Ventil\n", &|number, _, command| format!("{},{:.6}", number / 4 * 4, command * 100.0));
    check("coarse.csv", coarse.into_bytes(), &format!("time_column = \"Zeit\"\ntime_unit = \"ms\"\n{valve}"));
    // The same on the command line, without a configuration.
    let log =
        machine.write("line.csv", table("Ventil\n", &|_, _, command| format!("{:.6}", -100.0 * command)));
    machine.check(&log, &["--sample-rate", "1000", "--command", "Ventil", "--scale", "0.01", "--invert"]);
}

#[test]
fn archives_folders_patterns_and_pipes_give_the_same_estimates() {
    let machine = Machine::get();
    let mcap = fs::read(machine.place("machine.mcap")).unwrap();
    machine.check(&machine.write("machine.mcap.gz", gzip(&mcap)), &[]);
    machine.check(&machine.write("machine.mcap.zst", zstd::encode_all(&mcap[..], 3).unwrap()), &[]);
    machine.check_frames(&machine.write("zipped.asc.gz", gzip(asc(machine).as_bytes())));

    // A series whose files are sorted by number, one of them packed.
    let folder = machine.place("series");
    fs::create_dir_all(&folder).unwrap();
    let text = asc(machine);
    let all: Vec<&str> = text.lines().collect();
    let (header, frames) = all.split_at(2);
    let part = |from: usize, to: usize| {
        [header.join("\n"), frames[from..to.min(frames.len())].join("\n")].join("\n")
    };
    fs::write(folder.join("log_10.asc"), part(20_000, usize::MAX)).unwrap();
    fs::write(folder.join("log_9.asc.gz"), gzip(part(7_000, 20_000).as_bytes())).unwrap();
    fs::write(folder.join("log_1.asc"), part(0, 7_000)).unwrap();
    fs::write(folder.join("notes.md"), "no log").unwrap();
    let config = machine.write(
        "series.toml",
        "dbc = \"press.dbc\"\n[signals.command]\nfield = \"ValveCommand\"\n[signals.demand]\nfield = \"PositionDemand\"\n",
    );
    machine.check(&folder, &["--config", text_of(&config)]);
    machine.check(&folder.join("log_*"), &["--config", text_of(&config)]);

    for content in [&mcap[..], &gzip(&mcap)] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_seepd"))
            .args(["replay", "--json", "-"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(content).unwrap();
        let output = child.wait_with_output().unwrap();
        let lines: Vec<Value> =
            stdout(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(estimates(&lines), machine.estimates);
    }
}

/// A megabyte that unpacks to gigabytes is read as what it is, a text of one line, in little memory.
#[test]
fn a_bomb_is_unpacked_within_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let mut gz = GzEncoder::new(Vec::new(), Compression::best());
    let mut zst = zstd::Encoder::new(Vec::new(), 1).unwrap();
    let zeros = vec![b'0'; 1 << 20];
    for _ in 0..1024 {
        gz.write_all(&zeros).unwrap();
        zst.write_all(&zeros).unwrap();
    }
    for (name, archive) in [("bomb.csv.gz", gz.finish().unwrap()), ("bomb.csv.zst", zst.finish().unwrap())] {
        assert!(archive.len() < 2 << 20);
        let log = folder.path().join(name);
        fs::write(&log, archive).unwrap();
        let script =
            format!("ulimit -v 400000; exec {} replay {}", env!("CARGO_BIN_EXE_seepd"), text_of(&log));
        let output = Command::new("bash").args(["-c", &script]).output().unwrap();
        assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
        assert_eq!(stderr(&output).trim_end().lines().count(), 1, "{}", stderr(&output));
    }
}

/// One line that says what it is and what to do, for what is not read.
#[test]
fn what_is_not_read_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    for (name, content, words) in [
        ("a.tdms", &b"TDSm\x0e\0\0\0rest"[..], "npTDMS"),
        ("a.dat", b"MDF     3.30    TGT 15.0\0\0\0\0\0\0\x4a\x01\0\0rest of the header that is long enough, as headers are", "asammdf"),
        ("a.bag", b"#ROSBAG V2.0\n", "rosbags-convert"),
        ("a.blf", b"LOGG\x90\0\0\0", "its header is none of a BLF log"),
        ("a.mf4", b"MDF     4.10    ", "asammdf"),
    ] {
        let log = folder.path().join(name);
        fs::write(&log, content).unwrap();
        for command in ["replay", "inspect"] {
            let output = seepd([command, text_of(&log)]);
            let text = stderr(&output);
            assert_eq!((output.status.code(), text.trim_end().lines().count()), (Some(65), 1), "{name}: {text}");
            assert!(text.contains(words), "{name}: {text}");
        }
    }
    let output = seepd(["replay", text_of(folder.path())]);
    assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
    let none = folder.path().join("none*.csv");
    let output = seepd(["replay", text_of(&none)]);
    assert_eq!(output.status.code(), Some(66));
    assert!(
        stderr(&output).contains("there is no log of that name or in that folder"),
        "{}",
        stderr(&output)
    );
}
