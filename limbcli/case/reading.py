"""Read case.toml: its tables, the files that it names, and every problem found in it.

A case folder may come from somebody else. Paths outside it (`..`, an absolute path, a symbolic link) are
neither read nor written, unless case.toml says `[files] allow_outside = true`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from limbcli.case import schema as schema
from limbcli.errors.problems import Problem


@dataclass(frozen=True, eq=False)
class CaseReading:
    """The reading of one case.toml; what is wrong with it is added to `problems`.

    found : the problems of the whole file so far; `problems` are those after the first `before` of them
    """

    folder: Path
    allow_outside: bool = False
    found: list[Problem] = field(default_factory=list)
    before: int = 0

    @staticmethod
    def of(raw: Mapping[str, Any], folder: Path) -> CaseReading:
        """As set by the table [files] of case.toml; only the value `true` allows paths outside."""
        table = raw.get("files")
        return CaseReading(folder, isinstance(table, dict) and table.get("allow_outside") is True)

    @property
    def file(self) -> str:
        return str(self.folder / "case.toml")

    @property
    def problems(self) -> list[Problem]:
        return self.found[self.before :]

    def part(self) -> CaseReading:
        """The reading of what comes next: its problems are also those of the whole."""
        return replace(self, before=len(self.found))

    def wrong(self, what: str, fix: str, *, where: Path | None = None) -> None:
        """Add a problem, of case.toml or of a file that it names."""
        self.found.append(Problem(what, self.file if where is None else str(where), fix))

    def table(self, table: object, keys: Mapping[str, schema.Key], name: str) -> dict[str, Any]:
        """Values of a table, with defaults filled in; empty if it is no table."""
        values, problems = schema.check_table(table, keys, name=name, file=self.file)
        self.found.extend(problems)
        return values

    def may_use(self, name: str) -> bool:
        """Whether the name lies in the case folder, and, for a folder, also everything below it."""
        if self.allow_outside:
            return True
        home = self.folder.resolve()
        path = self.folder / name
        try:
            if not path.resolve().is_relative_to(home):
                return False
            below = path.rglob("*") if path.is_dir() else ()
            return all(each.resolve().is_relative_to(home) for each in below if each.is_symlink())
        except (OSError, RuntimeError, ValueError):  # circular links, or an invalid name
            return False

    def placed(self, name: object, label: str) -> Path | None:
        """The path of a file that need not exist."""
        if not isinstance(name, str):
            return None
        if self.may_use(name):
            return self.folder / name
        self.wrong(
            f"{label} points outside the case folder: {name}",
            "copy it into the case folder, or, if you trust this case, add a table [files] with "
            "`allow_outside = true`",
        )
        return None

    def existing(self, name: object, label: str, *, is_folder: bool | None) -> Path | None:
        """The path of a file or folder (`is_folder` None: either) that must exist."""
        path = self.placed(name, label)
        fitting = path is not None and (
            path.exists() if is_folder is None else path.is_dir() if is_folder else path.is_file()
        )
        if path is None or fitting:
            return path
        kind = "file or folder" if is_folder is None else "folder" if is_folder else "file"
        if path.exists():
            self.wrong(f"{label} is not a {kind}: {name}", f"name a {kind}", where=path)
        else:
            fix = f"put the {kind} there, or correct the name (it is relative to {self.folder})"
            self.wrong(f"{label} names a {kind} that was not found: {name}", fix, where=path)
        return None
