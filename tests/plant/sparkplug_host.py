"""A Sparkplug host by pysparkplug: prints what nodes and devices say, a line of JSON a message; `rebirth` on standard input asks for births."""

import json
import sys
import threading

import pysparkplug as spb

lock = threading.Lock()


def told(metric):
    return {"value": metric.value, "null": metric.is_null, "type": metric.datatype.name}


def heard(_client, message):
    topic, payload = message.topic, message.payload
    metrics = [payload.bd_seq_metric] if isinstance(payload, spb.NDeath) else getattr(payload, "metrics", ())
    line = {
        "type": topic.message_type.value,
        "device": topic.device_id,
        "topic": str(topic),
        "seq": getattr(payload, "seq", None),
        "timestamp": payload.timestamp,
        "retain": bool(message.retain),
        "metrics": {metric.name: told(metric) for metric in metrics},
        "stamped": all(metric.timestamp is not None for metric in metrics),
    }
    with lock:
        sys.stdout.write(json.dumps(line) + "\n")  # at once: others may be writing
        sys.stdout.flush()


group, node = sys.argv[2], sys.argv[3]
host = spb.Client(client_id="scada")
host.subscribe(spb.Topic(group_id="#"), spb.QoS.AT_LEAST_ONCE, heard)
host.connect("127.0.0.1", port=int(sys.argv[1]), blocking=False)
for line in sys.stdin:
    if line.strip() == "rebirth":
        metric = spb.Metric(timestamp=1, name="Node Control/Rebirth", datatype=spb.DataType.BOOLEAN, value=True)
        topic = spb.Topic(group_id=group, message_type=spb.MessageType.NCMD, edge_node_id=node)
        command = spb.NCmd(timestamp=1, metrics=(metric,))
        host.publish(spb.Message(topic=topic, payload=command, qos=spb.QoS.AT_LEAST_ONCE, retain=False), include_dtypes=True)
