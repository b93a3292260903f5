"""What the readings hold of every effect in the library, and what of it the diagnosis keeps.

    python -m tests.benchmarks.what_data_hold --out FOLDER [--only h05 h13] [--sites]

For every site of the FEBio study in the reference data (`febio-hidden`), segmented and meshed into FOLDER
unless it is: chi2 by which each effect of the library, at its plausible size, changes the data beyond what
other c and m make of it (the latter to first order). From the site's fit without effects, with the diagnosis'
surrogate, at the point of the effect's grid where the readings show most; in each channel alone, and in all
together, at three stages:

    read     the readings as they are: levels, pixels of maps, quarter seconds of the holds in a record, with
             the noise that the site states for them (or that a record's scatter shows); pixels whose noise is
             smooth count as so many fewer
    reduced  the data that the diagnosis compares, with the same noise: parts of maps, two ratios a hold
    judged   the same with the errors of the model and all that is counted as uncertain beside the noise

A reduction that keeps less than half is a fault; what is judged says how much our models let one see. A line
a site and effect is kept in FOLDER/what-data-hold.jsonl, and what is there is not computed again. Printed are
a summary by channel, by effect and by part of the noise model, and with --sites every line, as
read/reduced/judged.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from limbcli.case import Case, Site
from limbcli.diagnosis.data import held_forces
from limbcli.diagnosis.data.held_forces import HeldForces
from limbcli.diagnosis.data.rows import SmoothDepth
from limbcli.diagnosis.data.site_data import SiteData
from limbcli.diagnosis.data.windows import Windows, pitch_of
from limbcli.diagnosis.explanations.forward_model import Fitted
from limbcli.diagnosis.explanations.noise import LinearFit
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.forward_model.surrogate import AtPoints, SiteCurves
from limbcli.diagnosis.prepare import Preparation, Prepared, WorkingMesh, prepare
from limbcli.effects import EFFECTS
from limbcli.effects.curves import force_at
from limbcli.effects.effect import Effect, Theta, point_name
from limbcli.effects.reading import read
from limbcli.errors import LimbError
from limbcli.measurement.indentation import read_trace
from limbcli.measurement.map_noise import pixel_noise
from limbcli.model import Array, IntArray
from limbcli.numbers.whitening import Whitener
from limbcli.progress import SILENT
from limbcli.stages.mesh import mesh
from limbcli.stages.segment import SegmentOptions, segment
from tests.benchmarks.seeded_rows import made, succeeded

SHARED = Path(os.environ.get("LIMBCLI_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SITES = SHARED / "febio-hidden"
STAGES = ("read", "reduced", "judged")
CHANNELS = {"force": "force", "swe": "mean speed", "map": "maps", "hold": "holds", "travel": "travel",
            "skin-bone": "skin-bone", "all": "all"}  # fmt: skip
Line = Mapping[str, Any]
SHOWS = 25.0  # chi2 in the readings above which an effect is said to show, as in the study's gates
_STEP_MM, _STEP_LN_M = 0.1, 1e-2


@dataclass(frozen=True)
class PixelWindows(Windows):
    """Parts as large as pixels; changes between meshes are filtered over as many mm as in the usual parts.

    filtered : pixels, side of the median filter
    """

    filtered: int = 3

    def without_spikes(self, ln_speed: Array) -> Array:
        parts = ln_speed[:, 1:].reshape(-1, self.down, self.across)
        smooth = median_filter(parts, size=(1, self.filtered, self.filtered), mode="nearest")
        return np.column_stack([ln_speed[:, 0], smooth.reshape(len(ln_speed), -1)])


@dataclass(frozen=True, eq=False)
class Block:
    """Raw readings of one channel: their change by an effect and by ln c and ln m, and their noise.

    change (n,); base (n, 2); own (n,) : independent standard deviations; shared (n, k) : what errors that
    several readings have in common make of them, each at one standard deviation
    """

    channel: str
    change: Array
    base: Array
    own: Array
    shared: Array


def unexplained(blocks: Sequence[Block]) -> float:
    """chi2 left of the changes when c, m and the shared errors have made of them what they can."""
    if not blocks:
        return 0.0
    change, own = (np.concatenate([getattr(each, name) for each in blocks]) for name in ("change", "own"))
    base, shared = (np.concatenate([getattr(each, name) for each in blocks]) for name in ("base", "shared"))
    columns = np.hstack([base, shared]) / own[:, None]
    known = np.hstack([np.zeros((shared.shape[1], base.shape[1])), np.eye(shared.shape[1])])
    A, y = np.vstack([columns, known]), np.concatenate([change / own, np.zeros(len(known))])
    left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return float(left @ left)


class RawReadings:
    """The raw readings of one site, and how effects change them.

    pixels : curves of the same simulations in pixels of the maps; None where there are no maps
    """

    def __init__(self, prepared: Prepared, fitted: Fitted, pixels: SiteCurves | None):
        self.site: SiteData = prepared.curves.site
        self.prepared, self.fitted, self.pixels = prepared, fitted, pixels
        self.c, self.m = fitted.values["c_kpa"] / 1e3, fitted.values["m"]
        protocol = self.site.protocol
        self.smooth = replace(protocol, depth=SmoothDepth.through(protocol).at(protocol.force))
        self.n_shared = 2 * len(protocol) + 1  # depth and speed of each level, zero of the travel

    def blocks(self, rows: Array, effect: Effect, point: Theta) -> list[Block]:
        """rows (n,) : change of the reduced data by the effect at its plausible size."""
        found = [self._of_rows(channel, rows) for channel in self._channels()]
        if self.pixels is not None:
            found.append(self._of_pixels(effect, point))
        if self.site.seen.held is not None:
            found.append(self._of_holds(effect, point))
        return found

    def _channels(self) -> list[str]:
        present = dict.fromkeys(row.channel for row in self.site.rows)
        return [each for each in present if each not in ("map", "hold")]

    def _of_rows(self, channel: str, rows: Array) -> Block:
        """Levels are not reduced: a channel's rows are its readings."""
        site, at = self.site, np.array([row.channel == channel for row in self.site.rows])
        level = site._levels[at]
        parts = {part.name: part.covariance for part in site.data.noise.parts}
        own = np.sqrt(np.diag(parts["measurement: own error of each reading"]))[at]
        shared = np.zeros((at.sum(), self.n_shared))
        shared[np.arange(len(level)), level] = site.seen.noise.depth * site.slope[at] * self._pressed[level]
        if channel == "travel":
            zero = parts["measurement: zero of the travel"]
            shared[:, -1] = np.sqrt(np.diag(zero))[at]
        base = np.zeros((len(level), 2))  # a parameter on its bound has no column
        base[:, : self.fitted.jacobian.shape[1]] = self.fitted.jacobian[at]
        return Block(channel, rows[at], base, own, shared)

    @property
    def _pressed(self) -> Array:
        protocol = self.site.protocol
        return 1.0 - ((protocol.force == 0.0) & (protocol.depth == 0.0))

    # -------------------------------------------------------------- maps

    def _of_pixels(self, effect: Effect, point: Theta) -> Block:
        level, pixel = self._seen
        shared = np.zeros((len(level), self.n_shared))
        rises = (self._speeds(self._plain, further=_STEP_MM) - self._speeds(self._plain)) / _STEP_MM
        n = len(self.site.protocol)
        shared[np.arange(len(level)), level] = (
            self.site.seen.noise.depth * rises[level, pixel] * self._pressed[level]
        )
        noise = self.prepared.site.noise
        shared[np.arange(len(level)), n + level] = noise.swe_level_fraction
        change = self._speed_change(effect, point)[level, pixel]
        other = self._speeds((self.m * np.exp(_STEP_LN_M), AtPoints(), {})) - self._speeds(self._plain)
        base = np.column_stack([np.full(len(level), 0.5), (other / _STEP_LN_M)[level, pixel]])
        own = np.full(len(level), noise.swe_pixel_fraction * np.sqrt(self._pixels_alike))
        known = np.isfinite(change) & np.isfinite(base).all(axis=1) & np.isfinite(shared).all(axis=1)
        return Block("map", change[known], base[known], own[known], shared[known])

    @property
    def _pixels_alike(self) -> float:
        """Number of pixels that count as one, where their noise is smooth."""
        maps = _maps_of(self.prepared.site)
        found = pixel_noise(maps, usual=self.prepared.site.noise.swe_pixel_fraction)
        if found.smoothing <= 0:
            return 1.0
        sums = []
        for name in ("lateral", "depth"):
            apart = pitch_of(np.concatenate([getattr(each, name) for each in maps])) * np.arange(-50, 51)
            sums.append(float(np.sum(np.exp(-(apart**2) / (4 * found.smoothing**2)))))
        return 1.0 + found.share * (sums[0] * sums[1] - 1.0)

    @property
    def _plain(self) -> tuple[float, AtPoints, Theta]:
        return self.m, AtPoints(), {}

    @property
    def _seen(self) -> tuple[IntArray, IntArray]:
        """Level and number of each pixel that was read."""
        assert self.pixels is not None
        windows, maps = self.pixels.simulations.windows, _maps_of(self.prepared.site)
        numbers = [windows.part_of(each.lateral, each.depth) for each in maps]
        level = np.concatenate([np.full(len(each), k) for k, each in enumerate(numbers)])
        pixel = np.concatenate(numbers)
        return level[pixel >= 0], pixel[pixel >= 0]

    def _speeds(self, model: tuple[float, AtPoints, Theta], further: float = 0.0) -> Array:
        """ln speed (n_levels, n_pixels) of a model: m, effects at points of their grids, parameters."""
        assert self.pixels is not None
        curves, reading = self.pixels.read(self.c, *model)
        protocol = replace(self.smooth, depth=self.smooth.depth + further)
        return read(curves, protocol, reading).log_speed[:, 1:]

    def _speed_change(self, effect: Effect, point: Theta) -> Array:
        moved = self._speeds((self.m, _alone(effect, point), plausible(effect, point)))
        return _from_onset(moved - self._speeds(self._plain), effect, point)

    # -------------------------------------------------------------- holds

    def _of_holds(self, effect: Effect, point: Theta) -> Block:
        """ln force in every quarter of a second of each hold, about the hold's mean.

        At the hold's mean depth: the scatter of its samples is noise, which no effect turns into a signal.
        """
        held, curves = self.site.seen.held, self.prepared.curves
        assert held is not None
        begins = np.flatnonzero(held.place == 0)
        last = np.append(begins[1:], len(held)) - 1
        holds = list(zip(held.windows[begins, 0, 0].tolist(), held.windows[last, 1, 1].tolist(), strict=True))
        depth = held.depth.copy()
        for a, b in holds:
            depth[a:b] = depth[a:b].mean()
        steady = replace(held, depth=depth)

        def ln_force(c: float, m: float, model: AtPoints, theta: Theta) -> Array:
            forces = steady.force(*curves.read(c, m, model, theta))
            return np.concatenate([_about_mean(np.log(np.maximum(forces[a:b], 1e-6))) for a, b in holds])

        plain = ln_force(self.c, self.m, AtPoints(), {})
        more_c = ln_force(self.c * np.exp(_STEP_LN_M), self.m, AtPoints(), {})
        more_m = ln_force(self.c, self.m * np.exp(_STEP_LN_M), AtPoints(), {})
        change = ln_force(self.c, self.m, _alone(effect, point), plausible(effect, point)) - plain
        base = np.column_stack([more_c - plain, more_m - plain]) / _STEP_LN_M
        own = np.concatenate([np.full(b - a, self._of_sample(held, a, b)) for a, b in holds])
        return Block("hold", change, base, own, np.zeros((len(change), self.n_shared)))

    def _of_sample(self, held: HeldForces, a: int, b: int) -> float:
        """Standard deviation of ln force in a quarter of a second of one hold, from the scatter of the
        record's samples of force and depth."""
        assert self.prepared.site.trace is not None
        trace = read_trace(self.prepared.site.trace)
        n_samples = max(held_forces.STEP_S / float(np.median(np.diff(trace.time))), 1.0)
        curves = self.prepared.curves.curves(self.c, self.m, AtPoints(), {})
        depth = float(held.depth[a:b].mean())
        force = force_at(curves, np.array([depth - _STEP_MM, depth, depth + _STEP_MM]))
        stiffness = (force[2] - force[0]) / (2 * _STEP_MM)
        of_depth = 0.0 if trace.depth is None else stiffness * held_forces._scatter(trace.depth)
        return float(np.hypot(held_forces._scatter(trace.force), of_depth) / np.sqrt(n_samples) / force[1])


