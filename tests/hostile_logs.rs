//! Logs that are made to hurt: small ones that want much memory, time or a way round the mapping. Each is read or refused
//! within 64 MiB above what a good log takes, and what is good beside it counts.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use mcap::records::MessageHeader;
use serde_json::Value;

use crate::support::{fixture, seepd, stderr};

/// What the program takes for a good log, bytes of writable memory: its own data, stacks, buffers, the model's trees.
const GOOD_LOG_BYTES: u64 = 24 << 20;
/// What a log may make it take besides.
const BUDGET_BYTES: u64 = 64 << 20;

/// Runs the program where it cannot have more memory than that: it is killed where it wants more.
fn frugal<A: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = A>) -> Output {
    let limit_kb = (GOOD_LOG_BYTES + BUDGET_BYTES) >> 10;
    Command::new("sh")
        .args(["-c", &format!("ulimit -d {limit_kb}; exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_seepd")])
        .args(arguments)
        .output()
        .unwrap()
}

/// The one JSON object that a run printed.
fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(output)))
}

fn file(folder: &tempfile::TempDir, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, content).unwrap();
    path
}

/// A schema's name, encoding and data.
type Schema<'s> = (&'s str, &'s str, &'s [u8]);

/// A log with one channel, `/plc`, of these messages, a millisecond apart.
fn log(encoding: &str, schema: Schema<'_>, messages: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut bytes).unwrap();
    let schema_id = writer.add_schema(schema.0, schema.1, schema.2).unwrap();
    let channel_id = writer.add_channel(schema_id, "/plc", encoding, &Default::default()).unwrap();
    for (sequence, message) in (0u32..).zip(messages) {
        let log_time = u64::from(sequence) * 1_000_000;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, message).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

/// A protobuf field with bytes in it.
fn bytes_field(number: u64, body: &[u8]) -> Vec<u8> {
    [varint(number << 3 | 2), varint(body.len() as u64), body.to_vec()].concat()
}

fn varint_field(number: u64, value: u64) -> Vec<u8> {
    [varint(number << 3), varint(value)].concat()
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value > 0x7f {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

const DOUBLE: u64 = 1;
const INT32: u64 = 5;
const MESSAGE: u64 = 11;
const SINGLE: u64 = 1;
const REPEATED: u64 = 3;

/// A `FieldDescriptorProto`; `more` is what else it says.
fn field(name: &str, number: u64, label: u64, kind: u64, type_name: &str, more: &[u8]) -> Vec<u8> {
    let mut body = bytes_field(1, name.as_bytes());
    body.extend(varint_field(3, number));
    body.extend(varint_field(4, label));
    body.extend(varint_field(5, kind));
    if !type_name.is_empty() {
        body.extend(bytes_field(6, type_name.as_bytes()));
    }
    body.extend(more);
    bytes_field(2, &body)
}

fn message(name: &str, fields: &[Vec<u8>]) -> Vec<u8> {
    bytes_field(4, &[bytes_field(1, name.as_bytes()), fields.concat()].concat())
}

/// A `FileDescriptorSet` of one file in the package `p`.
fn descriptor_set(syntax: &str, messages: &[Vec<u8>]) -> Vec<u8> {
    let mut file = bytes_field(1, b"p.proto");
    file.extend(bytes_field(2, b"p"));
    file.extend(messages.concat());
    file.extend(bytes_field(12, syntax.as_bytes()));
    bytes_field(1, &file)
}

/// A `double` on the wire.
fn double(number: u64, value: f64) -> Vec<u8> {
    [varint(number << 3 | 1), value.to_le_bytes().to_vec()].concat()
}

/// Replays a log's `/plc` with the command in a field, and inspects it; gives both.
fn read_twice(path: &Path, command: &str) -> [Output; 2] {
    let path = path.to_str().unwrap();
    [
        frugal(["replay", "--quiet", "--topic", "/plc", "--command", command, path]),
        frugal(["inspect", "--json", path]),
    ]
}

/// Exit codes of the two, which must be no signal, and the first's standard error.
fn codes(outputs: &[Output; 2]) -> ([Option<i32>; 2], String) {
    (outputs.each_ref().map(|output| output.status.code()), stderr(&outputs[0]))
}

#[test]
fn a_good_log_fits_the_memory_that_is_set_aside_for_it() {
    let log = fixture("nominal_leak_1e-6.csv");
    let limit_kb = GOOD_LOG_BYTES >> 10;
    let output = Command::new("sh")
        .args(["-c", &format!("ulimit -d {limit_kb}; exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_seepd")])
        .args(["replay", "--quiet", log.to_str().unwrap()])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

/// The command of each message, then what kind of log it was.
fn protobuf_log(schema: &[u8], messages: &[Vec<u8>]) -> Vec<u8> {
    log("protobuf", ("p.Axis", "protobuf", schema), messages)
}

#[test]
fn a_protobuf_type_that_contains_itself_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let set = descriptor_set(
        "proto3",
        &[message(
            "Axis",
            &[
                field("inner", 1, SINGLE, MESSAGE, ".p.Axis", b""),
                field("command", 2, SINGLE, DOUBLE, "", b""),
            ],
        )],
    );
    let messages = [double(2, 0.5), bytes_field(1, &double(2, 0.25))];
    let path = file(&folder, "self.mcap", protobuf_log(&set, &messages));
    let outputs = read_twice(&path, "command");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
    let found: Value = serde_json::from_slice(&outputs[1].stdout).unwrap();
    let fields = found["topics"][0]["fields"].as_array().unwrap();
    let paths: Vec<&str> = fields.iter().map(|field| field["path"].as_str().unwrap()).collect();
    assert_eq!(paths, ["command", "inner.command"]);
}

/// Messages within messages, without end as far as the bytes go: followed so far, and then told.
#[test]
fn a_message_200_000_deep_costs_no_stack() {
    let folder = tempfile::tempdir().unwrap();
    let set = descriptor_set(
        "proto3",
        &[message(
            "Axis",
            &[
                field("inner", 1, SINGLE, MESSAGE, ".p.Axis", b""),
                field("command", 2, SINGLE, DOUBLE, "", b""),
            ],
        )],
    );
    // Each level has to state its length; the innermost are made first.
    let mut deep = Vec::new();
    for _ in 0..20_000 {
        deep = [varint(1 << 3 | 2), varint(deep.len() as u64), deep].concat();
    }
    let path = file(&folder, "deep.mcap", protobuf_log(&set, &[deep, double(2, 0.5)]));
    assert_eq!(codes(&read_twice(&path, "command")).0, [Some(0); 2]);
    // A group opens with one byte and needs no length.
    let groups = [vec![1 << 3 | 3; 200_000], vec![1 << 3 | 4; 200_000]].concat();
    let path = file(&folder, "groups.mcap", protobuf_log(&set, &[groups, double(2, 0.5)]));
    assert_eq!(codes(&read_twice(&path, "command")).0, [Some(0); 2]);

    let json = format!("{{\"x\":{}1{},\"command\":0.5}}", "[".repeat(200_000), "]".repeat(200_000));
    let path = file(&folder, "json.mcap", log("json", ("a", "jsonschema", b""), &[json.into_bytes()]));
    assert_eq!(codes(&read_twice(&path, "command")).0, [Some(0); 2]);
}

#[test]
fn a_field_path_200_000_deep_is_a_configuration_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, "a.mcap", log("json", ("a", "jsonschema", b""), &[b"{\"command\":1}".to_vec()]));
    let config = format!("[signals.command]\ntopic = \"/plc\"\nfield = \"{}\"\n", "a.".repeat(200_000));
    let config = file(&folder, "seepd.toml", config);
    let told = "signals.command.field is a path of 200000 parts; at most 32 are followed";
    let check = seepd(["check", config.to_str().unwrap()]);
    assert_eq!((check.status.code(), stderr(&check).contains(told)), (Some(78), true), "{}", stderr(&check));
    let output = seepd(["replay", "--config", config.to_str().unwrap(), path.to_str().unwrap()]);
    assert_eq!((output.status.code(), stderr(&output).contains(told)), (Some(78), true));
    let long = "a.".repeat(40_000);
    let output = seepd(["replay", "--topic", "/plc", "--command", &long, path.to_str().unwrap()]);
    let told = "signals.command.field is a path of 40000 parts";
    assert_eq!((output.status.code(), stderr(&output).contains(told)), (Some(78), true));
}

/// A few hundred bytes whose absent fields, each with its own, would be a thousand million.
#[test]
fn protobuf_defaults_that_fan_out_are_not_made() {
    let folder = tempfile::tempdir().unwrap();
    let level = |name: &str, next: &str| {
        let fields: Vec<Vec<u8>> = (1..=32)
            .map(|number| field(&format!("f{number}"), number, SINGLE, MESSAGE, next, b""))
            .chain([field("command", 33, SINGLE, DOUBLE, "", b"")])
            .collect();
        message(name, &fields)
    };
    let set = descriptor_set(
        "proto3",
        &[
            level("Axis", ".p.B"),
            level("B", ".p.C"),
            level("C", ".p.D"),
            level("D", ".p.E"),
            level("E", ".p.F"),
            level("F", ".p.Axis"),
        ],
    );
    let path = file(&folder, "fan.mcap", protobuf_log(&set, &[Vec::new(), double(33, 0.5)]));
    assert_eq!(codes(&read_twice(&path, "command")).0, [Some(0); 2]);
}

#[test]
fn a_packed_field_of_millions_takes_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let set = descriptor_set(
        "proto3",
        &[message(
            "Axis",
            &[field("many", 1, REPEATED, INT32, "", b""), field("command", 2, SINGLE, DOUBLE, "", b"")],
        )],
    );
    let body = [bytes_field(1, &vec![7; 6 << 20]), double(2, 0.5)].concat();
    let path = file(&folder, "packed.mcap", protobuf_log(&set, &[body]));
    let outputs = read_twice(&path, "command");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
    let outputs = read_twice(&path, "many[5000000]");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
}

