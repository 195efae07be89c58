"""Robots of MuJoCo Menagerie by name: in a clone, and in the cache of the installed package."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.published import find_file, is_published_name
from pupper_analysis.pupper.variant_files import parse_robot_words
from tests.support.repository import ROOT

SOURCE = ROOT / "mjcf" / "pupper_v3.xml"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Current folder without a clone, and an empty cache of the package."""
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "cache"))
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def make_clone(folder: Path) -> Path:
    """Write a clone with the robot unitree_go2, whose file is a copy of v3's, and a scene."""
    robot = folder / "unitree_go2"
    shutil.copytree(SOURCE.parent, robot)
    (robot / SOURCE.name).rename(robot / "go2.xml")
    (robot / "scene.xml").write_text('<mujoco><include file="go2.xml"/></mujoco>')
    return robot


@pytest.mark.parametrize("name", ["unitree_go2", "mujoco_menagerie/unitree_go2"])
def test_robot_of_a_clone_above_is_found_by_name_without_the_package(
    here: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    robot = make_clone(here / "mujoco_menagerie")
    (here / "mine").mkdir()
    monkeypatch.chdir(here / "mine")
    assert find_file(name) == robot / "go2.xml"
    assert find_file(f"{name}/scene.xml") == robot / "scene.xml"
    assert parse_robot_words([name]) == [(name,)]


def test_robot_is_read_from_the_cache_of_the_package(here: Path) -> None:
    """Reference: the folder of the package's own cache; nothing is downloaded."""
    menagerie = pytest.importorskip("mujoco_menagerie")
    with pytest.raises(ModelError, match="python -m mujoco_menagerie prefetch unitree_go2"):
        find_file("unitree_go2/go2.xml")
    folder = menagerie.Cache().model_path(menagerie.get("unitree_go2"))
    make_clone(folder.parent)
    (folder.parent / "unitree_go2").rename(folder)
    (folder / ".complete").write_text("{}")
    for name in ("unitree_go2", "unitree_go2/go2.xml", "mujoco_menagerie/unitree_go2"):
        assert find_file(name) == folder / "go2.xml"
    with pytest.raises(ModelError, match=r"no such file; valid: .*go2\.xml"):
        find_file("unitree_go2/go3.xml")
    with pytest.raises(UnknownNameError, match="unitree_go2"):
        find_file("mujoco_menagerie/unitree_go3")
    assert pa.load_robot("unitree_go2").nv == 18


def test_robot_of_menagerie_root_has_priority(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = make_clone(here / "clone")
    monkeypatch.setenv("MENAGERIE_ROOT", str(here / "clone"))
    assert find_file("unitree_go2/go2.xml") == robot / "go2.xml"


@pytest.mark.usefixtures("here")
def test_missing_package_is_named_with_the_way_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(ModelError, match="pip install mujoco-menagerie") as caught:
        find_file("mujoco_menagerie/unitree_go2")
    assert "\n" not in str(caught.value)
    assert not is_published_name("unitree_go2")  # an ordinary word


def test_existing_files_and_other_words_are_no_names(here: Path) -> None:
    (here / "unitree_go2").mkdir()
    (here / "unitree_go2" / "go2.xml").write_text("<mujoco/>")
    assert not is_published_name("unitree_go2/go2.xml")
    for word in ("v3", "robot.urdf", "models/robot.xml", "my_robot/robot.xml", "a/b/c/d.xml"):
        assert not is_published_name(word)