def plausible(effect: Effect, point: Theta) -> Theta:
    """The effect's parameters at a plausible size, at one point of its grid."""
    return {each.name: each.typical for each in effect.parameters} | effect.free(point)


def _about_mean(values: Array) -> Array:
    return values - values.mean()


def _from_onset(change: Array, effect: Effect, point: Theta) -> Array:
    """Zero at the levels (first axis) before the effect sets in."""
    first = int(np.ceil(point.get(effect.onset, 0.0) * len(change)))
    return np.where(np.arange(len(change))[:, None] < first, 0.0, change)


def _maps_of(site: Site) -> list[Any]:
    from limbcli.site_model.site_levels import levels_of, maps_of

    found = maps_of(site, levels_of(site))
    assert found is not None
    return found


def reduced(
    forward_model: SiteForwardModel, fitted: Fitted, change: Array, *, judged: bool
) -> dict[str, float]:
    """chi2 of a change (n,) of the reduced data, by channel and in all."""
    data = forward_model.data
    parts = [part.covariance for part in data.noise.parts if judged or part.name.startswith("measurement")]
    covariance = np.asarray(sum(parts))
    if not judged:  # what is assumed of other causes in a hold is not noise of its readings
        held = forward_model.sites[0].site.seen.held
        at = np.flatnonzero([channel == "hold" for channel in data.channel])
        if held is not None:
            covariance[at, at] -= held_forces.floors(held.windows)
    masks = {**data.channels(), "all": np.ones(len(data), dtype=bool)}
    found = {}
    for channel, mask in masks.items():
        at = np.flatnonzero(mask)
        found[channel] = _left(covariance[np.ix_(at, at)], change[at], fitted.jacobian[at])
    return found


