"""Models by a description's name, and as xacro: both packages are stand-ins here."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ModelError, OutputError
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.places import Place
from pupper_analysis.models.published import find_file
from pupper_analysis.models.urdf_file import UrdfFile

DESCRIPTION = """
from os import path
from ._cache import clone_to_cache
REPOSITORY_PATH = clone_to_cache("zoo", commit=None)
URDF_PATH = path.join(REPOSITORY_PATH, "rex", "rex.urdf")
"""
REPOSITORIES = """
class Repository:
    cache_path = "zoo"
REPOSITORIES = {"zoo": Repository}
"""
CACHE = """
def clone_to_cache(name, commit=None):
    raise AssertionError("nothing is downloaded")
"""
URDF = '<robot name="rex"><link name="base"/></robot>'


@pytest.fixture
def descriptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of one description, and its cache, which is empty."""
    package = tmp_path / "site" / "robot_descriptions"
    package.mkdir(parents=True)
    for name, text in (
        ("__init__", ""),
        ("_cache", CACHE),
        ("_repositories", REPOSITORIES),
        ("rex_description", DESCRIPTION),
        ("bare_description", ""),
    ):
        (package / f"{name}.py").write_text(text)
    for module in [name for name in sys.modules if name.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_description_is_read_only_from_its_cache(descriptions: Path) -> None:
    with pytest.raises(ModelError, match="python -m robot_descriptions pull rex_description"):
        find_file("robot_descriptions:rex_description")
    file = descriptions / "zoo" / "rex" / "rex.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(URDF)
    assert find_file("robot_descriptions:rex_description") == file
    assert read_model("robot_descriptions:rex_description").path == file
    cache = sys.modules["robot_descriptions._cache"]
    with pytest.raises(AssertionError, match="nothing is downloaded"):
        cache.clone_to_cache("zoo")  # the package is left as it was


@pytest.mark.usefixtures("descriptions")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("t_description", "has no description 't_description'"),
        ("../rex", "has no description"),
        ("bare_description", "has neither a URDF nor an MJCF"),
    ],
)
def test_other_names_are_refused(name: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        find_file(f"robot_descriptions:{name}")


def test_error_names_the_package_if_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    monkeypatch.setitem(sys.modules, "robot_descriptions._cache", None)
    with pytest.raises(ModelError, match="pip install robot_descriptions"):
        find_file("robot_descriptions:rex_description")


class _Expanded:
    def toxml(self) -> str:
        return URDF


def test_xacro_is_expanded_if_it_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "rex.urdf.xacro"
    file.write_text('<robot name="rex" xmlns:xacro="http://ros.org/wiki/xacro"/>')
    package = types.ModuleType("xacro")
    part = tmp_path / "leg.xacro"
    part.write_text("<robot/>")
    package.all_includes = ["another.xacro"]  # type: ignore[attr-defined]

    def expand(path: str) -> _Expanded:
        assert path == str(file)
        package.all_includes.append(str(part))
        return _Expanded()

    package.process_file = expand  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "xacro", package)
    with ensure_run() as run:
        read = read_model(file)
        # What it includes is read as well, and never written over.
        with pytest.raises(OutputError, match="which this run reads"):
            run.expect(part)
    assert isinstance(read, UrdfFile)
    assert list(read.tree.links) == ["base"]
    # The lines are those of no file that anyone has.
    assert read.place("link", "base") == Place(file)

    def refuse(path: str) -> _Expanded:
        raise NameError(f"{path}: name 'mass' is not defined")

    package.process_file = refuse  # type: ignore[attr-defined]
    with pytest.raises(ModelError, match=r"xacro cannot expand it: .*name 'mass' is not defined"):
        read_model(file)
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(ModelError, match="or install xacro"):
        read_model(file)
