"""Write results as a single HTML file that needs no network and no other file.

The page contains three.js for the 3-D views, taken from the installed package MeshCat.
"""

from __future__ import annotations

import base64
import json
import re
import reprlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import orjson
from numpy.typing import ArrayLike

from pupper_analysis import __version__
from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import PAGE_KIND, hash_content
from pupper_analysis.base.provenance import collect_provenance
from pupper_analysis.base.results import Result
from pupper_analysis.models.shapes import Mesh
from pupper_analysis.present.document import (
    Block,
    Document,
    Lines,
    Motion,
    MotionScene,
    Plot,
    Report,
    SceneView,
    StandScene,
    Table,
    Text,
    text,
)
from pupper_analysis.present.documents.registry import build_report
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.html.plots import DOT_OUTLINES, draw_svg
from pupper_analysis.present.scene import (
    JointAxis,
    collect_visible_shapes,
    describe_joint_axes,
    describe_scene,
    select_visible_geoms,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import is_slide, joint_motions
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    import jinja2

MAX_FACES = 12_000
"""Approximate upper bound of the number of triangles of all meshes of a robot, which limits the
size of the file. Chosen, not tuned.
"""

MAX_FRAMES = 80
"""Largest number of configurations of a motion. Chosen, not tuned."""


@singledispatch
def serialise_scene(scene: object) -> dict[str, Any] | None:
    """Convert the content of a 3-D view to JSON data for the viewer of an HTML page.

    Returns:
        Robot, motions, contacts and ground; lengths in m, forces in N. Contacts, ground and CoM are
        expressed in the world frame. Shapes and joint axes are expressed in the frames of the
        bodies. An implementation may return None for a scene that contains nothing to show.

    Raises:
        TypeError: If there is no implementation for this type of scene.
    """
    raise TypeError(f"no view of {type(scene).__name__}")


@serialise_scene.register
def _serialise_stand(scene: StandScene) -> dict[str, Any]:
    """Convert the scene of a stand to JSON data, {key: value}, for the viewer of a page.

    Contacts (point [m], force [N]), support polygon, ground and centre of mass [m], for example,
    are in the world frame.
    """
    robot, stand, statics = scene.robot, scene.stand, scene.statics
    still = Motion(text("the-stand"), np.zeros(1), stand.qpos[None])
    seen = describe_scene(robot, stand, statics)
    return {
        **_serialise_robot(robot, stand.qpos, (still, *scene.motions), seen.joints),
        "contacts": [
            {
                "name": escape_control(contact.foot),
                "point": round_values(contact.point),
                "force": round_values(contact.force),
            }
            for contact in seen.contacts
        ],
        "polygon": round_values(seen.polygon),
        "steps": [
            {
                "centre": round_values(step.centre),
                "half": round_values(step.half),
                "quat": round_values(step.quaternion),
                "pit": step.height < 0,
                "round": step.round,
            }
            for step in seen.steps.values()
        ],
        "ground": round_values(seen.ground_centre),
        "normal": round_values(seen.ground_normal),
        "com": round_values(seen.com),
        "below": round_values(seen.com_projection),
        "layers": ["shapes", "axes", *(["forces"] if statics else []), "support", "masses"],
        "size": float(np.ptp(seen.contact_positions, axis=0).max() + stand.qpos[2]),
    }


@serialise_scene.register
def _serialise_motion(scene: MotionScene) -> dict[str, Any]:
    """Convert the scene of a moving robot to JSON data, {key: value}, for the viewer of a page.

    The ground is level, at height 0. The base must be free.
    """
    robot, qpos = scene.robot, scene.motions[0].qpos[0]
    axes = describe_joint_axes(Configuration(robot, qpos), qpos[-robot.nu :], None)
    drawn = _serialise_robot(robot, qpos, scene.motions, axes)
    return {
        **drawn,
        **{"contacts": [], "polygon": [], "steps": [], "com": None, "below": None},
        "ground": round_values(np.array([*qpos[:2], 0.0])),
        "normal": [0.0, 0.0, 1.0],
        "size": 1.3 * drawn["radius"],
        "layers": ["shapes", "axes", "masses"],
    }


def _serialise_robot(
    robot: Robot, qpos: Array, motions: Iterable[Motion], axes: Iterable[JointAxis]
) -> dict[str, Any]:
    """Convert a robot to JSON data, {key: value}: bodies, shapes, meshes, motions, joints, extent.

    The extent is the centre (``middle``) and half the diagonal (``radius``) [m] of the box around
    the robot at ``qpos``, shape (nq,), in the world frame.
    """
    model, data = robot.mj_model, robot.compute_kinematics(qpos)
    low, high = compute_extent(model, data)
    geoms, meshes = serialise_geoms(model)
    kinds = joint_motions(robot)
    return {
        "bodies": serialise_bodies(model),
        "geoms": geoms,
        "meshes": meshes,
        "motions": [_pack_motion(robot, data, motion) for motion in motions],
        "joints": [
            {**_serialise_joint(axis, kinds[axis.name]), "slides": is_slide(robot, axis.name)}
            for axis in axes
        ],
        "middle": round_values((low + high) / 2),
        "radius": float(np.linalg.norm(high - low) / 2),
    }


def _pack_motion(robot: Robot, data: mujoco.MjData, motion: Motion) -> dict[str, Any]:
    """Convert a motion to JSON data (`pack_poses`) at up to `MAX_FRAMES` finite configurations.

    The kinematics in ``data`` are changed.
    """
    finite = np.isfinite(motion.qpos).all(axis=1)
    most = np.linspace(0, finite.sum() - 1, min(int(finite.sum()), MAX_FRAMES)).round()
    chosen = np.flatnonzero(finite)[np.unique(most.astype(int))]
    poses = []
    for qpos in motion.qpos[chosen]:
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_kinematics(robot.mj_model, data)
        poses.append(np.concatenate([data.xpos, data.xquat], axis=1)[1:])
    return pack_poses(motion.name, motion.time[chosen], np.array(poses))


def pack_poses(name: Text, time: Array, poses: Array) -> dict[str, Any]:
    """Pack the body poses of a motion as 16-bit integers in base64.

    Args:
        name: Name of the motion.
        time: Times, shape (n,) [s].
        poses: Position [m] and quaternion (w, x, y, z) of each body in the world frame, shape
            (n, bodies, 7).

    Returns:
        {key: value}. ``en`` and ``zh`` are the name in both languages, ``time`` the times [s], and
        ``reach`` the largest absolute coordinate [m], at least 1e-3. ``frames`` contains the
        integers: for each time and body x, y, z in units of ``reach`` / 32767, then the quaternion
        in units of 1 / 32767.
    """
    values = poses.copy()
    reach = max(float(np.abs(values[..., :3]).max()), 1e-3)
    values[..., :3] /= reach
    return {
        "en": name.en,
        "zh": name.zh,
        "time": round_values(time),
        "reach": reach,
        "frames": base64.b64encode(np.round(32767 * values).astype("<i2").tobytes()).decode(),
    }


def round_values(values: ArrayLike) -> list[Any]:
    """Round an array of any shape to five decimals, and convert the array to nested lists.

    For lengths in metres, five decimals are 0.01 mm, sufficient for a view.
    """
    return np.round(np.asarray(values), 5).tolist()  # type: ignore[no-any-return]


def compute_extent(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Compute the axis-aligned box around the visible geoms and body frames of a model.

    The box contains the boxes of the geoms (``geom_aabb``) and the origins of the frames. The
    kinematics of ``data`` must be evaluated.

    Returns:
        Lower and upper bounds, shape (3,) [m], in the world frame.
    """
    own = select_visible_geoms(model)
    boxes, rotations = model.geom_aabb[own], data.geom_xmat[own].reshape(-1, 3, 3)
    middle = data.geom_xpos[own] + np.einsum("nij,nj->ni", rotations, boxes[:, :3])
    reach = np.einsum("nij,nj->ni", np.abs(rotations), boxes[:, 3:])
    frames = data.xpos[1:]
    ends = np.concatenate([middle - reach, middle + reach, frames])
    return ends.min(axis=0), ends.max(axis=0)


def serialise_bodies(model: mujoco.MjModel) -> list[dict[str, Any]]:
    """Convert all bodies except the world to JSON data.

    Returns:
        Name, mass [kg] and CoM in the body frame [m] of each body, in the order of the model.
    """
    return [
        {
            "name": escape_control(str(model.body(body).name)),
            "mass": round(float(model.body_mass[body]), 6),
            "com": round_values(model.body_ipos[body]),
        }
        for body in range(1, model.nbody)
    ]


def _serialise_joint(one: JointAxis, motion: str) -> dict[str, Any]:
    """Convert a joint to JSON data, {key: value}, for the viewer of a page.

    Anchor [m] and axis are expressed in the body frame; position in rad or m, torque in N m or N.
    """
    return {
        "name": escape_control(one.name),
        "body": one.body - 1,
        "anchor": round_values(one.anchor),
        "axis": round_values(one.axis),
        "motion": motion,
        "position": round(one.position, 4),
        "torque": None if one.torque is None else round(one.torque, 4),
        "limit": None if one.limit is None else round(one.limit, 4),
    }


def serialise_geoms(
    model: mujoco.MjModel,
) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Convert the visible geoms and meshes of a model to JSON data.

    Returns:
        List of geoms, and {name of a mesh: packed mesh}. A geom has a shape, the index of the body
        (without the world), size [m], position [m] and quaternion (w, x, y, z) in the body frame,
        and colour. The name of a mesh is a hash, so robots with equal meshes share an entry.
    """
    shapes, found = collect_visible_shapes(model, MAX_FACES)
    meshes = {number: _pack_mesh(mesh) for number, mesh in found.items()}
    names = {number: hash_content(orjson.dumps(mesh))[:16] for number, mesh in meshes.items()}
    geoms = [
        {
            "shape": shape.form.kind,
            "body": shape.body - 1,
            "size": round_values(shape.form.size),
            "pos": round_values(shape.form.pose.position),
            "quat": round_values(quaternion_from_rotation(shape.form.pose.rotation)),
            "colour": np.round(shape.colour, 3).tolist(),
            **({} if shape.mesh is None else {"mesh": names[shape.mesh]}),
        }
        for shape in shapes
    ]
    return geoms, {names[number]: mesh for number, mesh in meshes.items()}


def _pack_mesh(mesh: Mesh) -> dict[str, Any]:
    """Pack a mesh for the viewer of a page, {key: value}, with integers in base64.

    A vertex has the coordinates ``low`` + ``span`` * (integer / 65535) [m]. Faces are three indices
    of vertices; ``wide`` is True for indices of 32 bits instead of 16.
    """
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    steps = np.round((mesh.vertices - low) / span * 65535).astype("<u2")
    wide = len(mesh.vertices) > 65535
    faces = mesh.faces.astype("<u4" if wide else "<u2")
    return {
        "low": round_values(low),
        "span": round_values(span),
        "vertices": base64.b64encode(steps.tobytes()).decode(),
        "faces": base64.b64encode(faces.tobytes()).decode(),
        "wide": wide,
    }


_VIEWER_PACKAGE = "meshcat"
"""Python package from which the script of the 3-D view, three.js, is read."""
_EXPORT_MARKER = "THREE:()=>"
"""Text in MeshCat's script ``main.min.js`` that shows that the script exports three.js. A script
without this text is not used.
"""


@dataclass(frozen=True)
class ViewerLibrary:
    """Script that contains three.js.

    Attributes:
        script: Script, which defines ``MeshCat.THREE``, without text that ends a script element.
        licence: Licences of the script and of the included parts.
    """

    script: str
    licence: str


def load_viewer_library() -> ViewerLibrary | None:
    """Load three.js, the script of the 3-D view, from the installed package MeshCat.

    None if the package or its script cannot be used, for example because it is not installed.
    """
    package = find_spec(_VIEWER_PACKAGE)  # which does not import it
    if package is None or package.origin is None:
        return None
    folder = Path(package.origin).parent / "viewer" / "dist"
    try:
        script = (folder / "main.min.js").read_text(encoding="utf-8")
        licences = _collect_licences(folder)
    except (OSError, ValueError, PackageNotFoundError):
        return None
    if _EXPORT_MARKER not in script:
        return None
    # Within a script's element "<" before these can only stand in a string or a pattern.
    return ViewerLibrary(re.sub(r"(?i)<(?=/script|!--)", r"\\x3c", script), licences)


def _collect_licences(folder: Path) -> str:
    """Return the licence texts of MeshCat, and of the libraries in the script of MeshCat."""
    named = (
        path
        for path in distribution(_VIEWER_PACKAGE).files or ()
        if path.name.startswith("LICENSE")
    )
    texts = [f"MeshCat\n\n{path.read_text(encoding='utf-8')}" for path in islice(named, 1)]
    parts = json.loads((folder / "main.min.js.THIRD_PARTY_LICENSES.json").read_text("utf-8"))
    texts += [
        f"{part['name']} {part['version']}\n\n{part.get('licenseText') or part['license']}"
        for part in parts
    ]
    return "\n\n".join(texts).expandtabs()


HTML_LANGUAGES = {"en": "en", "zh": "zh-Hans"}
"""{language of a report: value of the HTML attribute ``lang``}."""

Reportable = Result | Table
"""A result of this package, or a table, that a report can show."""

ReportInput = Reportable | Mapping[str, Reportable] | Iterable[Reportable]
"""Results that `write_report` accepts."""


def write_report(
    results: ReportInput,
    path: str | Path,
    *,
    robots: Iterable[Robot] = (),
    language: str = "en",
    force: bool = False,
) -> None:
    """Write results as a single HTML file, which needs no network and no other file.

    Args:
        results: A result, several results, or {name: result}. Results with a builder, such as
            analyses, stances and studies (``study_outcome``), have specific pages. For other
            results, the page lists the fields.
        path: File; ``-`` is standard output.
        robots: Robots of the results, for 3-D views. A robot belongs to the results with the name
            of the robot.
        language: Initial language of the page, ``"en"`` or ``"zh"``. The reader can switch the
            language.
        force: Whether to replace an existing file that is not a page of this package.

    Raises:
        ConfigurationError: For example if there is no result, an object is not a result, the
            language is unknown, an argument has the wrong type, or a stand belongs to another robot
            than the robot with its name.
        OutputError: If the file cannot be written, or ``force`` is False and the file would replace
            a non-empty file that is not a page of this package.
    """
    if language not in HTML_LANGUAGES:
        raise ConfigurationError("language", diagnose("language-unknown", language=language))
    check_type("path", path, str | Path)
    check_type("robots", robots, Iterable[Robot])
    named = _name_results(results)
    odd = [result for _, result in named if not isinstance(result, Result | Table)]
    if odd:
        raise ConfigurationError("results", diagnose("no-result", given=reprlib.repr(odd[0])))
    if not named:
        raise ConfigurationError("results", diagnose("nothing-to-report"))
    shown = build_report(
        [(name or "", result) for name, result in named if not isinstance(result, Table)],
        robots,
        [result for _, result in named if isinstance(result, Table)],
    )
    with write_atomically(Path(path), PAGE_KIND, force=force) as file:
        file.write(render_page(shown, language).encode())


def _name_results(
    results: ReportInput,
) -> list[tuple[str | None, Reportable]]:
    """List results as (name, result) pairs; the name is None if the caller passed no name."""
    if isinstance(results, Result | Table):
        return [(None, results)]
    if isinstance(results, Mapping):
        return list(results.items())
    check_type("results", results, Iterable[object])
    return [(None, result) for result in results]


def render_page(shown: Report, language: str = "en") -> str:
    """Convert a report to the text of a single HTML page, initially in ``language``.

    Raises:
        KeyError: If the language is unknown.
    """
    library = load_viewer_library()
    scenes: list[dict[str, Any]] = []
    sections = tuple(_draw_document(document, scenes) for document in shown.documents)
    meshes = {name: mesh for scene in scenes for name, mesh in scene.pop("meshes").items()}
    page: str = (
        _make_environment()
        .get_template("page.html")
        .render(
            title=shown.title,
            language=HTML_LANGUAGES[language],
            version=__version__,
            provenance=collect_provenance().lines(),
            sections=sections,
            overview=[_draw_block(block, scenes) for block in shown.overview],
            words=_collect_script_words(),
            text=text,
            library=library if scenes else None,
            three=_mark_safe(library.script if library else ""),
            meshes=meshes,
            dot_outlines=DOT_OUTLINES,
            style=_read_part("style.css"),
            script=_read_part("page.js"),
            viewer=_read_part("view.js"),
        )
    )
    return page


def _draw_document(document: Document, scenes: list[dict[str, Any]]) -> Document:
    """Convert the plots and 3-D views of a document for the HTML template; return a copy.

    The data of the 3-D views are appended to ``scenes``.
    """
    blocks = [_draw_block(block, scenes) for block in document.blocks]
    return replace(document, blocks=tuple(block for block in blocks if block is not None))


def _draw_block(block: Block, scenes: list[dict[str, Any]]) -> Any:
    """Convert a block, such as a plot or 3-D view, for the HTML template; plots become SVG.

    The data of a 3-D view are appended to ``scenes``. None if `serialise_scene` returns None.
    """
    if isinstance(block, Plot):
        return draw_svg(block)
    if not isinstance(block, SceneView):
        return block
    if block.scene is None:
        left_out = text("view-without-robot")
        return Lines((left_out,))
    scene = serialise_scene(block.scene)
    if scene is None:
        return None
    scenes.append(scene)
    return {"kind": "view", "title": block.title, "note": block.note, "scene": scene}


def _collect_script_words() -> dict[str, dict[str, str]]:
    """Collect the words that the scripts of a page display, as {language: {key: word}}."""
    word_keys = {
        "no_library": "view-without-three-js",
        "no_webgl": "view-without-webgl",
        "position": "position",
        "torque": "torque",
        "mass": "mass",
        "com": "com",
        "force": "force",
    }
    motions = ("roll", "pitch", "yaw", "oblique", "along x", "along y", "along z", "oblique slide")
    texts = {name: text(english) for name, english in word_keys.items()}
    texts |= {motion: text(motion) for motion in motions}
    return {
        language: {name: getattr(words, language) for name, words in texts.items()}
        for language in HTML_LANGUAGES
    }


def _make_environment() -> jinja2.Environment:
    """Create the Jinja environment of the HTML templates, which escapes inserted plain texts."""
    import jinja2
    import markupsafe

    def shown(value: object) -> object:
        """Return a value with escaped control characters, if it is a string without markup."""
        plain = isinstance(value, str) and not isinstance(value, markupsafe.Markup)
        return "\n".join(map(escape_control, str(value).split("\n"))) if plain else value

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pupper_analysis.present.html"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # NaN and infinity, which JSON lacks, become null.
    environment.policies["json.dumps_function"] = lambda value, **_: orjson.dumps(value).decode()
    return environment


def _read_part(name: str) -> object:
    """Read a style sheet or script of this package, to insert into the page without escaping."""
    part = files("pupper_analysis.present.html").joinpath("templates", name)
    return _mark_safe(part.read_text(encoding="utf-8"))


def _mark_safe(script: str) -> object:
    """Mark a text as safe for the HTML template, which then inserts the text without escaping."""
    import markupsafe

    return markupsafe.Markup(script)