#[test]
fn an_image_beside_the_command_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let body = [
        vec![0, 1, 0, 0],
        (4u32 << 20).to_le_bytes().to_vec(),
        vec![9; 4 << 20],
        vec![0; 4],
        0.5f64.to_le_bytes().to_vec(),
    ]
    .concat();
    let schema = ("p/msg/Axis", "ros2msg", &b"uint8[] image\nfloat64 command"[..]);
    let path = file(&folder, "image.mcap", log("cdr", schema, &[body]));
    let outputs = read_twice(&path, "command");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
    let found: Value = serde_json::from_slice(&outputs[1].stdout).unwrap();
    let fields = found["topics"][0]["fields"].as_array().unwrap();
    assert_eq!(fields.len(), 17, "16 pixels and the command");
    assert_eq!((fields[16]["path"].as_str(), fields[16]["least"].as_f64()), (Some("command"), Some(0.5)));
}

/// Elements without bytes: a count alone would keep a reader busy, and a second dimension for ever.
#[test]
fn ros_arrays_of_empty_messages_end() {
    let folder = tempfile::tempdir().unwrap();
    let schema = b"Row[200000] rows\nfloat64 command\n===\nMSG: p/Row\nEmpty[200000] cells\n===\nMSG: p/Empty\n# nothing\n";
    let body = [vec![0, 1, 0, 0], vec![0; 400_000]].concat();
    let path = file(&folder, "empty.mcap", log("cdr", ("p/msg/Axis", "ros2msg", schema), &[body]));
    let (codes, text) = codes(&read_twice(&path, "command"));
    assert_eq!(codes, [Some(65), Some(0)]);
    assert!(text.contains("it has far more fields than bytes"), "{text}");
}

