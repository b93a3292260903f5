"""The text of a model file as it is run: a foreign one is first made one whose results can be read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

from lxml import etree

from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.feb.write import encoded, render
from limbcli.feb.xml import UNITS, VERSION, is_native, model_text, open_model, stated_units, units_of
from limbcli.files.xml import parsed_xml
from limbcli.model import LimbModel


@dataclass(frozen=True)
class Runnable:
    """text : of the file to run; said : what was changed, one sentence each."""

    text: bytes
    said: tuple[str, ...] = ()


def runnable(source: Path) -> Runnable:
    """A file of format 4.0 in mm-N-s as it stands, but without names for its log and plot file, which would
    lead them away from the run's folder; any other file converted to it.

    Raises CaseError if the file cannot be read, or needs a conversion and holds what limbcli does not
    support.
    """
    root = open_model(source)
    said = [] if stated_units(root) else [f"the model states no unit system: it is taken to be in {UNITS}"]
    if not is_native(root):
        version, units = root.optional("version"), units_of(root)
        said += [f"model converted from FEBio's format {version} to {VERSION}"] if version != VERSION else []
        said += [f"model scaled from {units} to {UNITS}: results are in mm, N, MPa"] if units != UNITS else []
        return Runnable(encoded(render(_readable(source)), source), tuple(said))
    text = model_text(source)
    led = root.element.findall("Output/*[@file]")
    if not led:
        return Runnable(text, tuple(said))
    tree = parsed_xml(text)
    for each in tree.findall("Output/*[@file]"):
        del each.attrib["file"]
    names = " and ".join(f"<{each.tag}>" for each in led)
    said += [f"file name of {names} left out: a run's log is model.log, and its plot file is not kept"]
    written = etree.tostring(tree.getroottree(), xml_declaration=True, encoding="ISO-8859-1")
    return Runnable(cast(bytes, written), tuple(said))


def _readable(source: Path) -> LimbModel:
    try:
        return read_feb(source)
    except CaseError as error:
        other = f"; limbcli runs files that it cannot read only in format {VERSION} and {UNITS}, with FEBio"
        raise CaseError(error.what, where=error.where, fix=error.fix + other, **error.facts) from error
