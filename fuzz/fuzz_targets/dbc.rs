//! A DBC file: every signal that it names, looked up and read from a frame.
//! Parser: crates/logs/src/can/dbc.rs:at,sent_by,parse,names,message_name,message,frames,is_j1939,missing,all,find,look_up,no_such,signals_of,resolve,identifier,field,selectors,full_name,long_message_name,text_of,one_line crates/logs/src/can/bit_field.rs:new,first,least_bytes,raw,bits,value
#![no_main]
use seepd_logs::can::candump::Line;
use seepd_logs::can::dbc::Dbc;
use seepd_logs::can::j1939::SourceAddress;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let dbc = match Dbc::parse(data, "fuzzed.dbc") {
        Ok(dbc) => dbc,
        Err(error) => return drop(error.to_string()),
    };
    for name in dbc.names().take(50).collect::<Vec<_>>() {
        let short = name.rsplit_once('.').map_or("", |(_, short)| short);
        let misspelt = format!("{name}x");
        for name in [short, &misspelt, "nothing like any"] {
            let _ = dbc.find(name).map_err(|error| error.to_string());
        }
        let Ok(signal) = dbc.find(&name) else { continue };
        let identifier = signal.frames.identifier;
        let _ = (dbc.message_name(identifier), dbc.signals_of(identifier, 10));
        for content in ["0123456789ABCDEF", "FFFFFFFFFFFFFFFF", "01"] {
            let line = format!("(1.0) can0 {identifier}#{content}");
            let _ = signal.read(&Line::parse(line.as_bytes()).expect("a frame").frame);
        }
        let _ = signal.sent_by(SourceAddress::Of(1));
    }
});
