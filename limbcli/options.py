"""What an argument of a function is: its help, the range of its number, its form on the command line.

The functions of `limbcli.api` declare each argument once, as `name: Annotated[type, Option(...)] = default`.
The options of the commands, the checks of ranges, and the list of parameters in the functions' documentation
are made from this.
"""

from __future__ import annotations

import functools
import inspect
import textwrap
import types
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, Union, get_args, get_origin

from limbcli.numbers.mesh_bounds import ELEMENTS, MARGIN_MM

Bounds: TypeAlias = tuple[float | None, float | None]
SolverName = Literal["auto", "febio", "reference"]
LawName = Literal["ogden", "mooney-rivlin", "neo-hooke", "two-term-ogden", "holmes-mow", "fibres"]
_ANNOTATED = "Annotated["
_PLAIN = (str, int, float, bool)


@dataclass(frozen=True)
class Option:
    """Help of an argument, and what its type and default do not say about it.

    bounds : (lowest, largest) of its number, in its unit; None: without this end
    python : help in Python, where it differs
    flag, short : names on the command line; default: `--` and the argument's name, with hyphens
    kind : type on the command line, if it is not the argument's own
    example : of a table of numbers, for the message of an argument that is none
    before : argument before which the command line lists it
    such_as : what its value may be or begin with, for completion; besides the words of its type
    """

    help: str
    bounds: Bounds = (None, None)
    _: KW_ONLY
    python: str = ""
    flag: str = ""
    short: str = ""
    metavar: str | None = None
    kind: Any = None
    example: Mapping[str, float] | None = None
    before: str = ""
    such_as: tuple[str, ...] = ()


@dataclass(frozen=True)
class Argument:
    """An argument of a function.

    type : as written
    kinds : its types other than None
    positional : it may be given without its name
    """

    name: str
    type: str
    kinds: tuple[Any, ...]
    default: Any
    positional: bool
    option: Option

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    @property
    def flags(self) -> tuple[str, ...]:
        """Names on the command line, none where the argument is given by its place.

        >>> Argument("size_mm", "float", (float,), None, False, Option("")).flags
        ('--size-mm',)
        """
        if self.positional and not self.option.flag:
            return ()
        flag = self.option.flag or f"--{self.name.replace('_', '-')}"
        if self.default is True:
            flag += f"/--no-{flag.removeprefix('--')}"
        return (flag, self.option.short) if self.option.short else (flag,)

    @property
    def kind(self) -> Any:
        """Its type on the command line."""
        own = self.option.kind or next((each for each in self.kinds if each in _PLAIN), str)
        return own if self.required or self.default not in (None, ()) else own | None

    @property
    def words(self) -> tuple[str, ...]:
        """The words that it may be; none: any."""
        return tuple(word for kind in self.kinds if get_origin(kind) is Literal for word in get_args(kind))


@functools.cache
def arguments_of(function: Callable[..., Any]) -> Mapping[str, Argument]:
    """The arguments of a function that are declared with an `Option`, by name."""
    found = {}
    for name, each in inspect.signature(function).parameters.items():
        if str(each.annotation).startswith(_ANNOTATED):
            hint, option = get_args(eval(each.annotation, function.__globals__))
            union = get_origin(hint) in (types.UnionType, Union)
            kinds = tuple(one for one in (get_args(hint) if union else [hint]) if one is not type(None))
            by_name = each.kind is inspect.Parameter.KEYWORD_ONLY
            found[name] = Argument(name, _bare(each.annotation), kinds, each.default, not by_name, option)
    return found


def _bare(annotation: str) -> str:
    """
    >>> _bare("Annotated[tuple[float, float] | None, AT]")
    'tuple[float, float] | None'
    """
    text, depth = annotation.removeprefix(_ANNOTATED), 0
    for k, letter in enumerate(text):
        depth += (letter in "[(") - (letter in "])")
        if letter == "," and depth == 0:
            return text[:k]
    return annotation


def plain_signature(function: Callable[..., Any], returns: str) -> inspect.Signature:
    """The signature as people read it: types without their options, and what it returns."""
    arguments, own = arguments_of(function), inspect.signature(function)
    parameters = [
        each.replace(annotation=arguments[name].type if name in arguments else each.annotation)
        for name, each in own.parameters.items()
    ]
    return own.replace(parameters=parameters, return_annotation=returns)


def documented(text: str, arguments: Mapping[str, Argument]) -> str:
    """A function's documentation with its parameters, before the errors that it raises.

    >>> m = Argument("m", "float", (float,), 2.0, False, Option("Exponent.", (1, 100)))
    >>> print(documented("Mesh.", {"m": m}))
    Mesh.
    <BLANKLINE>
    Parameters
    ----------
    m : Exponent. From 1 to 100.
    """
    lines = [_described(each) for each in arguments.values()]
    before, raises, after = inspect.cleandoc(text).partition("Raises\n------")
    rest = f"\n\n{raises}{after}" if raises else ""
    return "\n".join([f"{before.rstrip()}\n\nParameters\n----------", *lines]) + rest


def _described(argument: Argument) -> str:
    low, high = argument.option.bounds
    bounds = "" if low is None else f" From {low:g}" + ("." if high is None else f" to {high:g}.")
    text = f"{argument.name} : {argument.option.python or argument.option.help}{bounds}"
    return text if len(text) <= 100 else textwrap.fill(text, 100, subsequent_indent="    ")


CASE = Option(
    "Case folder (containing case.toml).", metavar="CASE", kind=Path,
    python="Case folder (containing case.toml), or a `Case`.",
)  # fmt: skip
OUT = Option(
    "Output folder; default: out/<name of CASE>.", flag="--out", short="-o", metavar="DIR", kind=Path
)
SITES = Option(
    "Only this site (may be repeated); default: all.", flag="--site", short="-s", metavar="NAME",
    kind=list[str], python="Name or names of the sites; None: all.",
)  # fmt: skip
WAIT = Option("Wait for another process that writes into `out`; False: raise an error at once.")
PROGRESS = Option("Called with (kind, facts) at each event; None: no calls.")
SOLVER = Option(
    "auto | febio | reference; auto: FEBio if it is found, else the bundled solver.",
    python="auto: FEBio if it is found, else reference.",
)
FEBIO = Option("The FEBio program (its executable file).", metavar="FILE", kind=Path)
TEMPLATES = Option(
    "Folder of your own templates, which take precedence over limbcli's.", metavar="DIR", kind=Path
)
ELEMENT = Option(
    "Element type of the tissue: quadratic or linear tetrahedra; default: the case's.",
    metavar="|".join(ELEMENTS),
)
MARGIN = Option("Width of tissue kept around the probe, mm; default: the case's.", MARGIN_MM)
C_KPA = Option("c = 2 mu, kPa, given by hand; default: from the shear-wave speed at level 0.")
