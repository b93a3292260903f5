"""How often explanations are right that a diagnosis calls so probable: the picture of the documentation.

    python -m tests.benchmarks.calibration --picture docs/calibration.png
        [--sites OUT/rules.jsonl --truth SHARED/febio-hidden/truth.toml] [--study OUT/study.jsonl]

Every explanation of every data set, nothing among them, counts once at its probability: of `rules.py` (sites
that FEBio made) and of `hidden_study.py` (the reduced model). Data sets whose truth is no explanation
(outside of the library, noise understated) are left out. Prints counts.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import binomtest

from limbcli.drawing import save_picture
from tests.benchmarks.seeded_rows import kept

Said = list[tuple[float, bool]]
EDGES = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0 + 1e-9)


def of_sites(rows: Iterable[dict[str, Any]], truths: dict[str, list[str]]) -> Said:
    """truths : effects that are hidden in a site, by its id; without the sites that are outside"""
    return [
        each for row in rows if row["id"] in truths
        for each in _said(row, set(truths[row["id"]]) - {"none"})
    ]  # fmt: skip


def of_study(rows: Iterable[dict[str, Any]]) -> Said:
    left_out = ("outside", "noise understated")
    rows = [row for row in rows if row["arm"] not in left_out and not row["arm"].startswith("masked")]
    return [each for row in rows for each in _said(row, set(row["truth"]))]


def _said(row: dict[str, Any], truth: set[str]) -> Iterator[tuple[float, bool]]:
    """Probabilities and whether each explanation is right; a row of another version may have none."""
    for explanation, probability in row.get("probabilities", ()):
        yield probability, set(explanation) == truth


def draw(axes: Axes, said: Said, title: str) -> None:
    """Frequency right over the probability said, with Wilson's 95 % intervals."""
    p, right = np.array([each[0] for each in said]), np.array([each[1] for each in said])
    axes.plot([0, 1], [0, 1], color="#22303c", lw=0.8, ls="--")
    for low, high in pairwise(EDGES):
        inside = (p >= low) & (p < high)
        if not inside.any():
            continue
        n, k = int(inside.sum()), int(right[inside].sum())
        ends = binomtest(k, n).proportion_ci(0.95, method="wilson")
        at, rate = float(p[inside].mean()), k / n
        print(f"{title}: said {at:.2f}, right {k} of {n} ({ends.low:.2f} to {ends.high:.2f})")
        axes.errorbar(at, rate, [[rate - ends.low], [ends.high - rate]], fmt="o", color="#0072b2", capsize=3)
    axes.set(title=title, xlabel="probability said", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picture", type=Path, required=True)
    parser.add_argument("--sites", type=Path)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--study", type=Path)
    asked = parser.parse_args()
    panels: dict[str, Said] = {}
    if asked.study:
        rows = kept(asked.study)
        panels[f"reduced model, {len(rows)} data sets"] = of_study(rows)
    if asked.sites and asked.truth:
        cases = tomllib.loads(asked.truth.read_text(encoding="utf-8"))["case"]
        truths = {each["id"]: each["effects"] for each in cases if each["answer"] != "outside"}
        rows = [row for row in kept(asked.sites) if row["id"] in truths]
        panels[f"{len(rows)} sites of FEBio"] = of_sites(rows, truths)
    figure = Figure(figsize=(4.0 * len(panels), 4.2), layout="constrained")
    for axes, (title, said) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True
    ):
        draw(axes, said, title)
    figure.axes[0].set_ylabel("frequency right, with 95 % intervals")
    save_picture(figure, asked.picture, dpi=110)


if __name__ == "__main__":
    main()
