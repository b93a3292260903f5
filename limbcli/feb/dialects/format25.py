"""Format 2.5 to 3.0: geometry, one flat control, conditions by attributes, load curves.

Source: FEBio 4.11, FEBioGeometrySection25, FEBioControlSection, FEBioBoundarySection25,
FEBioContactSection25, FEBioLoadDataSection.
"""

from __future__ import annotations

from lxml import etree

from limbcli.feb.dialects.building import add, moved, new, split, taken
from limbcli.feb.read_control import OUTPUT_CONTROL, SOLVER
from limbcli.feb.xml import Tag

_SHELLS = ("tri", "quad", "q4")
_OF_STEP = ("time_steps", "step_size", "time_stepper", "analysis", *OUTPUT_CONTROL)
_OF_SOLVER = (
    *SOLVER,
    "max_ups",
    "qnmethod",
    "qn_max_buffer_size",
    "qn_cycle_buffer",
    "cmax",
    "linear_solver",
)
_ANALYSES = {
    "static": "STATIC", "steady-state": "STATIC", "dynamic": "TRANSIENT", "transient": "TRANSIENT"
}  # fmt: skip
_RIGID = {"x": "Rx", "y": "Ry", "z": "Rz", "Rx": "Ru", "Ry": "Rv", "Rz": "Rw"}


def to_format_30(root: Tag) -> None:
    """Convert a file of format 2.5, in place."""
    _steps(root)
    geometry = root.element.find("Geometry")
    if geometry is not None:
        _geometry(geometry, root)
    for owner in (root.element, *root.element.iterfind("Step/step")):
        for control in owner.findall("Control"):
            _control(control, root)
        for section in [*owner.findall("Boundary"), *owner.findall("Constraints")]:
            _conditions(section, owner)
    data = root.element.find("LoadData")
    for curve in data.findall("loadcurve") if data is not None else []:
        _curve(curve)


def _steps(root: Tag) -> None:
    """The <Step> sections, which contain one step each, become one section."""
    found = [each for each in root.element.findall("Step") if each.find("step") is None]
    if not found:
        return
    all_steps = new("Step", found[0])
    root.element.insert(root.element.index(found[0]), all_steps)
    for number, each in enumerate(found, start=1):
        moved(each, "step", drop=("type",)).set("id", str(number))
        all_steps.append(each)


def _geometry(geometry: etree._Element, root: Tag) -> None:
    """<Geometry> becomes <Mesh>, and the materials of its parts <MeshDomains>."""
    geometry.tag = "Mesh"
    # surfaces of format 2.5 list nodes by their place in the file, elements by id: both must be the same
    ids = [each.get("id") for each in geometry.iterfind("Nodes/node")]
    if ids != [str(k) for k in range(1, len(ids) + 1)]:
        raise root.of(geometry).problem(
            "in format 2.5 nodes that are not numbered 1, 2, 3, ... cannot be told apart",
            fix="save the model in FEBio's format 4.0 (FEBio Studio: export)",
        )
    domains = new("MeshDomains", geometry)
    root.element.insert(root.element.index(geometry) + 1, domains)
    names = {each.get("id"): each.get("name") for each in root.element.iterfind("Material/material")}
    for number, part in enumerate(geometry.findall("Elements"), start=1):
        mat = taken(part, "mat")
        name = part.get("name") or f"part_{number}"
        part.set("name", name)
        kind = "Shell" if (part.get("type") or "").lower().startswith(_SHELLS) else "Solid"
        given = mat if mat in names.values() else names.get(mat) or f"material_{mat}"
        domains.append(new(f"{kind}Domain", part, name=name, mat=given))
    for each in geometry.findall("NodeSet"):
        _node_list(each)
    for pair in geometry.findall("SurfacePair"):
        for old, now in (("slave", "primary"), ("master", "secondary")):
            for side in pair.findall(old):
                side.text = taken(side, "surface") or side.text
                side.tag = now