#[test]
fn wide_json_is_read_within_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let mut json = String::from("{");
    for number in 0..300_000 {
        json += &format!("\"k{number}\":{number},");
    }
    json += "\"command\":0.5}";
    let path = file(&folder, "wide.mcap", log("json", ("a", "jsonschema", b""), &[json.into_bytes()]));
    let outputs = read_twice(&path, "command");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
    let found: Value = serde_json::from_slice(&outputs[1].stdout).unwrap();
    assert_eq!(found["topics"][0]["fields"].as_array().unwrap().len(), 256);
}

/// A record as it stands in a file.
fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    [vec![opcode], (content.len() as u64).to_le_bytes().to_vec(), content.to_vec()].concat()
}

fn string(text: &str) -> Vec<u8> {
    [(text.len() as u32).to_le_bytes().to_vec(), text.as_bytes().to_vec()].concat()
}

fn schema_record(id: u16, name: &str, encoding: &str, data: &[u8]) -> Vec<u8> {
    let data = [(data.len() as u32).to_le_bytes().to_vec(), data.to_vec()].concat();
    record(3, &[id.to_le_bytes().to_vec(), string(name), string(encoding), data].concat())
}

fn channel_record(id: u16, schema: u16, topic: &str, encoding: &str) -> Vec<u8> {
    let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    record(4, &[ids, string(topic), string(encoding), vec![0; 4]].concat())
}

fn message_record(channel: u16, time_ns: u64, data: &[u8]) -> Vec<u8> {
    let times = [time_ns.to_le_bytes(), time_ns.to_le_bytes()].concat();
    record(5, &[channel.to_le_bytes().to_vec(), vec![0; 4], times, data.to_vec()].concat())
}

/// A chunk whose records are compressed by zstd.
fn zstd_chunk(records: &[u8], crc: u32) -> Vec<u8> {
    let packed = zstd::bulk::compress(records, 3).unwrap();
    let mut content = vec![0; 16];
    content.extend((records.len() as u64).to_le_bytes());
    content.extend(crc.to_le_bytes());
    content.extend(string("zstd"));
    content.extend((packed.len() as u64).to_le_bytes());
    content.extend(packed);
    record(6, &content)
}

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

