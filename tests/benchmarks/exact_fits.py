"""c and m out of FEBio's records without noise: what the model's own error makes of them.

    python -m tests.benchmarks.exact_fits [--out FOLDER] [--only h05 h13]

For every site of the FEBio study in the reference data (`febio-hidden`) with maps free of noise: its records
without the hidden effect in place of the readings, at the depths that were
read, but no deeper than the last map, fitted without effects with all that a diagnosis allows for. A line a
site: ln of c and m found over the true ones, the deviance that is left, the zero of depth (mm) and of force
(N) and the gain of depth that the model's own error is taken for, each alone and to first order, and the
effects that it resembles, with the ln Bayes factor of each over no effect, to first order (from 1 on).
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli.diagnosis.data.site_data import SiteData
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.explanations.forward_model import Fitted
from limbcli.diagnosis.explanations.linear_evidence import LinearEvidence
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.effects.curves import Curves, force_at
from limbcli.effects.reading import Reading
from limbcli.errors import LimbError
from limbcli.numbers.whitening import Whitener

RESEMBLES = 1.0  # least ln Bayes factor that is printed
ZEROS = ("depth-zero", "force-zero", "depth-gain")


def without_noise(site: SiteData, windows: Windows, truth: dict) -> SiteData:
    """The site with FEBio's record of it in place of what was read."""
    from tests.benchmarks.map_errors import record_of

    depth, force, ln_speed = record_of(truth["id"], windows)
    at_rest = np.full(1 + windows.n_parts, 0.5 * np.log(truth["c_kpa"] / 2.0))
    record = Curves(
        np.r_[0.0, depth], np.r_[0.0, force], np.array([at_rest, *ln_speed]), windows.depths,
        truth["thickness_mm"],
    )  # fmt: skip
    read = np.minimum(site.protocol.depth, depth[-1])
    borne = np.maximum(force_at(record, np.maximum(read, 0.0)), 0.0)
    found = replace(site, protocol=replace(site.protocol, depth=read, force=borne))
    return replace(found, data=replace(site.data, y=found.predict(record, Reading())))


def resembled(model: SiteForwardModel, found: Fitted) -> LinearEvidence:
    """Evidence of every effect at a fit without effects."""
    directions = {}
    for facts in model.candidates:
        with contextlib.suppress(LimbError):  # a channel is missing, or only FEBio can simulate it
            several = [each for each in model.directions(found, facts.name) if np.any(each.columns)]
            directions |= {facts.name: several} if several else {}
    return LinearEvidence.about(found, model.data.y, Whitener.of(model.data.noise.covariance), directions)


def fitted(truth: dict, folder: Path) -> tuple[float, float, float, int, LinearEvidence]:
    """ln of c and of m over the true ones, chi2, number of data, evidence of the effects."""
    from tests.benchmarks.map_errors import prepared_site

    prepared = prepared_site(truth["id"], folder)
    try:
        prepared.curves.site = without_noise(prepared.curves.site, prepared.simulations.windows, truth)
        model = SiteForwardModel([prepared.curves])
        model.settle_noise()
        found = model.fit((), {})
        off = model.whiten(model.data.y - found.prediction)
        evidence = resembled(model, found)
    finally:
        prepared.simulations.close()
    ln_c, ln_m = (float(np.log(found.values[name] / truth[name])) for name in ("c_kpa", "m"))
    return ln_c, ln_m, float(off @ off), len(off), evidence


def main() -> None:
    from tests.benchmarks.map_errors import RECORDED, SITES

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "map-errors")
    parser.add_argument("--only", nargs="*", default=RECORDED)
    options = parser.parse_args()
    truths = tomllib.loads((SITES / "truth.toml").read_text(encoding="utf-8"))["case"]
    print(f"| site | ln c | ln m | chi2 | data | {' | '.join(ZEROS)} | resembles |\n|{'-|' * 9}")
    rows, zeros = [], []
    for truth in (each for each in truths if each["id"] in options.only):
        rows.append(fitted(truth, options.out))
        ln_c, ln_m, chi2, n, evidence = rows[-1]
        drawn = evidence.residual[None]
        zeros.append([float(evidence.best(name).sizes(drawn)[0, 0]) for name in ZEROS])
        factors = {name: float(evidence.ln_factor(name)[0]) for name in evidence.added}
        most = sorted(((ln, name) for name, ln in factors.items() if ln > RESEMBLES), reverse=True)
        alike = ", ".join(f"{name} {value:.1f}" for value, name in most)
        of_zeros = " | ".join(f"{each:.2f}" for each in zeros[-1])
        print(
            f"| {truth['id']} | {ln_c:.3f} | {ln_m:.3f} | {chi2:.0f} | {n} | {of_zeros} | {alike} |",
            flush=True,
        )
    ln = np.array([each[:2] for each in rows])
    for name, mean, rms in zip(("c", "m"), ln.mean(axis=0), np.sqrt((ln**2).mean(axis=0)), strict=True):
        print(f"ln {name} found less true: mean {mean:.3f}, root mean square {rms:.3f}")
    for name, each in zip(ZEROS, np.array(zeros).T, strict=True):
        print(f"{name}: mean {each.mean():.3f}, root mean square {np.sqrt((each**2).mean()):.3f}")
    print(f"chi2, sum: {sum(each[2] for each in rows):.0f}")


if __name__ == "__main__":
    main()
