"""`<Loads>`: what is read, in which direction, and what is refused, all at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.fem.motion.load_curves import value
from limbcli.model import Load
from limbcli.numbers.math_expressions import Formula


def with_loads(punch: Path, folder: Path, loads: str, *more: tuple[str, str]) -> Path:
    text = punch.read_text().replace("<Boundary>", f"<Loads>{loads}</Loads><Boundary>", 1)
    for old, new in more:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "loaded.feb"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "load"),
    [
        (
            '<surface_load name="a" type="pressure" surface="skin"><pressure lc="1">0.5</pressure>'
            "<linear>1</linear><symmetric_stiffness>1</symmetric_stiffness><shell_bottom>0</shell_bottom>"
            "</surface_load>",
            Load("pressure", "skin", (0.5,), "travel", True),
        ),
        (
            '<surface_load type="traction" surface="skin"><scale lc="1">-2</scale><traction>0,1,0.5'
            "</traction></surface_load>",
            Load("traction", "skin", (-0.0, -2.0, -1.0), "travel"),
        ),
        (
            '<nodal_load type="nodal_force" node_set="@surface:skin"><relative>0</relative>'
            "<value>0,0,1</value></nodal_load>",
            Load("nodal force", "skin", (0.0, 0.0, 1.0)),
        ),
        (
            '<nodal_load type="nodal_load" node_set="skin"><dof>y</dof><scale lc="1">3</scale></nodal_load>',
            Load("nodal force", "skin", (0.0, 3.0, 0.0), "travel"),
        ),
        (
            '<body_load type="const" elem_set="tissue"><x>0</x><y lc="1">2</y><z lc="1">3</z></body_load>',
            Load("body force", "tissue", (0.0, -2.0, -3.0), "travel"),
        ),
        (
            '<body_load type="body force"><force>0,0,9810</force></body_load>',
            Load("body force", "", (0.0, 0.0, -9810.0)),
        ),
        (
            '<surface_load type="force" surface="skin"><scale lc="1">-2</scale><force>0,1,0.5</force>'
            "</surface_load>",
            Load("surface force", "skin", (-0.0, -2.0, -1.0), "travel", True),
        ),
        (
            '<surface_load type="pressure" surface="skin"><pressure lc="1" type="math">X*t</pressure>'
            "</surface_load>",
            Load("pressure", "skin", (Formula("X*t"),), "travel"),
        ),
        (
            '<surface_load type="traction" surface="skin"><scale>2</scale><traction type="math">'
            "0, max(X,1), Z</traction></surface_load>",
            Load("traction", "skin", tuple(map(Formula, ("(2.0)*(0)", "(2.0)*(max(X,1))", "(2.0)*(Z)")))),
        ),
        (
            '<body_load type="non-const"><x type="math">Y</x><z>2</z></body_load>',
            Load("body force", "", (Formula("-(Y)"), 0.0, -2.0)),
        ),
    ],
)
def test_a_load_is_read_as_febio_applies_it(punch: Path, tmp_path: Path, text: str, load: Load) -> None:
    """FEBio's body force acts against the direction it gives."""
    assert read_feb(with_loads(punch, tmp_path, text)).loads == (load,)


def test_components_with_curves_of_their_own_are_loads_of_their_own(punch: Path, tmp_path: Path) -> None:
    text = '<body_load type="const"><x lc="1">1</x><y>2</y></body_load>'
    assert read_feb(with_loads(punch, tmp_path, text)).loads == (
        Load("body force", "", (-1.0, 0.0, 0.0), "travel"),
        Load("body force", "", (0.0, -2.0, 0.0)),
    )


def test_formulas_survive_a_round_trip_and_other_units(punch: Path, tmp_path: Path) -> None:
    text = (
        '<surface_load type="pressure" surface="skin"><pressure type="math">X+t</pressure></surface_load>'
        '<body_load type="non-const"><x type="math">Y</x><z>2</z></body_load>'
        '<surface_load type="force" surface="skin"><force>0,1,0.5</force></surface_load>'
    )
    model = read_feb(with_loads(punch, tmp_path, text))
    again = read_feb(write_feb(model, tmp_path / "again.feb"))
    assert again.loads == model.loads
    pressure, weight, force = read_feb(with_loads(punch, tmp_path, text, ("mm-N-s", "SI"))).loads
    at = np.array([[2.0, 3.0, 0.0]])
    assert pressure.value[0](1000 * at, 0.5) == pytest.approx(2.5e-6)  # Pa at m
    assert weight.value[0](1000 * at, 0.0) == pytest.approx(-3000.0)  # m/s^2 at m
    assert force.value == (0.0, 1.0, 0.5)