#[test]
fn schemas_and_channels_by_the_hundred_thousand_are_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let mut records = Vec::new();
    let set = descriptor_set("proto3", &[message("Axis", &[field("command", 1, SINGLE, DOUBLE, "", b"")])]);
    let big = [set, bytes_field(999, &[b'x'; 1000])].concat();
    for id in 1..=65_000u16 {
        records.extend(schema_record(id, "p.Axis", "protobuf", &big));
        records.extend(channel_record(id, id, &format!("/robot/part_{id}"), "protobuf"));
    }
    records.extend(channel_record(65_001, 65_000, "/plc", "protobuf"));
    for tick in 0..100 {
        records.extend(message_record(65_001, tick * 1_000_000, &double(1, 0.5)));
    }
    let mut bytes = MAGIC.to_vec();
    bytes.extend(zstd_chunk(&records, crc32fast::hash(&records)));
    assert!(bytes.len() < 2 << 20, "{} bytes", bytes.len());
    let path = file(&folder, "channels.mcap", bytes);
    let outputs = read_twice(&path, "command");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
    let found: Value = serde_json::from_slice(&outputs[1].stdout).unwrap();
    assert_eq!(found["topics"].as_array().unwrap().len(), 1024);
    assert!(
        found["notes"].as_array().unwrap().contains(&"63977 more topics, which are left out here".into())
    );
    let (codes, text) = {
        let output = frugal(["replay", path.to_str().unwrap()]);
        (output.status.code(), stderr(&output))
    };
    assert_eq!(codes, Some(65));
    assert!(text.contains("/robot/part_32 (protobuf, 0 messages), 64969 more topics"), "{text}");
    assert!(text.len() < 4000, "{} bytes", text.len());
}

/// A ROS 2 definition of short types is thirty times its text.
#[test]
fn definitions_of_ten_thousands_of_types_stay_within_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let types: String = (0..40_000).map(|number| format!("===\nMSG: p/A{number}\nint8 a\n")).collect();
    let definition = format!("float64 command\n{types}");
    let mut bytes = MAGIC.to_vec();
    for id in 1..=4 {
        bytes.extend(schema_record(id, "p/msg/Axis", "ros2msg", definition.as_bytes()));
        bytes.extend(channel_record(id, id, if id == 1 { "/plc" } else { "/others" }, "cdr"));
    }
    let body = [vec![0, 1, 0, 0], 0.5f64.to_le_bytes().to_vec()].concat();
    bytes.extend(message_record(1, 0, &body));
    let path = file(&folder, "types.mcap", bytes);
    let outputs = read_twice(&path, "command");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
    let found = json(&outputs[1]);
    let topics = found["topics"].as_array().unwrap();
    let looked_into = |topic: &Value| topic["problem"].is_null();
    assert_eq!(topics.iter().filter(|topic| looked_into(topic)).count(), 1);
    let plc = topics.iter().find(|topic| topic["topic"] == "/plc").unwrap();
    assert_eq!(plc["fields"][0]["path"], "command");
}

/// Nothing says how far such a chunk may be unpacked but its own header.
#[test]
fn a_chunk_without_crc_is_unpacked_within_bounds() {
    let folder = tempfile::tempdir().unwrap();
    // A message of 200 MiB of nothing, then a command.
    let mut records = channel_record(1, 0, "/camera", "json");
    records.extend(channel_record(2, 0, "/plc", "json"));
    records.extend(message_record(1, 0, &vec![0; 200 << 20]));
    records.extend(message_record(2, 0, b"{\"command\":0.5}"));
    let mut bytes = [MAGIC, &zstd_chunk(&records, 0)].concat();
    let path = file(&folder, "bomb.mcap", &bytes);
    let outputs = read_twice(&path, "command");
    assert_eq!(codes(&outputs).0, [Some(0); 2], "{}", codes(&outputs).1);
    assert!(
        codes(&outputs).1.contains("1 messages longer than 8 MiB were passed over"),
        "{}",
        codes(&outputs).1
    );
    // One that says it holds a terabyte is damaged.
    let at = MAGIC.len() + 9 + 16;
    bytes[at..at + 8].copy_from_slice(&(1u64 << 40).to_le_bytes());
    let path = file(&folder, "terabyte.mcap", &bytes);
    let (codes, text) = codes(&read_twice(&path, "command"));
    assert_eq!(codes, [Some(65), Some(0)]);
    assert!(text.contains("1 damaged chunks"), "{text}");
}

#[test]
fn a_protobuf_command_that_is_absent_is_no_sample() {
    let folder = tempfile::tempdir().unwrap();
    let in_oneof = [varint_field(9, 0), varint_field(17, 1)].concat();
    let explicit = [message("Axis", &[field("command", 1, SINGLE, DOUBLE, "", &in_oneof)])];
    let implicit = [message("Axis", &[field("command", 1, SINGLE, DOUBLE, "", b"")])];
    let messages: Vec<Vec<u8>> =
        (0..100).map(|n| if n % 10 == 3 { Vec::new() } else { double(1, 0.5) }).collect();
    let count = |set: &[u8], name: &str| {
        let path = file(&folder, name, protobuf_log(set, &messages));
        let output =
            seepd(["replay", "--json", "--topic", "/plc", "--command", "command", path.to_str().unwrap()]);
        let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
        (summary["samples"].as_u64().unwrap(), stderr(&output))
    };
    for (syntax, what) in [("proto3", "proto3 optional"), ("proto2", "proto2")] {
        let definition = if syntax == "proto3" { &explicit } else { &implicit };
        let (samples, text) = count(&descriptor_set(syntax, definition), "explicit.mcap");
        assert_eq!(samples, 90, "{what}");
        let told = "10 messages were left out since they have no command, the first at 3000000 ns";
        assert!(text.contains(told), "{what}: {text}");
    }
    // Without presence a writer leaves out what is 0.
    let (samples, text) = count(&descriptor_set("proto3", &implicit), "implicit.mcap");
    assert_eq!((samples, text.as_str()), (100, ""));
}