def without_each(forward_model: SiteForwardModel, fitted: Fitted, change: Array) -> dict[str, float]:
    """chi2 of a change (n,) in all channels without one part of what is not the readings' own noise."""
    noise = forward_model.data.noise
    return {
        part.name: _left(noise.covariance - part.covariance, change, fitted.jacobian)
        for part in noise.parts if part.name in noise.names and not part.name.startswith("measurement")
    }  # fmt: skip


def _left(covariance: Array, change: Array, jacobian: Array) -> float:
    whiten = Whitener.of(covariance)
    return LinearFit.of(whiten(change), whiten(jacobian)).chi2


def in_pixels(case: Case, prepared: Prepared, fitted: Fitted, out: Path) -> SiteCurves | None:
    """Curves of the site in pixels of its maps, on the same mesh; None where it has no maps."""
    if prepared.site.swe_maps is None:
        return None
    maps, usual = _maps_of(prepared.site), prepared.simulations.windows
    across, down = (
        round((high - low) / pitch_of(np.concatenate([getattr(each, name) for each in maps])))
        for name, low, high in (("lateral", usual.left, usual.right), ("depth", usual.top, usual.bottom))
    )
    options = replace(WorkingMesh(), size=prepared.size)
    preparation = Preparation(case, prepared.site, out, options, SILENT)
    preparation.windows = PixelWindows(
        usual.left, usual.right, usual.top, usual.bottom, across, down, usual.smoothing, usual.elevation,
        whole_is_known=True, filtered=round(3 * across / usual.across),
    )  # fmt: skip
    preparation.work = preparation.work.with_name(f".pixels-{prepared.site.name}")
    known = prepared.curves
    found = SiteCurves(known.site, preparation.simulated(), known.effects, penetration=known.penetration,
                       refused=known.refused)  # fmt: skip
    found.solve_nodes(list(known.nodes))
    found.changes.m = min(found.nodes, key=lambda m: abs(np.log(m / fitted.values["m"])))
    return found


