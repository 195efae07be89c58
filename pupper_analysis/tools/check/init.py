"""The first ``pupper-analysis.toml`` of a repository: the models that its folders have."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.files import whole_file
from pupper_analysis.base.kinds import MODEL
from pupper_analysis.models.loading import kind_of
from pupper_analysis.tools.check.config import CONFIG
from pupper_analysis.tools.check.toml import toml_table

_PASSED_OVER: Final = ("node_modules", "site-packages", "build", "install", "log")
"""Folders of what was made or installed; those that begin with a dot are passed over too."""

_HEAD: Final = """\
# What pupper-analysis check checks. Models of one robot stand together, and are compared: those
# that share a file's name were put together here. docs/data/config-keys.csv has all keys.
"""


def write_config(folder: Path) -> tuple[Path, tuple[str, ...]]:
    """Writes a configuration that names all models in a folder and those below it.

    Args:
        folder: The repository's top folder.

    Returns:
        The file, and the names of the models in it.

    Raises:
        ConfigurationError: If there is a configuration already, or no model.
        OutputError: If it cannot be written.
    """
    path = folder / CONFIG
    if path.exists():
        raise ConfigurationError("--init", diagnose("config-there-already", file=path))
    entries = entries_of(folder)
    if not entries:
        raise ConfigurationError("--init", diagnose("no-models", folder=folder.absolute()))
    tables = [toml_table("pair", entry) for entry in entries]
    with whole_file(path, MODEL) as file:
        file.write("\n".join([_HEAD, *tables]).encode())
    return path, tuple(entry["name"] for entry in entries)


def entries_of(folder: Path) -> list[dict[str, str]]:
    """Returns the models of a folder and those below it: a URDF, an MJCF, or both of one stem."""
    found: dict[str, list[Path]] = {"urdf": [], "mjcf": []}
    for path in _files(folder):
        kind = kind_of(path)
        if kind:
            found[kind].append(path.relative_to(folder))
    stems = [path.stem.lower() for paths in found.values() for path in paths]
    entries = []
    partners = {path.stem.lower(): path for path in found["mjcf"]}
    for urdf in found["urdf"]:
        stem = urdf.stem.lower()
        pair = stem in partners and stems.count(stem) == 2
        name = urdf.stem if pair or stems.count(stem) == 1 else urdf.as_posix()
        mjcf = {"mjcf": partners.pop(stem).as_posix()} if pair else {}
        entries.append({"name": name, "urdf": urdf.as_posix(), **mjcf})
    compared = {entry["mjcf"] for entry in entries if "mjcf" in entry}
    for mjcf_path in found["mjcf"]:
        if mjcf_path.as_posix() not in compared:
            alone = stems.count(mjcf_path.stem.lower()) == 1
            name = mjcf_path.stem if alone else mjcf_path.as_posix()
            entries.append({"name": name, "mjcf": mjcf_path.as_posix()})
    return entries


def _files(folder: Path) -> Iterator[Path]:
    """Yields the files that may be models, in the order of their names."""
    for top, folders, files in os.walk(folder):
        kept = (name for name in folders if name[0] != "." and name not in _PASSED_OVER)
        folders[:] = sorted(kept)
        for name in sorted(files):
            if Path(name).suffix.lower() in (".urdf", ".xml", ".mjcf"):
                yield Path(top) / name
