"""This rule and three others on the same data: what each says of the sites of a study.

    python -m tests.benchmarks.rules --cases SHARED/febio-hidden --out OUT [--only h05 h13] [--workers 2]

Every site is segmented, meshed and diagnosed into OUT (what is there is used). On the same fits, the same
noise and the same sensitivities then decide:

    posterior   the diagnosis as it is
    bic         weights exp(-BIC / 2) of the same explanations, without prior sizes: BIC is the deviance plus
                ln n for each parameter; named with a weight of 0.95, the set has 0.95
    halves      score tests of every effect on the even levels with false-discovery control (Benjamini and
                Hochberg 1995, 5 %), confirmed on the odd levels (5 %): the set; named if it is one effect.
                Missing physics in models of buildings is sought like that (LISDD, arXiv 2606.23215)

A line a site is kept in OUT/rules.jsonl; the table has the rates of each rule.
`score.py table` of the study gives those of any earlier version of the program.
"""

from __future__ import annotations

import argparse
import os
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from limbcli.case import Case
from limbcli.config import one_blas_thread
from limbcli.diagnosis.explanations.conclusions import Diagnosis
from limbcli.diagnosis.explanations.noise import LinearFit
from limbcli.diagnosis.explanations.search import Search
from limbcli.diagnosis.explanations.verdict import Conclusion
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.prepare import WorkingMesh, prepare
from limbcli.effects import EFFECTS
from limbcli.numbers.whitening import Whitener
from limbcli.progress import SILENT
from limbcli.stages.mesh import mesh
from limbcli.stages.segment import SegmentOptions, segment
from tests.benchmarks.seeded_rows import made, succeeded

RULES, LEVEL, CREDIBLE = ("posterior", "bic", "halves"), 0.05, 0.95


def diagnosed(case: Case, out: Path) -> tuple[Diagnosis, Search]:
    """The diagnosis of all sites of a case as one place, and its search."""
    if not (out / "mesh").is_dir():
        segment(case, out=out, options=SegmentOptions(accept_bones=True))
        mesh(case, out=out)
    effects = {each.name: each for each in EFFECTS if each.kind != "numerical"}
    prepared = [
        prepare(case, site, effects, out=out, mesh=WorkingMesh(), progress=SILENT) for site in case.sites
    ]
    try:
        model = SiteForwardModel([each.curves for each in prepared])
        model.settle_noise()
        found = Conclusion.of(model, max_effects=2, seed=7, propose=False, progress=SILENT)
        return found.diagnosis(), found.search
    finally:
        for each in prepared:
            each.simulations.close()


def by_bic(search: Search) -> tuple[str, list[list[str]]]:
    """Verdict and set by BIC over the fitted explanations."""
    n, names, values = len(search.data), list(search.known), []
    for name in names:
        found = search.known[name]
        whiten = search.whitener(found)
        deviance = float(np.sum(whiten(search.data.y - found.fitted.prediction) ** 2))
        deviance += 2 * float(np.log(np.diag(whiten.factor)).sum())
        values.append(deviance + found.fitted.jacobian.shape[1] * np.log(n))
    weights = np.exp(-0.5 * (np.array(values) - min(values)))
    weights /= weights.sum()
    order = np.argsort(-weights)
    last = int(np.searchsorted(np.cumsum(weights[order]), CREDIBLE)) + 1
    members = [list(names[k]) for k in order[:last]]
    best = names[order[0]]
    if weights[order[0]] < CREDIBLE:
        return "ambiguous", members
    return ("named" if best else "adequate"), members


def by_halves(search: Search) -> tuple[str, list[list[str]]]:
    """Verdict and set by score tests on one half of the levels, confirmed on the other."""
    data, linear, nothing = search.data, search.linear[()], search.known[()]
    names = list(linear.added)
    if not names:
        return "adequate", []
    covariance = nothing.noise(data.noise).covariance
    p = {}
    for half in (0, 1):
        mask = data.order % 2 == half
        whiten = Whitener.of(covariance[np.ix_(mask, mask)])
        off = whiten((data.y - nothing.fitted.prediction)[mask])
        state = LinearFit.of(off, whiten(nothing.fitted.jacobian[mask]))
        for name in names:
            p[name, half] = min(
                _score_p(state, whiten(each.direction.columns[mask])) for each in linear.added[name]
            ) * len(linear.added[name])
    order = sorted(names, key=lambda name: p[name, 0])
    passed = [k for k, name in enumerate(order) if p[name, 0] <= LEVEL * (k + 1) / len(order)]
    found = order[: max(passed) + 1] if passed else []
    kept = [[name] for name in found if p[name, 1] <= LEVEL]
    return ("adequate" if not found else "named" if len(kept) == 1 else "ambiguous"), kept


