"""A tapered sleeve around a bone is donned and loaded: forces in balance, pressure and shear."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tubes import LENGTH, OUTER, tube

from limbcli.errors import CaseError, SolveError
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.meshing.surfaces import Triangles
from limbcli.model import LimbModel, Support
from limbcli.sockets.donning import FACE, SOCKET, DonningOptions, don_and_load, socket_model

OPTIONS = DonningOptions(loads_n=(0.5, 1.0), donning_steps=6, load_steps=2, search_radius_mm=8.0)
TAPER = 0.1


def limb() -> LimbModel:
    """A tube whose inner wall is held, as on a bone, tapered by 1 in 10 towards z = 0."""
    model = tube(1.0, n=(4, 16, 3))
    n = int(model.mesh.block("tissue").cells.max()) + 1
    points = model.mesh.points[:n].copy()
    radius = np.hypot(points[:, 0], points[:, 1])
    share = (radius - radius.min()) / np.ptp(radius)
    points[:, :2] *= (1 + share * TAPER * (points[:, 2] - 0.5 * LENGTH) / OUTER)[:, None]
    mesh = replace(
        model.mesh,
        points=points,
        blocks=(model.mesh.block("tissue"),),
        node_sets={"bone": model.mesh.node_sets["bone"]},
        surfaces={"skin": model.mesh.surfaces["skin"]},
    )
    return replace(
        model, mesh=mesh, bodies=(), drives=(), contacts=(), curves={},
        supports=(Support("bone", ("x", "y", "z")),),
    )  # fmt: skip


def face(tight: float = 0.8, n: int = 48) -> Triangles:
    """A conical sleeve, smaller than the limb by `tight` (mm), with its normals inward."""
    z = np.linspace(-0.5 * LENGTH, 1.5 * LENGTH, 9)
    angle = np.linspace(0.0, 2 * np.pi, n, endpoint=False)
    T, Z = np.meshgrid(angle, z)
    R = OUTER - tight + TAPER * (Z - 0.5 * LENGTH)
    points = np.stack([R * np.cos(T), R * np.sin(T), Z], axis=-1).reshape(-1, 3)
    k = np.arange(n)
    after = (k + 1) % n
    faces = []
    for row in range(len(z) - 1):
        a, b = row * n + k, row * n + after
        faces += [np.stack([a, b + n, b], axis=1), np.stack([a, a + n, b + n], axis=1)]
    return Triangles(points, np.concatenate(faces).astype(np.int64))


def test_a_limb_is_donned_and_loaded_in_balance() -> None:
    result = don_and_load(limb(), face(), OPTIONS, threads=1)
    assert [state.load_n for state in result.states] == [0.0, 0.5, 1.0]
    donned, low, high = result.states
    assert len(donned.pressure_mpa) == len(result.skin_nodes) == 16 * 4
    assert (donned.pressure_mpa > 0).mean() > 0.9
    for state, load in ((low, 0.5), (high, 1.0)):
        np.testing.assert_allclose(state.socket_force_n[2], load, rtol=1e-4)
        assert state.imbalance_n < 1e-4 * max(load, float(np.linalg.norm(state.socket_force_n)))
        assert (state.shear_mpa <= 0.3 * state.pressure_mpa * 1.2 + 1e-6).all()
    # the force drives the narrowing sleeve onto the limb
    assert high.socket_shift_mm[2] > low.socket_shift_mm[2]
    assert high.strain.max() > 0.0


def test_a_load_that_nothing_holds_says_what_it_was() -> None:
    pulled_off = replace(OPTIONS, loads_n=(40.0,), donning_steps=4, load_steps=1, sign=-1.0)
    with pytest.raises(SolveError, match="the load of 40 N has no equilibrium") as caught:
        don_and_load(limb(), face(), pulled_off, threads=1)
    assert "out of it" in caught.value.fix


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    model = socket_model(limb(), face(), OPTIONS)
    don = read_feb(write_feb(model, tmp_path / "socket.feb"))
    assert don.contacts == model.contacts
    assert don.steps == model.steps
    assert don.mesh.surfaces[FACE].n_facets == len(face().faces)
    np.testing.assert_array_equal(don.mesh.points, model.mesh.points)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (replace(OPTIONS, skin="hide"), "no surface 'hide'"),
        (replace(OPTIONS, friction=-0.1), "friction is below 0"),
        (replace(OPTIONS, loads_n=(400.0, -1.0)), "does not press"),
        (replace(OPTIONS, donning_steps=0), "no step"),
        (replace(OPTIONS, sign=2.0), "neither 1 nor -1"),
    ],
)
def test_options_out_of_range_have_their_own_messages(options: DonningOptions, words: str) -> None:
    with pytest.raises(CaseError, match=words):
        socket_model(limb(), face(), options)


def test_a_limb_in_a_socket_is_not_put_into_another() -> None:
    model = socket_model(limb(), face(), OPTIONS)
    with pytest.raises(CaseError, match="already holds"):
        socket_model(model, face(), OPTIONS)
    assert SOCKET in {body.name for body in model.bodies}