#[test]
fn a_footer_that_points_nowhere_costs_the_summary_alone() {
    let folder = tempfile::tempdir().unwrap();
    for summary_start in [1, 1 << 40, u64::MAX - 4, u64::MAX] {
        let mut bytes = [MAGIC.to_vec(), channel_record(1, 0, "/plc", "json")].concat();
        for tick in 0..100 {
            bytes.extend(message_record(1, tick * 1_000_000, b"{\"command\":0.5}"));
        }
        // A message whose channel only the summary may know.
        bytes.extend(message_record(9, 0, b"{}"));
        bytes.extend(record(15, &[0; 4]));
        bytes.extend(record(2, &[&u64::to_le_bytes(summary_start)[..], &[0; 12]].concat()));
        bytes.extend(MAGIC);
        let path = file(&folder, "footer.mcap", bytes);
        let output =
            seepd(["replay", "--json", "--topic", "/plc", "--command", "command", path.to_str().unwrap()]);
        let summary: Value = json(&output);
        assert_eq!((output.status.code(), summary["samples"].as_u64()), (Some(0), Some(100)));
        assert!(
            stderr(&output).contains("1 messages of topics that it does not name"),
            "{}",
            stderr(&output)
        );
    }
}

#[test]
fn two_times_on_one_topic_are_a_configuration_error() {
    let folder = tempfile::tempdir().unwrap();
    let body = b"{\"command\":0.5,\"x\":1,\"sent\":5.0,\"received\":6.0}".to_vec();
    let path = file(&folder, "a.mcap", log("json", ("a", "jsonschema", b""), &[body]));
    let config = |topic: &str| {
        let text = format!(
            "[signals.command]\ntopic = \"/plc\"\ntime = \"sent\"\n[signals.position]\ntopic = \"{topic}\"\ntime = \"received\"\n"
        );
        file(&folder, "seepd.toml", text)
    };
    let told = "signals.position.time is `received`, but signals.command.time, on the same topic, is `sent`";
    let config_file = config("/plc");
    let output = seepd(["check", config_file.to_str().unwrap()]);
    assert_eq!(
        (output.status.code(), stderr(&output).contains(told)),
        (Some(78), true),
        "{}",
        stderr(&output)
    );
    // Named by its ending, the topic shows only in the log.
    let config_file = config("*plc");
    let output = seepd(["replay", "--config", config_file.to_str().unwrap(), path.to_str().unwrap()]);
    assert_eq!(
        (output.status.code(), stderr(&output).contains(told)),
        (Some(78), true),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_counter_outside_the_commands_frame_is_a_configuration_error() {
    let folder = tempfile::tempdir().unwrap();
    let config = file(
        &folder,
        "seepd.toml",
        "[source]\ncan = \"can0\"\ncounter = { bits = { id = 0x124, start = 0, length = 8 } }\n\
         [signals.command]\nbits = { id = 0x123, start = 0, length = 16, encoding = \"signed\" }\n",
    );
    let log = file(&folder, "candump.log", "(1.000001) can0 123#0000\n(1.001001) can0 124#01\n");
    let told = "source.counter is in the frame 124, but signals.command is in 123";
    for arguments in [
        vec!["check", config.to_str().unwrap()],
        vec!["replay", "--config", config.to_str().unwrap(), log.to_str().unwrap()],
    ] {
        let output = seepd(arguments);
        let text = stderr(&output);
        assert_eq!((output.status.code(), text.contains(told)), (Some(78), true), "{text}");
    }
}

#[test]
fn a_line_without_end_takes_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let rows = |text: &mut String| {
        for tick in 0..100 {
            *text += &format!("{tick}e-3,0.5\n");
        }
    };
    let mut text = String::from("t_s,command\n");
    rows(&mut text);
    text += &"7".repeat(150 << 20);
    text += "\n";
    let good = text.clone() + "0.1,0.5\n";
    let path = file(&folder, "line.csv", &good);
    let output = frugal(["replay", "--json", path.to_str().unwrap()]);
    let summary: Value = json(&output);
    assert_eq!(summary["samples"], 101);
    let told = "1 rows were left out, the first at line 102: the line is longer than a row can be";
    assert!(stderr(&output).contains(told), "{}", stderr(&output));
    assert_eq!(frugal(["inspect", path.to_str().unwrap()]).status.code(), Some(0));
    let path = file(&folder, "header.csv", "x".repeat(100 << 20));
    let output = frugal(["replay", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("its first line has more than 1048576 bytes"), "{}", stderr(&output));
}

#[test]
fn a_stray_quote_costs_one_row() {
    let folder = tempfile::tempdir().unwrap();
    let mut text = String::from("t_s,command\n");
    for tick in 0..1000 {
        text += &format!("{}e-3,{}0.5\n", tick, if tick == 50 { "\"" } else { "" });
    }
    let path = file(&folder, "quote.csv", text);
    let output = seepd(["replay", "--json", path.to_str().unwrap()]);
    let summary: Value = json(&output);
    assert_eq!(summary["samples"], 999);
    let told = "1 rows were left out, the first at line 52: a quote is opened and not closed";
    assert!(stderr(&output).contains(told), "{}", stderr(&output));
}

/// Each kind of log ends in one line and exit code 65 where nothing in it is of use.
#[test]
fn a_log_of_which_nothing_can_be_used_is_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    let of_five = |body: &str| log("json", ("a", "jsonschema", b""), &vec![body.as_bytes().to_vec(); 5]);
    let candump = "(1.000001) can0 123#00\n(1.001001) can0 123#01\n".to_owned();
    let dbc = "VERSION \"\"\nBU_:\nBO_ 291 M: 8 X\n SG_ command : 0|16@1- (1,0) [0|0] \"\" X\n";
    let dbc = file(&folder, "a.dbc", dbc);
    for (name, content, told) in [
        ("header.csv", b"t_s,command\n".to_vec(), "the file has a header row and nothing else"),
        (
            "words.csv",
            b"t_s,command\n1,fast\n2,slow\n".to_vec(),
            "none of the 2 rows can be used; the first of them is at line 2: `fast`",
        ),
        ("empty.csv", b"t_s,command\n1,\n2,\n".to_vec(), "none of its 2 commands is a number"),
        ("null.mcap", of_five("{\"command\":null}"), "none of its 5 commands is a number"),
        (
            "words.mcap",
            of_five("{\"command\":\"fast\"}"),
            "5 messages were left out as unreadable, the first at 0 ns: `fast` is not a number",
        ),
        (
            "without.mcap",
            of_five("{\"x\":1}"),
            "5 messages were left out since they have no command, the first at 0 ns",
        ),
        ("short.log", candump.into_bytes(), "2 of them too short for the mapped signals"),
    ] {
        let path = file(&folder, name, content);
        let mut arguments = vec!["replay", "--topic", "/plc", path.to_str().unwrap()];
        if name.ends_with(".log") {
            arguments = vec!["replay", "--dbc", dbc.to_str().unwrap(), path.to_str().unwrap()];
        }
        let output = seepd(arguments);
        let text = stderr(&output);
        assert_eq!((output.status.code(), text.lines().count()), (Some(65), 1), "{name}: {text}");
        assert!(text.contains(told), "{name}: {text}");
    }
}

/// What inspect proposes for a CSV in another unit of time, replay reads at the rate that inspect saw.
#[test]
fn the_proposed_mapping_has_the_time_column_and_its_unit() {
    let folder = tempfile::tempdir().unwrap();
    let seconds = fs::read_to_string(fixture("nominal_leak_1e-6.csv")).unwrap();
    let mut rows = seconds.lines().skip(1).map(|row| row.split_once(',').unwrap());
    let mut text = String::from("time_ms,command\n");
    for (tick, (_, rest)) in
        rows.by_ref().chain(seconds.lines().skip(1).map(|row| row.split_once(',').unwrap())).enumerate()
    {
        text += &format!("{tick},{}\n", rest.split(',').next().unwrap());
    }
    let path = file(&folder, "log.csv", text);
    let log = path.to_str().unwrap();
    let inspected = seepd(["inspect", "--time-column", "time_ms", log]);
    let proposed = crate::support::stdout(&inspected);
    assert!(proposed.starts_with("time_column = \"time_ms\"\ntime_unit = \"ms\"\n"), "{proposed}");
    let told = "by its name, the column `time_ms` is taken to be in ms";
    assert!(
        stderr(&inspected).contains(told) && stderr(&inspected).contains("1000.0 Hz"),
        "{}",
        stderr(&inspected)
    );
    let config = file(&folder, "seepd.toml", &proposed);
    let check = seepd(["check", config.to_str().unwrap()]);
    assert_eq!(check.status.code(), Some(0), "{}", stderr(&check));
    let read = |config: &Path| {
        let lines = crate::support::replay(&path, &["--config", config.to_str().unwrap()]);
        (
            crate::support::summary(&lines)["duration_s"].as_f64().unwrap(),
            crate::support::estimates(&lines).len(),
        )
    };
    let (duration_s, cycles) = read(&config);
    assert!((duration_s - 20.0).abs() < 0.01, "{duration_s}");
    assert_eq!(cycles, 2);
    // The unit that is set goes before the name's.
    let config = file(&folder, "us.toml", proposed.replace("\"ms\"", "\"us\""));
    let output = seepd(["replay", "--quiet", "--config", config.to_str().unwrap(), log]);
    assert!(stderr(&output).contains("comes at 1000000.0 Hz"), "{}", stderr(&output));
}

#[test]
fn a_text_comes_through_a_fifo_and_an_mcap_log_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo");
    let make = |path: &Path| assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    make(&fifo);
    let fed = |content: Vec<u8>, arguments: &[&str]| {
        let to = fifo.clone();
        // The program may close the pipe before all of it is written.
        let writer = std::thread::spawn(move || fs::write(to, content).is_ok());
        let output = seepd(arguments);
        writer.join().unwrap();
        output
    };
    let path = fifo.to_str().unwrap();
    let text = fs::read(fixture("nominal_leak_1e-6.csv")).unwrap();
    let output = fed(text.clone(), &["replay", "--json", path]);
    let lines = crate::support::stdout(&output);
    assert_eq!(lines.lines().count(), 2, "{lines}");
    assert!(crate::support::stdout(&fed(text, &["inspect", path])).contains("[signals.command]"));
    // MCAP comes through a pipe as well; this one has no message.
    let output = fed(log("json", ("a", "jsonschema", b""), &[]), &["replay", path]);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("no message has"), "{}", stderr(&output));
}

