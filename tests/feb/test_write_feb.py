"""What is written reads back exactly, and is what FEBio is known to accept."""

from __future__ import annotations

import gzip
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from limbcli.errors import CaseError, ToolError
from limbcli.feb.read import read_feb
from limbcli.feb.write import render, write_feb
from limbcli.model import (
    Block,
    Curve,
    Curved,
    Domain,
    ElementMap,
    LimbModel,
    Load,
    Material,
    NodeMap,
    Step,
    Support,
    Surface,
)
from limbcli.model.bodies import Drive, RigidBody, Spring
from limbcli.model.npz_file import differences


def round_trip(model: LimbModel, folder: Path) -> LimbModel:
    return read_feb(write_feb(model, folder / "written.feb"))


@pytest.fixture
def model(punch: Path) -> LimbModel:
    return read_feb(punch)


def everything(model: LimbModel, rng: np.random.Generator) -> LimbModel:
    """The punch with all that a model can hold."""
    n_cells = len(model.mesh.block("tissue").cells)
    fibers = ElementMap("fibers", "tissue", rng.normal(size=(n_cells, 3)))
    stiff = ElementMap("stiff", "tissue", rng.uniform(1e-3, 1e-2, n_cells))
    law = Material(
        "mixture",
        parts=(
            Material("ogden", {"kappa": stiff, "c1": 0.1 + 0.2, "m1": 1 / 3}),
            Material("fiber_exp_pow", {"ksi": 0.003, "alpha": 0.0, "beta": 2.0, "fiber": fibers}),
            Material("active_contraction", {"T0": Curved(0.005, "twitch"), "fiber": (0.6, 0.0, 0.8)}),
        ),
    )
    relaxing = Material(
        "viscoelastic", {"g0": 1.0, "g1": 0.4, "t1": 0.8}, (Material("mooney_rivlin", {"c1": 1e-3}),)
    )
    relaxing = Material(
        "viscoelastic", {"g0": 1.0, "g1": 0.4, "t1": 0.8}, (Material("mooney_rivlin", {"c1": 1e-3}),)
    )
    prestrained = Material(
        "prestrain",
        {"ramp": Curved(1.0, "twitch"), "F0": (1.0, 0.0, 0.0, 0.0, 1.05, 0.0, 0.0, 0.0, 1 / 1.05)},
        (relaxing,),
    )
    bone = model.mesh.node_sets["bone"]
    tissue, probe = model.mesh.blocks
    extra = Block("extra", "tet4", tissue.cells[:3])
    return replace(
        model,
        mesh=replace(model.mesh, blocks=(tissue, extra, probe)),
        materials={"tissue": law, "extra": prestrained},
        domains=(
            Domain("tissue", "tissue", "TET4G1"),
            Domain("extra", "extra", "ut4-solid", {"alpha": 0.05}),
        ),
        bodies=(
            *model.bodies,
            RigidBody("bone", (0.0, 0.0, -10.0), (), ("bone",)),
            RigidBody("ground", (0.0, 0.0, 0.0)),
        ),
        supports=(
            Support("skin", ("y",)),
            Support("bone", ("x",), NodeMap("ux", "bone", rng.normal(size=len(bone))), "travel", True),
            Support("bone", ("z",), -0.25, None),
        ),
        drives=(
            *model.drives,
            Drive("bone", "u", "rotation", 0.1, "twitch", True),
            Drive("bone", "z", "force", -3.0, "travel"),
            Drive("ground", "w", "fixed"),
            Drive("ground", "x", "fixed"),
            Drive("ground", "v", "moment", 2.0),
        ),
        springs=(Spring("guide", "ground", "bone", 12.5, (0.0, 0.0, -60.0), (0.0, 0.0, -10.0), 50.0),),
        curves={**model.curves, "twitch": Curve(((0.0, 0.0), (0.3, 1 / 3)), "smooth", "repeat offset")},
        steps=(
            Step(4, 0.1, must_points=(0.1, 0.3), dt_max=0.2, control={"dtol": 1e-3, "cutback": 0.5}),
            Step(
                2, 0.5, "transient", adaptive=False,
                control={"linear_solver": "pardiso", "qn_method": "full Newton", "plot_range": "0,-1"},
                supports=(Support("skin", ("x", "z")),), drives=(Drive("probe", "y", "displacement", 1.0),),
                loads=(Load("traction", "skin", (0.1, 0.0, 1 / 3)),),
            ),
        ),
        loads=(
            Load("pressure", "skin", (1 / 3,), "travel", True),
            Load("nodal force", "skin", (0.0, 0.1, -1e-3), "twitch"),
            Load("body force", "", (0.0, 0.0, -9810.0), "travel"),
            Load("body force", "tissue", (1 / 3, 0.0, 0.0)),
        ),
        info={"note": "a -- b <&> 'é' \"q\" ---", "n": 3},
    )  # fmt: skip


