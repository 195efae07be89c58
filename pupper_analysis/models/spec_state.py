"""A MuJoCo spec as plain data, to be sent to another process, and back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pupper_analysis.base.inputs import MOST_FILE, read_input
from pupper_analysis.models.mjcf import LOST_OF_CLASSES, silence_mujoco

_LISTS = (
    *(
        "frames",
        "bodies",
        "geoms",
        "sites",
        "joints",
        "cameras",
        "lights",
        "meshes",
        "materials",
        "pairs",
    ),
    *("equalities", "tendons", "actuators", "sensors", "keys", "numerics", "hfields", "textures"),
)
_QUATERNION = mujoco.mjtOrientation.mjORIENTATION_QUAT
_PARTS = (
    *("option", "stat"),
    *("visual.headlight", "visual.map", "visual.quality", "visual.rgba", "visual.scale"),
)
_RESOLVED = {
    "bodies": ("body", ("pos", "quat", "ipos", "iquat", "inertia", "mass")),
    "geoms": ("geom", ("pos", "quat", "size")),
    "sites": ("site", ("pos", "quat", "size")),
    "joints": ("jnt", ("pos", "axis", "range")),
    "cameras": ("cam", ("pos", "quat")),
    "lights": ("light", ("pos", "dir")),
}
"""{list: (prefix of its arrays in the model, attributes that they hold)}."""

_ROUNDING = {"rtol": 2e-5, "atol": 1e-12}
"""What MuJoCo's writer does to numbers: it leaves them six digits."""


def state_of(spec: mujoco.MjSpec) -> dict[str, Any]:
    """Returns a spec as plain data: its XML, the files it needs, and the digits that XML lacks.

    Frames and angles other than quaternions are written as MuJoCo resolves them.

    Args:
        spec: One that compiles.
    """
    assets = {**_files(spec), **spec.assets}
    spec = spec.copy()
    with silence_mujoco():
        model = spec.compile()
        state = {"xml": spec.to_xml(), "folder": spec.modelfiledir, "assets": assets}
    return {**state, "exact": _corrections(spec, model, _read(state))}


def spec_from(state: dict[str, Any]) -> mujoco.MjSpec:
    """Returns the spec of such data; it needs no files."""
    spec = _read(state)
    parts = dict(_parts(spec))
    for part, name, value in state["exact"]:
        setattr(parts[part], name, value)
        if name == "fullinertia":  # instead of principal axes, which are others' last digits
            parts[part].inertia, parts[part].iquat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    return spec


def _read(state: dict[str, Any]) -> mujoco.MjSpec:
    with silence_mujoco():
        spec = mujoco.MjSpec.from_string(state["xml"], assets=state["assets"])
    spec.modelfiledir = state["folder"]
    return spec


def _files(spec: mujoco.MjSpec) -> dict[str, bytes]:
    """Returns the contents of the files that meshes, height fields and textures are read from."""
    named = [(one.file, one.compiler.meshdir) for one in (*spec.meshes, *spec.hfields, *spec.skins)]
    for texture in spec.textures:
        files = (texture.file, *texture.cubefiles)
        named += [(file, texture.compiler.texturedir) for file in files]
    contents = {}
    for file, folder in named:
        name = Path(file).name if spec.strippath else file
        place = Path(spec.modelfiledir) / folder / name
        if file and place.is_file():
            contents[name] = read_input(place, MOST_FILE)
    return contents


def _parts(spec: mujoco.MjSpec) -> Iterator[tuple[tuple[str, int], Any]]:
    """Yields all that has numbers in a spec, each under a key."""
    for name in _LISTS:
        for index, element in enumerate(getattr(spec, name)):
            yield (name, index), element
    for name in _PARTS:
        part = spec
        for step in name.split("."):
            part = getattr(part, step)
        yield (name, 0), part


def _numbers(part: Any) -> Iterator[tuple[str, Any]]:
    """Yields the attributes of a part that are numbers with fractions."""
    for name in dir(part):
        if not name.startswith("_"):
            value: Any = getattr(part, name, None)
            if type(value).__name__ in ("MjDoubleVec", "MjFloatVec"):
                value = np.array(list(value))
            elif name == "quat" and part.alt.type != _QUATERNION:
                value = np.array(
                    mujoco.MjSpec.resolve_orientation(
                        degree=bool(part.compiler.degree),
                        sequence=part.compiler.eulerseq,
                        orientation=part.alt,
                    )
                )
            if isinstance(value, float) or (
                isinstance(value, np.ndarray) and value.dtype.kind == "f"
            ):
                yield name, value


def _resolved(model: mujoco.MjModel, key: tuple[str, int], name: str) -> Any:
    """Returns what MuJoCo made of an element's attribute; None where that is nothing of its own."""
    prefix, names = _RESOLVED.get(key[0], ("", ()))
    return getattr(model, f"{prefix}_{name}")[key[1]] if name in names else None


def _number(key: tuple[str, int], part: Any) -> tuple[str, int]:
    """Returns a part's key with its number in the model it is compiled to; frames have none."""
    number = getattr(part, "id", -1)
    return key if number < 0 else (key[0], number)


def _corrections(
    spec: mujoco.MjSpec, model: mujoco.MjModel, rounded: mujoco.MjSpec
) -> list[tuple[tuple[str, int], str, Any]]:
    """Returns (part, attribute, value) where a number of a spec is another's before rounding.

    Elements are matched by their number in the model, as frames change their order in the spec.
    """
    compiled = rounded.copy()
    with silence_mujoco():
        compiled.compile()
    wanted = {_number(key, part): dict(_numbers(part)) for key, part in _parts(spec)}
    numbers = {key: _number(key, part) for key, part in _parts(compiled)}
    result = []
    for key, other in _parts(rounded):
        number = numbers[key]
        # Last what takes the place of others.
        for name, value in sorted(_numbers(other), key=lambda item: item[0] == "fullinertia"):
            stated = wanted.get(number, {}).get(name)
            if stated is None:
                continue
            for exact in (stated, _resolved(model, number, name), np.deg2rad(stated)):
                if exact is None or np.shape(exact) != np.shape(value):
                    continue
                full = name == "fullinertia" and not np.isnan(exact).any()
                lost = key[0] == "geoms" and name in LOST_OF_CLASSES
                if full or lost or np.allclose(exact, value, equal_nan=True, **_ROUNDING):
                    if not np.array_equal(exact, value, equal_nan=True):
                        kept = float(exact) if isinstance(value, float) else np.array(exact)
                        result.append((key, name, kept))
                    break
    return result
