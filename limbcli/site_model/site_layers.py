"""Skin and fat as separate layers: their thickness at a site and their material laws.

Options take precedence over `[site.layers]` of case.toml. A layer's law is held fixed, as the fit
identifies the tissue below. Values that are not given are assumed and reported as such:

fat   c = 1.5 kPa (mu 0.75 kPa): subcutaneous fat of the human buttock in vivo, uncompressed
      ("Strain-dependent shear properties of human adipose tissue in vivo", J Mech Behav Biomed
      Mater 2023); porcine subdermal fat 0.53 +- 0.31 kPa (Sims et al. 2010, Biomech Model
      Mechanobiol 9:703)
skin  c = 40 kPa (mu 20 kPa): an order of magnitude only, published values differ a hundredfold
      with method and length (Hendriks et al. 2006, Med Eng Phys 28:259)
both  m = 2, f_kappa = 100: nearly incompressible
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from limbcli.case import Site
from limbcli.case import schema as schema
from limbcli.errors import CaseError
from limbcli.errors.problems import raise_errors
from limbcli.materials.ogden import ogden_type
from limbcli.meshing.conforming_layers import Layer, layers_of
from limbcli.model import LimbModel, Material
from limbcli.numbers.units import kpa_from_mpa, mpa_from_kpa
from limbcli.results import StageResult

NAMES = schema.LAYER_NAMES
MRI = "mri"
_THINNEST = 0.5  # mm, thinnest layer that images can show
_LOCKS = 10.0  # f_kappa above which linear tetrahedra lock

Thickness = float | str
"""mm, or "mri"."""


@dataclass(frozen=True)
class ThicknessSource:
    """Where a layer's thickness comes from ("MRI", "given", ...), with details in words.

    >>> str(ThicknessSource("given")), str(ThicknessSource("MRI", "5.0 mm"))
    ('given', 'MRI: 5.0 mm')
    """

    origin: str
    details: str = ""

    def __str__(self) -> str:
        return f"{self.origin}: {self.details}" if self.details else self.origin


@dataclass(frozen=True)
class LayerLaw:
    """A layer's law in the tissue's parameters: c = 2 mu (MPa), kappa' = f_kappa c, exponent m or beta.

    assumed : the parameters that were not given
    """

    law: str = "ogden"
    c: float = 0.0015
    f_kappa: float = 100.0
    m: float = 2.0
    beta: float = 1.0
    assumed: tuple[str, ...] = ()

    def material(self) -> Material:
        """
        >>> LayerLaw("neo_hooke", c=0.002, f_kappa=10.0).material().parameters
        {'mu': 0.001, 'lambda': 0.02}
        """
        if self.law == "ogden":
            return ogden_type(c=self.c, f_kappa=self.f_kappa, m=self.m)
        elastic = {"mu": self.c / 2, "lambda": self.f_kappa * self.c}
        return Material(self.law, elastic if self.law == "neo_hooke" else {**elastic, "beta": self.beta})

    def to_json(self) -> dict[str, Any]:
        own = {key: getattr(self, key) for key in _shape(self.law)}
        return {"law": self.law, "c_kpa": kpa_from_mpa(self.c), **own, "assumed": list(self.assumed)}


_ASSUMED = {"skin": LayerLaw(c=0.040), "fat": LayerLaw(c=0.0015)}


def _shape(law: str) -> tuple[str, ...]:
    last = {"ogden": ("m",), "holmes_mow": ("beta",)}.get(law, ())
    return ("f_kappa", *last)


# ---------------------------------------------------------------- thickness


@dataclass(frozen=True)
class Layering:
    """Requested layer thicknesses of a run: mm, "mri" or None (according to the case).

    seen : whether thicknesses from images can be used (not for a place that is not one of the case's sites)
    """

    skin: Thickness | None
    fat: Thickness | None
    seen: bool = True

    def is_from_images(self, site: Site) -> bool:
        """Whether a layer of this site gets its thickness from the images."""
        return MRI in (_requested(site, "skin", self.skin), _requested(site, "fat", self.fat))

    def of(
        self, site: Site, segmented: StageResult, *, size: float
    ) -> tuple[tuple[Layer, ...], dict[str, ThicknessSource]]:
        """The layers of one site, outermost first, and the source of each thickness.

        Without a skin layer, fat begins at the surface; its thickness from images then includes the skin's,
        so that the border to the muscle is where the images show it.

        Raises CaseError if a thickness cannot be used, or the images do not give it.
        """
        if not self.seen and self.is_from_images(site):
            raise CaseError(
                "the images' thickness is known at the case's sites only",
                where=f"site {site.name}, --at",
                fix="give --fat-mm and --skin-mm in mm, 0 for none",
            )
        given = {"skin": self.skin, "fat": self.fat}
        requested = {name: _requested(site, name, value) for name, value in given.items()}
        seen = {name: _seen(site, segmented, name) for name, value in requested.items() if value == MRI}
        shown = "MRI" if "geometry" not in segmented.data else "[imaging] shape"
        found, sources = {}, {}
        for name, value in requested.items():
            found[name] = seen[name] if value == MRI else float(value)
            sources[name] = ThicknessSource(shown if value == MRI else "given")
        if requested["fat"] == MRI and found["skin"] == 0.0:
            above = float(segmented.data["layers"][site.name]["skin_mm"])
            found["fat"] += above
            details = f"{seen['fat']:.1f} mm of fat under {above:.1f} mm of skin"
            sources["fat"] = ThicknessSource(shown, details)
        layers = layers_of(skin=found["skin"], fat=found["fat"], size=size)
        return layers, {each.name: sources[each.name] for each in layers}


def _requested(site: Site, name: str, value: Thickness | None) -> Thickness:
    if value is None:
        value = site.layers.get(name, {}).get("thickness_mm", 0.0)
    assert value is not None
    return value


def _seen(site: Site, segmented: StageResult, name: str) -> float:
    """A layer's thickness found by `segment` at the site (mm)."""
    found = (segmented.data.get("layers") or {}).get(site.name, {}).get(f"{name}_mm")
    if found is None or found < _THINNEST:
        what = "give no" if found is None else f"show only {found:.1f} mm as"
        raise CaseError(
            f"the images {what} thickness of the {name} at this site",
            where=f"site {site.name}",
            fix=f"give it in mm, for instance from the B-mode image: --{name}-mm, or thickness_mm under "
            f"[site.layers.{name}]",
        )
    return float(found)


def thickness_of(text: str, option: str) -> Thickness:
    """
    >>> thickness_of("6.5", "--fat-mm"), thickness_of("mri", "--fat-mm")
    (6.5, 'mri')
    """
    if text.strip().lower() == MRI:
        return MRI
    try:
        return float(text)
    except ValueError as error:
        raise CaseError(
            f"{option} is {text!r}", where=option, fix="give a thickness in mm, 0 for none, or mri"
        ) from error


# ---------------------------------------------------------------- laws


def parse_law(text: str) -> tuple[str, dict[str, Any]]:
    """
    >>> parse_law("fat:c_kpa=2,m=4")
    ('fat', {'c_kpa': 2.0, 'm': 4.0})
    """
    name, _, rest = text.partition(":")
    table: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = (each.strip() for each in part.partition("="))
        try:
            table[key] = value if key == "law" else float(value)
        except ValueError as error:
            raise CaseError(f"{key} is {value!r}, not a number", where=f"--layer {text}", fix=_HOW) from error
    if name not in NAMES or not table:
        raise CaseError(f"--layer {text!r} is not valid", where="--layer", fix=_HOW)
    keys = {key: rule for key, rule in schema.LAYER.items() if key != "thickness_mm"}
    problems = schema.check_table(table, keys, name=f"--layer {name}", file="command line")[1]
    raise_errors(problems, CaseError)
    return name, table


_HOW = "write --layer fat:c_kpa=2,f_kappa=100,m=2 or --layer skin:law=neo_hooke,c_kpa=40,f_kappa=50"


def layer_laws(
    site: Site, names: Sequence[str], given: Mapping[str, Mapping[str, Any]] | None = None
) -> dict[str, LayerLaw]:
    """The law of each layer: by option, else by case.toml, else assumed (and listed as such).

    Raises CaseError if a law is given for a layer that the model does not have.
    """
    given = given or {}
    for name in given:
        if name not in names:
            raise CaseError(
                f"the model has no layer {name!r}",
                where=f"site {site.name}",
                fix=f"mesh again with --{name}-mm, or omit --layer {name}",
            )
    return {name: _law(name, {**site.layers.get(name, {}), **_known(given.get(name, {}))}) for name in names}


def _known(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value is not None}


def _law(name: str, table: Mapping[str, Any]) -> LayerLaw:
    usual, table = _ASSUMED[name], _known(table)
    law = table.get("law", usual.law)
    c = mpa_from_kpa(float(table["c_kpa"])) if "c_kpa" in table else usual.c
    shape = {key: float(table[key]) for key in _shape(law) if key in table}
    assumed = tuple(key for key in ("c_kpa", *_shape(law)) if key not in table)
    return replace(usual, law=law, c=c, assumed=assumed, **shape)


def with_layer_laws(model: LimbModel, laws: Mapping[str, LayerLaw]) -> LimbModel:
    """The model with a separate material for each layer's block."""
    materials = {**model.materials, **{name: law.material() for name, law in laws.items()}}
    domains = tuple(
        replace(each, material=each.block) if each.block in laws else each for each in model.domains
    )
    return replace(model, materials=materials, domains=domains)


def held_layers(model: LimbModel) -> tuple[str, ...]:
    """The layers of fixed stiffness; with any of them, forces are not proportional to the tissue's c."""
    held = {each.block for each in model.domains if each.material == each.block}
    return tuple(name for name in NAMES if name in held)


def layers_in(model: LimbModel) -> tuple[str, ...]:
    """The layers that a meshed model has."""
    return tuple(each.name for each in model.mesh.solid_blocks if each.name in NAMES)


def locking_warning(laws: Mapping[str, LayerLaw], element: str) -> list[str]:
    """Warn of locking: nearly incompressible layers of linear tetrahedra are stiffer than their law."""
    stiff = [name for name, law in laws.items() if law.f_kappa > _LOCKS]
    if element != "tet4" or not stiff:
        return []
    return [
        f"{' and '.join(stiff)}: above f_kappa {_LOCKS:g} a layer of tet4 is stiffer than its law; "
        "mesh with --element tet10, or give the layer a smaller one, such as 5 ([site.layers], or --layer of "
        "`build-feb`)"
    ]