def of_site(case: Case, site: Site, out: Path) -> Iterator[dict[str, Any]]:
    """A line for each effect that can be evaluated there."""
    effects = {each.name: each for each in EFFECTS if each.kind != "numerical" and not each.febio_only}
    prepared = prepare(case, site, effects, out=out, mesh=WorkingMesh(), progress=SILENT)
    pixels = None
    try:
        forward_model = SiteForwardModel([prepared.curves])
        forward_model.settle_noise()
        fitted = forward_model.fit((), {})
        pixels = in_pixels(case, prepared, fitted, out)
        raw = RawReadings(prepared, fitted, pixels)
        for facts in forward_model.candidates:
            effect = forward_model.effects[facts.name]
            found = []
            for point in effect.grid:
                with contextlib.suppress(LimbError):  # no channel shows it, or the law has no solution
                    found.append(_line(forward_model, fitted, raw, effect, point))
            if found:
                best = max(found, key=lambda each: float(each["read"]["all"]))
                yield {"effect": facts.name, **best}
    finally:
        prepared.simulations.close()
        if pixels is not None:
            pixels.simulations.close()


def _alone(effect: Effect, point: Theta) -> AtPoints:
    return AtPoints((effect.name,), (effect.held(point),))


def _line(
    forward_model: SiteForwardModel, fitted: Fitted, raw: RawReadings, effect: Effect, point: Theta
) -> dict[str, Any]:
    explanation, theta = (effect.name,), plausible(effect, point)
    forward_model.check_channels(explanation)
    x = [
        np.log(raw.c),
        np.log(raw.m),
        *(theta[slot.name] for slot in forward_model.slots(explanation)),
    ]
    change = forward_model.predict(np.array(x), _alone(effect, point)) - fitted.prediction
    blocks = raw.blocks(change, effect, point)
    return {
        "point": point_name(point),
        "read": {each.channel: unexplained([each]) for each in blocks} | {"all": unexplained(blocks)},
        "reduced": reduced(forward_model, fitted, change, judged=False),
        "judged": reduced(forward_model, fitted, change, judged=True),
        "without": without_each(forward_model, fitted, change),
    }


