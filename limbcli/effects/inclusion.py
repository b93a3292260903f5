"""A region of different stiffness: a scar, fibrosis.

c(X) = c exp(a) in a ball at any place in the image plane, of any radius, with an edge that is sharp or graded
over some millimetres. Outside the image plane the region is assumed to be a ball whose centre lies in that
plane. A ball fitted with a sharper edge than that in the map comes out larger and with less contrast.
FEBio: element maps of c1, c2, cp.
Tell-tale: visible in the map at rest, at the same place at every load; the force changes little.
Source: Bramley et al. 2021, Ann Biomed Eng 49:3176 (residual-limb tissue is patchy); element-wise c from a
speed map, as in Oddes & Solav 2023.
"""

from __future__ import annotations

import itertools

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta, exponential
from limbcli.effects.stiffness_places import Places
from limbcli.model import Array
from limbcli.numbers.compiled import njit

X, DEPTH, RADIUS, EDGE = (
    "inclusion_x_mm", "inclusion_depth_mm", "inclusion_radius_mm", "inclusion_edge_mm",
)  # fmt: skip
_LOGISTIC = 2.0 * np.log(9.0)  # width of a logistic step from 10 to 90 %, in multiples of its scale
_FAR = 20.0  # distance from the ball, in scales, beyond which it is neglected (2e-9 of it remain)
CONTRAST = Parameter("log_inclusion_ratio", null=0.0, start=0.7, low=-2.5, high=3.0, typical=1.0,
                     prior="scars 2 to 10 times as stiff",
                     reported="stiffness_ratio", turn=exponential)  # fmt: skip
SHAPE = (
    Parameter.of_shape(X, 0.0, -26.0, 26.0, "under the probe"),
    Parameter.of_shape(DEPTH, 12.0, 2.0, 40.0, "below the skin under the probe's centre"),
    Parameter.of_shape(RADIUS, 7.0, 3.0, 16.0, "scars and their beds: 5 to 15 mm"),
    Parameter.of_shape(EDGE, 3.0, 1.0, 8.0, "from 10 to 90 % of the change; scars fade out"),
)
_PLACES = tuple(
    {X: float(x), DEPTH: float(depth), RADIUS: 7.0, EDGE: 3.0}
    for depth, x in itertools.product((7, 13, 19, 26), (0, -8, 8, -16, 16))
)


def stiffness(places: Places, theta: Theta) -> Array:
    middle = np.array([theta.get(X, 0.0), 0.0, -theta.get(DEPTH, 12.0)])
    rise = float(np.expm1(theta[CONTRAST.name]))
    scale = theta.get(EDGE, 3.0) / _LOGISTIC
    ball = _ball(places.rows, middle, theta.get(RADIUS, 7.0), scale, rise)
    return np.asarray(ball.reshape(places.at.shape[:-1]))


@njit
def _ball(at, middle, radius, scale, rise):  # type: ignore[no-untyped-def]
    """1 (n,) at places (n, 3) outside a ball, 1 + rise inside; the edge is a logistic function with this
    scale (mm)."""
    out = np.ones(len(at))
    last = (radius + _FAR * scale) ** 2
    for i in range(len(at)):
        x, y, z = at[i, 0] - middle[0], at[i, 1] - middle[1], at[i, 2] - middle[2]
        squared = x * x + y * y + z * z
        if squared < last:
            out[i] += rise / (1.0 + np.exp((np.sqrt(squared) - radius) / scale))
    return out


EFFECT = Effect(
    name="inclusion",
    sentence="a region (scar, fibrosis) is stiffer or softer than the rest",
    kind="tissue",
    source="Bramley et al. 2021, Ann Biomed Eng 49:3176",
    parameters=(CONTRAST, *SHAPE),
    stiffness=stiffness,
    grid=_PLACES,
    needs=("force", "map"),
    solves=True,
)
