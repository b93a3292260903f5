#!/bin/sh
# ezc3d 1.7.2, pupyC3D 0.1.3 and c3d 0.6.0: a force of 0, 172, 322 and -128 N in two valid C3D files of sixteen-bit
# integers (scale 0.01 N a count): stored as signed counts, and as unsigned counts with an offset of 32768, which
# ANALOG:FORMAT says ("UNSIGNED", C3D User Guide: for analog data of full sixteen bits).
# Guess: each reader gives the force from both, as c3d does.
# Seen:  ezc3d takes counts and offset for signed ones: of the unsigned file -655.36, -483.36, -333.36 and -128 N:
#        what pushes is 655.36 N too low, what pulls is right. pupyC3D takes all counts for unsigned: of the
#        signed file -128 N is 527.36. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q ezc3d==1.7.2 pupyC3D==0.1.3 c3d==0.6.0 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import struct
import sys
from pathlib import Path

import c3d
import ezc3d
import numpy as np
from pupyC3D import C3DFile

SCALE, FORCE = 0.01, (0.0, 172.0, 322.0, -128.0)  # N a count, N
POINT, ANALOG, PLATES = 1, 2, 3


def whole(*values):
    return struct.pack(f"<{len(values)}H", *(value & 0xFFFF for value in values))


def real(*values):
    return struct.pack(f"<{len(values)}f", *values)


def entry(number, name, content):
    return struct.pack("<bb", len(name), number) + name.encode() + struct.pack("<h", len(content) + 2) + content


def parameter(group, name, kind, sizes, content):
    return entry(group, name, struct.pack("<bB", kind, len(sizes)) + bytes(sizes) + content + b"\0")


def text(group, name, value, count=None):
    sizes = [len(value)] if count is None else [len(value) // count, count]
    return parameter(group, name, -1, sizes, value.encode())


def recording(path, counts, kind, offset):
    def parameters(start):
        return b"".join((
            entry(-POINT, "POINT", b"\0"), parameter(POINT, "USED", 2, [], whole(1)),
            parameter(POINT, "SCALE", 4, [], real(0.1)), parameter(POINT, "RATE", 4, [], real(100)),
            parameter(POINT, "DATA_START", 2, [], whole(start)), parameter(POINT, "FRAMES", 2, [], whole(len(counts))),
            text(POINT, "LABELS", "KNEE", 1), text(POINT, "DESCRIPTIONS", "KNEE", 1), text(POINT, "UNITS", "mm"),
            entry(-ANALOG, "ANALOG", b"\0"), parameter(ANALOG, "USED", 2, [], whole(1)),
            parameter(ANALOG, "GEN_SCALE", 4, [], real(1)), parameter(ANALOG, "RATE", 4, [], real(100)),
            parameter(ANALOG, "SCALE", 4, [1], real(SCALE)), parameter(ANALOG, "OFFSET", 2, [1], whole(offset)),
            text(ANALOG, "LABELS", "FZ", 1), text(ANALOG, "DESCRIPTIONS", "FZ", 1), text(ANALOG, "UNITS", "N", 1),
            text(ANALOG, "FORMAT", kind), parameter(ANALOG, "BITS", 2, [], whole(16)),
            entry(-PLATES, "FORCE_PLATFORM", b"\0"), parameter(PLATES, "USED", 2, [], whole(0)), b"\0\0"))

    blocks = -(-(len(parameters(0)) + 4) // 512)
    head = bytes((2, 0x50)) + whole(1, 1, 1, len(counts), 0) + real(0.1) + whole(2 + blocks, 1) + real(100)
    middle = bytes((1, 0x50, blocks, 84)) + parameters(2 + blocks)
    data = b"".join(whole(10, 20, 30, 0, count) for count in counts)
    path.write_bytes(head.ljust(512, b"\0") + middle.ljust(512 * blocks, b"\0") + data.ljust(512, b"\0"))


def by_c3d(path):
    with path.open("rb") as file:
        return [float(analog[0, 0]) for _, _, analog in c3d.Reader(file).read_frames()]


READERS = {
    "c3d": by_c3d,
    "ezc3d": lambda path: ezc3d.c3d(str(path))["data"]["analogs"].ravel(),
    "pupyC3D": lambda path: np.ravel(C3DFile(str(path)).get_analog_data("FZ")),
}
counts = [round(force / SCALE) for force in FORCE]
seen = {}
for kind, offset in (("SIGNED", 0), ("UNSIGNED", 32768)):
    path = Path(sys.argv[1]) / f"{kind}.c3d"
    recording(path, [count + offset for count in counts], kind, offset)
    for name, read in READERS.items():
        seen[name, kind] = tuple(round(float(force), 2) + 0.0 for force in read(path))
        print(name, kind, *seen[name, kind], "N")
wrong = {("ezc3d", "UNSIGNED"): (-655.36, -483.36, -333.36, -128.0), ("pupyC3D", "SIGNED"): (0.0, 172.0, 322.0, 527.36)}
sys.exit(seen != {case: wrong.get(case, FORCE) for case in seen})
PYTHON
