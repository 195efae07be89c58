"""Where a model's files go in another folder: as they stand to each other, so that all are found.

No path in a file is rewritten, so that what is written differs in nothing else.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.packages import existing_file
from pupper_analysis.models.urdf_file import UrdfFile

_ASIDE = "mjcf"
"""Folder of the MJCF and its files, where one of them has the place of another file."""


@dataclass(frozen=True)
class Copies:
    """The files of a model, and where each goes in a folder.

    No path in them is rewritten: the folder repeats as much of the folders around them as is
    needed for each relative path to lead where it did.

    Attributes:
        main: The model's file.
        top: The folder around all of them, which the new folder takes the place of.
        files: All of them, the main file first.
        aside: Into which part of the new folder they go.
    """

    main: Path
    top: Path
    files: tuple[Path, ...]
    aside: Path = Path()

    @staticmethod
    def of(main: Path, others: Iterable[Path], within: Iterable[Path] = ()) -> Copies:
        """Lays out a model's files.

        Args:
            main: The model's file.
            others: All that it needs, beside absolute paths.
            within: Folders whose names are needed, too: those of packages.
        """
        files = tuple(dict.fromkeys((main, *others)))
        folders = {_plain(path).parent for path in (*files, *within)}
        return Copies(main, Path(os.path.commonpath(folders)), files)

    @cached_property
    def places(self) -> Mapping[Path, Path]:
        """{file: where it goes, relative to the folder}; the main file is one of them."""
        return {file: self.aside / _plain(file).relative_to(self.top) for file in self.files}

    def place(self) -> Path:
        """Returns where the model's file goes."""
        return self.places[self.main]


def laid_out(urdf: Copies, mjcf: Copies) -> tuple[Copies, Copies]:
    """Returns the files of both models in one folder.

    Where those of one stand in the folders of the other's, they stay there; else each begins with
    its own folder, and the MJCF's go to one of their own if they met the URDF's.
    """
    for outer in (urdf.top, mjcf.top):
        if all(one.top.is_relative_to(outer) for one in (urdf, mjcf)):
            return replace(urdf, top=outer), replace(mjcf, top=outer)
    taken = {place: file for file, place in urdf.places.items()}
    if all(_is_same(file, taken.get(place)) for file, place in mjcf.places.items()):
        return urdf, mjcf
    return urdf, replace(mjcf, aside=Path(_ASIDE))


def _plain(path: Path) -> Path:
    """Returns a path without ``..``, its links as they are: relative paths go by names."""
    return Path(os.path.normpath(path.absolute()))


def _is_same(file: Path, other: Path | None) -> bool:
    return other is None or file.samefile(other)


def copies_of_urdf(urdf: UrdfFile) -> Copies:
    """Lays out a URDF and the meshes and textures that are found from where it stands.

    A ``package://`` path that leads to a folder around the URDF does, too; one that is found by a
    package's given folder, or on ``ROS_PACKAGE_PATH``, is found from everywhere.
    """
    found: list[Path] = []
    packages: list[Path] = []
    around = urdf.path.absolute().parents
    for element in urdf.root.iter("mesh", "texture"):
        name = element.get("filename") or ""
        scheme, separator, rest = name.partition("://")
        file = urdf.resolve_mesh(name) if name else None
        if file is None or (not separator and Path(name).is_absolute()) or scheme == "file":
            continue
        if not separator:
            found.append(file)
            continue
        inside = rest.lstrip("/").partition("/")[2]
        package = Path(str(_plain(file)).removesuffix(inside)) if inside else file
        if package in around:
            manifest = existing_file(package / "package.xml")
            found += [file] if manifest is None else [file, manifest]
            packages.append(package)
    return Copies.of(urdf.path, found, packages)


def copies_of_mjcf(mjcf: MjcfFile) -> Copies:
    """Lays out an MJCF, what it includes or attaches, and the files of its assets."""
    return Copies.of(mjcf.path, [*mjcf.files, *_assets(mjcf)])


def _assets(mjcf: MjcfFile) -> Iterator[Path]:
    spec = mjcf.spec
    folders = tuple(dict.fromkeys(file.parent for file in (mjcf.path, *mjcf.files)))
    named = [
        (element.file, element.compiler.meshdir)
        for element in (*spec.meshes, *spec.hfields, *spec.skins)
    ]
    for texture in spec.textures:
        named += [(f, texture.compiler.texturedir) for f in (texture.file, *texture.cubefiles)]
    for file, folder in dict.fromkeys(named):
        name = Path(file).name if spec.strippath else file
        if not file or Path(name).is_absolute() or Path(folder).is_absolute():
            continue
        found = (existing_file(top / folder / name) for top in folders)
        yield from (path for path in found if path is not None)