def _node_list(tag: etree._Element) -> None:
    """<node_list> and <NodeSet node_set=""/> within a set are resolved."""
    ids: list[str] = []
    geometry = tag.getparent()
    assert geometry is not None
    for each in tag:
        if each.tag in ("n", "node") and each.get("id"):
            ids.append(str(each.get("id")))
        elif each.tag == "node_list":
            ids += split(each.text or "")
        elif each.tag == "NodeSet":
            other = [o for o in geometry.findall("NodeSet") if o.get("name") == each.get("node_set")]
            if not other:
                return
            ids += split(other[0].text or "")
        else:
            return
    if len(tag):
        for each in list(tag):
            tag.remove(each)
        tag.text = ",".join(ids)


def _control(control: etree._Element, root: Tag) -> None:
    solver = control.find("solver")
    solver = add(control, "solver", control) if solver is None else solver
    for each in list(control):
        if each.tag == "print_level":
            root.ignore("<print_level>, which FEBio 4 does not have")
            control.remove(each)
        elif each.tag == "analysis" and each.get("type"):
            kind = taken(each, "type") or ""
            each.text = _ANALYSES.get(kind, kind)
        elif each.tag in _OF_SOLVER and each.tag not in _OF_STEP:
            solver.append(each)


def _conditions(section: etree._Element, owner: etree._Element) -> None:
    for each in list(section):
        if each.tag in ("fix", "prescribe"):
            dofs, kind = taken(each, "bc"), str(each.tag)
            moved(each, "bc").set("type", kind)
            each.append(new("dofs" if kind == "fix" else "dof", each, dofs))
            for scale in each.findall("value"):
                if "node_data" in scale.attrib:
                    scale.text = taken(scale, "node_data")
                    scale.set("type", "map")
        elif each.tag == "rigid" and each.get("rb"):
            body = taken(each, "rb")
            moved(each, "bc").set("type", "rigid")
            each.append(new("rb", each, body))
        elif each.tag == "rigid_body" and each.get("mat"):
            _rigid_body(each, owner)
    if section.tag == "Constraints" and not len(section):
        owner.remove(section)


def _rigid_body(tag: etree._Element, owner: etree._Element) -> None:
    """Conditions of a rigid body, which become entries of <Rigid>; unknown ones stay and are refused."""
    section = owner.find("Rigid")
    section = add(owner, "Rigid", tag) if section is None else section
    for each in list(tag):
        dof = _RIGID.get(each.get("bc") or "")
        relative = each.get("type")
        if dof is None or each.tag not in ("fixed", "prescribed", "force"):
            continue
        if relative not in (None, "absolute", "relative") or (each.tag == "force" and relative):
            continue
        kinds = {"fixed": "fix", "prescribed": "prescribe", "force": "force"}
        made = new("rigid_constraint", each, type=kinds[str(each.tag)])
        made.append(new("rb", each, tag.get("mat")))
        made.append(new("dofs" if each.tag == "fixed" else "dof", each, dof))
        if each.tag != "fixed":
            made.append(new("value", each, each.text, lc=each.get("lc")))
            made.append(new("relative", each, "1" if relative == "relative" else "0"))
        section.append(made)
        tag.remove(each)
    parent = tag.getparent()
    if not len(tag) and parent is not None:
        parent.remove(tag)


def _curve(curve: etree._Element) -> None:
    """A <loadcurve> becomes a <load_controller>."""
    kind, extend = taken(curve, "type") or "linear", taken(curve, "extend") or "constant"
    points = new("points", curve)
    for each in list(curve):
        each.tag = "pt" if each.tag in ("point", "loadpoint") else each.tag
        points.append(each)
    moved(curve, "load_controller").set("type", "loadcurve")
    curve.text = None
    curve.extend([new("interpolate", curve, kind), new("extend", curve, extend), points])
