"""Hidden effects on a real model of a site: simulated on another mesh, diagnosed as a user would; resumable.

    python -m tests.benchmarks.hidden_sites --case CASE --out OUT [--truth CASE] --work DIR

CASE must have been segmented and meshed into OUT. The measurement is simulated on --truth (the case
itself by default; for a phantom its true surfaces) with a mesh of its own, and every arm is one
line of <work>/sites.jsonl. A summary of verdicts ends the run. Several sites are simulated with the same
hidden effects; those that share a place (two orientations) are diagnosed together.
"""

from __future__ import annotations

import argparse
import shutil
import time
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.effects import effect
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.phantom.simulated_readings import write_readings
from limbcli.stages.build_feb import build_feb
from limbcli.stages.diagnose import DiagnoseOptions, diagnose
from limbcli.stages.run import run
from limbcli.stages.simulated_subjects.hidden_effects import hide
from limbcli.stages.simulated_subjects.indent import KnownTissue
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.simulated_subjects.synth_truth import SyntheticSite
from limbcli.stages.synth import measure_sites, read_off
from tests.benchmarks.seeded_rows import made, succeeded

ARMS = """none none none force-zero=1.5 depth-zero=2 swe-time-scale=0.6 swe-guided-wave=2 swe-depth-bias=0.015
anisotropy=1.5 skin-layer=2.7 adipose-layer=1.2 contraction=1 inclusion=1.4 viscoelasticity=0.6 preload=1.2
nonlinearity=0.9 tilt=7 friction=0.3 thickness=0.1 force-gain=1.08 depth-gain=1.05"""
TISSUE = KnownTissue(8.0, 80.0, 6.0)


def simulated(arm: str, options: argparse.Namespace) -> tuple[SynthOptions, list[SyntheticSite]]:
    """The truth with this hidden, once for all its measurements."""
    source = Case.open(options.truth or options.case)
    hidden = () if arm == "none" else tuple(hide(each) for each in arm.split("+"))
    how = SynthOptions(
        tissue=TISSUE, hidden=hidden, protocol=LoadingProtocol(max_force=options.max_force_n), margin=50.0,
        size=options.size_mm, far_size=3 * options.size_mm, contact_penalty=options.contact_penalty,
    )  # fmt: skip
    chosen = source.selected(options.site)
    return how, measure_sites(source, chosen, out=options.work / "truth-out", options=how)


def one(
    arm: str, seed: int, how: SynthOptions, truth: list[SyntheticSite], options: argparse.Namespace
) -> dict:
    """Measure, diagnose, and compare with what was hidden."""
    work: Path = options.work
    begun, processor = time.perf_counter(), time.process_time()
    trial = work / "case"
    shutil.rmtree(trial, ignore_errors=True)
    shutil.copytree(options.case, trial)
    numbers = {each.name: k for k, each in enumerate(Case.open(options.truth or options.case).sites)}
    for each in truth:
        shutil.rmtree(trial / each.site, ignore_errors=True)
        readings = read_off(each.true, each.law, replace(how, seed=seed), numbers[each.site])
        write_readings(trial / each.site, readings)
    out = work / "out"
    if not out.is_dir():
        shutil.copytree(options.out, out, ignore=shutil.ignore_patterns("fit", "report", "diagnose"))
    for prepared in () if options.skip_run else (build_feb, run):
        prepared(Case.open(trial), out=out, sites=options.site)
    found = diagnose(Case.open(trial), out=out, sites=options.site, options=DiagnoseOptions())[0].data
    kept = work / "kept" / f"{arm}-{seed}.json"
    kept.parent.mkdir(exist_ok=True)
    shutil.copyfile(out / "diagnose" / options.site[0] / "diagnosis.json", kept)
    names = sorted(each.name for each in how.hidden)
    first, last = found["shrink"][0], found["shrink"][-1]
    return {
        "arm": arm,
        "seed": seed,
        "truth": names,
        "verdict": found["verdict"],
        "set": [sorted(each) for each in found["confidence_set"]],
        "best": [(c["name"], round(c["probability"], 4)) for c in found["candidates"][:4]],
        "nothing": found["probability_of_nothing"],
        "adequate_from": found["adequate_from_probability"],
        "probability": next(
            (e["probability"] for e in found["explanations"] if sorted(e["explanation"]) == names), 0.0
        ),
        "chi2_per_nu": [first["chi2_per_nu"], last["chi2_per_nu"]],
        "error": [_error(each["values"]) for each in (first, last)],
        "not_evaluated": found["not_evaluated"],
        "seconds": round(time.perf_counter() - begun, 1),
        "processor_seconds": round(time.process_time() - processor, 1),
        "values": [each["values"] for each in (first, last)],
        "intervals": [each["intervals_95"] for each in (first, last)],
    }


def _error(values: dict) -> float:
    return float(abs(np.log(values["c_kpa"] / TISSUE.c_kpa)) + abs(np.log(values["m"] / TISSUE.m)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--site", nargs="+", default=["p1"])
    parser.add_argument("--max-force-n", type=float, default=12.0)
    parser.add_argument("--arms", nargs="*", default=ARMS.split())
    parser.add_argument("--size-mm", type=float, default=4.0)
    parser.add_argument("--contact-penalty", type=float, help="of the truth; 160 is near a real one")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=1, help="measurements of every truth")
    parser.add_argument("--skip-run", action="store_true", help="without `build-feb` and `run`")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    store = options.work / "sites.jsonl"
    for arm in options.arms:
        [effect(each.partition("=")[0]) for each in arm.split("+") if arm != "none"]
    of_arm = lru_cache(maxsize=1)(partial(simulated, options=options))
    jobs = {
        (arm, seed): (arm, seed)
        for k, arm in enumerate(options.arms)
        for seed in (options.seed + k + 100 * n for n in range(options.repeats))
    }
    rows = made(store, jobs, lambda job: one(*job, *of_arm(job[0]), options), key=("arm", "seed"))
    reported = succeeded(rows)
    real = [r for r in reported if r["truth"]]
    print(f"nothing missing: {[r['verdict'] for r in reported if not r['truth']]}")
    for word in ("named", "ambiguous", "unexplained", "adequate", "untestable"):
        these = [r for r in real if r["verdict"] == word]
        inside = sum(r["truth"] in r["set"] for r in these)
        print(f"{word:12s} {len(these):3d}, truth in the set {inside}")


if __name__ == "__main__":
    main()
