"""The picture of the architecture is that of the code: its folders, their floors and the arrows."""

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
    assert drawing.embedded() == drawing.facts(drawing.folder_graph(), drawing.tool_graph()), (
        "draw it again: python docs/draw_architecture.py"
    )


def test_folders_are_those_of_the_layers_and_no_arrow_points_up(drawing: ModuleType) -> None:
    graph = drawing.folder_graph()
    assert set(graph) == set(FLOOR)
    for folder, below in graph.items():
        for other in below:
            assert FLOOR[other] < FLOOR[folder], f"{folder} imports {other}"


def test_the_house_has_few_folders_and_arrows(drawing: ModuleType) -> None:
    graph = drawing.folder_graph()
    assert len(graph) <= 11
    assert sum(map(len, graph.values())) <= 70
    loose = {path.name for path in drawing.PACKAGE.glob("*.py")}
    assert loose == {"__init__.py", "__main__.py"}


def test_tools_know_each_other_at_few_places_and_in_no_circle(drawing: ModuleType) -> None:
    graph = drawing.tool_graph()
    assert sum(map(len, graph.values())) <= 12
    graphlib.TopologicalSorter(graph).prepare()


def write_package(folder: Path, modules: dict[str, str]) -> None:
    for name, text in modules.items():
        path = folder / "pack" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


MODULES = {
    "__init__.py": "from pack.high import a",
    "base/__init__.py": '"""The ground. More."""',
    "base/errors.py": "",
    "low/__init__.py": '"""The low one.\n\nMore."""',
    "low/a.py": "from pack.base.errors import E\nfrom pack.low import b",
    "low/b.py": "import json",
    "high/__init__.py": '"""The high one."""',
    "high/a.py": "from pack.low.a import f, g\nfrom pack.low.a import h\nimport pack.low.b",
    "high/b.py": "def later():\n    from pack import low, base",
}
TOOLS = {
    "tools/__init__.py": '"""Tools."""',
    "tools/one/__init__.py": "from pack.high.a import f",
    "tools/two/__init__.py": "",
    "tools/two/a.py": "from pack.tools.one import f\nfrom pack.tools.two import b",
}


def test_imports_are_counted(
    drawing: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES | TOOLS)
    monkeypatch.setattr(drawing, "PACKAGE", tmp_path / "pack")
    graph, tools = drawing.folder_graph(), drawing.tool_graph()
    # Of high: a.py imports two modules of low, b.py the folder itself, within a function.
    assert graph == {
        "base": {},
        "low": {"base": 1},
        "high": {"low": 3, "base": 1},
        "tools": {"high": 1},
    }
    assert drawing.facts(graph, tools) == {
        "floors": ["base", "low", "high", "tools"],
        "arrows": {
            "base": {},
            "low": {"base": 1},
            "high": {"base": 1, "low": 3},
            "tools": {"high": 1},
        },
        "purposes": {
            "base": "The ground",
            "low": "The low one",
            "high": "The high one",
            "tools": "Tools",
        },
        "tools": {"one": [], "two": ["one"]},
    }


def test_what_is_drawn_is_embedded(
    drawing: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES | TOOLS | {"low/__init__.py": '"""A & B: "low" < high."""'})
    monkeypatch.setattr(drawing, "PACKAGE", tmp_path / "pack")
    monkeypatch.setattr(drawing, "PICTURE", tmp_path / "picture.svg")
    graph, tools = drawing.folder_graph(), drawing.tool_graph()
    drawing.draw(graph, tools, drawing.PICTURE)
    assert drawing.embedded() == drawing.facts(graph, tools)
    first = drawing.PICTURE.read_bytes()
    drawing.draw(graph, tools, drawing.PICTURE)
    assert drawing.PICTURE.read_bytes() == first


def test_folders_that_import_each_other_are_refused(
    drawing: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, MODULES | {"low/b.py": "from pack.high.a import f"})
    monkeypatch.setattr(drawing, "PACKAGE", tmp_path / "pack")
    with pytest.raises(graphlib.CycleError):
        drawing.floors(drawing.folder_graph())
