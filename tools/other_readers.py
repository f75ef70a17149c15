#!/usr/bin/env python3
"""Writes logs with the libraries that people use, and beside them what these libraries read back: other_readers.py FOLDER

python-can writes ASC, BLF, TRC, MF4 and candump logs, asammdf MDF logs of measured signals, rosbags ROS 2 bags. `expected.json` has, for a
log of frames, a row for each frame (time in s, identifier, 29 bits, kind, data in hexadecimal); for one of signals, the channels' values.
The fixtures in tests/fixtures/logs were made so, with seed 1; a test makes others where the libraries are installed.
"""
import json
import random
import shutil
import sys
from pathlib import Path

import can
import numpy as np
from asammdf import MDF, Signal
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

random.seed(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
expected = {}
BEGIN = 1_700_000_000.0


def frame(number, fd):
    # DIFFERENCE: python-can takes an FD frame without data in an ASC log for a remote frame, which FD does not have; none is written.
    time = BEGIN + number * 0.001 + random.randrange(900) * 1e-6
    kind = random.random()
    extended = random.random() < 0.4
    identifier = random.randrange(1 << 29 if extended else 1 << 11)
    common = dict(timestamp=round(time, 6), arbitration_id=identifier, is_extended_id=extended, channel=random.randrange(2))
    if kind < 0.05:
        return can.Message(**common, is_remote_frame=True, dlc=8)
    if fd and kind < 0.4:
        length = random.choice([1, 7, 8, 12, 16, 20, 24, 32, 48, 64])
        return can.Message(**common, is_fd=True, bitrate_switch=True, data=random.randbytes(length))
    return can.Message(**common, data=random.randbytes(random.randrange(9)))


def kind(message):
    return "error" if message.is_error_frame else "remote" if message.is_remote_frame else "data"


def rows(name):
    read = list(can.LogReader(folder / name))
    first = read[0].timestamp
    return [
        [round(m.timestamp - first, 7), m.arbitration_id, bool(m.is_extended_id), kind(m), "" if m.is_remote_frame else bytes(m.data).hex()]
        for m in read
        if not m.is_error_frame
    ]


def write(name, messages, writer=None, **options):
    writer = writer or can.Logger
    with writer(folder / name, **options) as log:
        for message in messages:
            log.on_message_received(message)
    expected[name] = {"frames": rows(name)}


def trc_1_0(path):
    writer = can.TRCWriter(path)
    writer.file_version = can.TRCFileVersion.V1_0
    return writer


messages = [frame(number, fd=False) for number in range(120)]
with_fd = [frame(number, fd=True) for number in range(120)]
# An 11-bit identifier as three digits is one of the TRC reader's "more than four", so that the writer's 29-bit ones differ; no FD in TRC.
write("python_can.asc", with_fd)
write("python_can.blf", with_fd)
write("python_can_stored.blf", with_fd, can.BLFWriter, compression_level=0)
write("python_can.log", with_fd)
write("python_can_2_1.trc", messages)
write("python_can_1_0.trc", messages, trc_1_0)
write("python_can.mf4", with_fd)
write("python_can.asc.gz", with_fd)

# Measured signals: two groups with clocks of their own, integers with a conversion, a state with names, values that are not valid.
count = 500
times = np.arange(count) * 0.002
command = (np.sin(times * 7) * 1000).astype("<i2")
linear = {"a": 0.1, "b": 0.5}
signals = [
    Signal(command, times, name="valve", unit="%", conversion=linear),
    Signal(np.cos(times).astype("<f4"), times, name="position", unit="m"),
    Signal((times * 100).astype(">u4"), times, name="counter"),
    Signal(np.arange(count) % 3, times, name="state", conversion={"val_0": 0, "text_0": "off", "val_1": 1, "text_1": "on", "default": b"fault"}),
]
slow = np.arange(count // 10) * 0.02 + 0.001
pressures = [
    Signal(
        np.linspace(0, 250, len(slow)),
        slow,
        name="p_supply",
        unit="bar",
        invalidation_bits=np.arange(len(slow)) % 7 == 0,
    ),
    Signal(np.arange(len(slow)).astype("u1"), slow, name="table", conversion={"raw_0": 0.0, "phys_0": 0.0, "raw_1": 50.0, "phys_1": 500.0, "interpolation": True} ),
]


def values(name):
    with MDF(folder / name) as log:
        found = {}
        for channel in ["valve", "position", "counter", "p_supply", "table"]:
            signal = log.get(channel, raw=False)
            valid = np.ones(len(signal.samples), bool)
            if signal.invalidation_bits is not None:
                valid = ~np.asarray(signal.invalidation_bits, bool)
            found[channel] = [[round(float(t), 9), float(v)] for t, v, ok in zip(signal.timestamps, signal.samples, valid) if ok]
    return found


for name, compression in [("asammdf_plain.mf4", 0), ("asammdf_zipped.mf4", 1), ("asammdf_transposed.mf4", 2)]:
    log = MDF(version="4.10")
    log.append(signals, comment="valve")
    log.append(pressures, comment="pressures")
    log.save(folder / name, overwrite=True, compression=compression)
    expected[name] = {"signals": values(name)}

# ROS 2 bags in SQLite's format: as they are, each message packed, the file packed.
store = get_typestore(Stores.ROS2_JAZZY)
kinds = store.types
MESSAGE = "geometry_msgs/msg/Vector3Stamped"


def stamped(number):
    stamp = kinds["builtin_interfaces/msg/Time"](sec=int(BEGIN), nanosec=number * 1_000_000)
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="press")
    vector = kinds["geometry_msgs/msg/Vector3"](x=random.uniform(-1, 1), y=number * 0.5, z=-1.0)
    return kinds[MESSAGE](header=header, vector=vector)


for name, mode in [("bag", None), ("bag_messages", CompressionMode.MESSAGE), ("bag_file", CompressionMode.FILE)]:
    shutil.rmtree(folder / name, ignore_errors=True)
    writer = Writer(folder / name, version=9, storage_plugin=StoragePlugin.SQLITE3)
    if mode:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        axis = writer.add_connection("/axis", MESSAGE, typestore=store)
        other = writer.add_connection("/other", "std_msgs/msg/Float64", typestore=store)
        for number in range(100):
            time = int(BEGIN) * 1_000_000_000 + number * 1_000_000
            writer.write(axis, time, store.serialize_cdr(stamped(number), axis.msgtype))
            if number % 10 == 0:
                writer.write(other, time + 1, store.serialize_cdr(kinds["std_msgs/msg/Float64"](data=1.0), other.msgtype))
    found = {"vector.x": [], "vector.y": []}
    with Reader(folder / name) as reader:
        for connection, time, data in reader.messages():
            if connection.topic == "/axis":
                vector = store.deserialize_cdr(data, connection.msgtype).vector
                for part in "xy":
                    found[f"vector.{part}"].append([(time - int(BEGIN) * 1_000_000_000) / 1e9, getattr(vector, part)])
    expected[name] = {"signals": found}

(folder / "expected.json").write_text(json.dumps(expected, indent=None, separators=(",", ":")) + "\n")