def test_the_punch_comes_back_exactly(model: LimbModel, tmp_path: Path) -> None:
    assert differences(model, round_trip(model, tmp_path)) == []


def test_all_that_a_model_can_hold_comes_back_exactly(
    model: LimbModel, tmp_path: Path, rng: np.random.Generator
) -> None:
    full = everything(model, rng)
    back = round_trip(full, tmp_path)
    fixed = replace(back, steps=(back.steps[0], replace(back.steps[1], dt_min=1e-3, max_retries=8)))
    assert differences(replace(full, materials=dict(full.materials)), fixed) == []


def test_febios_own_xml_reader_can_read_it(model: LimbModel, rng: np.random.Generator) -> None:
    """It knows five entities by name, none by number, and looks for them in comments too."""
    full = everything(model, rng)
    odd = replace(full, springs=(replace(full.springs[0], name='the patient\'s <"guide"> & rail'),))
    text = render(odd)
    assert set(re.findall(r"&[^;]*;", text)) == {"&apos;", "&lt;", "&gt;", "&amp;", "&quot;"}
    assert text.count("&") == len(re.findall(r"&(apos|lt|gt|amp|quot);", text))
    comment = text[text.index("<!--") + 4 : text.index("-->")]
    assert not {"--", "&", "<", ">"} & set(re.findall(r"--|[&<>]", comment))
    for tag in ("Boundary", "Rigid", "Contact", "LoadData", "logfile", "Surface", "NodeSet"):
        assert not re.search(rf"<{tag}[^>]*>\s*</{tag}>", text), "an empty section is read as its neighbour"


def test_empty_sets_are_not_written_and_yet_come_back(model: LimbModel, tmp_path: Path) -> None:
    mesh = replace(
        model.mesh,
        node_sets={**model.mesh.node_sets, "cut": np.zeros(0, dtype=np.int64)},
        surfaces={**model.mesh.surfaces, "cut": Surface("cut", {})},
    )
    bare = replace(model.with_mesh(mesh), supports=(), records=())
    assert 'name="cut"' not in render(bare)
    assert "<Boundary>" not in render(bare)
    assert differences(bare, round_trip(bare, tmp_path)) == []


def test_a_node_set_may_be_called_as_the_nodes_are(model: LimbModel, tmp_path: Path) -> None:
    sets = {**model.mesh.node_sets, "all_nodes": np.arange(4)}
    changed = replace(model, mesh=replace(model.mesh, node_sets=sets))
    assert differences(changed, round_trip(changed, tmp_path)) == []


def test_contacts_of_one_name_are_not_written(model: LimbModel) -> None:
    other = replace(model.contacts[0], primary=model.contacts[0].secondary)
    with pytest.raises(CaseError, match="contacts share a name"):
        render(replace(model, contacts=(*model.contacts, other)))


