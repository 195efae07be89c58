"""Writes results as one HTML file that needs nothing else.

Not even to draw in space: three.js is in it, of a package that is installed. MeshCat's viewer has
it, which PlaCo brings. A scene has a robot's shapes, where they are, and what acts on it; of two
files that are compared, the MJCF's shapes and the URDF's joints as lines over each other.
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
from numpy.typing import ArrayLike, NDArray

from pupper_analysis import __version__
from pupper_analysis.base.arguments import check_type
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
    StandScene,
    Table,
    Text,
    View,
    text,
)
from pupper_analysis.present.documents.registry import build_report
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.html.plots import draw_svg
from pupper_analysis.present.scene import (
    JointAxis,
    collect_visible_shapes,
    describe_joint_axes,
    describe_scene,
    select_visible_geoms,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_motions
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    import jinja2


Array = NDArray[np.float64]

MAX_FACES = 12_000
"""Of all meshes of a robot together: some 150 kB of the file, so that six robots fit in 3 MB."""

MAX_FRAMES = 80
"""Configurations of a motion: what a slider of its width can tell apart."""


@singledispatch
def serialise_scene(scene: object) -> dict[str, Any] | None:
    """Returns a scene as plain lists and numbers: lengths in m, in the world unless said.

    Returns:
        The scene; None where what it is made of has gone.

    Raises:
        TypeError: If nobody has said how such a scene is drawn.
    """
    raise TypeError(f"no view of {type(scene).__name__}")


@serialise_scene.register
def _stand(scene: StandScene) -> dict[str, Any]:
    robot, stand, statics = scene.robot, scene.stand, scene.statics
    still = Motion(text("the-stand"), np.zeros(1), stand.qpos[None])
    seen = describe_scene(robot, stand, statics)
    return {
        **_robot(robot, stand.qpos, (still, *scene.motions), seen.joints),
        "contacts": [
            {
                "name": escape_control(one.foot),
                "point": round_values(one.point),
                "force": round_values(one.force),
            }
            for one in seen.contacts
        ],
        "polygon": round_values(seen.polygon),
        "steps": [
            {
                "centre": round_values(one.centre),
                "half": round_values(one.half),
                "quat": round_values(one.turn),
                "pit": one.height < 0,
                "round": one.round,
            }
            for one in seen.steps.values()
        ],
        "ground": round_values(seen.ground_centre),
        "normal": round_values(seen.ground_normal),
        "com": None if statics is None else round_values(seen.com),
        "below": round_values(seen.com_projection),
        "layers": ["shapes", "axes", *(["forces"] if statics else []), "support", "masses"],
        "size": float(np.ptp(seen.contact_positions, axis=0).max() + stand.qpos[2]),
    }


@serialise_scene.register
def _motion(scene: MotionScene) -> dict[str, Any]:
    robot, qpos = scene.robot, scene.motions[0].qpos[0]
    axes = describe_joint_axes(Configuration(robot, qpos), qpos[-robot.nu :], None)
    drawn = _robot(robot, qpos, scene.motions, axes)
    return {
        **drawn,
        **{"contacts": [], "polygon": [], "steps": [], "com": None, "below": None},
        "ground": round_values(np.array([*qpos[:2], 0.0])),
        "normal": [0.0, 0.0, 1.0],
        "size": 1.3 * drawn["radius"],
        "layers": ["shapes", "axes", "masses"],
    }


def _robot(
    robot: Robot, qpos: Array, motions: Iterable[Motion], axes: Iterable[JointAxis]
) -> dict[str, Any]:
    """Returns a robot's bodies, shapes, joints and motions, and where it is at a configuration."""
    model, data = robot.mj_model, robot.placed(qpos)
    low, high = compute_extent(model, data)
    geoms, meshes = serialise_geoms(model)
    kinds = joint_motions(robot)
    return {
        "bodies": serialise_bodies(model),
        "geoms": geoms,
        "meshes": meshes,
        "motions": [_frames(robot, data, motion) for motion in motions],
        "joints": [_joint(one, kinds[one.name]) for one in axes],
        "middle": round_values((low + high) / 2),
        "radius": float(np.linalg.norm(high - low) / 2),
    }


