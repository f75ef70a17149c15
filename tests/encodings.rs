//! Logs with protobuf and ROS 2 messages: the same samples as from JSON, and one line for what does not fit.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;

use mcap::records::MessageHeader;
use prost_reflect::prost::Message;
use prost_reflect::prost_types::field_descriptor_proto::{Label, Type};
use prost_reflect::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
};
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use re_cdr::{CdrWriter, LittleEndian};
use seepd_logs::McapSource;
use seepd_logs::Source;
use seepd_logs::survey::{FieldSurvey, survey};
use seepd_logs::{LogError, LogMapping, Selection, SignalMapping};
use seepd_signals::Signal;

use crate::support::{fixture, python, replay, simulate};

/// Mapping of the command (in percent) and the cap's pressure (second of three, in bar) with the message's own time.
fn mapping() -> Vec<(Signal, SignalMapping)> {
    let of = |field: &str, scale| SignalMapping {
        topic: "/plc".into(),
        field: field.into(),
        scale,
        time: "stamp".into(),
        ..SignalMapping::default()
    };
    vec![(Signal::Command, of("valve.percent", 0.01)), (Signal::PCap, of("pressures[1]", 1e5))]
}

/// A log with one channel of these messages.
fn log(schema: (&str, &str, &[u8]), encoding: &str, messages: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::Writer::new(&mut bytes).unwrap();
    let schema = writer.add_schema(schema.0, schema.1, schema.2).unwrap();
    let channel_id = writer.add_channel(schema, "/plc", encoding, &Default::default()).unwrap();
    for (sequence, message) in (0u32..).zip(messages) {
        let header = MessageHeader { channel_id, sequence, log_time: 5, publish_time: 5 };
        writer.write_to_known_channel(&header, message).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

/// Time in ns, command and cap pressure.
type Row = (i64, f64, f64);

/// The samples and the notes.
fn read(bytes: Vec<u8>) -> Result<(Vec<Row>, Vec<String>), String> {
    let mut source = McapSource::new(Cursor::new(bytes), "log", mapping()).unwrap();
    let mut samples = Vec::new();
    while let Some(sample) = source.next_sample().map_err(|failure| failure.to_string())? {
        samples.push((
            sample.time_ns,
            sample.get(Signal::Command).unwrap(),
            sample.get(Signal::PCap).unwrap(),
        ));
    }
    Ok((samples, source.notes()))
}

const EXPECTED: [Row; 2] = [(1_750_000_000_001_000_000, 0.25, 8.5e6), (1_750_000_000_002_000_000, -0.5, 9e6)];

fn protobuf_set() -> FileDescriptorSet {
    let field =
        |name: &str, number, kind: Type, label: Label, type_name: Option<&str>| FieldDescriptorProto {
            name: Some(name.into()),
            number: Some(number),
            r#type: Some(kind as i32),
            label: Some(label as i32),
            type_name: type_name.map(str::to_owned),
            ..Default::default()
        };
    let message = |name: &str, field: Vec<FieldDescriptorProto>| DescriptorProto {
        name: Some(name.into()),
        field,
        ..Default::default()
    };
    let single = Label::Optional;
    FileDescriptorSet {
        file: vec![FileDescriptorProto {
            name: Some("plc.proto".into()),
            package: Some("plc".into()),
            syntax: Some("proto3".into()),
            message_type: vec![
                message("Valve", vec![field("percent", 1, Type::Double, single, None)]),
                message(
                    "Stamp",
                    vec![
                        field("seconds", 1, Type::Int64, single, None),
                        field("nanos", 2, Type::Int32, single, None),
                    ],
                ),
                message(
                    "Axis",
                    vec![
                        field("stamp", 1, Type::Message, single, Some(".plc.Stamp")),
                        field("valve", 2, Type::Message, single, Some(".plc.Valve")),
                        field("pressures", 3, Type::Float, Label::Repeated, None),
                        field("name", 4, Type::String, single, None),
                    ],
                ),
            ],
            ..Default::default()
        }],
    }
}

fn protobuf_messages() -> Vec<Vec<u8>> {
    let pool = DescriptorPool::from_file_descriptor_set(protobuf_set()).unwrap();
    let new = |name: &str| DynamicMessage::new(pool.get_message_by_name(name).unwrap());
    EXPECTED
        .iter()
        .map(|(time_ns, command, pressure)| {
            let (mut axis, mut valve, mut stamp) = (new("plc.Axis"), new("plc.Valve"), new("plc.Stamp"));
            valve.set_field_by_name("percent", Value::F64(command * 100.0));
            stamp.set_field_by_name("seconds", Value::I64(time_ns / 1_000_000_000));
            stamp.set_field_by_name("nanos", Value::I32((time_ns % 1_000_000_000) as i32));
            axis.set_field_by_name("stamp", Value::Message(stamp));
            axis.set_field_by_name("valve", Value::Message(valve));
            let bar = [1.0, (pressure / 1e5) as f32, 3.0].map(Value::F32);
            axis.set_field_by_name("pressures", Value::List(bar.to_vec()));
            axis.set_field_by_name("name", Value::String("press".into()));
            axis.encode_to_vec()
        })
        .collect()
}

#[test]
fn protobuf_by_the_descriptor_set_in_the_schema() {
    let set = protobuf_set().encode_to_vec();
    let (samples, notes) =
        read(log(("plc.Axis", "protobuf", &set), "protobuf", &protobuf_messages())).unwrap();
    assert_eq!(samples, EXPECTED);
    assert_eq!(notes, [""; 0]);
}

const ROS: &str = "builtin_interfaces/Time stamp\nValve valve\nfloat32[] pressures\nstring name\n\
    ================================================================================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
    ================================================================================\nMSG: plc/Valve\nfloat64 percent\n";

fn ros_messages() -> Vec<Vec<u8>> {
    EXPECTED
        .iter()
        .map(|(time_ns, command, pressure)| {
            let mut body = Vec::new();
            let mut writer = CdrWriter::<LittleEndian>::new(&mut body);
            writer.write_i32((time_ns / 1_000_000_000) as i32);
            writer.write_u32((time_ns % 1_000_000_000) as u32);
            writer.write_f64(command * 100.0);
            writer.write_u32(3);
            [1.0, (pressure / 1e5) as f32, 3.0].into_iter().for_each(|bar| writer.write_f32(bar));
            writer.write_u32(1);
            writer.write_u8(0);
            [vec![0, 1, 0, 0], body].concat()
        })
        .collect()
}

#[test]
fn cdr_by_the_ros_2_definition_in_the_schema() {
    let bytes = log(("plc/msg/Axis", "ros2msg", ROS.as_bytes()), "cdr", &ros_messages());
    assert_eq!(read(bytes).unwrap().0, EXPECTED);
}

#[test]
fn json_gives_the_same_samples() {
    let messages: Vec<Vec<u8>> = EXPECTED
        .iter()
        .map(|(time_ns, command, pressure)| {
            let (sec, nanosec) = (time_ns / 1_000_000_000, time_ns % 1_000_000_000);
            let (percent, bar) = (command * 100.0, pressure / 1e5);
            format!(r#"{{"stamp":{{"sec":{sec},"nanosec":{nanosec}}},"valve":{{"percent":{percent}}},"pressures":[1,{bar},3]}}"#).into_bytes()
        })
        .collect();
    assert_eq!(read(log(("Axis", "jsonschema", b"{}"), "json", &messages)).unwrap().0, EXPECTED);
}

#[test]
fn schema_that_does_not_parse_is_refused_in_one_line() {
    let refused = |schema: (&str, &str, &[u8]), encoding| {
        read(log(schema, encoding, &protobuf_messages())).unwrap_err()
    };
    let text = refused(("plc.Axis", "protobuf", b"\xff\xff\xff"), "protobuf");
    assert!(
        text.starts_with("log: topic /plc its protobuf schema does not parse: ") && !text.contains('\n'),
        "{text}"
    );
    let set = protobuf_set().encode_to_vec();
    let text = refused(("plc.Press", "protobuf", &set), "protobuf");
    assert_eq!(text, "log: topic /plc its protobuf schema does not define the message `plc.Press`");
    let text = refused(("plc/msg/Axis", "ros2msg", b"float64 = = x\nnonsense"), "cdr");
    assert!(
        text.starts_with("log: topic /plc its ros2msg schema does not parse: ") && !text.contains('\n'),
        "{text}"
    );
    let text = refused(("plc/msg/Axis", "ros2idl", b"module plc {};"), "cdr");
    assert!(text.contains("with a schema in `ros2idl`"), "{text}");
    let text = refused(("plc.Axis", "flatbuffer", b""), "flatbuffer");
    assert_eq!(
        text,
        "log: topic /plc has the message encoding `flatbuffer`; this version reads json, protobuf and cdr"
    );
}

#[test]
fn message_that_does_not_fit_its_schema_is_left_out_and_told() {
    let set = protobuf_set().encode_to_vec();
    let mut messages = protobuf_messages();
    messages.insert(1, vec![0x12, 0x7f, 0x01]);
    let (samples, notes) = read(log(("plc.Axis", "protobuf", &set), "protobuf", &messages)).unwrap();
    assert_eq!(samples, EXPECTED);
    assert_eq!(notes.len(), 1);
    assert!(
        notes[0].starts_with(
            "log: 1 messages were left out as unreadable, the first at 5 ns: does not fit its schema"
        ),
        "{notes:?}"
    );

    let mut messages = ros_messages();
    messages.insert(0, vec![0, 1, 0, 0, 1, 2]);
    messages.push(vec![0, 9, 0, 0]);
    // A sequence that says it has four thousand million elements.
    messages.push([vec![0, 1, 0, 0], vec![0; 16], vec![0xff; 4]].concat());
    let (samples, notes) = read(log(("plc/msg/Axis", "ros2msg", ROS.as_bytes()), "cdr", &messages)).unwrap();
    assert_eq!(samples, EXPECTED);
    assert!(notes[0].starts_with("log: 3 messages were left out as unreadable"), "{notes:?}");
}

/// A message that holds itself would never end.
#[test]
fn definition_that_refers_to_itself_is_followed_only_so_far() {
    let ros = "Self inner\nfloat64 percent\n===\nMSG: plc/Self\nSelf inner\nfloat64 percent\n";
    let bytes = log(("plc/msg/Axis", "ros2msg", ros.as_bytes()), "cdr", &[vec![0, 1, 0, 0, 0, 0, 0, 0]]);
    let mut source = McapSource::new(Cursor::new(bytes), "log", mapping()).unwrap();
    assert!(source.next_sample().is_err());
    assert!(source.notes()[0].contains("more than 32 messages deep"), "{:?}", source.notes());
}

#[test]
fn default_mapping_does_not_trip_over_other_topics() {
    let bytes =
        log(("std_msgs/msg/String", "ros2msg", b"string data"), "cdr", &[vec![0, 1, 0, 0, 0, 0, 0, 0]]);
    let mut source = McapSource::new(Cursor::new(bytes), "log", LogMapping::default().places()).unwrap();
    let text = source.next_sample().unwrap_err().to_string();
    assert!(text.contains("the log has /plc (cdr, 1 messages)"), "{text}");
}

/// What the Python packages `mcap` and `mcap-ros2-support` read from the logs of others: messages by topic, and how often
/// each numeric field is there with its range. Null: they do not read the topic's messages.
fn python_read() -> BTreeMap<String, BTreeMap<String, PythonTopic>> {
    serde_json::from_str(&fs::read_to_string(fixture("mcap/expected.json")).unwrap()).unwrap()
}

#[derive(serde::Deserialize)]
struct PythonTopic {
    encoding: String,
    messages: u64,
    fields: Option<BTreeMap<String, (u64, f64, f64)>>,
}

#[test]
fn reference_python_reads_the_same_from_the_logs_of_others() {
    let mut fields_compared = 0;
    for (name, topics) in python_read() {
        let path = fixture("mcap").join(&name);
        let found = survey(fs::File::open(&path).unwrap(), &name, "t_s", None).unwrap();
        let names: Vec<&String> = found.topics.iter().map(|topic| &topic.topic).collect();
        assert_eq!(names, topics.keys().collect::<Vec<_>>(), "{name}");
        for topic in &found.topics {
            let expected = &topics[&topic.topic];
            assert_eq!((&topic.encoding, topic.messages), (&expected.encoding, expected.messages), "{name}");
            assert_eq!(topic.unreadable, 0, "{name} {}", topic.topic);
            let readable = ["json", "cdr"].contains(&&*topic.encoding) && expected.fields.is_some();
            assert_eq!(topic.problem.is_none(), readable, "{name} {}", topic.topic);
            let Some(fields) = &expected.fields else { continue };
            let of = |field: &FieldSurvey| (field.path.clone(), (field.count, field.least, field.largest));
            // ROS 2 fills empty structures with a byte, which the Python package reads and hides.
            let filler = |field: &&FieldSurvey| !field.path.ends_with(".structure_needs_at_least_one_member");
            let found: BTreeMap<_, _> = topic.fields.iter().filter(filler).map(of).collect();
            assert_eq!(&found, fields, "{name} {}", topic.topic);
            fields_compared += fields.len();
        }
    }
    assert!(fields_compared > 150, "{fields_compared}");
}

#[test]
fn every_log_of_others_is_read_or_refused_with_what_it_holds() {
    for (name, topics) in python_read() {
        let path = fixture("mcap").join(&name);
        // The synthetic logs have a command; nothing else here is an axis.
        let selection = Selection {
            topic: Some("/axis/sample".into()),
            command: Some("valve_command".into()),
            ..Selection::default()
        };
        let mapping = LogMapping { selection, ..LogMapping::default() };
        let mut source = seepd_logs::open(&path, &mapping).unwrap();
        let mut samples = 0;
        let end = loop {
            match source.next_sample() {
                Ok(Some(_)) => samples += 1,
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
        match end {
            Ok(()) => assert_eq!(samples, topics["/axis/sample"].messages, "{name}"),
            Err(error) => {
                assert!(!topics.contains_key("/axis/sample"), "{error}");
                let message = error.to_string();
                assert!(matches!(error, LogError::Data { .. }) && message.lines().count() == 1, "{message}");
                for (topic, expected) in &topics {
                    let told = format!("{topic} ({}, {} messages)", expected.encoding, expected.messages);
                    assert!(message.contains(&told), "{name}: {message}");
                }
                let nothing = topics.is_empty() && !name.ends_with("with_padding.mcap");
                assert_eq!(message.contains("no topics at all"), nothing, "{message}");
                let orphans = message.contains("12 messages of topics that it does not name");
                assert_eq!(orphans, name.ends_with("zstd_chunk_with_padding.mcap"), "{message}");
            }
        }
    }
}

#[test]
fn an_encoding_that_is_not_read_is_named() {
    for (file, topic, told) in [
        ("rosbag2/wrong_rmw_test_0.mcap", "/test_topic", "has the message encoding `wrong_format`"),
        ("rust_crate/compressed.mcap", "/tf", "has the message encoding `ros1`"),
        ("conformance/TenMessages.mcap", "example", "has the message encoding `a`"),
    ] {
        let mut mapping = LogMapping::default();
        mapping.selection.topic = Some(topic.into());
        let mut source = seepd_logs::open(&fixture("mcap").join(file), &mapping).unwrap();
        let error = source.next_sample().unwrap_err().to_string();
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn the_python_package_reads_our_logs() {
    let Some(mut python) = python("mcap") else { return };
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("ours.mcap");
    let estimates = folder.path().join("estimates.mcap");
    simulate(&log, &["--cycles", "3", "--leak-area", "1e-6"]);
    let lines = replay(&log, &["--mcap", estimates.to_str().unwrap()]);
    let script = "
import json, sys
from mcap.reader import make_reader
found = {}
for path in sys.argv[1:]:
    with open(path, 'rb') as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            value = json.loads(message.data)
            topic = found.setdefault(channel.topic, {'schema': schema.name, 'encoding': schema.encoding, 'times': [], 'values': []})
            topic['times'].append(message.log_time)
            topic['values'].append(value)
        found[path] = [record.name for record in reader.iter_metadata()] + [record.name for record in reader.iter_attachments()]
print(json.dumps(found))";
    let output = python.args(["-c", script]).args([&log, &estimates]).output().unwrap();
    let found: serde_json::Value = serde_json::from_str(&crate::support::stdout(&output)).unwrap();
    let signals = &found["/axis/signals"];
    assert_eq!(signals["schema"], "seepd.Signals");
    let commands: Vec<f64> =
        signals["values"].as_array().unwrap().iter().map(|v| v["command"].as_f64().unwrap()).collect();
    let mut source = seepd_logs::open(&log, &LogMapping::default()).unwrap();
    let mut ours = Vec::new();
    while let Some(sample) = source.next_sample().unwrap() {
        assert_eq!(signals["times"][ours.len()].as_i64(), Some(sample.time_ns));
        ours.push(sample.get(Signal::Command).unwrap());
    }
    assert_eq!((commands.len(), commands == ours), (30_000, true));
    assert_eq!(found["/axis/truth"]["values"][0]["leak_area"], 1e-6);
    assert_eq!(found[log.to_str().unwrap()].as_array().unwrap().len(), 2, "metadata and plant");
    let cycles = found["/axis/leakage"]["values"].as_array().unwrap();
    assert_eq!(cycles.as_slice(), &lines[..3]);
}
