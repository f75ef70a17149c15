//! Schemas and messages of JSON, protobuf and ROS 2, each number of them seen: the first byte picks what the rest is. Where it
//! is both a schema and a message, two bytes say how long the schema is.
//! Parser: crates/logs/src/decode.rs:new,visit crates/logs/src/json.rs:visit,visit_f64,visit_i64,visit_u64,visit_bool,visit_unit,visit_str,visit_map,visit_seq,deserialize crates/logs/src/protobuf.rs crates/logs/src/protobuf_wire.rs crates/logs/src/ros.rs
#![no_main]
use seepd_logs::fuzzing::walk;

const ROS: &str = "std_msgs/Header header\nfloat64 command\nfloat32[] pressures\nPart[] parts\nstring name\n===\nMSG: std_msgs/Header\n\
    builtin_interfaces/Time stamp\nstring frame_id\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n===\nMSG: plc/Part\nint16[3] codes\nbool on\n";

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((which, rest)) = data.split_first() else { return };
    let both = || {
        let (length, rest) = rest.split_first_chunk()?;
        rest.split_at_checked(u16::from_le_bytes(*length).into())
    };
    let (encoding, schema, message) = match which % 4 {
        0 => ("cdr", ("plc/msg/Axis", "ros2msg", ROS.as_bytes()), rest),
        1 => {
            let Some((definition, message)) = both() else { return };
            ("cdr", ("plc/msg/Axis", "ros2msg", definition), message)
        }
        2 => {
            let Some((set, message)) = both() else { return };
            ("protobuf", ("p.Axis", "protobuf", set), message)
        }
        _ => ("json", ("plc", "jsonschema", &b"{}"[..]), rest),
    };
    if let Some(walk) = walk(encoding, schema, message) {
        // Whoever was led down is led up again, and a message has no more numbers than steps that it may take.
        assert!(!walk.good || walk.depth == 0);
        assert!(walk.numbers <= message.len() + (1 << 16));
    }
});