#[test]
fn a_message_of_20_000_signals_is_inspected_by_its_first() {
    let folder = tempfile::tempdir().unwrap();
    let mut dbc = String::from("VERSION \"\"\nBU_:\nBO_ 291 M: 8 X\n");
    for number in 0..20_000 {
        dbc += &format!(" SG_ S{number} : {}|16@1- (0.01,0) [-1|1] \"\" X\n", number % 48);
    }
    let dbc = file(&folder, "wide.dbc", dbc);
    let frames: String = (0..20_000)
        .map(|tick| format!("({}.{:03}001) can0 123#{tick:04X}223344556677\n", tick / 1000, tick % 1000))
        .collect();
    let path = file(&folder, "candump.log", frames);
    let output = seepd(["inspect", "--json", "--dbc", dbc.to_str().unwrap(), path.to_str().unwrap()]);
    let found: Value = json(&output);
    let topic = &found["topics"][0];
    assert_eq!(
        (topic["messages"].as_u64(), topic["fields"].as_array().map(Vec::len)),
        (Some(20_000), Some(256))
    );
}

/// Names with escape sequences, as logs, files and others can have them, show themselves instead of doing something.
#[test]
fn control_characters_in_names_do_not_reach_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let evil = "\u{1b}]0;owned\u{7}\u{9b}2J\nseepd: all is well\r";
    let records: Vec<u8> = [
        schema_record(1, evil, "jsonschema", b"{}"),
        channel_record(1, 1, evil, "json"),
        channel_record(2, 1, "/other", evil),
        message_record(1, 0, serde_json::json!({ evil: 0.5, "command": evil }).to_string().as_bytes()),
        message_record(1, 1, serde_json::json!({ evil: 0.25, "command": 0.1 }).to_string().as_bytes()),
        message_record(1, 2, serde_json::json!({ evil: 0.25, "command": 0.2 }).to_string().as_bytes()),
    ]
    .concat();
    let log = file(&folder, "evil\u{1b}[2J.mcap", [MAGIC, &records].concat());
    let csv = file(&folder, "evil.csv", format!("{}\n1,2\n", evil.replace('\n', "")));
    let (log, csv) = (log.to_str().unwrap(), csv.to_str().unwrap());
    for arguments in [
        vec!["inspect", log],
        vec!["inspect", "--json", log],
        vec!["replay", log],
        vec!["replay", "--topic", evil, "--command", "command", log],
        vec!["replay", "--topic", evil, "--command", evil, log],
        vec!["replay", csv],
        vec!["check", log, csv],
    ] {
        let output = seepd(&arguments);
        for text in [&output.stdout, &output.stderr] {
            let text = String::from_utf8(text.clone()).unwrap();
            let foreign = text.find(|c: char| c.is_control() && c != '\n' && c != '\t');
            assert_eq!(foreign, None, "{arguments:?}: {text:?}");
            assert!(!text.contains("\nseepd: all is well"), "{arguments:?}: {text:?}");
        }
    }
    let proposed = seepd(["inspect", log]);
    let proposed: toml::Value = toml::from_str(&crate::support::stdout(&proposed)).unwrap();
    // The mapping has the very name.
    assert_eq!(proposed["signals"]["command"]["topic"].as_str(), Some(evil));
}

