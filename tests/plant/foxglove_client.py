"""A client of Foxglove's WebSocket by websockets, with the message types of foxglove-websocket: hears every channel, and prints a line a message.

`foxglove_client.py URL [ORIGIN]`. Messages are held against the schemas that the server has advertised.
"""

import json
import struct
import sys

import jsonschema
from foxglove_websocket.types import BinaryOpcode
from websockets.exceptions import InvalidHandshake
from websockets.sync.client import connect


def say(**line):
    sys.stdout.write(json.dumps(line) + "\n")  # at once: others may be writing
    sys.stdout.flush()


try:
    origin = sys.argv[2] if len(sys.argv) > 2 else None
    socket = connect(sys.argv[1], subprotocols=["foxglove.websocket.v1", "foxglove.sdk.v1"], origin=origin)
except InvalidHandshake as error:
    say(op="refused", why=str(error))
    sys.exit()
say(op="connected", protocol=socket.subprotocol)
channels, schemas, topics = {}, {}, {}
for message in socket:
    if isinstance(message, str):
        text = json.loads(message)
        say(**text)
        if text["op"] == "advertise":
            wanted = []
            for channel in text["channels"]:
                assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
                number = 1000 + channel["id"]
                topics[number] = channel["topic"]
                schemas[number] = json.loads(channel["schema"])
                jsonschema.Draft7Validator.check_schema(schemas[number])
                wanted.append({"id": number, "channelId": channel["id"]})
            socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    else:
        opcode, number, time_ns = struct.unpack_from("<BIQ", message)
        assert opcode == BinaryOpcode.MESSAGE_DATA
        content = json.loads(message[13:])
        jsonschema.validate(content, schemas[number])
        say(op="data", topic=topics[number], time=time_ns, content=content)
