//! Schemas and messages of JSON, protobuf and ROS 2, each number of them seen: the first byte picks what the rest is. Where it
//! is both a schema and a message, two bytes say how long the schema is.
#![no_main]
use seepd::source::decode::Decoder;
use seepd::source::fields::{FieldVisitor, Step};
use seepd::source::mcap_file::SchemaRecord;

const ROS: &str = "std_msgs/Header header\nfloat64 command\nfloat32[] pressures\nPart[] parts\nstring name\n===\nMSG: std_msgs/Header\n\
    builtin_interfaces/Time stamp\nstring frame_id\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n===\nMSG: plc/Part\nint16[3] codes\nbool on\n";

/// Goes wherever there is something, and counts.
#[derive(Default)]
struct Everything {
    depth: usize,
    seen: usize,
}

impl FieldVisitor for Everything {
    fn enter(&mut self, _step: Step<'_>) -> bool {
        self.depth += 1;
        true
    }

    fn leave(&mut self) {
        self.depth -= 1;
    }

    fn number(&mut self, _value: f64) -> Result<(), String> {
        self.seen += 1;
        Ok(())
    }

    fn text(&mut self, _text: &str) -> Result<(), String> {
        Ok(())
    }
}

fn schema(name: &str, encoding: &str, data: &[u8]) -> SchemaRecord {
    SchemaRecord { id: 1, name: name.into(), encoding: encoding.into(), data: data.to_vec() }
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((which, rest)) = data.split_first() else { return };
    let both = || {
        let (length, rest) = rest.split_first_chunk()?;
        rest.split_at_checked(u16::from_le_bytes(*length).into())
    };
    let (encoding, record, message) = match which % 4 {
        0 => ("cdr", schema("plc/msg/Axis", "ros2msg", ROS.as_bytes()), rest),
        1 => {
            let Some((definition, message)) = both() else { return };
            ("cdr", schema("plc/msg/Axis", "ros2msg", definition), message)
        }
        2 => {
            let Some((set, message)) = both() else { return };
            ("protobuf", schema("p.Axis", "protobuf", set), message)
        }
        _ => ("json", schema("plc", "jsonschema", b"{}"), rest),
    };
    if let Ok(decoder) = Decoder::new(encoding, Some(&record)) {
        let mut everything = Everything::default();
        let good = decoder.visit(message, &mut everything).is_ok();
        // Whoever was led down is led up again, and a message has no more numbers than steps that it may take.
        assert!(!good || everything.depth == 0);
        assert!(everything.seen <= message.len() + (1 << 16));
    }
});
