"""The picture of a joint fit: force over depth and speed over force, a row a site; and the profiles."""

from __future__ import annotations

import numpy as np

from limbcli.drawing import save_figure
from limbcli.inference.adaptive import Intervals
from limbcli.inference.joint import JointProblem
from limbcli.reporting.figures.profiles import ProfileCurve, profile_figure
from limbcli.reporting.figures.style import INK, VERMILION, new_figure, style
from limbcli.results import StageWriter
from limbcli.units import kpa_from_mpa


def draw_joint(problem: JointProblem, found: Intervals, writer: StageWriter) -> None:
    """fit-joint.png and profiles.png."""
    sites = problem.task.data
    with style():
        figure = new_figure(7.6, 3.0 * len(sites))
        panels = figure.subplots(len(sites), 2, squeeze=False)
        for k, (data, (left, right)) in enumerate(zip(sites, panels, strict=True)):
            seen = problem.predict(k, found.best)
            order = np.argsort(data.force)
            left.errorbar(
                data.depth, data.force, xerr=data.depth_deviation, yerr=data.force_deviation,
                fmt="o", ms=4, color=INK, label="measured (±1 SD)",
            )  # fmt: skip
            left.plot(
                np.r_[0, seen.depth[order]], np.r_[0, data.force[order]], color=VERMILION, label="joint fit"
            )
            left.set(xlabel="indentation depth [mm]", ylabel="probe force [N]", title=f"site {data.name}")
            left.legend(loc="upper left")
            speed = np.exp(data.log_speed)
            right.errorbar(
                data.speed_force, speed, yerr=speed * data.speed_deviation, fmt="o", ms=4, color=INK
            )
            order = np.argsort(data.speed_force)
            right.plot(data.speed_force[order], np.exp(seen.log_speed)[order], color=VERMILION)
            right.set(xlabel="probe force [N]", ylabel="shear-wave speed [m/s]")
            if not len(speed):
                right.text(0.5, 0.5, "no speeds enter", ha="center", transform=right.transAxes)
        save_figure(figure, writer.file("picture", "fit-joint.png"))
    profiles = []
    for k, (name, each) in enumerate(found.profiles.items()):
        unit = kpa_from_mpa(1.0) if name == "c" else 1.0
        values = unit * each.values
        profiles.append(
            ProfileCurve(
                name, values, each.deviance, unit * float(found.best[k]), "kPa" if name == "c" else "–"
            )
        )
    save_figure(profile_figure(profiles), writer.file("profiles", "profiles.png"))
