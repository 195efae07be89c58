"""The picture of the architecture is that of the code: its folders, their floors and the arrows."""

from __future__ import annotations

import graphlib
from types import ModuleType

import pytest

from tests.support.repository import script


@pytest.fixture
def drawing() -> ModuleType:
    return script("docs/draw_architecture.py")


def test_committed_picture_is_current(drawing: ModuleType) -> None:
    assert drawing.embedded() == drawing.facts(drawing.folder_graph(), drawing.tool_graph()), (
        "draw it again: python docs/draw_architecture.py"
    )


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
