#!/bin/sh
# pynrrd 1.1.3: `byte skip` of a gzip-encoded NRRD (the format counts those bytes after unpacking:
# teem.sourceforge.net/nrrd/format.html, "byte skip").
# Guess: the bytes are skipped once, after unpacking.
# Seen:  they are skipped before unpacking too, which ends in zlib's "incorrect header check"; SimpleITK 2.5.7
#        reads the file.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pynrrd==1.1.3 SimpleITK==2.5.7 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - "$folder/a.nrrd" <<'PYTHON'
import gzip
import sys
import zlib
from pathlib import Path

import nrrd
import numpy as np
import SimpleITK

path = Path(sys.argv[1])
values = np.arange(24, dtype=np.uint8)
header = """NRRD0004
type: uint8
dimension: 3
space: left-posterior-superior
sizes: 4 3 2
encoding: gzip
space directions: (1,0,0) (0,1,0) (0,0,1)
kinds: domain domain domain
space origin: (0,0,0)
byte skip: 5

"""
path.write_bytes(header.encode() + gzip.compress(b"12345" + values.tobytes()))
by_itk = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path))).ravel()
print("SimpleITK:", by_itk[:6].tolist(), "...")
try:
    print("pynrrd:", nrrd.read(str(path))[0].shape)
    refused = False
except zlib.error as error:
    print("pynrrd:", error)
    refused = True
sys.exit(not (refused and np.array_equal(by_itk, values)))
PYTHON
