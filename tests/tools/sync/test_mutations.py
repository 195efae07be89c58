"""Change random numbers of a file, and restore the numbers from the other file by `sync`.

`sync` must change no other number. The test edits the files by regular expressions, which share no
code with the package.
"""

from __future__ import annotations

import math
import random
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import pytest

import pupper_analysis as pa
from tests.support.repository import ROOT
from tests.support.robots import mjcf_text, quadruped, urdf_text

TAG = re.compile(r"<([a-z]+)((?:\s+[\w]+=\"[^\"]*\")*)\s*/?>")
ATTRIBUTE = re.compile(r"(\w+)=\"([^\"]*)\"")
MODELS = [*pa.VARIANTS, "quadruped"]
MUTATION_COUNT = 30
"""Number of undone mutations per model."""
LAYOUTS = ("original", "v3", "long-leg", "quadruped")
"""Published files of both bases, one derived variant, and a pair without includes. The same
function writes all derived variants, so ``long-leg`` is an example of these."""


class Pair(NamedTuple):
    urdf: Path
    mjcf: Path

    def texts(self) -> dict[Path, str]:
        """Return {file: text} of the URDF, the MJCF and the included files."""
        files = [self.urdf, *sorted(self.mjcf.parent.glob("*.xml"))]
        return {file: file.read_bytes().decode() for file in files}


@cache
def write_model(name: str, folder: Path) -> Pair:
    """Write the files of a model; copy the published files, with includes, if not derived."""
    (folder / "urdf").mkdir(parents=True)
    (folder / "mjcf").mkdir()
    if name == "quadruped":
        parts = quadruped()
        pair = Pair(folder / "urdf" / "q.urdf", folder / "mjcf" / "q.xml")
        pair.urdf.write_text(urdf_text(parts))
        pair.mjcf.write_text(mjcf_text(parts))
        return pair
    spec = pa.VARIANTS[name]
    if spec.leg_scale == spec.torso_mass_scale == 1:
        base = f"pupper_{spec.base}"
        shutil.copytree(ROOT / "mjcf" / "meshes", folder / "mjcf" / "meshes")
        shutil.copy(ROOT / "urdf" / f"{base}.urdf", folder / "urdf")
        for file in (ROOT / "mjcf").glob(f"{base}*.xml"):
            if "fixed" not in file.name:
                shutil.copy(file, folder / "mjcf")
        return Pair(folder / "urdf" / f"{base}.urdf", folder / "mjcf" / f"{base}.xml")
    return Pair(*pa.pupper.write_variant(name, folder))


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sync")


def attributes(tag: str) -> dict[str, str]:
    return dict(ATTRIBUTE.findall(tag))


class Mutated(NamedTuple):
    file: Path
    text: str


Change = Callable[[random.Random, list[float]], list[float]]


def scale_numbers(choose: random.Random, values: list[float]) -> list[float]:
    return [value * (1 + choose.choice([-1, 1]) * choose.uniform(0.02, 0.1)) for value in values]


def shift_number(choose: random.Random, values: list[float]) -> list[float]:
    index = choose.randrange(len(values))
    step = choose.choice([-1, 1]) * choose.uniform(0.002, 0.01)
    return [value + step * (place == index) for place, value in enumerate(values)]


def turn_quaternion(choose: random.Random, values: list[float]) -> list[float]:
    w, x, y, z = values
    axis = [choose.gauss(0, 1) for _ in range(3)]
    length = math.hypot(*axis)
    a, b, c = (math.sin(0.05) * value / length for value in axis)
    d = math.cos(0.05)
    return [
        w * d - x * a - y * b - z * c,
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
    ]


def scale_one_number(choose: random.Random, values: list[float]) -> list[float]:
    index = choose.choice([place for place, value in enumerate(values) if value])
    factor = 1 + choose.uniform(0.01, 0.05)
    return [value * (factor if place == index else 1) for place, value in enumerate(values)]


def limits(choose: random.Random, values: list[float]) -> list[float]:
    return [value + choose.uniform(-0.1, 0.1) for value in values]


KINDS: dict[str, list[tuple[str, str, Change]]] = {
    ".urdf": [
        ("mass", "value", scale_numbers),
        ("inertial origin", "xyz", shift_number),
        ("inertia", "ixx", scale_numbers),
        ("inertia", "iyy", scale_numbers),
        ("inertia", "izz", scale_numbers),
        ("moving origin", "xyz", shift_number),
        ("limit", "lower", limits),
        ("limit", "upper", limits),
        ("limit", "effort", scale_numbers),
        ("dynamics", "damping", scale_numbers),
        ("dynamics", "friction", scale_numbers),
    ],
    ".xml": [
        ("inertial", "mass", scale_numbers),
        ("inertial", "pos", shift_number),
        ("inertial", "fullinertia", scale_one_number),
        ("inertial", "diaginertia", scale_one_number),
        ("inertial", "quat", turn_quaternion),
        ("body", "pos", shift_number),
        ("joint", "range", limits),
        ("joint", "damping", scale_numbers),
        ("joint", "frictionloss", scale_numbers),
        ("joint+", "range", lambda *_: [-0.3, 0.4]),
        ("joint+", "damping", lambda *_: [0.3]),
        ("joint+", "frictionloss", lambda *_: [0.3]),
        ("motor+", "forcerange", lambda *_: [-2.5, 2.5]),
        ("motor", "ctrlrange", lambda _, values: [0.9 * value for value in values]),
    ],
}