/// A pipe that nobody writes to keeps its own axis waiting, and neither the others nor the signal to end.
#[cfg(feature = "live")]
#[test]
fn a_fifo_without_a_writer_holds_up_its_axis_alone() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let port = crate::daemon::free_port();
    let config = format!(
        "state_dir = \"state\"\n[http]\nlisten = \"127.0.0.1:{port}\"\n\
         [[axes]]\naxis = \"waiting\"\n[axes.source]\nlog = \"{}\"\n\
         [[axes]]\naxis = \"reading\"\n[axes.source]\npace = \"fast\"\nlog = \"{}\"\n",
        fifo.display(),
        fixture("nominal_leak_1e-6.csv").display()
    );
    let running = crate::daemon::Daemon::start(folder.path(), &config);
    let samples = |axis: &str| {
        let answer = crate::daemon::ask(port, "GET", &format!("/api/v1/axes/{axis}"), "")?;
        answer.json()["source"]["samples"].as_u64()
    };
    let long = std::time::Duration::from_secs(30);
    crate::daemon::until("the other axis reads", long, || samples("reading") == Some(10_000));
    assert_eq!(samples("waiting"), Some(0));
    assert_eq!(running.terminate().0.code(), Some(0));
}

/// Small relatives of what is above, from which `fuzz/run` sets out.
fn fuzz_seeds() -> Vec<(&'static str, Vec<u8>)> {
    let with_schema = |which: u8, schema: &[u8], message: &[u8]| {
        [vec![which], (schema.len() as u16).to_le_bytes().to_vec(), schema.to_vec(), message.to_vec()]
            .concat()
    };
    let recursive = descriptor_set(
        "proto3",
        &[message(
            "Axis",
            &[
                field("inner", 1, SINGLE, MESSAGE, ".p.Axis", b""),
                field("command", 2, SINGLE, DOUBLE, "", b""),
                field("many", 3, REPEATED, INT32, "", b""),
            ],
        )],
    );
    let empty =
        b"Row[200] rows\nfloat64 command\n===\nMSG: p/Row\nEmpty[200] cells\n===\nMSG: p/Empty\n# nothing\n";
    let records =
        [channel_record(1, 0, "/a/signals", "json"), message_record(1, 0, b"{\"command\":0.5}")].concat();
    let footer = [
        MAGIC.to_vec(),
        records.clone(),
        message_record(9, 0, b"{}"),
        record(15, &[0; 4]),
        record(2, &[&u64::to_le_bytes(u64::MAX - 4)[..], &[0; 12]].concat()),
        MAGIC.to_vec(),
    ];
    let mut mux = String::from("VERSION \"\"\nBU_:\nBO_ 291 M: 8 X\n SG_ S0 M : 0|8@1+ (1,0) [0|0] \"\" X\n");
    for number in 1..20 {
        mux += &format!(" SG_ S{number} m{number}M : {number}|8@1+ (1,0) [0|0] \"\" X\n");
    }
    vec![
        ("messages/seed-protobuf-recursive", with_schema(2, &recursive, &bytes_field(1, &double(2, 0.5)))),
        ("messages/seed-protobuf-groups", with_schema(2, &recursive, &[[11; 40], [12; 40]].concat())),
        ("messages/seed-protobuf-packed", with_schema(2, &recursive, &bytes_field(3, &[7; 500]))),
        ("messages/seed-ros-empty", with_schema(1, empty, &[vec![0, 1, 0, 0], vec![0; 400]].concat())),
        ("messages/seed-json-deep", format!("\u{3}{}1{}", "[".repeat(1000), "]".repeat(1000)).into_bytes()),
        ("mcap_log/seed-chunk-without-crc", [MAGIC, &zstd_chunk(&records, 0)].concat()),
        ("mcap_log/seed-chunk", [MAGIC, &zstd_chunk(&records, crc32fast::hash(&records))].concat()),
        ("mcap_log/seed-footer-nowhere", footer.concat()),
        ("csv_log/seed-stray-quote", b"t_s;\"command\"\n0;\"1\n1;\"0.5\"\n2;\"0\"\"5\"\n".to_vec()),
        ("dbc/seed-multiplexers", mux.into_bytes()),
    ]
}

/// `SEEPD_WRITE_SEEDS=1` writes them anew.
#[test]
fn the_fuzz_corpus_has_each_seed() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, bytes) in fuzz_seeds() {
        let path = corpus.join(name);
        if std::env::var_os("SEEPD_WRITE_SEEDS").is_some() {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, &bytes).unwrap();
        }
        assert!(bytes.len() < 4096, "{name} has {} bytes", bytes.len());
        assert!(fs::read(&path).ok().as_ref() == Some(&bytes), "{name} is another");
    }
}
