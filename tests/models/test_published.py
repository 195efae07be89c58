"""Models of robot_descriptions and of xacro files; stubs replace both packages."""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator
from pathlib import Path

import mujoco
import pytest

from pupper_analysis import (
    audit_model,
    compare_models,
    convert_model,
    diff_models,
    load_robot,
)
from pupper_analysis.base.errors import (
    ConfigurationError,
    ModelError,
    OutputError,
    UnknownNameError,
    VariantError,
)
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.places import Place
from pupper_analysis.models.published import (
    find_file,
    is_published_name,
    list_similar_published_names,
)
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.pupper.variant_files import parse_robot_word

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
def descriptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Write a package ``robot_descriptions`` with one description and an empty cache."""
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
    yield tmp_path / "cache"
    for module in [name for name in sys.modules if name.startswith("robot_descriptions")]:
        del sys.modules[module]  # before monkeypatch restores the modules


def test_description_is_read_only_from_its_cache(descriptions: Path) -> None:
    """The package's own function would download; it is called neither for an empty cache nor for a
    full one.
    """
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


def test_description_without_prefix_is_found_unless_a_file_has_its_name(
    descriptions: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModelError, match="python -m robot_descriptions pull rex_description"):
        find_file("rex_description")
    file = descriptions / "zoo" / "rex" / "rex.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(URDF)
    assert find_file("rex_description") == file
    assert parse_robot_word("rex_description") == ("rex_description",)
    (tmp_path / "rex_description").write_text(URDF)
    assert find_file("rex_description") == Path("rex_description")


@pytest.mark.parametrize(
    ("word", "names"),
    [
        ("rex_descripton", ["rex_description"]),
        ("rexx_description", ["rex_description"]),
        ("unitree_g02", ["unitree_go2"]),
        ("go2", ["unitree_go2"]),
        ("mujoco_menagerie/unitree_g02", ["unitree_go2"]),
        ("nobody", []),
        ("robot", []),
        ("hand", []),
        ("robot_arm", []),
        ("v4", []),
    ],
)
def test_error_about_a_name_proposes_similar_published_names(
    word: str, names: list[str], descriptions: Path
) -> None:
    """Best first; nothing is downloaded."""
    assert not descriptions.exists()
    assert list_similar_published_names(word)[:1] == names
    with pytest.raises((ModelError, VariantError, UnknownNameError), match="|".join(names) or "v3"):
        load_robot(word)
    assert not descriptions.exists()


@pytest.mark.parametrize("place", ["given", "above", "inside", "ros", "ament"])
def test_file_of_ros_package_is_found(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ROS is not installed. The package is found by option, in parent folders, and in ROS paths."""
    top = {"ament": tmp_path / "install" / "share"}.get(place, tmp_path / "src")
    file = top / "rex" / "urdf" / "rex.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(URDF)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    folders = {"above": file.parent, "inside": top}
    monkeypatch.chdir(folders.get(place, elsewhere))
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(variable, raising=False)
    if place == "ros":
        monkeypatch.setenv("ROS_PACKAGE_PATH", f"{elsewhere}:{top}")
    if place == "ament":
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    packages = {"rex": top / "rex"} if place == "given" else None
    word = "package://rex/urdf/rex.urdf"
    assert find_file(word, packages).samefile(file)
    assert find_file(Path(word), packages).samefile(file)  # with a single slash
    assert read_model(word, packages).path.samefile(file)
    assert parse_robot_word(word) == (word,)


@pytest.mark.parametrize(
    "model", ["https://x.org/a.urdf", Path("http://x.org/a.xml"), "HTTPS://x.org/a.usd"]
)
def test_web_address_is_refused(model: str | Path) -> None:
    with pytest.raises(
        ModelError, match=r"(?i:https?)://x\.org/a.*: web addresses are not downloaded"
    ):
        load_robot(model)


