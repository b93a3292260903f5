"""A surrogate for FEBio: replays a log and writes records, in the way FAKE_FEBIO says.

Run by the tests as a program: `fake_febio.py -i model.feb -o model.log`, or `-info`.
"""

import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path

DATA = Path(__file__).resolve().parent
TIMES = (0.0, 0.25, 0.5, 1.0)


def replay(log: Path, source: str, *, pause: float = 0.0) -> None:
    with log.open("w") as stream:
        if "-p" in sys.argv and os.environ.get("FAKE_FEBIO") != "other run":
            stream.write(f"\tPlot file  : {sys.argv[sys.argv.index('-p') + 1]}\n")
        for line in (DATA / source).read_text().splitlines(keepends=True):
            stream.write(line)
            stream.flush()
            if pause and "Nonlinear" in line:
                time.sleep(pause)


def records(model: Path, *, n_times: int) -> None:
    root = ET.parse(model).getroot()
    n_cells = len(root.findall("Mesh/Elements/elem"))
    for each in root.findall("Output/logfile/*"):
        fields = each.get("data").split(";")
        ids = [int(k) for k in (each.text or "").split(",") if k] or list(range(1, n_cells + 1))
        with (model.parent / each.get("file")).open("w") as stream:
            for step, now in enumerate(TIMES[:n_times]):
                stream.write(f"*Step  = {step}\n*Time  = {now}\n*Data  = {each.get('data')}\n")
                for k in ids:
                    values = [value(name, now) for name in fields]
                    stream.write(",".join([str(k), *(f"{v:.8g}" for v in values)]) + "\n")


def value(name: str, now: float) -> float:
    return {"z": -0.05 - 1.95 * now, "Fz": -0.8 * now, "J": 1.0}.get(name, 0.0)


def main() -> int:
    if "-info" in sys.argv and os.environ.get("FAKE_FEBIO") == "hang at once":
        time.sleep(600)
    if "-info" in sys.argv:
        print((DATA / "log-normal.txt").read_text()[:400])
        return 0
    mode = os.environ.get("FAKE_FEBIO", "complete")
    model = Path(sys.argv[sys.argv.index("-i") + 1]).resolve()
    log = model.parent / sys.argv[sys.argv.index("-o") + 1]
    (model.parent / "threads.txt").write_text(os.environ["OMP_NUM_THREADS"])
    model.with_suffix(".xplt").write_bytes(b"plot")
    if "-p" in sys.argv:
        (model.parent / sys.argv[sys.argv.index("-p") + 1]).write_bytes(b"plot of this run")
    if mode == "no log":
        print("error while loading shared libraries: libmkl_rt.so")
        return 127
    if mode in ("complete", "lies bad", "other run", "lingers"):
        replay(log, "log-normal.txt", pause=0.02)
        records(model, n_times=4)
        if mode == "lingers":
            time.sleep(600)
        return 1 if mode == "lies bad" else 0
    if mode in ("failed", "lies good"):
        replay(log, "log-failed.txt")
        records(model, n_times=2)
        return 0 if mode == "lies good" else 1
    replay(log, "log-stopped.txt")
    records(model, n_times=3)
    if mode == "hang":
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        (model.parent / "child.pid").write_text(str(child.pid))
        time.sleep(600)
    return 0


if __name__ == "__main__":
    sys.exit(main())
