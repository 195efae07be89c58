"""Writes a study's design as URDF, MJCF with its gains and stance, and measures these anew."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_input
from pupper_analysis.base.kinds import MODEL
from pupper_analysis.base.results import Result
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import to_xml
from pupper_analysis.models.published import existing_file
from pupper_analysis.models.urdf_file import urdf_from
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.robot.plane import Contact, Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.stance.stand import solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.design import DesignBuilder, measure_columns
from pupper_analysis.tools.study.measures import Design
from pupper_analysis.tools.study.store import require_library
from pupper_analysis.tools.study.study import Study

_TOLERANCE = 1e-6
"""Relative: files have all digits, and what is left are the tolerances of iterative solvers."""

_MESHES = "meshes"
"""Folder of the meshes, beside the models."""


@dataclass(frozen=True, eq=False)
class WrittenDesign(Result):
    """A design as files, and what is measured of them.

    Attributes:
        number: Which row of the study's table it is, from 1.
        urdf: Its URDF.
        mjcf: Its MJCF.
        stance: Its stance, for ``--stance``.
        numbers: {parameter: its value}.
        measured: {metric: what the study measured of the design}.
        found: {metric: what is measured of the files, read again}.
        command: Which command gives the numbers of its stand.
        failures: Metrics in which the two differ.
    """

    number: int
    urdf: Path
    mjcf: Path
    stance: Path
    numbers: Mapping[str, float] = field(metadata={"unit": "varies"})
    measured: Mapping[str, float] = field(metadata={"unit": "varies"})
    found: Mapping[str, float] = field(metadata={"unit": "varies"})
    command: str
    failures: tuple[Diagnostic, ...]

    @property
    def passed(self) -> bool:
        """Whether the files give the study's numbers."""
        return not self.failures


def write_design(study: Study, number: int, folder: str | Path) -> WrittenDesign:
    """Writes a measured design of a study to ``design-NUMBER`` in the study's folder.

    The URDF, the MJCF with the design's servo gains, the meshes of both, and the stance as options
    of commands. The files are read again, and the study's metrics are measured of them.

    Args:
        study: The study.
        number: The row of its table, from 1.
        folder: The study's folder, as ``run`` has filled it.

    Raises:
        ConfigurationError: If there is no such design, or it makes no robot.
        StudyError: If it is no study's folder, or damaged.
        OutputError: If a file cannot be written, or is there with another content.
    """
    check_type("study", study, Study)
    check_type("number", number, int)
    check_type("folder", folder, str | Path)
    require_library("pandas")
    table = study.table(folder)
    if not 1 <= number <= len(table):
        finding = diagnose("design-not-there", number=number, count=len(table))
        raise ConfigurationError("number", finding)
    row = table.iloc[number - 1]
    numbers = {name: float(row[name]) for name in study.variables}
    maker = DesignBuilder(study.whole_source(), study.task, study.point)
    try:
        design = maker.design(numbers)
    except PupperAnalysisError as error:
        finding = diagnose("design-makes-no-robot", number=number, reason=error.diagnostic)
        raise ConfigurationError("number", finding) from error
    into = Path(folder) / f"design-{number}"
    packages = getattr(getattr(study.source, "files", None), "options", {}).get("packages")
    contents = dict(_contents(design.robot.description, packages))
    contents[Path("stance.toml")] = format_stance(design.stand.task).encode()
    write_all(
        [
            Writing(into / place, content, MODEL)
            for place, content in contents.items()
            if not _holds(into / place, content)
        ]
    )
    urdf, mjcf = (into / place for place in contents if place.suffix in (".urdf", ".xml"))
    loaded, words = _read_again(design.robot, urdf, mjcf)
    stand = solve_stand(loaded, design.stand.task)
    again = Design(loaded, stand, own_servos=design.own_servos, point=design.point)
    found = measure_columns(again, study.metrics)
    measured = {name: float(row[name]) for name in found if name in row and _is_number(row[name])}
    found = {name: value for name, value in found.items() if name in measured}
    stance = into / "stance.toml"
    words = ["pupper-analysis", "stand", str(urdf), str(mjcf), *words, "--stance", str(stance)]
    return WrittenDesign(
        number=number,
        urdf=urdf,
        mjcf=mjcf,
        stance=stance,
        numbers=numbers,
        measured=measured,
        found=found,
        command=shlex.join(words),
        failures=tuple(
            diagnose(
                "written-design-differs", number=number, metric=name, found=value, measured=old
            )
            for name, value in found.items()
            if not abs(value - (old := measured[name])) <= _TOLERANCE * max(abs(old), _TOLERANCE)
        ),
    )