def test_names_that_febio_cannot_read_are_refused(model: LimbModel, tmp_path: Path) -> None:
    spring = Spring("Führung → 1", "probe", "probe", 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    with pytest.raises(CaseError, match="→"):
        write_feb(replace(model, springs=(spring,)), tmp_path / "model.feb")


def test_random_points_come_back_to_the_last_bit(
    model: LimbModel, tmp_path: Path, rng: np.random.Generator
) -> None:
    points = model.mesh.points + rng.normal(size=model.mesh.points.shape) * 1e-7
    moved = model.with_mesh(replace(model.mesh, points=points))
    assert np.array_equal(round_trip(moved, tmp_path).mesh.points, points)


def test_lames_constants_come_back_to_round_off(model: LimbModel, tmp_path: Path) -> None:
    neo = model.with_material("tissue", Material("neo_hooke", {"mu": 0.0027, "lambda": 0.53}))
    back = round_trip(neo, tmp_path).materials["tissue"].parameters
    assert back["mu"] == pytest.approx(0.0027, rel=1e-13)
    assert back["lambda"] == pytest.approx(0.53, rel=1e-11)  # 1 - 2 nu cancels three digits here


def test_ids_run_from_1_without_gaps(model: LimbModel, rng: np.random.Generator) -> None:
    root = etree.fromstring(render(everything(model, rng)).encode("iso-8859-1", "xmlcharrefreplace"))
    for path in (
        "Material/material",
        "LoadData/load_controller",
        "Mesh/Nodes/node",
        "Mesh/Elements/elem",
        "Step/step",
    ):
        ids = [int(each.get("id") or 0) for each in root.iterfind(path)]
        assert ids == list(range(1, len(ids) + 1)), path
        assert ids


def test_must_points_stand_as_the_decimals_they_are(model: LimbModel) -> None:
    step = replace(model.steps[0], must_points=(0.0625, 0.1, 0.3, 1.0))
    text = render(replace(model, steps=(step,)))
    points = re.findall(r"<pt>([^<]*)</pt>", text.split('name="must_points"')[1])
    assert points == ["0,0.1", "0.0625,0.1", "0.1,0.1", "0.3,0.1", "1,0.1"]


def test_must_points_of_a_later_step_are_global_times(model: LimbModel, tmp_path: Path) -> None:
    steps = (Step(10, 0.07, must_points=(0.35, 0.7)), Step(10, 0.03, must_points=(0.1, 0.3)))
    two = replace(model, steps=tuple(replace(step, dt_max=0.05) for step in steps))
    assert "<pt>0.8,0.05</pt>" in render(two)
    back = round_trip(two, tmp_path)
    assert [step.must_points for step in back.steps] == [(0.35, 0.7), (0.1, 0.3)]


def test_the_users_template_comes_first_and_ours_fill_in(model: LimbModel, tmp_path: Path) -> None:
    own = tmp_path / "templates" / "feb"
    own.mkdir(parents=True)
    (own / "mesh_data.j2").write_text("<MeshData>\n</MeshData>\n<!-- mine -->\n")
    path = write_feb(model, tmp_path / "model.feb", templates=tmp_path / "templates")
    assert "<!-- mine -->" in path.read_text()
    assert differences(model, read_feb(path)) == []


def test_a_faulty_template_is_named_with_its_line(model: LimbModel, tmp_path: Path) -> None:
    own = tmp_path / "templates" / "feb"
    own.mkdir(parents=True)
    (own / "output.j2").write_text("<Output>\n{% if %}\n</Output>")
    with pytest.raises(CaseError, match=r"output\.j2, line 2"):
        render(model, templates=tmp_path / "templates")
    (own / "output.j2").write_text("{{ nothing_of_that_name }}")
    with pytest.raises(CaseError, match="nothing_of_that_name"):
        render(model, templates=tmp_path / "templates")
    with pytest.raises(ToolError, match="does not exist"):
        render(model, templates=tmp_path / "absent")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\n{{ 1 / 0 }}", r"(?s)division by zero.*feb/output\.j2, line 2"),
        (b"\n{{ none|number }}", r"(?s)NoneType.*feb/output\.j2, line 2"),
        (b"\n{{ model.meshh }}", r"(?s)meshh.*feb/output\.j2, line 2"),
        (b'{% include "feb/output.j2" %}', r"(?s)recursion.*feb/output\.j2, line 1"),
        (b"{# gro\xdf #}", r"(?s)utf-8.*feb/output\.j2"),
    ],
)
def test_whatever_a_template_does_wrong_is_told_with_its_place(
    model: LimbModel, tmp_path: Path, content: bytes, words: str
) -> None:
    own = tmp_path / "templates" / "feb"
    own.mkdir(parents=True)
    (own / "output.j2").write_bytes(content)
    with pytest.raises(CaseError, match=words):
        render(model, templates=tmp_path / "templates")


