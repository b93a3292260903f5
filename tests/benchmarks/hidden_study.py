"""The hidden-effect study on the reduced model: resumable, with a confusion matrix and a table of gates.

    python -m tests.benchmarks.hidden_study --out out/hidden --repeats 4

Every data set is one line of <out>/study.jsonl; what is there already is not done again. The data are
those of tests/diagnosis/hidden_cases.py.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from tests.benchmarks.seeded_rows import made, succeeded
from tests.diagnosis import hidden_cases

TOLD = """force-zero depth-zero anisotropy skin-layer adipose-layer contraction swe-time-scale swe-guided-wave
preload"""
TIMES = (0.5, 1.0, 2.0, 4.0)
PAIRS = (("force-zero", "swe-guided-wave"), ("depth-zero", "anisotropy"), ("force-zero", "skin-layer"))


def arms(sizes: dict[str, dict[str, float]]) -> list[tuple[str, dict[str, dict[str, float]]]]:
    """(name of the arm, effect -> theta)."""
    theta_of = hidden_cases.theta_of
    every = [("nothing", {})] * 8
    for times in TIMES:
        for name in TOLD.split():
            every.append((f"{name} x{times:g}", {name: theta_of(name, sizes, times)}))
        every.append((f"late contraction x{times:g}", {"contraction": theta_of("contraction", sizes, times)}))
    every += [(" + ".join(pair), {n: theta_of(n, sizes, 2.0) for n in pair}) for pair in PAIRS]
    masked = ("masked: force-gain", {"force-gain": {"force_gain": 1.05}})
    return [*every, *[("outside", {})] * 4, *[("noise understated", {})] * 2, masked]


def one(job: tuple[str, dict, int, bool]) -> dict:
    case = hidden_cases.Case(*job[:3], own_tissue=job[3])
    return hidden_cases.account(case, case.diagnose())


def line(row: dict) -> str:
    answer = row.get("verdict", "failed")
    return f"{row['arm']:32s} {answer:12s} {' + '.join(row.get('chosen', ()))}"


def gates(rows: list[dict]) -> list[str]:
    null = [r for r in rows if r["arm"] == "nothing"]
    real = [r for r in rows if r["truth"] and not r["arm"].startswith("masked")]
    named = [r for r in real if r["verdict"] == "named"]
    right = [r for r in named if r["chosen"] == r["truth"]]
    half = [r for r in named if set(r["chosen"]) <= set(r["truth"])]
    outside = [r for r in rows if r["arm"] == "outside"]

    followed = [r for r in real if r.get("set_after") is not None and r.get("expected_probability", 0) >= 0.8]
    table = [
        ("nothing missing, named (at most 5 % + 2 se)", [r for r in null if r["verdict"] == "named"], null),
        ("nothing missing, not adequate", [r for r in null if r["verdict"] != "adequate"], null),
        ("truth in the set (95 %)", [r for r in real if r["truth"] in r["set"]], real),
        ("named right (90 %)", right, named),
        ("... or one of two that are hidden", half, named),
        ("outside, named (at most 5 %)", [r for r in outside if r["verdict"] == "named"], outside),
        ("named, held-out error fell (95 %)", [r for r in named if _fell(*r["held_out"])], named),
        ("named, chi2/nu at the noise", [r for r in named if r["chi2_per_nu"][1] < 1.6], named),
        ("named, c and m nearer (90 %)", _nearer(named), named),
        ("named, true c and m in their 95 % intervals", [r for r in named if _covered(r)], named),
        ("... in those of the model without it", [r for r in named if _covered(r, 0)], named),
        ("recommended measurement made, set shrinks", [r for r in followed if _shrinks(r)], followed),
        ("... and holds the truth", [r for r in followed if r["truth"] in r["set_after"]], followed),
    ]
    lines = [f"{name:45s} {_share(len(part), len(whole))}" for name, part, whole in table]
    stated = sum(r["probability"]["named"] for r in named)
    return [*lines, f"{'named, right as their probabilities say':45s} {stated:.1f} of {len(named)}"]


def _share(k: int, n: int) -> str:
    """Counts, per cent, and the exact binomial 95 % interval."""
    if not n:
        return "0 of 0"
    low, high = binomtest(k, n).proportion_ci(0.95, method="exact")
    return f"{k} of {n} ({100 * k / n:.0f} %; {100 * low:.0f} to {100 * high:.0f})"


def _nearer(rows: list[dict]) -> list[dict]:
    return [r for r in rows if r["error"][1] < r["error"][0]]


def _covered(row: dict, stage: int = 1) -> bool:
    intervals = row["intervals"][stage]
    return all(intervals[name][0] <= true <= intervals[name][1] for name, true in row["true"].items())


def _shrinks(row: dict) -> bool:
    return len(row["set_after"]) < len(row["set"])


def _fell(before: float | None, after: float | None) -> bool:
    """Whether data that were left out are predicted better with what was named."""
    return before is not None and after is not None and after < before


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
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    ax.set_xticks(range(len(answers)), answers, rotation=60, ha="right", fontsize=8)
    ax.set_yticks(range(len(truths)), truths, fontsize=8)
    for i, j in zip(*np.nonzero(table), strict=True):
        color = "white" if share[i, j] > 0.6 else "black"
        ax.text(j, i, f"{table[i, j]:.0f}", ha="center", va="center", fontsize=8, color=color)
    ax.set_xlabel("answer")
    ax.set_ylabel("hidden")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/hidden"))
    parser.add_argument("--repeats", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="first thousand of the seeds: fresh data")
    parser.add_argument("--own-tissue", action="store_true", help="c and m of every case its own")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    store, plan = options.out / "study.jsonl", options.out / "plan.json"
    if not plan.is_file():
        plan.write_text(json.dumps(hidden_cases.detectable()))
    sizes = json.loads(plan.read_text())
    jobs = {
        (arm, 1000 * repeat + k): (arm, truth, 1000 * repeat + k, options.own_tissue)
        for repeat in range(options.first, options.first + options.repeats)
        for k, (arm, truth) in enumerate(arms(sizes))
    }
    rows = succeeded(made(store, jobs, one, key=("arm", "seed"), processes=options.jobs, show=line))
    confusion(rows, options.out / "confusion.png")
    table = "\n".join(gates(rows))
    (options.out / "gates.txt").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
