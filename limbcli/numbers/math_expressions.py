"""Formulas of position and time in model files: FEBio's `type="math"`.

A formula is parsed by the grammar below and evaluated on arrays; nothing else in it can be executed.

    sum     = product { (+|-) product }
    product = power { (*|/) power }
    power   = operand { ^ operand }               from left to right: 2^3^2 = 64
    operand = number | name | name ( sum {, sum} ) | - power | ( sum ) | "|" sum "|"

Names: X, Y, Z (position in the reference state), t (time, s), pi, e, gamma.

Source: FEBio 4.11, MObjBuilder (grammar), MFunctions (functions), FEMathExpression (variables).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, reduce

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import SolveError

Array = NDArray[np.float64]

VARIABLES = ("X", "Y", "Z", "t")
LONGEST = 511  # characters without blanks that FEBio 4.11 has room for
_DEEPEST = 40
_TOKEN = re.compile(
    r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_]\w*)|(?P<sign>\S)", re.ASCII
)
_CONSTANTS = {"pi": np.pi, "e": np.e, "gamma": np.euler_gamma}


def _special(name: str) -> Callable[[Array], Array]:
    """A function of `scipy.special`, imported when used: it would be half of a mesher process's start."""

    def of(x: Array) -> Array:
        from scipy import special

        return np.asarray(getattr(special, name)(x))

    return of


_OF_ONE: dict[str, Callable[[Array], Array]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan,
    "csc": lambda x: 1 / np.sin(x), "sec": lambda x: 1 / np.cos(x), "cot": lambda x: 1 / np.tan(x),
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "acosh": np.arccosh,
    "ln": np.log, "log": np.log10, "exp": np.exp, "sqrt": np.sqrt, "abs": np.abs,
    "sgn": lambda x: np.where(x < 0, -1.0, 1.0),
    "H": lambda x: np.heaviside(x, 0.5),
    "step": lambda x: np.where(x < 0, 0.0, 1.0),
    "sinc": lambda x: np.sinc(x / np.pi),
    "erf": _special("erf"), "erfc": _special("erfc"), "tgamma": _special("gamma"),
}  # fmt: skip
_OF_TWO: dict[str, Callable[[Array, Array], Array]] = {"atan2": np.arctan2, "pow": np.power}
_OF_MANY: dict[str, Callable[[list[Array]], Array]] = {
    "max": lambda each: reduce(np.maximum, each),
    "min": lambda each: reduce(np.minimum, each),
    "avg": lambda each: sum(each[1:], each[0]) / len(each),
}
_Node = Callable[[dict[str, Array]], Array]


class FormulaError(ValueError):
    """What is wrong with a formula's text."""


@dataclass(frozen=True)
class Formula:
    """A formula in mm and s.

    Raises FormulaError if the text is none.

    >>> float(Formula("2*X^2 - t")(np.array([3.0, 0.0, 0.0]), 1.0))
    17.0
    """

    text: str

    def __post_init__(self) -> None:
        _parsed(self.text)

    @property
    def names(self) -> frozenset[str]:
        """The variables in it, of `VARIABLES`."""
        return _parsed(self.text)[1]

    def __call__(self, points: Array, time: float) -> Array:
        """Values (...) at points (..., 3), mm, and a time (s).

        Raises SolveError if a value is not finite.
        """
        x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
        with np.errstate(all="ignore"):
            values = _parsed(self.text)[0]({"X": x, "Y": y, "Z": z, "t": np.float64(time)})  # type: ignore[dict-item]
            values = np.broadcast_to(values, x.shape)
        wrong = np.argwhere(~np.isfinite(values))
        if len(wrong):
            at = tuple(wrong[0])
            where = ", ".join(f"{each[at]:g}" for each in (x, y, z))
            raise SolveError(
                f"the formula {self.text!r} is {values[at]:g} at X, Y, Z = {where} mm, t = {time:g} s",
                where="model file",
                fix="correct the formula, or the position and time where it is used",
            )
        return values

    def __neg__(self) -> Formula:
        """
        >>> (-Formula("X")).text, (-Formula("-(X)")).text
        ('-(X)', 'X')
        """
        inner = self.text[2:-1]
        if self.text == f"-({inner})" and _closes_what_it_opens(inner):
            return Formula(inner)
        return Formula(f"-({self.text})")

    def scaled(self, length: float, amount: float) -> Formula:
        """The same formula where positions were in units of `length` mm and values in units of `amount`.

        >>> Formula("X*t").scaled(1000.0, 0.5).text
        '0.5*((X/1000.0)*t)'
        """
        text = self.text
        if length != 1.0:
            text = re.sub(r"(?<![\w.])([XYZ])(?!\w)", rf"(\1/{length!r})", text)
        return self if text == self.text and amount == 1.0 else Formula(f"{amount!r}*({text})")


