"""The library inside of exported FMUs on two platforms: does the press give the same bits on 64-bit ARM as on x86-64? Needs gcc, the cross
compiler gcc-aarch64-linux-gnu and qemu-user, and Python's mcap. Press and monitor get the command of a machine with a leak.

    cargo build --release -p seepd -p seepd-fmu-library
    rustup target add aarch64-unknown-linux-gnu
    CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \\
        cargo build --release -p seepd-fmu-library --target aarch64-unknown-linux-gnu
    python3 tools/exported_press/check_platforms.py
"""
import argparse
import json
import subprocess
import tempfile
import zipfile
import xml.etree.ElementTree as xml
from pathlib import Path

from mcap.reader import make_reader

HERE = Path(__file__).parent
PLATFORMS = {
    "x86_64-linux": ("linux64", "gcc", [], "target/release/libseepd_fmu_library.so"),
    "aarch64-linux": ("aarch64-linux", "aarch64-linux-gnu-gcc", ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"],
                      "target/aarch64-unknown-linux-gnu/release/libseepd_fmu_library.so"),
}
STEP_S = 0.001


def command(seepd, folder):
    """Four cycles of a valve command, a number a line."""
    log = folder / "leak.mcap"
    subprocess.run([seepd, "simulate", "--out", log, "--cycles", "4", "--leak-area", "2e-7", "--no-truth"], check=True)
    with open(log, "rb") as file:
        messages = (json.loads(message.data) for _, _, message in make_reader(file).iter_messages())
        return "\n".join(repr(message["command"]) for message in messages)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seepd", default="target/release/seepd")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        course = command(arguments.seepd, folder)
        for name, options in [("press", []), ("monitor", ["--monitor"])]:
            libraries = [word for platform, (*_, file) in PLATFORMS.items() for word in ("--library", f"{platform}={file}")]
            fmu = folder / f"{name}.fmu"
            subprocess.run([arguments.seepd, "export-fmu", *options, "--out", fmu, *libraries], check=True,
                           stdout=subprocess.DEVNULL)
            unpacked = folder / name
            zipfile.ZipFile(fmu).extractall(unpacked)
            description = xml.parse(unpacked / "modelDescription.xml").getroot()
            scalars = [(scalar.get("causality"), scalar.get("valueReference"))
                       for scalar in description.iter("ScalarVariable") if scalar.find("Real") is not None]
            ports = [f"i:{reference}" for causality, reference in scalars if causality == "input"][:1]
            ports += [f"o:{reference}" for causality, reference in scalars if causality == "output"]
            told = {}
            for platform, (place, compiler, runner, _) in PLATFORMS.items():
                program = folder / f"steps-{platform}"
                subprocess.run([compiler, "-O1", HERE / "steps.c", "-o", program, "-ldl"], check=True)
                library = next((unpacked / "binaries" / place).iterdir())
                order = [*runner, program, library, f"file://{unpacked / 'resources'}", description.get("guid"),
                         str(STEP_S), *ports]
                told[platform] = subprocess.run(order, input=course, check=True, capture_output=True, text=True).stdout
            lines = [told[platform].splitlines() for platform in PLATFORMS]
            apart = sum(one != other for one, other in zip(*lines, strict=True))
            values = len({line for line in lines[0]})
            print(f"{name}: {len(lines[0])} steps of {len(ports) - 1} outputs, {values} different; {apart} steps differ between "
                  f"{' and '.join(PLATFORMS)}")


if __name__ == "__main__":
    main()
