"""The hidden-effect study on the reduced model: resumable, with a confusion matrix and a table of gates.

    python tests/benchmarks/hidden_study.py --out out/hidden --repeats 4

Every data set is one line of <out>/study.jsonl; what is there already is not done again.
Data come from a finer block, another shape of the deformation, Laplace noise and, where the
library has a simpler form, another form of the effect.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import zlib
from pathlib import Path

import numpy as np

from limbcli.diagnostics.engine import diagnose
from limbcli.diagnostics.heldout import fell
from limbcli.effects import EFFECTS, effect
from limbcli.effects.reading import Reading
from limbcli.effects.tissue import ground_modulus, layer_share, limb_axis, scaled, with_part
from limbcli.model import Material
from limbcli.stages.diagnosis_bench import SiteBench
from limbcli.stages.diagnosis_data import ModelError, site_data

TOLD = """force-zero depth-zero anisotropy skin-layer adipose-layer contraction swe-time-scale swe-guided-wave
preload"""
TIMES = (0.5, 1.0, 2.0, 4.0)
PAIRS = (("force-zero", "swe-guided-wave"), ("depth-zero", "anisotropy"), ("force-zero", "skin-layer"))
TRUE_C_KPA, TRUE_M = 6.5, 4.0
_LARGEST = 2.0


def _reduced():
    path = Path(__file__).resolve().parents[1] / "diagnostics" / "reduced.py"
    spec = importlib.util.spec_from_file_location("reduced", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["reduced"] = module
    spec.loader.exec_module(module)
    return module


reduced = _reduced()


class Otherwise:
    """An effect of the library in another form: exponential fibres, a thinner skin."""

    def __init__(self, name: str):
        self.name = name
        self.waves = effect(name).waves

    def apply(self, model, theta):
        if self.name == "anisotropy":
            c = ground_modulus(model)
            fibre = {
                "ksi": theta["fibre_tension_per_c"] * c,
                "alpha": 1.5,
                "beta": 2.0,
                "mu": theta["fibre_shear_per_c"] * c,
                "lam0": 1.0,
                "fiber": limb_axis(model),
            }
            return with_part(model, Material("fiber_exp_pow", fibre))
        if self.name == "skin-layer":
            ratio = 1 + (np.exp(theta["log_skin_ratio"]) - 1) * 1.5 / 1.2
            return scaled(model, 1 + layer_share(model, 0.0, 1.2) * (ratio - 1))
        return effect(self.name).apply(model, theta)


class Outside:
    """Not in the library: the tissue slackens at one depth (a muscle that slips aside)."""

    name = "outside"

    @staticmethod
    def after(shown, curves, protocol):
        from dataclasses import replace

        depth = protocol.depth
        dip = 0.6 * np.exp(-(((depth - 4.0) / 0.9) ** 2)) - 0.5 * np.exp(-(((depth - 6.5) / 0.7) ** 2))
        return replace(shown, force=shown.force - dip)


def detectable() -> dict[str, dict[str, float]]:
    """Theta of every effect at the size seen with 80 % power on a noise-free bench."""
    levels = reduced.measured(np.random.default_rng(1), book=reduced.ReducedBook())
    found = diagnose(bench(levels), n_draws=4000, propose=False)
    sizes = {}
    for spot in found.blind_spots:
        known = effect(spot.name)
        times = spot.detectable_times_typical
        sizes[spot.name] = {p.name: times * (p.typical - p.null) for p in known.parameters}
    return sizes


def bench(levels) -> SiteBench:
    book = reduced.ReducedBook()
    n = len(levels)
    none = np.zeros((n, len(book.windows.depths)))
    errors = [
        ModelError("model: mesh", np.full(n, 0.01), none, correlation=0.8),
        ModelError("model: gain of the force by the geometry", np.full(n, 0.03), none),
    ]
    site = site_data("p1", levels, reduced.NOISE, windows=book.windows, model_error=errors)
    return SiteBench(site, book, EFFECTS)


def arms(sizes: dict[str, dict[str, float]]) -> list[tuple[str, dict[str, dict[str, float]]]]:
    """(name of the arm, effect -> theta)."""
    every = [("nothing", {})] * 4
    for times in TIMES:
        for name in TOLD.split():
            every.append((f"{name} x{times:g}", {name: theta_of(name, sizes, times)}))
    every += [(" + ".join(pair), {n: theta_of(n, sizes, 2.0) for n in pair}) for pair in PAIRS]
    masked = ("masked: force-gain", {"force-gain": {"force_gain": 1.05}})
    return [*every, ("outside", {}), ("outside", {}), ("noise understated", {}), masked]


def theta_of(name: str, sizes, times: float) -> dict[str, float]:
    """So many times the detectable size; at most twice the plausible one (skin is not steel)."""
    known = effect(name)
    theta = dict(known.grid[0])
    first = known.parameters[0]
    largest = _LARGEST * abs(first.typical - first.null)
    times = min(times, largest / max(abs(sizes[name][first.name]), 1e-9))
    for p in known.parameters:
        theta[p.name] = float(np.clip(p.null + times * sizes[name][p.name], p.low, p.high))
    return theta


def make(arm: str, truth, rng):
    reading, ingredients = Reading(), []
    for name, theta in truth.items():
        known = effect(name)
        if known.solves:
            ingredients.append((Otherwise(name), theta))
        else:
            reading = known.observe(reading, theta)
    if arm == "outside":
        reading = Reading(after=(Outside.after,))
    plain = reading == Reading() and not truth
    return reduced.measured(
        rng, tuple(ingredients), None if plain else reading, c=TRUE_C_KPA / 1e3, m=TRUE_M,
        understated=2.5 if arm == "noise understated" else 1.0,
    )  # fmt: skip


def one(arm: str, truth, seed: int) -> dict:
    levels = make(arm, truth, np.random.default_rng([seed, zlib.crc32(arm.encode())]))
    found = diagnose(bench(levels), seed=seed, n_draws=4000)
    first, last = found.shrink[0], found.shrink[-1]
    error = [_error(each) for each in (found.base, found.final)]
    return {
        "arm": arm,
        "seed": seed,
        "truth": sorted(truth),
        "verdict": found.verdict,
        "chosen": sorted(found.chosen),
        "set": [sorted(each) for each in found.confidence_set],
        "chi2_per_nu": [first.chi2_per_nu, last.chi2_per_nu],
        "held_out_fell": fell(first.held_out, last.held_out),
        "error": error,
        "best_power": found.next_steps[0].power if found.next_steps else None,
    }


def _error(fitted) -> float:
    """|ln c error| + |ln m error|."""
    return float(abs(np.log(fitted.values["c_kpa"] / TRUE_C_KPA)) + abs(np.log(fitted.values["m"] / TRUE_M)))


def gates(rows: list[dict]) -> list[str]:
    null = [r for r in rows if r["arm"] == "nothing"]
    real = [r for r in rows if r["truth"] and not r["arm"].startswith("masked")]
    sets = [r for r in real if r["set"]]
    named = [r for r in real if r["verdict"] == "named"]
    right = [r for r in named if r["chosen"] == r["truth"]]
    outside = [r for r in rows if r["arm"] == "outside"]

    def share(part, whole) -> str:
        return f"{len(part)} of {len(whole)}" + (f" ({100 * len(part) / len(whole):.0f} %)" if whole else "")

    ambiguous = [r for r in rows if r["verdict"] == "ambiguous"]
    table = [
        ("nothing missing, named (at most 5 % + 2 se)", [r for r in null if r["verdict"] == "named"], null),
        ("nothing missing, not adequate", [r for r in null if r["verdict"] != "adequate"], null),
        ("truth in the set (95 %)", [r for r in sets if r["truth"] in r["set"]], sets),
        ("named right (90 %)", right, named),
        ("outside, named (at most 5 %)", [r for r in outside if r["verdict"] == "named"], outside),
        ("named, held-out error fell (95 %)", [r for r in named if r["held_out_fell"]], named),
        ("named, chi2/nu at the noise", [r for r in named if r["chi2_per_nu"][1] < 1.6], named),
        ("named, c and m nearer (90 %)", [r for r in named if r["error"][1] < r["error"][0]], named),
        (
            "ambiguous, proposal of power 0.8",
            [r for r in ambiguous if (r["best_power"] or 0) >= 0.8],
            ambiguous,
        ),
    ]
    return [f"{name:45s} {share(part, whole)}" for name, part, whole in table]


def confusion(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    truths = list(dict.fromkeys(" + ".join(r["truth"]) or r["arm"] for r in rows))
    answers = ["adequate", "untestable", "unexplained", "ambiguous, with truth", "ambiguous, without"]
    answers += list(
        dict.fromkeys("named " + " + ".join(r["chosen"]) for r in rows if r["verdict"] == "named")
    )
    table = np.zeros((len(truths), len(answers)))
    for r in rows:
        answer = r["verdict"]
        if answer == "named":
            answer = "named " + " + ".join(r["chosen"])
        elif answer == "ambiguous":
            answer += ", with truth" if r["truth"] in r["set"] else ", without"
        table[truths.index(" + ".join(r["truth"]) or r["arm"]), answers.index(answer)] += 1
    figure = Figure(figsize=(2.5 + 0.45 * len(answers), 1.5 + 0.35 * len(truths)), layout="constrained")
    ax = figure.subplots()
    ax.imshow(
        table / np.maximum(table.sum(axis=1, keepdims=True), 1), cmap="Blues", vmin=0, vmax=1, aspect="auto"
    )
    ax.set_xticks(range(len(answers)), answers, rotation=60, ha="right", fontsize=8)
    ax.set_yticks(range(len(truths)), truths, fontsize=8)
    for i, j in zip(*np.nonzero(table), strict=True):
        ax.text(j, i, f"{table[i, j]:.0f}", ha="center", va="center", fontsize=8)
    ax.set_xlabel("answer")
    ax.set_ylabel("hidden")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/hidden"))
    parser.add_argument("--repeats", type=int, default=4)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    store, plan = options.out / "study.jsonl", options.out / "plan.json"
    if not plan.is_file():
        plan.write_text(json.dumps(detectable()))
    sizes = json.loads(plan.read_text())
    rows = [json.loads(line) for line in store.read_text().splitlines()] if store.is_file() else []
    done = {(r["arm"], r["seed"]) for r in rows}
    for repeat in range(options.repeats):
        for k, (arm, truth) in enumerate(arms(sizes)):
            seed = 1000 * repeat + k
            if (arm, seed) in done:
                continue
            row = one(arm, truth, seed)
            with store.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
            rows.append(row)
            print(f"{arm:32s} {row['verdict']:12s} {' + '.join(row['chosen'])}", flush=True)
    confusion(rows, options.out / "confusion.png")
    table = "\n".join(gates(rows))
    (options.out / "gates.txt").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