def _score_p(state: LinearFit, columns: np.ndarray) -> float:
    """p of the most significant column of the sensitivities, two-sided, for all of them."""
    seen = state.project(columns)
    length = np.linalg.norm(seen, axis=0)
    z = np.abs(state.left @ seen) / np.where(length > 0, length, np.inf)
    return float(min(1.0, 2 * norm.sf(z.max()) * columns.shape[1]))


def one(job: tuple[Path, Path]) -> dict[str, Any]:
    folder, out = job
    case = Case.open(folder)
    with one_blas_thread():
        found, search = diagnosed(case, out / folder.name)
    answers = {"posterior": (found.verdict, [list(each) for each in found.confidence_set])}
    answers |= {"bic": by_bic(search), "halves": by_halves(search)}
    chosen = {"posterior": list(found.chosen)}
    for rule in ("bic", "halves"):
        chosen[rule] = answers[rule][1][0] if answers[rule][0] == "named" else []
    said = [[list(e.explanation), e.probability] for e in found.explanations if e.probability > 1e-4]
    estimates = found.estimates
    return {
        "id": folder.name, "verdicts": {rule: answers[rule][0] for rule in RULES},
        "sets": {rule: answers[rule][1] for rule in RULES}, "chosen": chosen, "probabilities": said,
        "nothing": found.nothing, "level": found.adequate_from, "left": found.left.p if found.left else None,
        "values": [dict(stage.estimates.values) for stage in (found.shrink[0], found.shrink[-1])],
        "intervals": dict(estimates.intervals), "base": dict(found.base.values),
    }  # fmt: skip


def line(row: dict[str, Any]) -> str:
    return f"{row['id']} {row.get('verdicts', 'failed')} {row.get('chosen', '')}"


def table(rows: Sequence[dict[str, Any]], truths: dict[str, dict[str, Any]]) -> list[str]:
    """Rates of every rule."""
    lines = ["| | " + " | ".join(RULES) + " |", "|-|" + "-|" * len(RULES)]
    hidden = [
        r for r in rows if truths[r["id"]]["effects"] != ["none"] and truths[r["id"]]["answer"] != "outside"
    ]
    nothing = [r for r in rows if truths[r["id"]]["effects"] == ["none"]]

    def true(row: dict[str, Any]) -> set[str]:
        return set(truths[row["id"]]["effects"])

    tests = (
        ("nothing hidden: adequate", nothing, lambda r, rule: r["verdicts"][rule] == "adequate"),
        ("nothing hidden: named", nothing, lambda r, rule: r["verdicts"][rule] == "named"),
        (
            "hidden: named rightly",
            hidden,
            lambda r, rule: r["chosen"][rule] and set(r["chosen"][rule]) == true(r),
        ),
        (
            "hidden: named wrongly",
            hidden,
            lambda r, rule: r["chosen"][rule] and set(r["chosen"][rule]) != true(r),
        ),
        ("hidden: in the set", hidden, lambda r, rule: true(r) in [set(each) for each in r["sets"][rule]]),
    )
    for name, among, test in tests:
        counts = [f"{sum(bool(test(r, rule)) for r in among)} of {len(among)}" for rule in RULES]
        lines.append(f"| {name} | " + " | ".join(counts) + " |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--workers", type=int, default=max(1, (os.cpu_count() or 1)))
    options = parser.parse_args()
    truths = {each["id"]: each for each in tomllib.loads((options.cases / "truth.toml").read_text())["case"]}
    kept = options.out / "rules.jsonl"
    options.out.mkdir(parents=True, exist_ok=True)
    wanted = [name for name in truths if options.only is None or name in options.only]
    jobs = {(name,): (options.cases / name, options.out) for name in wanted}
    rows = succeeded(made(kept, jobs, one, key=("id",), processes=options.workers, show=line))
    rows = [row for row in rows if row["id"] in wanted]
    print("\n".join(table(rows, truths)))


if __name__ == "__main__":
    main()
