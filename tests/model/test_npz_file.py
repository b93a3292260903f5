"""A stored model comes back to the last bit; a damaged one says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.model import (
    Block,
    Curve,
    Curved,
    Domain,
    ElementMap,
    LimbModel,
    LogRecord,
    Material,
    Mesh,
    NodeMap,
    Step,
    Support,
    Surface,
)
from limbcli.model.bodies import Drive, RigidBody
from limbcli.model.npz_file import differences, load_model, save_model


@pytest.fixture
def model(rng: np.random.Generator) -> LimbModel:
    points = rng.normal(size=(5, 3))
    cells = np.array([[0, 1, 2, 3]])
    face = Surface("skin", {"tri3": np.array([[0, 1, 2], [0, 1, 3]])})
    fibers = ElementMap("fibers", "tissue", rng.normal(size=(1, 3)))
    return LimbModel(
        mesh=Mesh(points, (Block("tissue", "tet4", cells),), {"bone": np.array([0, 4])}, {"skin": face}),
        materials={
            "tissue": Material(
                "mixture",
                parts=(
                    Material("ogden", {"c1": 0.1 + 0.2, "m1": 2.0, "kappa": 1 / 3}),
                    Material("active_contraction", {"T0": Curved(0.005, "ramp"), "fiber": fibers}),
                ),
            )
        },
        domains=(Domain("tissue", "tissue", "ut4-solid", {"alpha": 0.05}),),
        bodies=(RigidBody("probe", (0.0, 0.0, -0.05), (), ("bone",)),),
        supports=(Support("bone", ("z",), NodeMap("uz", "bone", np.array([0.1, 0.3])), "ramp"),),
        drives=(Drive("probe", "z", "displacement", -8.0, "ramp"),),
        curves={"ramp": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(must_points=(0.1, 0.7), control={"dtol": 1e-2, "qn_method": "BFGS"}),),
        records=(LogRecord("rigid_body", ("z", "Fz"), "rigid_body.csv", "probe"),),
        info={"site": "p1", "matrix": [1.0, 2.0], "size": (53.0, 14.0), "none": None, "n": np.int64(3)},
    )


def test_a_stored_model_comes_back_to_the_last_bit(model: LimbModel, tmp_path: Path) -> None:
    save_model(model, tmp_path / "model.npz")
    back = load_model(tmp_path / "model.npz")
    plain = replace(model, info={**model.info, "n": 3})
    assert differences(plain, back) == []
    assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]


def test_a_changed_bit_is_a_difference(model: LimbModel) -> None:
    points = model.mesh.points.copy()
    points[2, 1] = np.nextafter(points[2, 1], 9)
    assert differences(model, model.with_mesh(replace(model.mesh, points=points))) == ["model.mesh.points"]


def test_the_same_model_gives_the_same_file(model: LimbModel, tmp_path: Path) -> None:
    save_model(model, tmp_path / "a.npz")
    save_model(model, tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_damaged_or_missing_file_is_a_case_error(model: LimbModel, tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    with pytest.raises(CaseError, match="missing"):
        load_model(path)
    save_model(model, path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(CaseError, match="cannot be read"):
        load_model(path)
    np.savez(path, something=np.zeros(3))
    with pytest.raises(CaseError, match="cannot be read"):
        load_model(path)


def test_what_is_not_plain_data_is_refused(model: LimbModel, tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="cannot be stored"):
        save_model(replace(model, info={"file": Path("x")}), tmp_path / "model.npz")
    assert not list(tmp_path.iterdir())
