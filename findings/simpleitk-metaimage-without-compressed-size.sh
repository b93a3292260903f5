#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): compressed MetaImage whose header has no CompressedDataSize.
# Guess: the data are all that follows the header (.mha) or all of the data file (.mhd): both are read.
# Seen:  the .mhd is read; of the .mha "Uncompress failed" is printed, and an image of arbitrary values returned
#        without an error.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
import zlib
from pathlib import Path

import numpy as np
import SimpleITK

folder = Path(sys.argv[1])
values = np.arange(24, dtype="<i2")
packed = zlib.compress(values.tobytes())
header = """ObjectType = Image
NDims = 3
BinaryData = True
BinaryDataByteOrderMSB = False
CompressedData = True
TransformMatrix = 1 0 0 0 1 0 0 0 1
Offset = 0 0 0
ElementSpacing = 1 1 1
DimSize = 4 3 2
ElementType = MET_SHORT
ElementDataFile = """


def read(name):
    found = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(folder / name))).ravel()
    print(name, found[:6].tolist(), "...")
    return np.array_equal(found, values)


(folder / "whole.mha").write_bytes(f"{header}LOCAL\n".encode() + packed)
(folder / "beside.mhd").write_text(f"{header}beside.zraw\n")
(folder / "beside.zraw").write_bytes(packed)
sys.exit(not (read("beside.mhd") and not read("whole.mha")))
PYTHON
