"""An example of each command, shown below its help text."""

from __future__ import annotations

EXAMPLES = {
    "doctor": "limbcli doctor --febio /opt/febio/bin/febio4",
    "new": "limbcli new S12 --site p1 --site p2",
    "check": "limbcli check S12",
    "measure": "limbcli measure S12 --site p1 --write",
    "segment": "limbcli segment S12 --limb left --seed bone=12,40,-60",
    "mesh": "limbcli mesh S12 --site p1 --size-mm 3",
    "build-feb": "limbcli build-feb S12 --c-kpa 8 --out results/S12",
    "run": "limbcli run S12 --solver reference",
    "fit": "limbcli fit S12 --site p1 --compare-element",
    "diagnose": "limbcli diagnose S12 --site p1 --measured tare_n=0.4",
    "limb": "limbcli limb S12 --nodes 20000",
    "socket": "limbcli socket S12 --align",
    "report": "limbcli report S12 --out results/S12",
    "batch": "limbcli batch S12 S13 --out results",
    "cohort": "limbcli cohort people.csv --out results/people",
    "phantom": "limbcli phantom subject --seed 7 --max-force-n 10",
    "synth": "limbcli synth S12 --out-case S12-known --c-kpa 8 --m 6 --noise 0",
}
