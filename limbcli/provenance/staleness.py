"""The chain of results: a result is used only if nothing that it was made from has changed.

A result stores hashes of its inputs and of its own files, the values of the case that it used, and
what it took from earlier results (`made_from` and `files_sha256` in its provenance). Before a stage uses
a result, the whole chain behind it is checked; the first broken link, starting from the images, is
reported with the commands that update it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from limbcli.case import Case, Site
from limbcli.case.noting import unnoted
from limbcli.errors import CaseError
from limbcli.files.atomic import sha256
from limbcli.provenance.chain_inputs import SITES, in_words, input_path, is_unchanged
from limbcli.provenance.remaking_command import CommandStep, commands
from limbcli.results import UNLIKE_OURS, StageResult, StageWriter, plain, read_result, stage_folder
from limbcli.version import __version__


@dataclass(frozen=True)
class BrokenLink:
    """A broken link: what changed, where, and the stages to run again, in order.

    before : advice that precedes the commands (an alternative, or a preparation)
    """

    what: str
    where: str
    steps: tuple[CommandStep, ...]
    before: str = ""

    def fix(self, case: Case, out: Path) -> str:
        """The advice and the commands."""
        return self.before + commands(self.steps, case.folder, out)

    def error(self, case: Case, out: Path) -> CaseError:
        first = self.steps[0]
        return CaseError(
            self.what, where=self.where, fix=self.fix(case, out), stage=first.stage, site=first.site
        )


class Chain:
    """The results below an output folder, as one case may use them."""

    def __init__(self, case: Case, out: Path):
        self.case, self.out = unnoted(case), out

    def result(self, stage: str, *, site: str | None = None, about: Collection[str] = ()) -> StageResult:
        """A stage's result, after a check of the whole chain behind it.

        about : sites whose values in a result of the whole case are to be used

        Raises CaseError if the result is missing or out of date; the message has the commands that update it.
        """
        found = self._read(stage, site)
        broken = found if isinstance(found, BrokenLink) else self.broken(found, about=about)
        if broken is not None:
            raise broken.error(self.case, self.out)
        assert isinstance(found, StageResult)
        return found

    def present(
        self, stage: str, *, site: str | None = None, about: Collection[str] = ()
    ) -> StageResult | None:
        """The same, or None if the stage has not been run."""
        there = (stage_folder(self.out, stage, site) / f"{stage}.json").is_file()
        return self.result(stage, site=site, about=about) if there else None

    def broken(self, found: StageResult, *, about: Collection[str] | None = None) -> BrokenLink | None:
        """The first broken link behind a result, starting from the images; None if the result is current.

        about : as in `result`; None: every site of the case
        """
        own = CommandStep.of(found)
        made = _links(found)
        for label, link in made["results"].items():
            earlier = self._broken_at(label, link)
            if earlier is not None:
                return replace(earlier, steps=(*earlier.steps, own))
        if found.subject != self.case.subject:
            what = (
                f"the result of `{found.label}` is of {found.subject}, but the case is of {self.case.subject}"
            )
            before = f"give another --out; to replace the results of {found.subject} permanently: "
            return BrokenLink(what, str(found.folder), (own,), before)
        if made["version"] != __version__:
            by = f"limbcli {made['version']}" if made["version"] else "an earlier limbcli"
            what = f"the result of `{found.label}` was made by {by}, this is {__version__}"
            return BrokenLink(what, str(found.folder), (own,))
        try:
            changed = next(self._changes(found, made, about), None)
        except UNLIKE_OURS as error:
            changed = f"the record of what `{found.label}` was made from cannot be read ({error})", ""
        return None if changed is None else BrokenLink(changed[0], changed[1] or str(found.folder), (own,))

    def _broken_at(self, label: str, link: Mapping[str, Any]) -> BrokenLink | None:
        upstream = self._read(*_named(label))
        about = [key.split("/")[1] for key in link["data"] if "/" in key]
        return upstream if isinstance(upstream, BrokenLink) else self.broken(upstream, about=about)

    def _read(self, stage: str, site: str | None) -> StageResult | BrokenLink:
        try:
            return read_result(self.out, stage, site=site)
        except CaseError as error:
            return BrokenLink(error.what, error.where, (CommandStep(stage, site),))

    def _changes(
        self, found: StageResult, made: Mapping[str, Any], about: Collection[str] | None
    ) -> Iterator[tuple[str, str]]:
        """(what, where) of every broken link of this result itself, without those of earlier results."""
        after = f"changed after `{found.label}` was run"
        for key, value in made["case"].items():
            if self._matters(key, found, about) and not self._is_as_it_was(key, value, about):
                yield f"{in_words(key)} {after}", str(self.case.file)
        for role, digest in made["files"].items():
            path = input_path(self.case, role)
            if digest is None:
                if path is not None and path.exists():
                    yield f"{in_words(role)} was added after `{found.label}` was run", str(path)
            elif path is None or not path.exists():
                yield (
                    f"{in_words(role)} is missing, from which `{found.label}` was made",
                    str(path or self.case.file),
                )
            elif sha256(path) != digest:
                yield f"{in_words(role)} {after}", str(path)
        for label, link in made["results"].items():
            stage, site = _named(label)
            upstream = read_result(self.out, stage, site=site)
            for name in _unlike(link, upstream):
                yield f"the result of `{label}` ({name}) {after}", str(upstream.folder)
        for label in made.get("absent", {}):
            stage, site = _named(label)
            folder = stage_folder(self.out, stage, site)
            if (folder / f"{stage}.json").is_file():
                yield f"the result of `{label}` was made after `{found.label}`, which uses it", str(folder)
        for name, digest in found.provenance.get("files_sha256", {}).items():
            path = found.path(name)
            if not path.exists():
                yield f"{path.name}, written by `{found.label}`, is missing", str(path)
            elif sha256(path) != digest:
                yield f"{path.name}, written by `{found.label}`, was changed since", str(path)

    def _matters(self, key: str, found: StageResult, about: Collection[str] | None) -> bool:
        """Whether a value of the case matters: one of a single site does only if that site is in `about`."""
        if found.site is not None or not key.startswith("site/"):
            return True
        name = key.split("/")[1]
        return name in self._names() if about is None else name in about

    def _is_as_it_was(self, key: str, value: Any, about: Collection[str] | None) -> bool:
        if key == SITES:
            return set(self._names() if about is None else about) <= set(value)
        return is_unchanged(self.case, key, value)

    def _names(self) -> list[str]:
        return [each.name for each in self.case.sites]


def _links(found: StageResult) -> dict[str, Any]:
    """The recorded inputs of a result; empty and without a version if the record is damaged or absent."""
    made = found.provenance.get("made_from")
    kinds = ("case", "files", "results")
    if (
        isinstance(made, dict)
        and all(isinstance(made.get(each), dict) for each in kinds)
        and all(_is_link(each) for each in made["results"].values())
    ):
        return {"version": "", **made}
    return {"version": "", **{each: {} for each in kinds}}


def _is_link(link: object) -> bool:
    return isinstance(link, dict) and all(isinstance(link.get(each), dict) for each in ("files", "data"))


def _named(label: str) -> tuple[str, str | None]:
    stage, _, site = label.partition(" ")
    return stage, site or None


def _unlike(link: Mapping[str, Mapping[str, Any]], upstream: StageResult) -> Iterator[str]:
    """Names of files and data of an earlier result that have changed since they were used."""
    now = upstream.provenance.get("files_sha256", {})
    for name, digest in link["files"].items():
        if now.get(name) != digest:
            yield name
    for key, value in link["data"].items():
        if plain(upstream.value(key)) != value:
            yield key.replace("/", " of ")


def check_earlier(case: Case, out: Path, sites: Iterable[Site]) -> None:
    """Check the chain behind all results of earlier stages for these sites.

    Raises CaseError as in `Chain.result`; a stage that has not been run is no error here.
    """
    chain = Chain(case, out)
    for site in sites:
        for stage in reversed(_EARLIER):  # the check of the last one includes those that it depends on
            chain.present(stage, site=None if stage == "segment" else site.name)


def note_earlier(out: Path, site: Site, writer: StageWriter) -> None:
    """Record all results of earlier stages for a site as inputs of a result."""
    for stage, names in _EARLIER.items():
        of = None if stage == "segment" else site.name
        if (stage_folder(out, stage, of) / f"{stage}.json").is_file():
            found = read_result(out, stage, site=of)
            writer.used_result(found, files=[name for name in found.files if name.startswith(names)])
        elif stage == "mesh":  # to which a diagnosis corrects its own
            writer.without_result(stage, of)


_EARLIER = {"segment": ("skin", "bone"), "mesh": ("model",), "build-feb": ("feb",), "run": ("force_depth",)}