def test_a_load_curve_may_be_a_formula_of_time(punch: Path, tmp_path: Path) -> None:
    text = '<surface_load type="pressure" surface="skin"><pressure lc="3">1</pressure></surface_load>'
    path = with_loads(punch, tmp_path, text)
    controller = '<load_controller id="3" name="beat" type="math"><math>sin(pi*t)^2</math></load_controller>'
    path.write_text(path.read_text().replace("</LoadData>", controller + "</LoadData>"))
    model = read_feb(path)
    assert value(model.curves["beat"], 0.25) == pytest.approx(0.5)
    assert read_feb(write_feb(model, tmp_path / "again.feb")).curves == model.curves


def test_a_displacement_by_formula_becomes_a_map(punch: Path, tmp_path: Path) -> None:
    path = with_loads(punch, tmp_path, "")
    condition = (
        '<bc name="pull" type="prescribed displacement" node_set="@surface:skin"><dof>z</dof>'
        '<value type="math">0.1*X</value><relative>0</relative></bc>'
    )
    path.write_text(path.read_text().replace("</Boundary>", condition + "</Boundary>"))
    model = read_feb(path)
    pulled = model.supports[-1]
    nodes = model.mesh.node_sets[pulled.node_set]
    np.testing.assert_allclose(pulled.value.values, 0.1 * model.mesh.points[nodes, 0], rtol=1e-15)


@pytest.mark.parametrize("text", ["X*q", "X,Y", "1/"])
def test_a_formula_that_cannot_be_read_is_told_with_its_line(punch: Path, tmp_path: Path, text: str) -> None:
    load = (
        f'<surface_load type="pressure" surface="skin"><pressure type="math">{text}</pressure></surface_load>'
    )
    with pytest.raises(CaseError, match="formula") as caught:
        read_feb(with_loads(punch, tmp_path, load))
    assert "line" in str(caught.value)


def test_loads_without_a_value_are_none(punch: Path, tmp_path: Path) -> None:
    text = '<body_load type="const"><z lc="1">0</z></body_load>'
    assert read_feb(with_loads(punch, tmp_path, text)).loads == ()


def test_other_units_scale_the_loads(punch: Path, tmp_path: Path) -> None:
    text = (
        '<surface_load type="pressure" surface="skin"><pressure>1000</pressure></surface_load>'
        '<nodal_load type="nodal_force" node_set="skin"><value>0,0,2</value></nodal_load>'
        '<body_load type="body force"><force>0,0,9.81</force></body_load>'
    )
    path = with_loads(punch, tmp_path, text, ("mm-N-s", "SI"))
    pressure, force, weight = (each.value for each in read_feb(path).loads)
    assert pressure == (pytest.approx(1e-3),)  # 1 kPa in MPa
    assert force == (0.0, 0.0, 2.0)
    assert weight == (0.0, 0.0, pytest.approx(-9810.0))


def test_all_that_is_not_supported_is_told_at_once(punch: Path, tmp_path: Path) -> None:
    text = (
        '<surface_load type="fluidflux" surface="skin"/><body_load type="centrifugal"/>'
        '<surface_load type="pressure" surface="nowhere"><pressure>1</pressure></surface_load>'
        '<surface_load type="pressure" surface="skin"><pressure type="map">m</pressure></surface_load>'
        '<nodal_load type="nodal_force" node_set="skin"><value>0,0,1</value><relative>1</relative>'
        "</nodal_load>"
    )
    with pytest.raises(CaseError) as caught:
        read_feb(with_loads(punch, tmp_path, text))
    told = str(caught.value)
    for words in (
        "surface load of type 'fluidflux'",
        "body load of type 'centrifugal'",
        "type='map'",
        "relative",
    ):
        assert words in told


def test_a_body_force_needs_the_density_that_febio_would_assume(punch: Path, tmp_path: Path) -> None:
    text = '<body_load type="body force"><force>0,0,9810</force></body_load>'
    path = with_loads(punch, tmp_path, text, ("<density>1e-09</density><cp>", "<cp>"))
    with pytest.raises(CaseError, match="no <density>"):
        read_feb(path)


def test_a_rotation_vector_has_all_three_components(punch: Path, tmp_path: Path) -> None:
    path = with_loads(punch, tmp_path, "")
    turn = '<rigid_bc type="rigid_rotation_vector"><rb>probe</rb><vz lc="1">0.2</vz></rigid_bc></Rigid>'
    path.write_text(path.read_text().replace("</Rigid>", turn, 1))
    turns = [(each.dof, each.value, each.curve) for each in read_feb(path).drives if each.kind == "rotation"]
    assert turns == [("u", 0.0, None), ("v", 0.0, None), ("w", 0.2, "travel")]