def _frames(robot: Robot, data: mujoco.MjData, motion: Motion) -> dict[str, Any]:
    """Returns where the bodies are in some of the configurations."""
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
    """Returns poses in few letters.

    Args:
        name: What moves.
        time: (n,) when (s).
        poses: (n, bodies, 7) x, y, z (m) and quaternion w, x, y, z.

    Returns:
        ``frames`` are whole numbers of 16 bits: x, y, z in parts of ``reach`` / 32767, then the
        quaternion in parts of 1 / 32767.
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
    """Returns numbers to a hundredth of a millimetre: a view shows no more."""
    return np.round(np.asarray(values), 5).tolist()  # type: ignore[no-any-return]


def compute_extent(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Returns the least and the greatest x, y, z (3,) of the balls round the robot's shapes (m)."""
    own = select_visible_geoms(model)
    middle, reach = data.geom_xpos[own], model.geom_rbound[own, None]
    frames = data.xpos[1:]
    ends = np.concatenate([middle - reach, middle + reach, frames])
    return ends.min(axis=0), ends.max(axis=0)


def serialise_bodies(model: mujoco.MjModel) -> list[dict[str, Any]]:
    """Returns the bodies but the world: names, masses (kg) and coms in their own frames (m)."""
    return [
        {
            "name": escape_control(str(model.body(body).name)),
            "mass": round(float(model.body_mass[body]), 6),
            "com": round_values(model.body_ipos[body]),
        }
        for body in range(1, model.nbody)
    ]


def _joint(one: JointAxis, motion: str) -> dict[str, Any]:
    """Returns a joint's axis, what it does, where it is and what its motor holds."""
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
    """Returns the robot's shapes, and the meshes that they have, named after their content.

    So robots that have the same share it.
    """
    shapes, found = collect_visible_shapes(model, MAX_FACES)
    meshes = {number: _mesh(mesh) for number, mesh in found.items()}
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


def _mesh(mesh: Mesh) -> dict[str, Any]:
    """Returns a mesh in few letters: its vertices in whole steps of its box's sides."""
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


_PACKAGE = "meshcat"
_EXPORT = "THREE:()=>"
"""How the bundle says that it gives three.js away, beside its own viewer."""


@dataclass(frozen=True)
class ViewerLibrary:
    """A script with three.js in it.

    Attributes:
        script: The script, which leaves ``MeshCat.THREE`` behind; nothing in it ends a script's
            element.
        licence: Under which it, and all that is in it, may be passed on.
    """

    script: str
    licence: str


def load_viewer_library() -> ViewerLibrary | None:
    """Returns three.js, or None where no package with it is installed."""
    found = find_spec(_PACKAGE)  # which does not import it
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent / "viewer" / "dist"
    try:
        script = (folder / "main.min.js").read_text(encoding="utf-8")
        licences = _licences(folder)
    except (OSError, ValueError, PackageNotFoundError):
        return None
    if _EXPORT not in script:
        return None
    # Within a script's element "<" before these can only stand in a string or a pattern.
    return ViewerLibrary(re.sub(r"(?i)<(?=/script|!--)", r"\\x3c", script), licences)


def _licences(folder: Path) -> str:
    named = (path for path in distribution(_PACKAGE).files or () if path.name.startswith("LICENSE"))
    texts = [f"MeshCat\n\n{path.read_text(encoding='utf-8')}" for path in islice(named, 1)]
    parts = json.loads((folder / "main.min.js.THIRD_PARTY_LICENSES.json").read_text("utf-8"))
    texts += [
        f"{part['name']} {part['version']}\n\n{part.get('licenseText') or part['license']}"
        for part in parts
    ]
    return "\n\n".join(texts).expandtabs()


HTML_LANGUAGES = {"en": "en", "zh": "zh-Hans"}
"""The page's languages, and their names in HTML."""

Reportable = Result | Table
ReportInput = Reportable | Mapping[str, Reportable] | Iterable[Reportable]
"""What may be reported."""


