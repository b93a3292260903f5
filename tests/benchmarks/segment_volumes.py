"""Time and memory of `segment` against the number of voxels.

    python tests/benchmarks/segment_volumes.py [--calf]

A limb in formulas at three resolutions, the largest 176 x 256 x 176 at 1 mm, and with
--calf the real calf of the reference data; each in a process of its own. Prints a table.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve()
SHARED = Path(os.environ.get("LIMBCLI_SHARED", HERE.parents[3] / "shared")) / "data"
GRIDS = {
    "coarse": ((88, 128, 88), (2.0, 2.0, 2.0)),
    "axial": ((176, 256, 44), (1.0, 1.0, 4.0)),
    "protocol": ((176, 256, 176), (1.0, 1.0, 1.0)),
}


def measure(name: str) -> dict[str, float | str]:
    """Segments one volume here and tells what it took."""
    sys.path.insert(0, str(HERE.parents[1] / "imaging"))
    from limb_images import Limb, write_dicom

    from limbcli.case import Case, Imaging, ModelOptions, Probe
    from limbcli.stages.segment import segment

    with tempfile.TemporaryDirectory() as folder:
        series = SHARED / "calf-mri"
        if name != "calf":
            shape, spacing = GRIDS[name]
            limb = Limb(
                half_width=70.0,
                half_depth=75.0,
                bones=((-6.0, -30.0, 16.0, 4.0), (30.0, 0.0, 8.0, 2.5)),
            )
            series = Path(folder) / "mri"
            write_dicom(series, limb.image(shape=shape, spacing=spacing, samples=1)[0])
        probe = Probe(name="", length=53.0, width=14.0, edge_radius=3.0)
        case = Case(
            folder=Path(folder),
            subject="S1",
            limb="left",
            imaging=Imaging(mri=series),
            probe=probe,
            model=ModelOptions(),
            sites=(),
            raw={},
        )
        start, start_cpu = time.perf_counter(), time.process_time()
        result = segment(case, out=Path(folder) / "out")
        seconds, cpu = time.perf_counter() - start, time.process_time() - start_cpu
    image = result.data["image"]
    voxels = image["matrix"][0] * image["matrix"][1] * image["n_slices"]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {"name": name, "voxels": voxels, "seconds": seconds, "cpu_s": cpu, "peak_gb": peak}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calf", action="store_true")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one)))
        return
    print(f"{'volume':10} {'voxels':>10} {'seconds':>8} {'CPU s':>8} {'peak GB':>8}")
    for name in [*GRIDS, *(["calf"] if options.calf else [])]:
        done = subprocess.run(
            [sys.executable, str(HERE), "--one", name], check=True, capture_output=True, text=True
        )
        row = json.loads(done.stdout.splitlines()[-1])
        print(
            f"{name:10} {row['voxels']:10d} {row['seconds']:8.1f} {row['cpu_s']:8.1f} {row['peak_gb']:8.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