def test_a_template_that_would_be_passed_over_is_refused(model: LimbModel, tmp_path: Path) -> None:
    own = tmp_path / "templates" / "feb"
    own.mkdir(parents=True)
    (own / "control.j2").write_text("")  # ours by name, though this model of several steps has no use for it
    render(model, templates=tmp_path / "templates")
    (own / "contacts.j2").write_text("<Contact/>")
    with pytest.raises(CaseError, match=r"did you mean contact\.j2"):
        render(model, templates=tmp_path / "templates")
    (own / "contact.j2").write_text('{% include "feb/contacts.j2" %}')
    assert "<Contact/>" in render(model, templates=tmp_path / "templates")
    with pytest.raises(ToolError, match="neither feb/ nor report/"):
        render(model, templates=own)


@pytest.mark.parametrize(
    "change",
    [
        {"steps": (Step(must_points=(0.3, 0.2)),)},
        {"steps": (Step(control={"dtoll": 1.0}),)},
        {"materials": {"tissue": Material("ogden", {"c7": 1.0})}},
        {"materials": {"tissue": Material("ogden", {"c1": float("nan")})}},
        {"materials": {"tissue": Material("cheese", {})}},
        {"materials": {"probe": Material("ogden", {})}},
    ],
)
def test_what_febio_cannot_take_is_refused(
    model: LimbModel, tmp_path: Path, change: dict[str, object]
) -> None:
    with pytest.raises(CaseError):
        write_feb(replace(model, **change), tmp_path / "model.feb")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- against the stored models of FEBio


OTHER_NUMBERS = {
    "punch-tet10", "punch-tet10-deep", "punch-tet10-fk10", "punch-tet10-penalty-x4", "punch-tet4-fk10",
    "punch-tet4-penalty-x10", "ah1-nu0.45", "ah2-nu0.45", "tet10.feb.gz",
}  # fmt: skip


@pytest.mark.slow
def test_every_golden_model_comes_back_exactly(golden: Path, tmp_path: Path) -> None:
    """All but large ones that differ from another by numbers alone."""
    files = [
        each
        for each in sorted(golden.rglob("*.feb*"))
        if OTHER_NUMBERS.isdisjoint((each.parent.name, each.name))
    ]
    assert len(files) > 45
    for path in files:
        model = read_feb(path)
        assert {domain.block for domain in model.domains} == {each.name for each in model.mesh.solid_blocks}
        assert differences(model, round_trip(model, tmp_path), path.parent.name) == []


def leaves(element: etree._Element) -> list[tuple[str, object]]:
    """(tag, value) of every leaf below, numbers as numbers."""
    found: list[tuple[str, object]] = []
    for each in element.iter():
        if len(each) == 0:
            text = (each.text or "").strip()
            found.append((str(each.tag), float(text) if re.fullmatch(r"[-+.\deE]+", text) else text))
    return found


@pytest.fixture(scope="module")
def limb_twice(golden: Path) -> tuple[etree._Element, etree._Element]:
    """The golden limb's file, and ours."""
    path = golden / "limb-posterior" / "tet4.feb.gz"
    theirs = etree.fromstring(gzip.decompress(path.read_bytes()))
    return theirs, etree.fromstring(render(read_feb(path)).encode("iso-8859-1"))


@pytest.mark.parametrize(
    "section", ["Control", "Contact", "Boundary", "Rigid", "MeshDomains", "LoadData", "Module"]
)
def test_sections_are_those_of_the_golden_limb(limb_twice, section: str) -> None:
    theirs, ours = limb_twice
    one, two = theirs.find(section), ours.find(section)
    assert one is not None
    assert two is not None
    assert leaves(one) == leaves(two)
    theirs_order = [each.tag for each in theirs if each.tag != "MeshData"]
    assert [each.tag for each in ours if isinstance(each.tag, str)] == theirs_order


@pytest.mark.slow
def test_a_model_of_50000_nodes_is_written_and_read_in_seconds(model: LimbModel, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    points = rng.normal(size=(50_000, 3))
    cells = rng.integers(0, 50_000, size=(30_000, 10))
    mesh = replace(model.mesh, points=points, blocks=(Block("tissue", "tet10", cells), model.mesh.blocks[1]))
    start = time.process_time()  # of this process alone: the machine may be busy
    back = round_trip(model.with_mesh(mesh), tmp_path)
    seconds = time.process_time() - start
    assert np.array_equal(back.mesh.blocks[0].cells, cells)
    assert seconds < 5, f"{seconds:.1f} s: rows must not pass through template loops"