def test_missing_ros_package_names_the_option(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"no ROS package rex .*--package rex=FOLDER"):
        find_file("package://rex/rex.urdf")
    with pytest.raises(ModelError, match=r"has no file 'rex\.urdf'"):
        find_file("package://rex/rex.urdf", {"rex": tmp_path})
    for incomplete in ("rex", "rex/", "", "/rex.urdf"):
        for path in (f"package://{incomplete}", Path(f"package://{incomplete}")):
            if path != Path("package:/rex.urdf"):  # the same path as that of the package rex.urdf
                with pytest.raises(ModelError, match="incomplete path"):
                    find_file(path, {"rex": tmp_path, "rex.urdf": tmp_path})


@pytest.mark.usefixtures("descriptions")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("t_description", "has no description 't_description'"),
        ("../rex", "has no description"),
        ("bare_description", "has neither a URDF nor an MJCF"),
    ],
)
def test_unknown_descriptions_are_refused(name: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        find_file(f"robot_descriptions:{name}")


def test_word_longer_than_a_file_name_is_no_path() -> None:
    """The operating system refuses to look for a file with such a name."""
    assert is_published_name("a" * 300 + "_description")


def test_error_names_the_package_if_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    monkeypatch.setitem(sys.modules, "robot_descriptions._cache", None)
    for name, similar in (
        ("robot_descriptions:rex_description", ""),
        ("go2_mj_description", "go2"),
    ):
        with pytest.raises(ModelError, match=f"{similar}.*pip install robot_descriptions"):
            find_file(name)
    with pytest.raises(VariantError, match=r"robot_descriptions.*pip install robot_descriptions"):
        load_robot("nobody")
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(VariantError, match="pip install mujoco-menagerie"):
        load_robot("unitree_go2")


@pytest.mark.parametrize(
    ("file", "text", "cause"),
    [
        ("_cache", "raise ImportError('Bad git executable')", "ImportError: Bad git executable"),
        ("__init__", "import no_such_module", "No module named 'no_such_module'"),
        ("_repositories", "REPOSITORIES = {}", "KeyError: 'zoo'"),
        ("rex_description", "import no_such_module", "No module named 'no_such_module'"),
        ("rex_description", "1 / 0", "ZeroDivisionError"),
        ("rex_description", "def", "SyntaxError"),
    ],
)
def test_error_names_the_cause_if_the_import_of_descriptions_fails(
    file: str, text: str, cause: str, descriptions: Path
) -> None:
    """The package is installed, so the error states the cause instead of ``pip install``."""
    package = descriptions.parent / "site" / "robot_descriptions"
    (package / f"{file}.py").write_text(text)
    with pytest.raises(ModelError, match=cause) as caught:
        load_robot("rex_description")
    assert "not installed" not in str(caught.value)
    with pytest.raises(VariantError, match="known variants"):
        load_robot("nobody")


class _Expanded:
    def toxml(self) -> str:
        return URDF


def test_xacro_is_expanded_if_it_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stub returns the expansion: its included file counts as read, elements have no line, and
    errors of xacro are reported in one sentence.
    """
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
        read = read_model(file, None, {})
        # The included file counts as an input, so it must not be an output.
        with pytest.raises(OutputError, match="an input of this run"):
            run.register_output(part)
    assert isinstance(read, UrdfFile)
    assert list(read.tree.links) == ["base"]
    # Line numbers of the expanded text belong to no file of the user.
    assert read.place("link", "base") == Place(file)

    def refuse(path: str) -> _Expanded:
        raise NameError(f"{path}: name 'mass' is not defined")

    package.process_file = refuse  # type: ignore[attr-defined]
    with pytest.raises(
        ModelError, match=r"xacro cannot expand the file: .*name 'mass' is not defined"
    ):
        read_model(file, None, {})
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(ModelError, match="pip install xacro"):
        read_model(file, None, {})


ARM = """<?xml version="1.0"?>
<robot name="rex" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:arg name="arm" default="false"/>
  <xacro:include filename="$(find rex_parts)/parts.xacro"/>
  <link name="base"/>
  <xacro:if value="$(arg arm)"><xacro:tool/></xacro:if>
</robot>
"""
PARTS = """<robot xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:macro name="tool"><link name="tool"/>
    <joint name="j" type="revolute"><parent link="base"/><child link="tool"/>
      <limit effort="1" lower="-1" upper="${pi / 2}" velocity="1"/></joint>
  </xacro:macro>
</robot>
"""


def test_packages_and_arguments_of_xacro_are_resolved_without_ros(tmp_path: Path) -> None:
    """The package xacro expands the file; the folder of the ROS package is found by its
    package.xml.
    """
    pytest.importorskip("xacro")
    clone = tmp_path / "rex-main"  # a clone whose folder has another name than the package
    (clone / "urdf").mkdir(parents=True)
    (clone / "package.xml").write_text("<package><name>rex_parts</name></package>")
    (clone / "parts.xacro").write_text(PARTS)
    file = clone / "urdf" / "rex.urdf.xacro"
    file.write_text(ARM)
    with_arm = read_model(file, None, {"arm": "true"})
    assert isinstance(with_arm, UrdfFile)
    assert [*with_arm.tree.links] == ["base", "tool"]
    without = read_model(file, None, {})
    assert isinstance(without, UrdfFile)
    assert [*without.tree.links] == ["base"]
    with pytest.raises(UnknownNameError, match=r"xacro argument 'leg'.*arm"):
        read_model(file, None, {"leg": "true"})
    for model in (tmp_path / "rex.urdf", "v3", URDF):
        with pytest.raises(
            ConfigurationError, match=r"not a xacro file|only to files, not to a variant"
        ):
            load_robot(model, xacro=True, xacro_args={"arm": "true"})


def test_undeclared_argument_of_xacro_is_named_and_accepted(tmp_path: Path) -> None:
    """As in the drivers of AR4: the file uses an argument that it does not declare.

    Reference: xacro itself, which expands the file with this argument.
    """
    xacro = pytest.importorskip("xacro")
    file = tmp_path / "rex.urdf.xacro"
    file.write_text(
        '<robot name="rex" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="base">'
        '<inertial><mass value="$(arg load)"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
        ' iyz="0"/></inertial></link></robot>'
    )
    with pytest.raises(ModelError, match="--xacro-arg load=VALUE"):
        read_model(file, None, {})
    with pytest.raises(UnknownNameError, match=r"xacro argument 'lod'.*load"):
        read_model(file, None, {"lod": "3", "load": "3"})
    expanded = read_model(file, None, {"load": "3"})
    assert isinstance(expanded, UrdfFile)
    mass = expanded.tree.links["base"].element.find("inertial/mass")
    reference = xacro.process_file(str(file), mappings={"load": "3"})
    assert mass.get("value") == reference.getElementsByTagName("mass")[0].getAttribute("value")


def test_missing_package_of_xacro_names_the_option(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    file = tmp_path / "rex.urdf.xacro"
    file.write_text(ARM)
    with pytest.raises(ModelError, match="--package rex_parts=FOLDER") as caught:
        read_model(file, None, {})
    assert "\n" not in str(caught.value)
    assert str(caught.value).count("rex_parts=") == 1  # xacro encloses and repeats the error
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "parts.xacro").write_text(PARTS)
    assert isinstance(read_model(file, {"rex_parts": folder}, {}), UrdfFile)


LEG = """

<?xml version="1.0"?>
<robot xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:macro name="leg" params="mass"><link name="leg"><inertial><mass value="${mass}"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></xacro:macro>
</robot>
"""
LEGGED = """
<?xml version="1.0"?>
<robot name="rex" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:arg name="load" default="1"/>
  <xacro:include filename="leg.xacro"/>
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <xacro:leg mass="${2 * $(arg load) + mark()}"/>
  <joint name="hip" type="revolute"><parent link="base"/><child link="leg"/><axis xyz="1 0 0"/>
    <limit effort="1" lower="-1" upper="1" velocity="1"/></joint>
</robot>
"""


@pytest.fixture
def evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Write ``rex.urdf.xacro`` and return a list that grows if xacro evaluates its expressions.

    Both files of the robot begin with blank lines.
    """
    xacro = pytest.importorskip("xacro")
    calls: list[str] = []
    monkeypatch.setitem(xacro._global_symbols, "mark", lambda: calls.append("evaluated") or 0)
    (tmp_path / "leg.xacro").write_text(LEG)
    (tmp_path / "rex.urdf.xacro").write_text(LEGGED)
    (tmp_path / "rex.urdf").write_text(LEGGED)
    return calls


@pytest.mark.parametrize("name", ["rex.urdf.xacro", "rex.urdf"])
def test_expressions_of_xacro_are_evaluated_only_on_request(
    name: str, evaluated: list[str], tmp_path: Path
) -> None:
    """The stand-in for Python code in a file is called only with ``xacro=True``. Reference: masses
    [kg] of the expression; blank lines in front of the declaration are accepted."""
    file = tmp_path / name
    for read in (
        load_robot,
        audit_model,
        lambda path: convert_model(path, tmp_path / "rex.xml"),
        lambda path: compare_models(path, "v3"),
        lambda path: diff_models(path, path),
    ):
        with pytest.raises(ModelError, match=r"\(in Python: xacro=True\)"):
            read(file)
    with pytest.raises(ConfigurationError, match="require --xacro"):
        load_robot(file, xacro_args={"load": "3"})
    with pytest.raises(ConfigurationError, match=r"xacro_args\[load\]: 3 is not a text"):
        load_robot(file, xacro=True, xacro_args={"load": 3})  # type: ignore[dict-item]
    assert not evaluated
    robot = load_robot(file, feet=[], xacro=True, xacro_args={"load": "3"})
    assert evaluated
    assert robot.total_mass == pytest.approx(1 + 2 * 3)


def test_other_functions_read_the_expanded_xacro(evaluated: list[str], tmp_path: Path) -> None:
    """Reference: the mass [kg] of the expression, read by MuJoCo from the converted MJCF."""
    file, arguments = tmp_path / "rex.urdf.xacro", {"load": "3"}
    converted = tmp_path / "rex.xml"
    convert_model(file, converted, fixed_base=True, xacro=True, xacro_args=arguments)
    mass = mujoco.MjModel.from_xml_path(str(converted)).body("leg").mass
    assert mass == pytest.approx(6)
    assert compare_models(file, converted, xacro=True, xacro_args=arguments).agree
    assert not compare_models(file, converted, xacro=True).agree
    changed = diff_models(file, file, xacro=True, xacro_args=arguments)
    assert changed.same
    audit = audit_model(file, xacro=True, xacro_args=arguments)
    assert audit.findings
    assert {finding.line for finding in audit.findings} == {None}
    assert len(evaluated) >= 5


def test_expression_without_xacro_element_is_not_read_as_a_name(tmp_path: Path) -> None:
    file = tmp_path / "rex.xacro"
    file.write_text('<robot name="rex">\n<link name="${1 + 1}"/></robot>')
    with pytest.raises(ModelError, match=r"rex.xacro:2: the file is a xacro file"):
        read_model(file)
    # xacro expands $$ to a dollar sign: the expanded text may contain such texts.
    file.write_text('<robot name="rex"><link name="base"/><gazebo>$${later}</gazebo></robot>')
    pytest.importorskip("xacro")
    assert "${later}" in read_model(file, None, {}).text  # type: ignore[union-attr]


def test_xacro_without_expressions_is_read_as_a_urdf(tmp_path: Path) -> None:
    """Nothing is evaluated, so no consent is necessary; blank lines are accepted as in a URDF."""
    file = tmp_path / "rex.xacro"
    file.write_text('\n<?xml version="1.0"?>\n' + URDF)
    read = read_model(file)
    assert isinstance(read, UrdfFile)
    assert [*read.tree.links] == ["base"]
