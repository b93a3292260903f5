"""Model files as FEBio Studio, GIBBON and pyfebio write them, in other units, of formats 2.5 to 4.0."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.feb.outline import read_outline
from limbcli.feb.read import IGNORED, read_feb
from limbcli.feb.runnable import runnable
from limbcli.feb.write import write_feb
from limbcli.model import LimbModel

BODY = '<material id="2" name="probe" type="rigid body"><density>1e-09</density>'
CENTRE = "<center_of_mass>0,0,-0.05</center_of_mass>"


@pytest.fixture
def changed(punch: Path, tmp_path: Path):
    """A copy of the small model with parts of its text replaced, each exactly once."""

    def change(*pairs: tuple[str, str], name: str = "foreign.feb") -> Path:
        text = punch.read_text()
        for old, new in pairs:
            assert text.count(old) >= 1, old
            text = text.replace(old, new, 1)
        path = tmp_path / name
        path.write_text(text)
        return path

    return change


def assert_same(found: LimbModel, expected: LimbModel) -> None:
    """Everything that a solver uses, but not the names and numbers of curves."""
    np.testing.assert_allclose(found.mesh.points, expected.mesh.points, rtol=1e-12, atol=1e-12)
    for mine, theirs in zip(found.mesh.blocks, expected.mesh.blocks, strict=True):
        assert (mine.name, mine.kind) == (theirs.name, theirs.kind)
        assert np.array_equal(mine.cells, theirs.cells)
    for name, law in expected.materials.items():
        assert found.materials[name].law == law.law
        assert found.materials[name].parameters == pytest.approx(dict(law.parameters), rel=1e-9)
    assert [body.blocks for body in found.bodies] == [body.blocks for body in expected.bodies]
    for mine, theirs in zip(found.bodies, expected.bodies, strict=True):
        assert mine.center_of_mass == pytest.approx(theirs.center_of_mass, abs=1e-12)
    nodes = [[each.mesh.node_sets[s.node_set].tolist() for s in each.supports] for each in (found, expected)]
    assert nodes[0] == nodes[1]
    assert [each.dofs for each in found.supports] == [each.dofs for each in expected.supports]
    for mine, theirs in zip(found.drives, expected.drives, strict=True):
        assert (mine.body, mine.dof, mine.kind) == (theirs.body, theirs.dof, theirs.kind)
        assert mine.value == pytest.approx(theirs.value)
    for mine, theirs in zip(found.contacts, expected.contacts, strict=True):
        assert mine.penalty == pytest.approx(theirs.penalty)
        assert mine.search_radius == pytest.approx(theirs.search_radius)
        assert (mine.auto_penalty, mine.primary) == (theirs.auto_penalty, theirs.primary)
    assert [each.points for each in found.curves.values()] == [e.points for e in expected.curves.values()]
    for mine, theirs in zip(found.steps, expected.steps, strict=True):
        assert (mine.n_steps, mine.step_size, mine.analysis) == (
            theirs.n_steps, theirs.step_size, theirs.analysis,
        )  # fmt: skip
        assert (mine.must_points, mine.max_retries) == (theirs.must_points, theirs.max_retries)


# ---------------------------------------------------------------- names with @


@pytest.mark.parametrize(
    ("before", "name", "nodes"),
    [
        ("", "@surface:skin", None),
        ('<Surface name="top"><tri3 id="1">52,51,57</tri3></Surface>', "@surface:top", [51, 50, 56]),
        (
            '<Edge name="rim"><line2 id="1">3,2</line2><line2 id="2">2,9</line2></Edge>',
            "@edge:rim",
            [2, 1, 8],
        ),
        ('<ElementSet name="one">1</ElementSet>', "@elem_set:one", None),
        ('<PartList name="list">tissue</PartList>', "@part_list:list", None),
        ("", "@elem_set:tissue", None),
        ("", "all_nodes", None),
    ],
)
def test_node_sets_that_febio_makes(changed, before: str, name: str, nodes: list[int] | None) -> None:
    model = read_feb(changed(("</Mesh>", f"{before}</Mesh>"), ('node_set="fixed"', f'node_set="{name}"')))
    found = model.mesh.node_sets[model.supports[0].node_set].tolist()
    if nodes is not None:
        assert found == nodes
    elif name == "@surface:skin":  # a node set of that name goes first
        assert found == list(range(50, 75))
    elif name == "@elem_set:one":
        assert found == model.mesh.block("tissue").cells[0].tolist()
    elif name == "all_nodes":
        assert found == list(range(len(model.mesh.points)))
    else:
        assert sorted(found) == np.unique(model.mesh.block("tissue").cells).tolist()


def test_a_node_set_that_febio_makes_is_written_under_a_plain_name(changed, tmp_path: Path) -> None:
    list_of_parts = ("</Mesh>", '<PartList name="list">tissue</PartList></Mesh>')
    model = read_feb(changed(list_of_parts, ('node_set="fixed"', 'node_set="@part_list:list"')))
    path = write_feb(model, tmp_path / "again.feb")
    assert "@" not in path.read_text()
    assert_same(read_feb(path), model)


@pytest.mark.parametrize(
    "name", ["@surface:none", "@edge:skin", "@elem_set:none", "@part_list:tissue", "@x:skin"]
)
def test_an_at_name_of_what_is_not_there_is_refused(changed, name: str) -> None:
    with pytest.raises(CaseError, match="there is no"):
        read_feb(changed(('node_set="fixed"', f'node_set="{name}"')))


# ---------------------------------------------------------------- rigid bodies and shells

THICK = '<ShellDomain name="probe" mat="probe"><shell_thickness>0.2</shell_thickness></ShellDomain>'
THIN = '<ShellDomain name="probe" mat="probe"/>'


def test_without_centre_of_mass_shells_without_thickness_have_theirs_at_the_origin(changed) -> None:
    """As in FEBio, which divides by no mass (FERigidBody::UpdateCOM)."""
    assert read_feb(changed((CENTRE, ""))).bodies[0].center_of_mass == (0, 0, 0)


@pytest.mark.parametrize(
    "given", ["", "<override_com>0</override_com>", f"{CENTRE}<override_com>0</override_com>"]
)
@pytest.mark.parametrize("by_map", [False, True])
def test_without_centre_of_mass_it_is_that_of_the_mesh(changed, given: str, by_map: bool) -> None:
    rows = "".join(f'<e lid="{k}">0.2,0.2,0.2,0.2</e>' for k in range(1, 5))
    data = f'<MeshData><ElementData type="shell thickness" elem_set="probe">{rows}</ElementData></MeshData>'
    thick = ("</MeshDomains>", f"</MeshDomains>{data}") if by_map else (THIN, THICK)
    model = read_feb(changed((CENTRE, given), thick))
    shells = model.mesh.points[model.mesh.block("probe").cells].mean(axis=1)
    assert len(shells) == 4
    assert model.bodies[0].center_of_mass == pytest.approx(shells.mean(axis=0).tolist())


@pytest.mark.parametrize(
    "given", [CENTRE, f"<override_com>1</override_com>{CENTRE}", f"<override_com>0</override_com>{CENTRE}"]
)
def test_a_centre_of_mass_that_is_given_counts(changed, given: str) -> None:
    assert read_feb(changed((CENTRE, given), (THIN, THICK))).bodies[0].center_of_mass == (0, 0, -0.05)


def test_a_rigid_solid_has_the_centre_of_its_volume(changed) -> None:
    law = '<material id="1" name="tissue" type="Ogden unconstrained">'
    text = changed().read_text()
    start, end = text.index(law), text.index("</material>")
    model = read_feb(
        changed(
            (text[start:end], '<material id="1" name="tissue" type="rigid body">'),
            (
                '<SolidDomain name="tissue" mat="tissue"/>',
                '<SolidDomain name="tissue" mat="tissue" type="rigid-solid"/>',
            ),
        )
    )
    low, high = model.mesh.points[:75].min(axis=0), model.mesh.points[:75].max(axis=0)
    assert model.bodies[0].center_of_mass == pytest.approx(((low + high) / 2).tolist(), abs=1e-9)


def test_rigid_bodies_that_share_nodes_are_refused(changed) -> None:
    """FEBio makes one body of them."""
    other = f'<material id="3" name="other" type="rigid body">{CENTRE}</material></Material>'
    part = '<Elements type="tri3" name="other"><elem id="900">76,77,80</elem></Elements>\n<NodeSet'
    domain = '<ShellDomain name="other" mat="other"/></MeshDomains>'
    pairs = (("</Material>", other), ("<NodeSet", part), ("</MeshDomains>", domain))
    with pytest.raises(CaseError, match="'probe' and 'other' share nodes"):
        read_feb(changed(*pairs))


def test_a_rigid_body_may_be_named_by_its_material_s_id(changed, punch: Path) -> None:
    assert_same(read_feb(changed(("<rb>probe", "<rb>2"), ("<rb>probe", "<rb>2"))), read_feb(punch))
    with pytest.raises(CaseError, match=r"no rigid body '1'[\s\S]*a material of the type rigid body"):
        read_feb(changed(("<rb>probe", "<rb>1")))


# ---------------------------------------------------------------- what is left out, and what is refused


def test_harmless_content_is_left_out_and_listed(changed, punch: Path, tmp_path: Path) -> None:
    more = (
        '<face_data data="contact pressure" surface="skin" file="p.txt"/><node_data data="ux"/>'
        '<element_data data="=sx+sy" file="sum.txt"/><rigid_connector_data data="RCFx" file="c.txt"/>'
        "</logfile>"
        '<plotfile type="febio" file="x.xplt"><var type="displacement" surface="skin"/>'
        "<compression>1</compression></plotfile>"
    )
    rows = "".join(f'<e lid="{k}">1</e>' for k in range(1, 5))
    lonely = f'<ElementData name="lonely" elem_set="probe">{rows}</ElementData>'
    path = changed(
        ("<logfile>", '<logfile file="/home/me/run.txt">'),
        ("</logfile>", more),
        (
            "<Boundary>",
            f"<Loads/><Constraints></Constraints><Discrete/><MeshData>{lonely}</MeshData><Boundary>",
        ),
    )
    model = read_feb(path)
    assert_same(model, read_feb(punch))
    listed = "; ".join(model.info[IGNORED])
    for words in (
        "'lonely'",
        "<face_data>",
        "'ux'",
        "'=sx+sy'",
        "RCFx",
        "<plotfile>",
        "<logfile>",
        "empty <Discrete>",
    ):
        assert words in listed
    assert [each.file for each in read_outline(path).records] == [each.file for each in model.records]
    again = read_feb(write_feb(model, tmp_path / "again.feb"))
    assert IGNORED not in again.info


def test_one_error_tells_all_that_is_refused(changed) -> None:
    path = changed(
        ("<Boundary>", '<Loads><body_load type="centrifugal"/></Loads><Boundary>'),
        ('type="Ogden unconstrained"', 'type="Yeoh"'),
        ('type="sliding-elastic"', 'type="sticky"'),
        ("</Boundary>", '<bc type="zero concentration"/><bc type="zero concentration"/></Boundary>'),
        ('type="tet4"', 'type="tet15"'),
    )
    with pytest.raises(CaseError) as caught:
        read_feb(path)
    error = caught.value
    assert len(error.facts["problems"]) == 5
    for words in (
        "'centrifugal'",
        "'Yeoh'",
        "'sticky'",
        "concentration' is not supported (and 1 more",
        "'tet15'",
    ):
        assert words in error.what
    assert "there is no" not in error.what, "what follows from another refusal is not told"
    assert error.facts["line"] == int(error.facts["problems"][0].split()[1].rstrip(":"))


def test_datatype_is_a_word_of_older_formats(changed) -> None:
    rows = "".join(f'<e lid="{k}">1</e>' for k in range(1, 5))
    data = (
        f'<MeshData><ElementData name="m" elem_set="probe" datatype="scalar">{rows}</ElementData></MeshData>'
    )
    with pytest.raises(CaseError, match=r"datatype='scalar'(.|\n)*did you mean data_type"):
        read_feb(changed(("</MeshDomains>", f"</MeshDomains>{data}")))
    model = read_feb(changed(("</MeshDomains>", f"</MeshDomains>{data}"), ('version="4.0"', 'version="3.0"')))
    assert model.info[IGNORED] == ["map 'm', which nothing uses"]


@pytest.mark.parametrize(("named", "rule"), [("TET10G8", None), ("TET10G8_S7", None), ("TET10G4", "TET10G4")])
def test_an_element_type_may_name_its_rule(
    golden: Path, tmp_path: Path, named: str, rule: str | None
) -> None:
    path = tmp_path / "model.feb"
    text = (golden / "cube-shear-tet10-m8-fk1" / "model.feb").read_text()
    path.write_text(text.replace('type="tet10"', f'type="{named}"'))
    model = read_feb(path)
    assert (model.mesh.blocks[0].kind, model.domains[0].rule) == ("tet10", rule)
    path.write_text(text.replace('type="tet10"', 'type="TET10G4_S3"'))
    with pytest.raises(CaseError, match="TET10G4_S3"):
        read_feb(path)


# ---------------------------------------------------------------- units


def in_units(text: str, length: float, stress: float) -> str:
    """The small model with lengths divided by `length` and stresses by `stress`."""
    import re

    def nodes(found: re.Match[str]) -> str:
        at = ",".join(repr(float(x) / length) for x in found[2].split(","))
        return f"<node id={found[1]}>{at}</node>"

    text = re.sub(r"<node id=(\"\d+\")>([^<]*)</node>", nodes, text)
    for name in ("cp", "c1", "c2"):
        text = re.sub(rf"<{name}>([^<]*)<", lambda m, n=name: f"<{n}>{float(m[1]) / stress!r}<", text)
    text = text.replace("0,0,-0.05<", f"0,0,{-0.05 / length!r}<").replace(">-1.95<", f">{-1.95 / length!r}<")
    return re.sub(r"<search_radius>([^<]*)<", lambda m: f"<search_radius>{float(m[1]) / length!r}<", text)


@pytest.mark.parametrize(
    ("units", "length", "stress"),
    [("SI", 1e3, 1e-6), ("CGS", 10.0, 1e-7), ("mm-kg-s", 1.0, 1e-3), ("um-nN-s", 1e-3, 1e-3)],
)
def test_other_units_are_scaled_and_said(
    punch: Path, tmp_path: Path, units: str, length: float, stress: float
) -> None:
    path = tmp_path / "si.feb"
    path.write_text(in_units(punch.read_text(), length, stress).replace("mm-N-s", units))
    assert_same(read_feb(path), read_feb(punch))
    run = runnable(path)
    assert units in run.said[0]
    (tmp_path / "run.feb").write_bytes(run.text)
    assert_same(read_feb(tmp_path / "run.feb"), read_feb(punch))
    read_outline(tmp_path / "run.feb")
    with pytest.raises(CaseError, match=f"in {units}, not of 4.0 in mm-N-s"):
        read_outline(path)


def test_a_model_without_units_is_said_to_be_taken_for_ours(punch: Path, tmp_path: Path) -> None:
    path = tmp_path / "bare.feb"
    path.write_text(punch.read_text().replace("<units>mm-N-s</units>", ""))
    run = runnable(path)
    assert run.said == ("the model states no unit system: it is taken to be in mm-N-s",)
    assert run.text == path.read_bytes()
    assert runnable(punch).said == ()


def test_a_penalty_without_auto_penalty_is_scaled(punch: Path, tmp_path: Path) -> None:
    """20 MPa/mm are 2e10 Pa/m."""
    path = tmp_path / "si.feb"
    text = in_units(punch.read_text(), 1e3, 1e-6).replace("mm-N-s", "SI")
    path.write_text(
        text.replace("<penalty>20", "<penalty>2e10").replace("<auto_penalty>1", "<auto_penalty>0")
    )
    assert read_feb(path).contacts[0].penalty == pytest.approx(20)


# ---------------------------------------------------------------- older formats


def as_children(ids: str) -> str:
    return "".join(f'<n id="{k}"/>' for k in ids.split(","))


def format_30(text: str) -> str:
    """The small model as GIBBON writes it in format 3.0."""
    import re

    text = text.replace('version="4.0"', 'version="3.0"')
    text = re.sub(r'(<NodeSet name="\w+">)([^<]*)<', lambda m: f"{m[1]}{as_children(m[2])}<", text)
    text = text.replace(
        '<bc name="fixed" type="zero displacement" node_set="fixed"><x_dof>1</x_dof><y_dof>1</y_dof>'
        "<z_dof>1</z_dof></bc>",
        '<bc type="fix" node_set="fixed"><dofs>x,y,z</dofs></bc>',
    )
    start, end = text.index("<Rigid>"), text.index("</Rigid>")
    rigid = (
        '<Rigid><rigid_constraint type="fix"><rb>2</rb><dofs>Rx,Ry,Ru,Rv,Rw</dofs></rigid_constraint>'
        '<rigid_constraint type="prescribe"><rb>2</rb><dof>Rz</dof><value lc="1">-1.95</value>'
        "<relative>0</relative></rigid_constraint>"
    )
    text = text[:start] + rigid + text[end:]
    return text.replace('<qn_method type="BFGS"><max_ups>10</max_ups></qn_method>', "<max_ups>10</max_ups>")


def format_25(text: str) -> str:
    """The small model as FEBio 2 reads it."""
    import re

    text = text.replace('version="4.0"', 'version="2.5"')
    text = text.replace(
        "<analysis>STATIC</analysis>", '<analysis type="static"/><print_level>PRINT_DEFAULT</print_level>'
    )
    text = text.replace('<solver type="solid">', "").replace("</solver>", "")
    text = text.replace('<qn_method type="BFGS"><max_ups>10</max_ups></qn_method>', "<max_ups>10</max_ups>")
    text = text.replace("<Mesh>", "<Geometry>").replace("</Mesh>", "</Geometry>")
    text = text.replace('type="tet4"', 'type="tet4" mat="1"').replace(
        'type="quad4"', 'type="quad4" mat="probe"'
    )
    text = re.sub(r'(<NodeSet name="\w+">)([^<]*)<', lambda m: f"{m[1]}{as_children(m[2])}<", text)
    text = re.sub(r"<MeshDomains>.*?</MeshDomains>", "", text, flags=re.DOTALL)
    text = re.sub(
        r"<primary>(\w+)</primary><secondary>(\w+)</secondary>",
        r'<master surface="\2"/><slave surface="\1"/>', text,
    )  # fmt: skip
    boundary = (
        '<Boundary><fix bc="x,y,z" node_set="fixed"/><rigid_body mat="2"><fixed bc="x"/><fixed bc="y"/>'
        '<fixed bc="Rx"/><fixed bc="Ry"/><fixed bc="Rz"/>'
        '<prescribed bc="z" lc="1">-1.95</prescribed></rigid_body></Boundary>'
    )
    text = re.sub(r"<Boundary>.*?</Boundary>", boundary, text, flags=re.DOTALL)
    text = re.sub(r"<Rigid>.*?</Rigid>", "", text, flags=re.DOTALL)
    text = re.sub(
        r'<load_controller id="(\d)"[^>]*><interpolate>(\w+)</interpolate><extend>CONSTANT</extend>'
        r"<points>(.*?)</points></load_controller>",
        lambda m: f'<loadcurve id="{m[1]}" type="{m[2].lower()}">{m[3].replace("pt>", "point>")}</loadcurve>',
        text,
    )
    return text


@pytest.mark.parametrize("convert", [format_30, format_25])
def test_older_formats_are_converted(punch: Path, tmp_path: Path, convert) -> None:
    path = tmp_path / "old.feb"
    path.write_text(convert(punch.read_text()))
    found, expected = read_feb(path), read_feb(punch)
    assert_same(found, expected)
    assert found.steps[0].control["qn_method"] == "BFGS"
    assert found.steps[0].control["max_ups"] == 10
    run = runnable(path)
    assert "converted from FEBio's format" in run.said[-1]
    (tmp_path / "run.feb").write_bytes(run.text)
    assert_same(read_feb(tmp_path / "run.feb"), expected)


@pytest.mark.parametrize("convert", [format_30, format_25])
def test_what_an_older_format_holds_beyond_the_scope_is_named_with_its_line(
    punch: Path, tmp_path: Path, convert
) -> None:
    path = tmp_path / "old.feb"
    text = convert(punch.read_text())
    load = '<Loads><surface_load type="bearing load"/></Loads>\n<Material>'
    path.write_text(text.replace("<Material>", load, 1).replace('type="sliding-elastic"', 'type="sticky"', 1))
    with pytest.raises(CaseError, match=r"2 things(.|\n)*'bearing load'(.|\n)*'sticky'") as caught:
        read_feb(path)
    assert caught.value.facts["line"] == 1 + path.read_text().split("<Loads>")[0].count("\n")


def test_steps_of_format_25_become_steps(punch: Path, tmp_path: Path) -> None:
    text = format_25(punch.read_text())
    start, end = text.index("<Control>"), text.index("</Control>") + len("</Control>")
    control = text[start:end].replace(' lc="2"', "")
    step = f'<Step name="one">{control}</Step>'
    path = tmp_path / "steps.feb"
    path.write_text(text[:start] + text[end:].replace("<Output>", f"{step}{step}<Output>"))
    assert [each.n_steps for each in read_feb(path).steps] == [10, 10]


def test_nodes_of_format_25_with_numbers_of_their_own_are_refused(punch: Path, tmp_path: Path) -> None:
    path = tmp_path / "old.feb"
    path.write_text(format_25(punch.read_text()).replace('<node id="77"', '<node id="177"'))
    with pytest.raises(CaseError, match="not numbered 1, 2, 3"):
        read_feb(path)