def role(text: str, start: int, tag: str) -> str:
    """Return the kind of an element; the kind of an origin contains the kind of its parent.

    The origin of a joint is a ``fixed origin`` or a ``moving origin``.
    """
    if tag != "origin":
        return {"general": "motor"}.get(tag, tag)
    before = text[:start]
    around = max(("inertial", "visual", "collision", "joint"), key=lambda t: before.rfind(f"<{t}"))
    if around == "joint":
        joint = before[before.rfind("<joint") :]
        return "fixed origin" if 'type="fixed"' in joint else "moving origin"
    return f"{around} origin"


def is_free(found: dict[str, str], tag: str) -> bool:
    return tag == "body" and found.get("name") in ("base_link", "base")


def mutate_attribute(pair: Pair, choose: random.Random) -> Mutated | None:
    """Change or add a random attribute in a file; return None if the change is impossible.

    For example, no element of the file has the drawn attribute, or all numbers are 0.
    """
    texts = pair.texts()
    file = choose.choice(list(texts) if choose.random() < 0.6 else [pair.urdf])
    kind, attribute, change = choose.choice(KINDS[file.suffix])
    inserts, kind = kind.endswith("+"), kind.removesuffix("+")
    text = texts[file]
    places = []
    for found in TAG.finditer(text):
        stated = attributes(found[2])
        own = role(text, found.start(), found[1]) == kind and not is_free(stated, found[1])
        in_class = found.start() < text.rfind("</default>") and file.suffix == ".xml"
        free = stated.get("type") == "free"
        fits = (attribute in stated) != inserts and bool(stated)
        if own and fits and not in_class and not free:
            places.append(found)
    if not places:
        return None
    place = choose.choice(places)
    stated = attributes(place[2])
    if inserts:
        words = " ".join(repr(value) for value in change(choose, []))
        at = place.end(2)
        return Mutated(file, f'{text[:at]} {attribute}="{words}"{text[at:]}')
    values = [float(word) for word in stated[attribute].split()]
    if not any(values) and change in (scale_numbers, scale_one_number):
        return None
    words = " ".join(repr(value) for value in change(choose, values))
    span = re.compile(rf'\s{attribute}="([^"]*)"').search(text, place.start(2))
    assert span is not None
    return Mutated(file, text[: span.start(1)] + words + text[span.end(1) :])


def changed_attributes(before: str, after: str) -> int:
    """Return the number of attributes that differ; all other bytes must be equal."""
    spans = [list(ATTRIBUTE.finditer(text)) for text in (before, after)]
    assert len(spans[0]) == len(spans[1])
    blank = [ATTRIBUTE.sub(lambda found: f"{found[1]}=", text) for text in (before, after)]
    assert blank[0] == blank[1]
    return sum(first[2] != second[2] for first, second in zip(*spans, strict=True))


def restore_by_sync(pair: Pair, seed: int) -> str | None:
    """Mutate a file, restore the file by `sync`, and return file suffix and restored attribute.

    None if there is no mutation, if MuJoCo refuses the mutated file, or if `sync` finds no
    difference.
    """
    choose = random.Random(seed)
    mutation = mutate_attribute(pair, choose)
    if mutation is None:
        return None
    good = pair.texts()
    try:
        mutation.file.write_bytes(mutation.text.encode())
        try:
            mujoco.MjModel.from_xml_path(str(pair.mjcf))
        except ValueError:
            return None  # MuJoCo refuses the value
        side = "mjcf" if mutation.file == pair.urdf else "urdf"
        sync = pa.sync_models(pair.urdf, pair.mjcf, take=side)
        after = pair.texts()
        if not sync.differences:
            assert after[mutation.file] == mutation.text
            return None  # without effect, for example a rotation of a sphere
        description = f"{seed}: {mutation.file.name}: {sync.to_json()}"
        assert sync.agree, description
        assert not sync.not_mended
        assert sync.written == (str(mutation.file),), description
        count = changed_attributes(mutation.text, after[mutation.file])
        assert count == len(sync.edits) == 1, description
        assert all(after[file] == good[file] for file in good if file != mutation.file)
        return f"{mutation.file.suffix} {sync.edits[0].attribute}"
    finally:
        for file, text in good.items():
            file.write_bytes(text.encode())


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_a_few_mutations_are_undone(model: str, folder: Path) -> None:
    pair = write_model(model, folder / model)
    done = [restore_by_sync(pair, seed) for seed in range(6)]
    assert sum(description is not None for description in done) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("model", LAYOUTS)
def test_many_mutations_are_undone(model: str, folder: Path) -> None:
    pair = write_model(model, folder / model)
    done: list[str] = []
    seed = 1000 * MODELS.index(model)  # different choices for each model
    while len(done) < MUTATION_COUNT:
        seed += 1
        found = restore_by_sync(pair, seed)
        done += [found] if found is not None else []
    assert len(set(done)) >= 8  # several kinds of attributes, in both files
