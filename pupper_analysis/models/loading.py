"""Reads anybody's URDF or MJCF: what is malformed is refused with its file and line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lxml import etree

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import MOST_TEXT, read_input
from pupper_analysis.base.runs import note_input
from pupper_analysis.models.mjcf_file import MjcfFile, mjcf_from
from pupper_analysis.models.places import NO_LINE, refusal_at
from pupper_analysis.models.published import XACRO, expand_xacro, find_file
from pupper_analysis.models.urdf_file import UrdfFile, urdf_from
from pupper_analysis.models.xml import parse_file_text, parse_xml


def read_model(path: str | Path, packages: Mapping[str, Path] | None = None) -> UrdfFile | MjcfFile:
    """Reads a URDF or an MJCF; the root element tells which it is.

    A xacro file is expanded, if that package is installed: its elements have no lines then.

    An MJCF that MuJoCo parses but does not compile is returned, too, with its ``refusal``.

    Args:
        path: The file, or ``robot_descriptions:NAME``.
        packages: Folders of packages, for a URDF's ``package://``.

    Raises:
        ModelError: If it cannot be loaded; one line that tells where and why.
    """
    check_type("path", path, str | Path)
    path = find_file(path)
    note_input(path)
    if path.suffix == XACRO:
        text = expand_xacro(path)
        root = parse_file_text(path, text)
        for element in root.iter():
            element.sourceline = NO_LINE
    else:
        text, root = parse_xml(path)
    if root.tag in ("mujoco", "mujocoinclude"):
        return mjcf_from(path, root)
    if root.tag != "robot":
        raise refusal_at(path, root, diagnose("no-model", tag=str(root.tag)))
    return urdf_from(path, text, root, packages)


def kind_of(path: Path) -> str | None:
    """Returns ``urdf`` or ``mjcf``; None of what is neither, or a part that other files include.

    An MJCF counts if it has a body of its own: a scene has but a floor around a robot's file.
    """
    if path.suffix.lower() == ".urdf":
        return "urdf"
    try:
        # Neither entities nor the network: what stands in a repository may be anybody's.
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
        root = etree.fromstring(read_input(path, MOST_TEXT), parser)
    except (etree.XMLSyntaxError, InputError):
        return None
    if root.tag == "robot":
        return "urdf" if root.find("link") is not None else None
    return "mjcf" if root.tag == "mujoco" and root.find("worldbody/body") is not None else None