def _is_number(value: Any) -> bool:
    return value is not None and bool(np.isfinite(float(value)))


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


def _read_again(robot: Robot, urdf: Path, mjcf: Path) -> tuple[Robot, list[str]]:
    """Loads the written files; returns also the options that name the design's feet."""
    loaded = load_robot(urdf, mjcf)
    feet = robot.description.contact_points
    own = any(link not in robot.description.made_frames for link, _ in feet.values())
    if not own or loaded.description.contact_points == feet:
        return loaded, []
    words = [f"--foot={name}={link}:{frame}" for name, (link, frame) in feet.items()]
    return load_robot(urdf, mjcf, feet=dict(feet)), words


def format_stance(task: StandTask) -> str:
    """Returns a stance as TOML, as ``--stance`` takes it."""
    lines, tables = [], []
    for name, value in task.values().items():
        field = FIELDS[name]
        if not field.help or value == field.usual:
            continue
        if field.per:
            tables += [
                f"{field.option}.{json.dumps(of)} = {_typed(one)}" for of, one in value.items()
            ]
        else:
            lines.append(f"{field.option} = {_typed(value, field.unit)}")
    return "".join(f"{line}\n" for line in (*lines, *tables))


def _typed(value: Any, unit: str = "") -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_typed, value))}]"
    if isinstance(value, str | Contact | Weld):
        return json.dumps(str(value))
    return json.dumps(f"{value!r}{unit}" if unit in ("m", "rad") else value)


def _contents(
    description: Description, packages: Mapping[str, Path] | None
) -> Iterator[tuple[Path, bytes]]:
    """Yields {place: content} of a description's two files, and of what they need."""
    description = _without_made_frames(description)
    taken: dict[str, tuple[Path | None, bytes]] = {}
    urdf = urdf_from(
        description.urdf_source, description.urdf, parse_text(description.urdf), packages
    )
    for element in urdf.root.iter("mesh", "texture"):
        name = element.get("filename") or ""
        file = urdf.resolve_mesh(name) if name else None
        if file is not None:
            element.set("filename", _place(taken, file, read_input(file, MAX_FILE_BYTES)))
    name = description.name.replace("/", "_")
    yield Path(f"{name}.urdf"), to_text(urdf.root).encode()
    yield Path(f"{name}.xml"), _mjcf_text(description, partial(_place, taken)).encode()
    yield from ((Path(place), content) for place, (_, content) in taken.items())


def _without_made_frames(description: Description) -> Description:
    """Returns it without the frames that feet were given in memory, which reading gives again."""
    tree, spec = UrdfTree.of(description.urdf), description.mjcf.copy()
    for frame in description.made_frames:
        tree.remove_subtree(frame)
        spec.delete(spec.site(frame))
    return replace(description, urdf=to_text(tree.root), mjcf=spec)


def _place(taken: dict[str, tuple[Path | None, bytes]], file: Path, content: bytes) -> str:
    """Returns where a mesh goes; two of one name and another content get a number."""
    number = 0
    while True:
        place = f"{_MESHES}/{file.stem}{f'_{number}' if number else ''}{file.suffix}"
        if taken.setdefault(place, (file, content))[1] == content:
            return place
        number += 1


def _mjcf_text(description: Description, place: Any) -> str:
    """Returns the MJCF with all that it names in the folder of meshes."""
    spec = description.mjcf.copy()
    top = description.mjcf_source.parent
    named: dict[str, str] = {}

    def found(name: str, folder: str) -> Path | None:
        if not name:
            return None
        name = Path(name).name if spec.strippath else name
        return existing_file(top / folder / name)

    def moved(name: str, folder: str) -> str:
        """Returns the file's full path, by which its place is known in what MuJoCo writes."""
        file = found(name, folder)
        if file is None:
            return name
        full = str(file.absolute())
        named[full] = place(file, read_input(file, MAX_FILE_BYTES))
        return full

    for element in (*spec.meshes, *spec.hfields, *spec.skins):
        element.file = moved(element.file, element.compiler.meshdir)
    for texture in spec.textures:
        texture.file = moved(texture.file, texture.compiler.texturedir)
        texture.cubefiles = [moved(file, texture.compiler.texturedir) for file in texture.cubefiles]
    spec.compiler.meshdir = spec.compiler.texturedir = ""
    spec.strippath = False
    root = ElementTree.fromstring(to_xml(spec))
    for node in root.iter():
        for word, value in node.attrib.items():
            if value in named:
                node.set(word, named[value])
    return ElementTree.tostring(root, encoding="unicode") + "\n"
