"""Check the files that case.toml names: they exist, are of the right kind, and lie inside the case folder.

A case folder may come from somebody else. Paths outside it (`..`, an absolute path, a symbolic link) are
neither read nor written, unless case.toml says `[files] allow_outside = true`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from limbcli.errors.problems import Problem


@dataclass(frozen=True)
class CaseFiles:
    """Resolves names of files and folders to paths, for one case folder."""

    folder: Path
    allow_outside: bool = False

    @staticmethod
    def of(raw: Mapping[str, Any], folder: Path) -> CaseFiles:
        """As set by the table [files] of case.toml; only the value `true` allows paths outside."""
        table = raw.get("files")
        return CaseFiles(folder, isinstance(table, dict) and table.get("allow_outside") is True)

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

    def placed(self, name: object, label: str) -> tuple[Path | None, list[Problem]]:
        """The path of a file that need not exist."""
        if not isinstance(name, str):
            return None, []
        if self.may_use(name):
            return self.folder / name, []
        problem = Problem(
            f"{label} points outside the case folder: {name}",
            str(self.folder / "case.toml"),
            "copy it into the case folder, or, if you trust this case, add a table [files] with "
            "`allow_outside = true`",
        )
        return None, [problem]

    def existing(
        self, name: object, label: str, *, is_folder: bool | None
    ) -> tuple[Path | None, list[Problem]]:
        """The path of a file or folder (`is_folder` None: either) that must exist."""
        path, problems = self.placed(name, label)
        fitting = path is not None and (
            path.exists() if is_folder is None else path.is_dir() if is_folder else path.is_file()
        )
        if path is None or fitting:
            return path, problems
        kind = "file or folder" if is_folder is None else "folder" if is_folder else "file"
        if path.exists():
            return None, [Problem(f"{label} is not a {kind}: {name}", str(path), f"name a {kind}")]
        fix = f"put the {kind} there, or correct the name (it is relative to {self.folder})"
        return None, [Problem(f"{label} names a {kind} that was not found: {name}", str(path), fix)]
