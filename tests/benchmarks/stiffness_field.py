"""How often the stiffness field of a limb holds the truth, and how far off one c for the whole limb is.

    python tests/benchmarks/stiffness_field.py [--seeds 50] [--points 100]

A synthetic limb with eight sites whose readings have noise; its true c is drawn from fields of five kinds
that are not those of the model. Per kind: share of the points in the tissue inside their 95 % interval, share
of the sites left out that were inside the interval predicted without them, and the error of ln c (root mean
square, and what 95 % of the points stay below, as factors) of the field and of one c (the geometric mean of
the sites). Three further rows change what the model assumes: sites that see shallow tissue more than the
model says, noise of twice the stated size, and three sites instead of eight.

The last table is of sites that read a force, too: 2 % noise, and an error of 5 % of each site's model. Its
rows are c, m and f_kappa, whose true fields are all of the five kinds: share inside, and the error of the
field with the forces and without them; then how far the force of the field's tissue, and that of draws, is
from the one read.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # run as a script

from limbcli.stiffness_field import PARAMETERS, PRIORS, Draws, held_out, stiffness_field
from limbcli.stiffness_field.coordinates import LimbCoordinates
from tests.stiffness_field import synthetic as limb

HEADER = (
    "| field | inside, % | sites left out inside, % | field: rms | one c: rms | field: 95 % within "
    "| one c: 95 % within |"
)


def one(
    coordinates: LimbCoordinates, kind: str, rng: np.random.Generator, n: int, change: str, *, leave_out: bool
) -> dict[str, np.ndarray]:
    """Errors of one seed."""
    points = limb.tissue_points(n, rng)
    noise = 0.2 if change == "noise" else 0.1
    truth, sites = limb.measured(kind, points, rng, deviation=noise, shallow=change == "shallow")
    if change == "noise":  # stated as half of what it is
        sites = [limb.site(s.name, s.points, s.values["c"].value, 0.1) for s in sites]
    if change == "three":
        sites = [sites[0], sites[4], sites[6]]
    field = stiffness_field(coordinates, sites)
    found = field.at(points)
    mean = float(np.mean([np.log(s.values["c"].value) for s in sites]))
    return {
        "inside": (np.exp(truth) > found.c_low) & (np.exp(truth) < found.c_high),
        "field": np.log(found.c) - truth,
        "one": mean - truth,
        "left_out": np.array([each.inside for each in held_out(field).sites] if leave_out else [], bool),
    }


def row(name: str, found: list[dict[str, np.ndarray]]) -> str:
    together = {key: np.concatenate([each[key] for each in found]) for key in found[0]}
    rms = [np.sqrt(np.mean(together[key] ** 2)) for key in ("field", "one")]
    most = [np.exp(np.quantile(np.abs(together[key]), 0.95)) for key in ("field", "one")]
    left_out = f"{100 * together['left_out'].mean():.1f}" if len(together["left_out"]) else "-"
    return (
        f"| {name} | {100 * together['inside'].mean():.1f} | {left_out} | {rms[0]:.3f} | {rms[1]:.3f} "
        f"| x/÷ {most[0]:.2f} | x/÷ {most[1]:.2f} |"
    )


def draws_inside(coordinates: LimbCoordinates, n: int) -> float:
    """Share of 50 draws inside the 95 % interval of the points, of one field."""
    rng = np.random.default_rng(7)
    points = limb.tissue_points(n, rng)
    _, sites = limb.measured("smooth", points, rng)
    field = stiffness_field(coordinates, sites)
    found, draws = field.at(points), Draws(field)
    c = np.array([draws.draw(k).at(points).c for k in range(draws.n)])
    return float(np.mean((c > found.c_low) & (c < found.c_high)))


def with_forces(coordinates: LimbCoordinates, seed: int, n: int) -> dict[str, np.ndarray]:
    """By parameter: inside, error with forces, error without; errors of ln force of field and draws."""
    rng = np.random.default_rng([9, seed])
    points, regions = limb.tissue_points(n, rng), [limb.region(*each) for each in limb.EIGHT]
    every = np.concatenate([points, *regions])
    truth = {}
    for name in PARAMETERS:
        kind = limb.KINDS[int(rng.integers(len(limb.KINDS)))]
        values = limb.true_log_c(kind, every, rng) - PRIORS["c"].mean + PRIORS[name].mean
        truth[name] = np.clip(values, np.log(PRIORS[name].low), np.log(PRIORS[name].high))
    at = np.array([each[n:].reshape(len(regions), -1).mean(axis=1) for each in truth.values()]).T
    sites = [
        limb.with_force(
            limb.site(f"p{k}", where, float(np.exp(tissue[0] + 0.1 * rng.standard_normal())), 0.1),
            np.exp(tissue), noise=0.02, gain=0.05,
            off=0.05 * rng.standard_normal() + 0.02 * rng.standard_normal(2),
        )
        for k, (where, tissue) in enumerate(zip(regions, at, strict=True))
    ]  # fmt: skip
    field = stiffness_field(coordinates, sites)
    alone = stiffness_field(coordinates, [replace(each, force=None) for each in sites])
    found: dict[str, np.ndarray] = {}
    for name in PARAMETERS:
        values, true = field.values_of(name, points), truth[name][:n]
        found[f"{name} inside"] = (np.exp(true) > values.low) & (np.exp(true) < values.high)
        found[f"{name} with"] = np.log(values.value) - true
        found[f"{name} without"] = np.log(alone.values_of(name, points).value) - true
    draws, forces, drawn = Draws(field), [], []
    for each in sites:
        places = coordinates.places(each.points)
        tissue = [np.log(field.values_of(name, each.points).value).mean() for name in PARAMETERS]
        forces.append(np.log(each.force.ratio(np.array(tissue))))
        for k in range(20):
            log_tissue = np.log([getattr(draws.draw(k).at(places), name) for name in PARAMETERS]).mean(axis=1)
            drawn.append(np.log(each.force.ratio(log_tissue)))
    return found | {"force": np.array(forces), "drawn": np.array(drawn)}


def print_forces(coordinates: LimbCoordinates, n_seeds: int, n_points: int) -> None:
    found = [with_forces(coordinates, k, n_points) for k in range(n_seeds)]
    together = {key: np.concatenate([each[key] for each in found]) for key in found[0]}
    rms = {key: float(np.sqrt(np.mean(np.square(each)))) for key, each in together.items()}
    print("\n| parameter | inside, % | rms with forces | rms without |\n|-|-|-|-|")
    for name in PARAMETERS:
        inside = 100 * together[f"{name} inside"].mean()
        print(f"| {name} | {inside:.1f} | {rms[f'{name} with']:.3f} | {rms[f'{name} without']:.3f} |")
    print(
        f"force of the field's tissue: rms {100 * rms['force']:.1f} % (at most "
        f"{100 * np.abs(together['force']).max():.1f} %) off; of draws: {100 * rms['drawn']:.1f} %"
    )


def main(n_seeds: int, n_points: int) -> None:
    coordinates = limb.coordinates()
    print(HEADER)
    print("|-" * 7 + "|")
    everything = []
    for number, kind in enumerate(limb.KINDS):
        found = [
            one(coordinates, kind, np.random.default_rng([7, number, k]), n_points, "", leave_out=k < 25)
            for k in range(n_seeds)
        ]
        everything += found
        print(row(kind, found), flush=True)
    print(row("all five", everything), flush=True)
    for change, words in (
        ("shallow", "all five; sites see shallow tissue more"),
        ("noise", "all five; noise twice as stated"),
        ("three", "all five; three sites"),
    ):
        found = [
            one(
                coordinates, limb.KINDS[k % len(limb.KINDS)], np.random.default_rng([8, k]), n_points, change,
                leave_out=k < 25,
            )
            for k in range(n_seeds)
        ]  # fmt: skip
        print(row(words, found), flush=True)
    print_forces(coordinates, n_seeds, n_points)
    print(f"50 draws of one field: {100 * draws_inside(coordinates, n_points):.1f} % inside its intervals")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--forces-alone", action="store_true", help="the last table only")
    asked = parser.parse_args()
    if asked.forces_alone:
        print_forces(limb.coordinates(), asked.seeds, asked.points)
    else:
        main(asked.seeds, asked.points)
