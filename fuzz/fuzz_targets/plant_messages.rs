//! What others in the plant say to the daemon, by the first byte: orders by MQTT, commands of Sparkplug, answers of an OTLP endpoint, J1939
//! frames. Topics end at the first zero.
//! Parser: crates/daemon/src/sink/mqtt/mod.rs:take_order crates/daemon/src/sink/mqtt/sparkplug.rs:take_command crates/daemon/src/sink/opentelemetry.rs:verdict,retry_after,heed crates/daemon/src/sink/j1939/frames.rs:heard crates/daemon/src/hub/order.rs:from_json,said,at
#![no_main]
use std::cell::RefCell;

use seepd::config::{DaemonConfig, MqttConfig};
use seepd::hub::{AxisStatus, Hub, Order};
use seepd::sink::j1939;
use seepd::sink::mqtt::Broker;
use seepd::sink::mqtt::sparkplug::Node;
use seepd::sink::opentelemetry::Exporter;
use tokio::sync::mpsc;

struct Plant {
    broker: Broker,
    node: Node,
    exporter: Exporter,
    orders: mpsc::Receiver<Order>,
}

thread_local! {
    static PLANT: RefCell<Plant> = RefCell::new(plant());
}

fn plant() -> Plant {
    let config = DaemonConfig::parse("[sparkplug]\ngroup = \"g\"\nnode = \"n\"\n[opentelemetry]\n");
    let sinks = config.expect("a configuration").sinks;
    let hub = Hub::new("fuzzed".into());
    let (sender, orders) = mpsc::channel(1);
    hub.add_axis(AxisStatus::new("press", 7e6), sender);
    let folder = std::env::temp_dir().join(format!("fuzzed-spool-{}", std::process::id()));
    let broker = Broker::new(&MqttConfig::default(), &folder, hub.clone()).ok().expect("a broker");
    std::fs::remove_dir_all(&folder).expect("its own folder");
    let node = Node::new(&sinks.sparkplug.expect("is there"), hub.clone()).ok().expect("a node");
    let exporter = Exporter::new(&sinks.opentelemetry.expect("is there"), hub).ok().expect("an exporter");
    Plant { broker, node, exporter, orders }
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((which, rest)) = data.split_first() else { return };
    let retained = which & 8 != 0;
    let topic_and_content = || {
        let end = rest.iter().position(|byte| *byte == 0).unwrap_or(rest.len());
        (String::from_utf8_lossy(&rest[..end]), rest.get(end + 1..).unwrap_or_default())
    };
    PLANT.with_borrow_mut(|plant| match which % 4 {
        0 => {
            let (topic, content) = topic_and_content();
            plant.broker.hear(&topic, retained, content);
            while let Ok(order) = plant.orders.try_recv() {
                if let Order::Repair(entry) = order {
                    let _ = entry.at(0);
                }
            }
        }
        1 => {
            let (topic, content) = topic_and_content();
            plant.node.hear(&topic, retained, content);
        }
        2 => {
            let Some((status, rest)) = rest.split_first_chunk() else { return };
            let end = rest.iter().position(|byte| *byte == 0).unwrap_or(rest.len());
            let body = rest.get(end + 1..).unwrap_or_default();
            plant.exporter.hear(u16::from_le_bytes(*status), &rest[..end], body);
        }
        _ => {
            let _ = j1939::concerns(rest, 0x80);
        }
    });
});
