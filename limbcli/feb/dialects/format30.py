"""Format 3.0 to 4.0: boundary and rigid conditions, sets listed by children, control, and map attributes.

Source: FEBio 4.11, FEBioBoundarySection3, FEBioRigidSection, FEBioMeshSection, FEBioControlSection3.
"""

from __future__ import annotations

from lxml import etree

from limbcli.feb.dialects.building import add, new, set_ids, split, step_owners
from limbcli.feb.xml import Tag

_ANALYSES = {
    "STEADY_STATE": "STATIC", "STEADY-STATE": "STATIC", "STATIC": "STATIC", "0": "STATIC",
    "TRANSIENT": "TRANSIENT", "DYNAMIC": "TRANSIENT", "1": "TRANSIENT",
}  # fmt: skip
_OF_QUASI_NEWTON = {
    "max_ups": "max_ups", "qn_max_buffer_size": "max_buffer_size", "qn_cycle_buffer": "cycle_buffer",
    "cmax": "cmax",
}  # fmt: skip
_METHODS = {"0": "BFGS", "BFGS": "BFGS", "1": "Broyden", "BROYDEN": "Broyden", "2": "JFNK", "JFNK": "JFNK"}
_OF_SHELLS = ("shell_formulation", "shell_normal_nodal")
_SHELL_DOFS = frozenset({"u", "v", "w", "sx", "sy", "sz"})
_RIGID = ("Rx", "Ry", "Rz", "Ru", "Rv", "Rw")
_SHORT = {"Rx": "x", "Ry": "y", "Rz": "z"}


def to_format_40(root: Tag) -> None:
    """Convert a file of format 3.0, in place."""
    for each in root.element.iterfind("Mesh/NodeSet"):
        set_ids(each, ("n", "node"))
    for each in root.element.iterfind("Mesh/ElementSet"):
        set_ids(each, ("e", "elem"))
    for each in root.element.iterfind("MeshData/*"):
        _rename(each, "datatype", "data_type")
        _rename(each, "var", "type")
        _rename(each, "generator", "type")
    for owner in step_owners(root):
        for control in owner.iterfind("Control"):
            _control(control, root)
        for each in list(owner.iterfind("Boundary/bc")):
            kind = each.get("type")
            if kind == "fix":
                _fixed(each, root)
            elif kind == "prescribe" and (each.findtext("dof") or "").strip() in ("x", "y", "z"):
                each.set("type", "prescribed displacement")
                for scale in each.findall("scale"):
                    scale.tag = "value"
        for each in list(owner.iterfind("Rigid/rigid_constraint")):
            _rigid(each)


def _rename(element: etree._Element, old: str, new_name: str) -> None:
    if old in element.attrib and new_name not in element.attrib:
        element.set(new_name, element.attrib.pop(old))


def _control(control: etree._Element, root: Tag) -> None:
    analysis = control.find("analysis")
    if analysis is not None:
        analysis.text = _ANALYSES.get((analysis.text or "").strip(), analysis.text)
    for name in _OF_SHELLS:
        for each in control.findall(name):
            root.ignore(f"<{name}>, which only deformable shells use")
            control.remove(each)
    solver = control.find("solver")
    if solver is None:  # FEBio makes one in this format, but not in 4.0
        new("solver", control)
    else:
        _quasi_newton(solver)


def _quasi_newton(solver: etree._Element) -> None:
    """<qnmethod>, <max_ups> and others of the solver become parts of <qn_method>."""
    named = solver.find("qnmethod")
    kind = _METHODS.get((named.text or "").strip().upper()) if named is not None else None
    loose = [each for each in solver if each.tag in _OF_QUASI_NEWTON]
    if kind is None and not loose:
        return
    method = solver.find("qn_method")
    if method is None:
        method = new("qn_method", solver, type=kind or "BFGS")
        solver.append(method)
    if named is not None and kind is not None:
        solver.remove(named)
    for each in loose:
        each.tag = _OF_QUASI_NEWTON[str(each.tag)]
        method.append(each)


def _fixed(tag: etree._Element, root: Tag) -> None:
    given = tag.find("dofs")
    dofs = split(given.text or "") if given is not None else []
    if given is None or not dofs:
        return
    kept = [dof for dof in dofs if dof not in _SHELL_DOFS]
    if len(kept) < len(dofs):
        root.ignore("fixed rotations of nodes, which only deformable shells have")
    if not kept:
        parent = tag.getparent()
        assert parent is not None
        parent.remove(tag)
    elif set(kept) <= {"x", "y", "z"}:
        tag.remove(given)
        tag.set("type", "zero displacement")
        for dof in kept:
            add(tag, f"{dof}_dof", tag, "1")
    elif kept == ["p"]:
        tag.remove(given)
        tag.set("type", "zero fluid pressure")


def _rigid(tag: etree._Element) -> None:
    kind = tag.get("type")
    given = tag.find("dofs" if kind == "fix" else "dof")
    if given is None or kind not in ("fix", "prescribe", "force"):
        return
    dofs = [_RIGID[int(dof)] if dof in "012345" else dof for dof in split(given.text or "")]
    if not dofs or not set(dofs) <= set(_RIGID):
        return
    if kind == "fix":
        tag.remove(given)
        for dof in dofs:
            add(tag, f"{dof}_dof", tag, "1")
        tag.tag, name = "rigid_bc", "rigid_fixed"
    else:
        turns = dofs[0] not in _SHORT
        if kind == "prescribe":
            given.text = dofs[0] if turns else _SHORT[dofs[0]]
            tag.tag, name = "rigid_bc", "rigid_rotation" if turns else "rigid_displacement"
        else:
            given.text = dofs[0]
            tag.tag, name = "rigid_load", "rigid_moment" if turns else "rigid_force"
    tag.set("type", name)