def split_outside_brackets(text: str) -> list[str]:
    """The parts between commas that are in no round brackets.

    >>> split_outside_brackets("max(X,1), 2,t")
    ['max(X,1)', '2', 't']
    """
    depth, parts = 0, [""]
    for sign in text:
        depth += (sign == "(") - (sign == ")")
        if sign == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += sign
    return [part.strip() for part in parts]


def _closes_what_it_opens(text: str) -> bool:
    depth = 0
    for sign in text:
        depth += (sign == "(") - (sign == ")")
        if depth < 0:
            return False
    return depth == 0


@lru_cache(maxsize=1024)
def _parsed(text: str) -> tuple[_Node, frozenset[str]]:
    parser = _Parser(text)
    node = parser.sum()
    if parser.kind:
        raise FormulaError(f"an operator is missing before {parser.word!r}")
    return node, frozenset(parser.used)


class _Parser:
    """Recursive descent; every method leaves the token after what it has read."""

    def __init__(self, text: str):
        self._tokens = [(str(each.lastgroup), each.group()) for each in _TOKEN.finditer(text)]
        if sum(len(word) for _, word in self._tokens) > LONGEST:
            raise FormulaError(f"it is longer than {LONGEST} characters, which is all that FEBio takes")
        self._at, self._depth = -1, 0
        self.used: set[str] = set()
        self._next()

    def _next(self) -> None:
        self._at += 1
        self.kind, self.word = self._tokens[self._at] if self._at < len(self._tokens) else ("", "")

    def _take(self, signs: str) -> str:
        """The sign, if it is one of these, which is then passed."""
        if self.kind != "sign" or self.word not in signs:
            return ""
        found = self.word
        self._next()
        return found

    def _need(self, sign: str) -> None:
        if not self._take(sign):
            found = repr(self.word) if self.kind else "the end"
            raise FormulaError(f"{sign!r} was expected before {found}")

    def _chain(self, part: Callable[[], _Node], signs: str) -> _Node:
        node = part()
        while sign := self._take(signs):
            node = _binary(sign, node, part())
        return node

    def sum(self) -> _Node:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise FormulaError(f"it has more than {_DEEPEST} brackets in each other")
        node = self._chain(lambda: self._chain(self._power, "*/"), "+-")
        self._depth -= 1
        return node

    def _power(self) -> _Node:
        return self._chain(self._operand, "^")

    def _operand(self) -> _Node:
        kind, word = self.kind, self.word
        if kind in ("number", "name"):
            self._next()
            return _constant(float(word)) if kind == "number" else self._name(word)
        if self._take("-"):
            self._depth += 1
            if self._depth > _DEEPEST:
                raise FormulaError(f"it has more than {_DEEPEST} signs in a row")
            inner = self._power()
            self._depth -= 1
            return lambda values: -inner(values)
        if bar := self._take("(|"):
            inside = self.sum()
            self._need(")" if bar == "(" else "|")
            return inside if bar == "(" else lambda values: np.abs(inside(values))
        raise FormulaError(f"{word!r} is not expected" if word else "something is missing at its end")

    def _name(self, name: str) -> _Node:
        if self._take("("):
            return self._function(name)
        if name in _CONSTANTS:
            return _constant(_CONSTANTS[name])
        if name not in VARIABLES:
            known = ", ".join((*VARIABLES, *_CONSTANTS))
            raise FormulaError(f"the name {name!r} is not known (known are {known})")
        self.used.add(name)
        return lambda values: values[name]

    def _function(self, name: str) -> _Node:
        given = [self.sum()]
        while self._take(","):
            given.append(self.sum())
        self._need(")")
        n = 1 if name in _OF_ONE else 2 if name in _OF_TWO else 0
        if not n and name not in _OF_MANY:
            known = ", ".join(sorted((*_OF_ONE, *_OF_TWO, *_OF_MANY)))
            raise FormulaError(f"the function {name!r} is not known (known are {known})")
        if n and len(given) != n:
            raise FormulaError(f"{name} takes {n} value(s), not {len(given)}")
        if n == 1:
            return lambda values: _OF_ONE[name](given[0](values))
        if n == 2:
            return lambda values: _OF_TWO[name](given[0](values), given[1](values))
        return lambda values: _OF_MANY[name]([each(values) for each in given])


def _constant(value: float) -> _Node:
    return lambda _: np.float64(value)  # type: ignore[return-value]


def _binary(sign: str, left: _Node, right: _Node) -> _Node:
    operate: Callable[[Array, Array], Array] = {
        "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "^": np.power
    }[sign]  # fmt: skip
    return lambda values: operate(left(values), right(values))
