"""The picture of the architecture is that of the code: its rooms, their floors and the arrows."""

from __future__ import annotations

import graphlib
import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from conftest import ROOT
from test_layers import FLOOR


@pytest.fixture
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "draw_architecture", ROOT / "docs" / "draw_architecture.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_committed_picture_is_current(script: ModuleType) -> None:
    assert script.embedded() == script.facts(script.room_graph()), (
        "draw it again: python docs/draw_architecture.py"
    )


@pytest.mark.slow
def test_rooms_are_those_of_the_layers_and_no_arrow_points_up(script: ModuleType) -> None:
    graph = script.room_graph()
    tops = {room for room, floor in FLOOR.items() if floor == 0}
    assert set(graph) - {script.SHARED} == set(FLOOR) - tops
    assert set(script.purpose(script.SHARED).split(", ")) == tops
    assert not graph.pop(script.SHARED)
    for room, below in graph.items():
        assert script.SHARED in below, f"the legend says that {room} imports the package's top"
        for other in set(below) - {script.SHARED}:
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
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES)
    monkeypatch.setattr(script, "PACKAGE", tmp_path / "pack")
    graph = script.room_graph()
    # Of high: a.py imports two modules of low, b.py the room itself, within a function.
    assert graph == {"shared": {}, "low": {"shared": 1}, "high": {"low": 3, "shared": 1}}
    assert script.facts(graph) == {
        "floors": {"shared": 0, "low": 1, "high": 2},
        "arrows": {"shared": [], "low": ["shared"], "high": ["low", "shared"]},
        "purposes": {"shared": "errors", "low": "The low one", "high": "The high one"},
    }
    assert script.needed(graph, "high", "low")
    assert not script.needed(graph, "high", "shared")


def test_what_is_drawn_is_embedded(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES | {"low/__init__.py": '"""A & B: "low" < high."""'})
    monkeypatch.setattr(script, "PACKAGE", tmp_path / "pack")
    monkeypatch.setattr(script, "PICTURE", tmp_path / "picture.svg")
    graph = script.room_graph()
    script.draw(graph, script.PICTURE)
    assert script.embedded() == script.facts(graph)
    first = script.PICTURE.read_bytes()
    script.draw(graph, script.PICTURE)
    assert script.PICTURE.read_bytes() == first


def test_rooms_that_import_each_other_are_refused(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES | {"low/b.py": "from pack.high.a import f"})
    monkeypatch.setattr(script, "PACKAGE", tmp_path / "pack")
    with pytest.raises(graphlib.CycleError):
        script.floors(script.room_graph())