def write_report(
    results: ReportInput,
    path: str | Path,
    *,
    robots: Iterable[Robot] = (),
    language: str = "en",
    force: bool = False,
) -> None:
    """Writes results as one HTML file, which needs no network and nothing beside it.

    Args:
        results: One result, several, or {name: result}. Analyses, stances, pushed stances,
            comparisons, audits, paths and studies (``study_outcome``) have pages of their own; of
            any other result the fields are shown.
        path: The file; ``-`` is standard output.
        robots: The robots that the results are of, for the views in three dimensions; they are
            found by their names.
        language: In which it opens, ``"en"`` or ``"zh"``; it can be changed on the page.
        force: Replace what is no page of ours, too.

    Raises:
        ConfigurationError: If there is no result, or the language is neither.
        OutputError: If the file cannot be written, or is no page of ours.
    """
    if language not in HTML_LANGUAGES:
        raise ConfigurationError("language", diagnose("language-unknown", language=language))
    check_type("path", path, str | Path)
    check_type("robots", robots, Iterable[Robot])
    named = _named(results)
    odd = [one for _, one in named if not isinstance(one, Result | Table)]
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


def _named(
    results: ReportInput,
) -> list[tuple[str | None, Reportable]]:
    if isinstance(results, Result | Table):
        return [(None, results)]
    if isinstance(results, Mapping):
        return list(results.items())
    check_type("results", results, Iterable[object])
    return [(None, result) for result in results]


def render_page(shown: Report, language: str = "en") -> str:
    """Returns a report as one HTML page.

    Args:
        shown: The report.
        language: In which it opens, ``"en"`` or ``"zh"``.
    """
    library = load_viewer_library()
    scenes: list[dict[str, Any]] = []
    sections = tuple(_drawn(document, scenes) for document in shown.documents)
    meshes = {name: one for scene in scenes for name, one in scene.pop("meshes").items()}
    page: str = (
        _environment()
        .get_template("page.html")
        .render(
            title=shown.title,
            language=HTML_LANGUAGES[language],
            version=__version__,
            provenance=collect_provenance().lines(),
            sections=sections,
            overview=[_block(block, scenes) for block in shown.overview],
            words=_spoken(),
            text=text,
            library=library if scenes else None,
            three=_as_it_is(library.script if library else ""),
            meshes=meshes,
            style=_part("style.css"),
            script=_part("page.js"),
            viewer=_part("view.js"),
        )
    )
    return page


def _drawn(document: Document, scenes: list[dict[str, Any]]) -> Document:
    """Returns a document with its plots drawn, and its views built and put into ``scenes``."""
    blocks = [_block(block, scenes) for block in document.blocks]
    return replace(document, blocks=tuple(block for block in blocks if block is not None))


def _block(block: Block, scenes: list[dict[str, Any]]) -> Any:
    """Returns what the template shows of a block; None where nothing is to be shown."""
    if isinstance(block, Plot):
        return draw_svg(block)
    if not isinstance(block, View):
        return block
    if block.scene is None:
        left_out = text("view-without-robot")
        return Lines((left_out,))
    scene = serialise_scene(block.scene)
    if scene is None:
        return None
    scenes.append(scene)
    return {"kind": "view", "title": block.title, "note": block.note, "scene": scene}


def _spoken() -> dict[str, dict[str, str]]:
    """Returns the words that the page's scripts say, by language."""
    said = {
        "no_library": "view-without-three-js",
        "no_webgl": "view-without-webgl",
        "position": "position",
        "torque": "torque",
        "mass": "mass",
        "com": "com",
        "force": "force",
    }
    motions = ("roll", "pitch", "yaw", "oblique", "along x", "along y", "along z", "oblique slide")
    texts = {name: text(english) for name, english in said.items()}
    texts |= {motion: text(motion) for motion in motions}
    return {
        language: {name: getattr(words, language) for name, words in texts.items()}
        for language in HTML_LANGUAGES
    }


def _environment() -> jinja2.Environment:
    """Returns the templates' environment: every text is escaped, and none acts."""
    import jinja2
    import markupsafe

    def shown(value: object) -> object:
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
    # What is not a number becomes null, which JSON has a word for.
    environment.policies["json.dumps_function"] = lambda value, **_: orjson.dumps(value).decode()
    return environment


def _part(name: str) -> object:
    """Returns a file of the package that is put into the page as it is."""
    part = files("pupper_analysis.present.html").joinpath("templates", name)
    return _as_it_is(part.read_text(encoding="utf-8"))


def _as_it_is(script: str) -> object:
    """Returns the package's own text, or a library's, which is not escaped."""
    import markupsafe

    return markupsafe.Markup(script)
