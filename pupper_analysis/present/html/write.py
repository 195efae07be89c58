"""Writes results as one HTML file that needs nothing else.

Not even to draw in space: three.js is in it, of a package that is installed. MeshCat's viewer has
it, which PlaCo brings.
"""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson

from pupper_analysis import __version__
from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.files import whole_file
from pupper_analysis.base.kinds import PAGE
from pupper_analysis.base.provenance import find_provenance
from pupper_analysis.base.results import Result
from pupper_analysis.present.document import (
    Block,
    Document,
    Lines,
    Plot,
    Report,
    Table,
    Text,
    View,
)
from pupper_analysis.present.documents.registry import build_report
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.html.plots import draw_svg
from pupper_analysis.present.html.scene import scene_of, share_meshes
from pupper_analysis.present.words import text
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    import jinja2

_PACKAGE = "meshcat"
_EXPORT = "THREE:()=>"
"""How the bundle says that it gives three.js away, beside its own viewer."""


@dataclass(frozen=True)
class Library:
    """A script with three.js in it.

    Attributes:
        script: The script, which leaves ``MeshCat.THREE`` behind; nothing in it ends a script's
            element.
        licence: Under which it, and all that is in it, may be passed on.
    """

    script: str
    licence: str


def installed_library() -> Library | None:
    """Returns three.js, or None where no package with it is installed."""
    found = find_spec(_PACKAGE)  # which does not import it
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent / "viewer" / "dist"
    try:
        script = (folder / "main.min.js").read_text(encoding="utf-8")
        licences = _licences(folder)
    except (OSError, ValueError):
        return None
    if _EXPORT not in script:
        return None
    # Within a script's element "<" before these can only stand in a string or a pattern.
    return Library(re.sub(r"(?i)<(?=/script|!--)", r"\\x3c", script), licences)


def _licences(folder: Path) -> str:
    """Returns the licences of the viewer, and of all that is bundled in it."""
    texts = []
    try:
        own = [
            path
            for path in distribution(_PACKAGE).files or []
            if path.name.upper().startswith("LICENSE")
        ]
        texts += [f"MeshCat\n\n{path.read_text(encoding='utf-8')}" for path in own[:1]]
    except (PackageNotFoundError, OSError):
        pass
    parts = json.loads((folder / "main.min.js.THIRD_PARTY_LICENSES.json").read_text("utf-8"))
    texts += [
        f"{part['name']} {part['version']}\n\n{part.get('licenseText') or part['license']}"
        for part in parts
    ]
    return "\n\n".join(texts).expandtabs()


LANGUAGES = {"en": "en", "zh": "zh-Hans"}
"""The page's languages, and their names in HTML."""

_HINT = "view-hint"
_NO_LIBRARY = "view-without-three-js"

Reportable = Result | Table
Reported = Reportable | Mapping[str, Reportable] | Iterable[Reportable]
"""What may be reported."""


def write_report(
    results: Reported,
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
    if language not in LANGUAGES:
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
    with whole_file(Path(path), PAGE, force=force) as file:
        file.write(render_page(shown, language).encode())


def _named(
    results: Reported,
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
    library = installed_library()
    scenes: list[dict[str, Any]] = []
    sections = tuple(_drawn(document, scenes) for document in shown.documents)
    meshes = share_meshes(scenes)
    judged = [section for section in sections if section.passed is not None]
    page: str = (
        _environment()
        .get_template("page.html")
        .render(
            title=shown.title,
            language=LANGUAGES[language],
            version=__version__,
            provenance=find_provenance().lines(),
            sections=sections,
            overview=[_block(block, scenes) for block in shown.overview],
            counted=_counted(judged),
            ui=_interface(),
            words=_spoken(),
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
    scene = scene_of(block.scene)
    if scene is None:
        return None
    scenes.append(scene)
    return {"kind": "view", "title": block.title, "note": block.note, "scene": scene}


def _counted(judged: list[Document]) -> Text | None:
    if len(judged) < 2:  # of one, its own verdict says it
        return None
    good = sum(bool(section.passed) for section in judged)
    return text("count-passed", good=good, count=len(judged))


def _interface() -> dict[str, Any]:
    """Returns the words of the page itself."""
    layers = {
        "shapes": text("shapes"),
        "axes": text("joint axes"),
        "forces": text("contact-forces"),
        "support": text("support-polygon-and-com"),
        "other": text("joints-of-the-urdf"),
        "masses": text("masses-of-the-links"),
    }
    said = {
        "best": "the-best",
        "source": "numbers-source",
        "save_svg": "save-as-svg",
        "save_png": "save-as-png",
        "view_label": "view-label",
        "view_hint": _HINT,
        "reset": "reset-the-view",
        "time": "time",
        "motion": "motion-shown",
        "joint_axes": "joint axes",
        "no_library": _NO_LIBRARY,
        "skip": "skip-to-the-summary",
        "theme": "light-or-dark",
        "sections": "sections",
        "summary": "summary",
        "made_by": "made-by",
        "failed": "what-failed",
        "notes": "notes-title",
        "licences": "licences-of-scripts",
    }
    return {"layers": layers, **{name: text(english) for name, english in said.items()}}


def _spoken() -> dict[str, dict[str, str]]:
    """Returns the words that the page's scripts say, by language."""
    said = {
        "no_library": _NO_LIBRARY,
        "no_webgl": "view-without-webgl",
        "position": "position",
        "torque": "torque",
        "mass": "mass",
        "com": "com",
        "force": "force",
        "same": "no-difference",
    }
    motions = ("roll", "pitch", "yaw", "oblique", "along x", "along y", "along z", "oblique slide")
    texts = {name: text(english) for name, english in said.items()}
    texts |= {motion: text(motion) for motion in motions}
    return {
        language: {name: getattr(words, language) for name, words in texts.items()}
        for language in LANGUAGES
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
