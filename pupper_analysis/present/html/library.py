"""three.js, from a package that is installed: MeshCat's viewer, which PlaCo brings."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, files
from importlib.util import find_spec
from pathlib import Path

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
        own = [path for path in files(_PACKAGE) or [] if path.name.upper().startswith("LICENSE")]
        texts += [f"MeshCat\n\n{path.read_text(encoding='utf-8')}" for path in own[:1]]
    except (PackageNotFoundError, OSError):
        pass
    parts = json.loads((folder / "main.min.js.THIRD_PARTY_LICENSES.json").read_text("utf-8"))
    texts += [
        f"{part['name']} {part['version']}\n\n{part.get('licenseText') or part['license']}"
        for part in parts
    ]
    return "\n\n".join(texts).expandtabs()
