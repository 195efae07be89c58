"""The picture of the architecture is that of the code: its rooms, their floors and the arrows."""

from __future__ import annotations

import graphlib
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.repository import script
from tests.support.rooms import FLOOR


@pytest.fixture
def drawing() -> ModuleType:
    return script("docs/draw_architecture.py")


def test_committed_picture_is_current(drawing: ModuleType) -> None:
    assert drawing.embedded() == drawing.facts(drawing.room_graph()), (
        "draw it again: python docs/draw_architecture.py"
    )


def test_rooms_are_those_of_the_layers_and_no_arrow_points_up(drawing: ModuleType) -> None:
    graph = drawing.room_graph()
    tops = {room for room, floor in FLOOR.items() if floor == 0}
    assert set(graph) - {drawing.SHARED} == set(FLOOR) - tops
    assert set(drawing.purpose(drawing.SHARED).split(", ")) == tops
    assert not graph.pop(drawing.SHARED)
    for room, below in graph.items():
        assert drawing.SHARED in below, f"the legend says that {room} imports the package's top"
        for other in set(below) - {drawing.SHARED}:
            assert FLOOR[other] < FLOOR[room], f"{room} imports {other}"


def write_package(folder: Path, modules: dict[str, str]) -> None:
    for name, text in modules.items():
        path = folder / "pack" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


MODULES = {
    "__init__.py": "from pack.high import a",
    "errors.py": "",
    "low/__init__.py": '"""The low one.\n\nMore."""',
    "low/a.py": "from pack.errors import E\nfrom pack.low import b",
    "low/b.py": "import json",
    "high/__init__.py": '"""The high one."""',
    "high/a.py": "from pack.low.a import f, g\nfrom pack.low.a import h\nimport pack.low.b",
    "high/b.py": "def later():\n    from pack import low, errors",
}


def test_imports_are_counted(
    drawing: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES)
    monkeypatch.setattr(drawing, "PACKAGE", tmp_path / "pack")
    graph = drawing.room_graph()
    # Of high: a.py imports two modules of low, b.py the room itself, within a function.
    assert graph == {"shared": {}, "low": {"shared": 1}, "high": {"low": 3, "shared": 1}}
    assert drawing.facts(graph) == {
        "floors": {"shared": 0, "low": 1, "high": 2},
        "arrows": {"shared": [], "low": ["shared"], "high": ["low", "shared"]},
        "purposes": {"shared": "errors", "low": "The low one", "high": "The high one"},
    }
    assert drawing.needed(graph, "high", "low")
    assert not drawing.needed(graph, "high", "shared")


def test_what_is_drawn_is_embedded(
    drawing: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES | {"low/__init__.py": '"""A & B: "low" < high."""'})
    monkeypatch.setattr(drawing, "PACKAGE", tmp_path / "pack")
    monkeypatch.setattr(drawing, "PICTURE", tmp_path / "picture.svg")
    graph = drawing.room_graph()
    drawing.draw(graph, drawing.PICTURE)
    assert drawing.embedded() == drawing.facts(graph)
    first = drawing.PICTURE.read_bytes()
    drawing.draw(graph, drawing.PICTURE)
    assert drawing.PICTURE.read_bytes() == first


def test_rooms_that_import_each_other_are_refused(
    drawing: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES | {"low/b.py": "from pack.high.a import f"})
    monkeypatch.setattr(drawing, "PACKAGE", tmp_path / "pack")
    with pytest.raises(graphlib.CycleError):
        drawing.floors(drawing.room_graph())
