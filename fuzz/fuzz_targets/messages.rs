//! Schemas and messages of protobuf and ROS 2: the first byte picks what the rest is.
#![no_main]
use seepd::source::decode::Decoder;
use seepd::source::mcap_file::SchemaRecord;

const ROS: &str = "std_msgs/Header header\nfloat64 command\nfloat32[] pressures\nPart[] parts\nstring name\n===\nMSG: std_msgs/Header\n\
    builtin_interfaces/Time stamp\nstring frame_id\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n===\nMSG: plc/Part\nint16[3] codes\nbool on\n";

fn schema(encoding: &str, data: &[u8]) -> SchemaRecord {
    SchemaRecord { id: 1, name: "plc/msg/Axis".into(), encoding: encoding.into(), data: data.to_vec() }
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((which, rest)) = data.split_first() else { return };
    let (encoding, record, message) = match which % 4 {
        0 => ("cdr", schema("ros2msg", ROS.as_bytes()), rest),
        1 => ("cdr", schema("ros2msg", rest), &[0u8, 1, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8][..]),
        2 => ("protobuf", schema("protobuf", rest), &[8u8, 1, 18, 0][..]),
        _ => ("json", schema("jsonschema", b"{}"), rest),
    };
    if let Ok(decoder) = Decoder::new(encoding, Some(&record)) {
        let _ = decoder.value(message);
    }
});