# ------------------------------------------------------------------ tables


def shown(lines: Sequence[Line], channel: str) -> list[tuple[float, float, float]]:
    """chi2 read, reduced and judged wherever the readings of this channel show an effect."""
    found = [tuple(line[stage].get(channel, 0.0) for stage in STAGES) for line in lines]
    return [(a, b, c) for a, b, c in found if a > SHOWS]


def by_channel(lines: Sequence[Line]) -> Iterator[str]:
    yield "| channel | shown (effects x sites) | reduced/read (10 to 90 %) | below half | judged/reduced |"
    yield "|-|-|-|-|-|"
    for channel, name in CHANNELS.items():
        found = np.array(shown(lines, channel))
        if len(found):
            kept = found[:, 1] / found[:, 0]
            low, middle, high = np.quantile(kept, [0.1, 0.5, 0.9])
            judged = float(np.median(found[:, 2] / found[:, 1]))
            below = int(np.sum(kept < 0.5))
            yield (
                f"| {name} | {len(found)} | {middle:.2f} ({low:.2f} to {high:.2f}) | {below} | {judged:.2f} |"
            )


def by_effect(lines: Sequence[Line]) -> Iterator[str]:
    """In all channels together, over the sites where an effect can be evaluated."""
    yield "| effect | sites | shown: read, reduced, judged | chi2 read | reduced/read | judged/reduced |"
    yield "|-|-|-|-|-|-|"
    for effect in dict.fromkeys(line["effect"] for line in lines):
        mine = [line for line in lines if line["effect"] == effect]
        chi2 = np.array([[line[stage]["all"] for stage in STAGES] for line in mine])
        counts = ", ".join(str(int(each)) for each in np.sum(chi2 > SHOWS, axis=0))
        ratio = np.median(chi2[:, 1:] / np.maximum(chi2[:, :-1], 1e-9), axis=0)
        yield (
            f"| {effect} | {len(mine)} | {counts} | {np.median(chi2[:, 0]):.0f} "
            f"| {ratio[0]:.2f} | {ratio[1]:.2f} |"
        )


def by_part(lines: Sequence[Line]) -> Iterator[str]:
    """What each part of the noise that is not the readings' own costs, where the readings show an effect."""
    yield "| counted as uncertain | judged without it / with it, median: sites with maps | with means |"
    yield "|-|-|-|"
    mine = [line for line in lines if line["read"]["all"] > SHOWS]
    for part in dict.fromkeys(name for line in mine for name in line["without"]):
        ratios = []
        for maps in (True, False):
            found = [
                line["without"][part] / line["judged"]["all"]
                for line in mine if part in line["without"] and ("map" in line["read"]) == maps
            ]  # fmt: skip
            ratios.append(f"{np.median(found):.2f}" if found else "")
        yield f"| {part} | {ratios[0]} | {ratios[1]} |"


def by_site(lines: Sequence[Line]) -> Iterator[str]:
    for line in lines:
        found = (
            f"{CHANNELS[channel]} " + "/".join(f"{line[stage].get(channel, 0.0):.3g}" for stage in STAGES)
            for channel in line["read"]
        )
        yield f"{line['site']}  {line['effect']}  {', '.join(found)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--sites", action="store_true")
    options = parser.parse_args()
    kept = options.out / "what-data-hold.jsonl"
    options.out.mkdir(parents=True, exist_ok=True)
    folders = sorted(each for each in SITES.glob("h??") if not options.only or each.name in options.only)
    cases = [Case.open(folder) for folder in folders]
    jobs = {(f"{case.folder.name} {site.name}",): (case, site) for case in cases for site in case.sites}

    def one(job: tuple[Case, Site]) -> list[dict[str, Any]]:
        case, out = job[0], options.out / job[0].folder.name
        if not (out / "mesh").is_dir():
            segment(case, out=out, options=SegmentOptions(accept_bones=True))
            mesh(case, out=out)
        return list(of_site(*job, out))

    lines = succeeded(made(kept, jobs, one, key=("site",), show=None))
    tables = (by_channel(lines), by_effect(lines), by_part(lines))
    for table in (by_site(lines), *tables) if options.sites else tables:
        print(*table, sep="\n", end="\n\n")


if __name__ == "__main__":
    main()
