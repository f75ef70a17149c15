"""A diagnostic tester by can-j1939 on a Unix datagram socket in the place of a bus: prints the codes that it is told.

`j1939_tester.py SOCKET`. Words on standard input: `ask PGN [ADDRESS]` sends a request, `claim ADDRESS NAME` claims an address (numbers in hexadecimal).
"""

import json
import os
import socket
import struct
import sys
import threading
import time

import j1939

bus = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
bus.bind(sys.argv[1])
speaker = [None]
EXTENDED = 0x80000000


def say(**line):
    sys.stdout.write(json.dumps(line) + "\n")  # at once: others may be writing
    sys.stdout.flush()


def send(can_id, extended_id, data, fd_format=False):
    frame = struct.pack("=IB3x8s", can_id | EXTENDED, len(data), bytes(data))
    bus.sendto(frame, speaker[0])


ecu = j1939.ElectronicControlUnit(send_message=send)
tester = j1939.ControllerApplication(j1939.Name(identity_number=1), 0xF9, bypass_address_claim=True)
ecu.add_ca(controller_application=tester)


def codes(data):
    words = [int.from_bytes(data[at : at + 4], "little") for at in range(2, len(data) - 3, 4)]
    return [{"spn": dtc.spn, "fmi": dtc.fmi, "times": dtc.oc, "cm": dtc.cm} for dtc in map(lambda word: j1939.DTC(dtc=word), words)]


def on_dm1(sa, lamps, found, timestamp):
    say(message="DM1", address=sa, lamps=lamps, codes=found, time=time.monotonic())


dm1 = j1939.Dm1(tester)
dm1.subscribe(on_dm1)


def on_message(priority, pgn, sa, timestamp, data):
    if pgn == 65227:
        lamps = {name: j1939.diagnostic_messages.DtcLamp().get_status(data[0] >> at & 3, data[1] >> at & 3) for name, at in [("pl", 0), ("awl", 2), ("rsl", 4), ("mil", 6)]}
        say(message="DM2", address=sa, lamps=lamps, codes=codes(data), size=len(data))


tester.subscribe(on_message)


def listen():
    while True:
        frame, speaker[0] = bus.recvfrom(80)
        (word, length) = struct.unpack_from("=IB", frame)
        assert word & EXTENDED, "all of it has 29 bits"
        can_id, data = word & 0x1FFFFFFF, frame[8 : 8 + length]
        pgn = can_id >> 8 & 0x3FFFF
        if pgn & 0xFF00 in (0xEC00, 0xEB00, 0xEE00, 0xE800):
            say(message=f"{pgn:05X}", address=can_id & 0xFF, data=data.hex(), priority=can_id >> 26, time=time.monotonic())
        ecu.notify(can_id, bytearray(data), time.time())


threading.Thread(target=listen, daemon=True).start()
for line in sys.stdin:
    word, *numbers = line.split()
    numbers = [int(number, 16) for number in numbers]
    if word == "ask":
        tester.send_request(0, numbers[0], numbers[1] if len(numbers) > 1 else 0xFF)
    elif word == "claim":
        send(0x18EEFF00 | numbers[0], True, numbers[1].to_bytes(8, "little"))
os._exit(0)
