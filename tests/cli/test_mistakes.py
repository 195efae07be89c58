"""Typing mistakes: each is refused in one line with the correct input."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pupper_analysis.cli import shared
from pupper_analysis.cli.stance_fields import parse_contact
from pupper_analysis.present.document import MAX_ANSWER_WIDTH
from tests.support import arm
from tests.support.commands import answer
from tests.support.repository import ROOT


def run_refused(*arguments: str, folder: Path | None = None) -> str:
    """Run a command that must fail with one line on standard error, and return the line.

    The next command may follow in a second line, which is not returned.
    """
    result = answer(*arguments, folder=folder)
    assert result.returncode == 2
    assert result.stdout == ""
    error, *steps = result.stderr.splitlines(keepends=True)
    assert [step.partition(":")[0] for step in steps] in ([], ["  next"])
    return error


@pytest.mark.parametrize(
    ("typed", "suggested"),
    [("stnad", "Did you mean stand"), ("crosschek", "Did you mean crosscheck?"), ("hodl", "hold")],
)
def test_error_of_a_misspelt_command_lists_similar_commands(typed: str, suggested: str) -> None:
    assert suggested in run_refused(typed, "v3")
    assert "Did you mean" not in run_refused("xyzzy", "v3")


@pytest.mark.parametrize(
    "arguments",
    [
        ("--height", "120"),
        ("--height=120",),
        ("--offset", "0,120"),
        ("--payload-at", "0,0,120", "--payload", "1kg"),
        ("--swing", "FL=120"),
        ("--contact", "FL=table:120"),
        ("--contact", "FL=plane:0,0,120,0,0,1"),
        ("--stance", "stance.toml"),
    ],
    ids=" ".join,
)
def test_error_of_a_length_without_unit_suggests_millimetres(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "stance.toml").write_text("height = 120\n")
    message = run_refused("stand", "v3", *arguments, folder=tmp_path)
    assert "write 120mm" in message or "write 120.0mm" in message


@pytest.mark.parametrize(("command", "option"), [("gains", "--delay"), ("stand", "--timestep")])
def test_error_of_a_time_without_unit_suggests_milliseconds(command: str, option: str) -> None:
    message = run_refused(command, "v3", option, "4")
    assert "4 without a unit is read in seconds and too long; write 4ms" in message


def test_error_of_an_angle_in_degrees_without_unit_suggests_the_option_with_unit() -> None:
    """In Python, the same message suggests ``math.radians(5)`` (tests/base/test_units.py)."""
    message = run_refused("stand", "v3", "--pitch", "5")
    assert "--pitch: 286.479 deg is out of range" in message
    assert "(for degrees write 5deg)" in message


def test_error_of_a_mass_without_unit_suggests_grams() -> None:
    message = run_refused("stand", "v3", "--payload", "500")
    assert "500 without a unit is read in kg and too heavy; write 500g or 500kg" in message


def test_a_direction_may_have_any_length() -> None:
    """Reference: distance of a point at 1 m height from a plane at 45 mm, 0.955 m."""
    for z in ("10", "1"):
        plane = parse_contact("contact", f"plane:0,0,45mm,0,0,{z}", "").plane
        assert plane is not None
        assert plane.signed_distance((0.3, 0.2, 1.0)) == pytest.approx(0.955)


@pytest.mark.parametrize(
    "arguments", [("--height", "12", "cm"), ("--height=12", "cm"), ("--payload", "1.5", "kg")]
)
def test_error_of_a_unit_after_a_blank_suggests_one_word(arguments: tuple[str, ...]) -> None:
    message = run_refused("stand", "v3", *arguments)
    value = arguments[-2].rpartition("=")[2]
    assert f"'{value} {arguments[-1]}' is two words" in message
    assert f"write the unit directly behind the number: {value}{arguments[-1]}" in message


@pytest.mark.parametrize(
    ("option", "name", "suffix"),
    [
        ("--report", "x.pdf", ".html"),
        ("--report", "x.PDF", ".html"),
        ("--json", "x.html", ".json"),
        ("--csv", "x.xlsx", ".csv"),
        ("--figure", "x.svg", ".png"),
        ("--figure", "x.foo", ".png"),
        ("--report", "x.txt", ".html"),
        ("--json", "x.csv", ".json"),
    ],
)
def test_a_result_is_not_written_under_another_formats_suffix(
    option: str, name: str, suffix: str, tmp_path: Path
) -> None:
    message = run_refused("stand", "v3", option, name, folder=tmp_path)
    assert f"{option}: {name}: " in message
    assert f"valid endings: {suffix}" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "suggested"),
    [
        (("audit", "v3x"), "did you mean v3?"),
        (("crosscheck", "V3-heavi"), "did you mean v3-heavy"),
        (("stand", "v3-longleg"), "did you mean v3-long-leg"),
        (("stand", "robot.udrf"), "did you mean robot.urdf?"),
        (("stand", "v3-heavy.urdf"), "did you mean v3-heavy?"),
        (("stand", "zebra.urdf"), "zebra.urdf: there is no such file\n"),
        (
            ("fit", "v3", "--plan", "3", "--prior", "mass", "20%"),
            "write one word without blanks: --prior mass=20%",
        ),
        (("stand", "v4"), "'v4' is not valid; did you mean v3?"),
        (("crosscheck", "V4-heavy"), "did you mean v3-heavy or"),
        (("stand", "robot"), "'robot' is not valid; did you mean robot.urdf?"),
        (("diff", "v3", "nobody"), "'nobody' is not valid; known: original, long-leg"),
        (("stand", "package://"), "incomplete path: write package://NAME/FILE"),
        (("stand", "package:///x"), "incomplete path: write package://NAME/FILE"),
        (("convert", "package:", "-o", "x.xml"), "incomplete path: write package://NAME"),
        (("audit", "rex.xacro"), "rex.xacro:2: the file is a xacro file; give the expanded URDF"),
        (("stand", "go2.sdf"), "SDF is not supported: give a URDF or an MJCF of the robot"),
        (("audit", "go2.sdf"), "SDF is not supported: give a URDF or an MJCF of the robot"),
        (("stand", "go2.srdf"), "go2.srdf: the file is an SRDF, which only adds groups"),
        (("stand", "folder"), "the path is a folder; give the path of a file"),
        (("stand", "deploy.yaml"), "the file does not begin with <"),
    ],
    ids=str,
)
def test_error_of_a_wrong_robot_names_the_nearest(
    arguments: tuple[str, ...], suggested: str, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "urdf" / "pupper_v3.urdf", tmp_path / "robot.urdf")
    (tmp_path / "folder").mkdir()
    (tmp_path / "deploy.yaml").write_text("kp: 5\n")
    xacro = '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">\n<xacro:leg/></robot>'
    (tmp_path / "rex.xacro").write_text(xacro)
    (tmp_path / "go2.sdf").write_text('<sdf version="1.9"><model name="go2"/></sdf>')
    (tmp_path / "go2.sdf").write_text('<sdf version="1.9"><model name="go2"/></sdf>')
    (tmp_path / "go2.srdf").write_text('<robot name="go2"><group name="legs"/></robot>')
    assert suggested in run_refused(*arguments, folder=tmp_path)


@pytest.mark.parametrize(
    ("typed", "proposed", "fixed"),
    [
        ("stand go2", "stand unitree_go2", False),
        ("audit GO2 --fix", "audit unitree_go2 --fix", False),
        ("best payload go2 --kp 50", "best payload unitree_go2 --kp 50", False),
        ("stand unitree_go2", "stand unitree_go2", False),
        ("diff v3 mujoco_menagerie/unitree_go2", "diff v3 mujoco_menagerie/unitree_go2", False),
        ("contract go2", "contract unitree_go2", False),
        ("crosscheck go2", "audit unitree_go2", False),
        ("sync unitree_go2", "audit unitree_go2", False),
        ("hold panda", "hold franka_emika_panda", False),
        ("stand panda --payload 1kg", "hold franka_emika_panda --payload 1kg", True),
        ("gains ur5e", "gains universal_robots_ur5e --contact base=weld", True),
        ("workspace franka_emika_panda", "hold franka_emika_panda", True),
        ("hold unitree_z2", "hold unitree_z1", False),
        ("stand unitree_z2", "hold unitree_z1", True),
        ("stand unitree_g02", "stand unitree_go2", False),
    ],
)
def test_error_of_a_robot_that_is_not_downloaded_proposes_download_and_command(
    typed: str, proposed: str, fixed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the command line of the package, and the categories of its robots.

    The error proposed a name, and the same command with this name was refused.
    """
    pytest.importorskip("mujoco_menagerie")
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "cache"))
    result = answer(*typed.split(), folder=tmp_path)
    error, step = result.stderr.splitlines()
    [robot] = (word for word in proposed.split() if "_" in word and word != "base=weld")
    robot = robot.removeprefix("mujoco_menagerie/")
    assert result.returncode == 2
    assert len(error) <= MAX_ANSWER_WIDTH
    assert "not downloaded" in error
    assert ("its base is fixed" in error) == fixed
    assert step == (
        f"  next: python -m mujoco_menagerie prefetch {robot} && pupper-analysis {proposed}"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("diff", "a.urdf"), "argument NEW is missing: the new version, of the same format"),
        (("crosscheck",), "argument URDF is missing: a URDF, or the name of a variant such as v3"),
        (("study",), "argument FILE is missing: a TOML file that describes the study"),
        (("study", "none.toml"), "none.toml: there is no such file"),
        (("study", "v3", "-o", "out"), 'write robot = "v3" into the file'),
        (("crosscheck", "a.urdf", "a.urdf"), "both files are URDFs; one URDF and one MJCF"),
        (("stand", "v3", "--height"), " stand --help)"),
    ],
    ids=str,
)
def test_error_of_a_wrong_argument_states_the_expected_argument(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "urdf" / "pupper_v3.urdf", tmp_path / "a.urdf")
    assert message in run_refused(*arguments, folder=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message", "command"),
    [
        (("sync", "a.urdf"), "argument MJCF is missing: the MJCF to compare and change; usage:",
         "convert a.urdf -o a.xml"),
        (("sync", "a.urdf", "missing.xml"), "missing.xml: there is no such file",
         "convert a.urdf -o missing.xml"),
        (("crosscheck", "a.urdf"), "argument MJCF is missing", "audit a.urdf"),
        (("crosscheck", "a.urdf", "missing.xml"), "missing.xml: there is no such file",
         "audit a.urdf"),
        (("crosscheck", "b.urdf", "--strict"), "argument MJCF is missing",
         "crosscheck b.urdf b.xml --strict"),
    ],
    ids=str,
)  # fmt: skip
def test_error_of_a_missing_second_model_proposes_a_command(
    arguments: tuple[str, ...], message: str, command: str, tmp_path: Path
) -> None:
    for name in ("a.urdf", "b.urdf"):
        shutil.copy(ROOT / "urdf" / "pupper_v3.urdf", tmp_path / name)
    (tmp_path / "b.xml").write_text("<mujoco/>")
    error, step = answer(*arguments, folder=tmp_path).stderr.splitlines()
    assert message in error
    assert step == f"  next: pupper-analysis {command}"


@pytest.mark.parametrize(
    ("arguments", "message", "command"),
    [
        (("diff", "far/one.urdf", "far/arm.urdf"), "one.urdf: no common joint with arm.urdf; diff",
         "audit far/one.urdf"),
        (("diff", "far/arm.xml", "far/arm.urdf"), "arm.urdf: format differs from arm.xml;",
         "crosscheck far/arm.xml far/arm.urdf"),
        (("crosscheck", "far/one.urdf", "far/arm.urdf"),
         "error: one.urdf, arm.urdf: both files are URDFs; one URDF and one MJCF are needed",
         "audit far/one.urdf"),
        (("crosscheck", "far/arm.urdf", "far/one.urdf", "--strict"), "error: arm.urdf, one.urdf: ",
         "crosscheck far/arm.urdf far/arm.xml --strict"),
        (("sync", "far/one.urdf", "far/two.urdf"), "one.urdf, two.urdf: both files are URDFs",
         "diff far/one.urdf far/two.urdf"),
        (("crosscheck", "far/one.urdf", "far/arm.xml"),
         "error: one.urdf: no common joint with arm.xml; for other names of one robot: --map ",
         "audit far/one.urdf"),
    ],
    ids=str,
)  # fmt: skip
def test_error_of_two_robots_or_formats_is_short_and_proposes_a_command(
    arguments: tuple[str, ...], message: str, command: str, tmp_path: Path
) -> None:
    """The errors listed paths and joints in more than 400 characters, without a command."""
    far = tmp_path / "far"
    far.mkdir()
    for name in ("one.urdf", "two.urdf"):
        shutil.copy(ROOT / "urdf" / "pupper_v3.urdf", far / name)
    (far / "arm.urdf").write_text(arm.URDF)
    (far / "arm.xml").write_text(arm.MJCF)
    error, step = answer(*arguments, folder=tmp_path).stderr.splitlines()
    assert message in error
    assert len(error) <= MAX_ANSWER_WIDTH
    assert step == f"  next: pupper-analysis {command}"


def test_error_of_two_missing_models_proposes_no_command(tmp_path: Path) -> None:
    assert "there is no such file" in run_refused("sync", "y.urdf", "z.xml", folder=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--height", "12,5cm"), "write 12.5cm"),
        (("--kp", "5,5"), "kp: '5,5' is not a number; write 5.5"),
        (("--kp", "five"), "kp: 'five' is not a number"),
        (("--swing", "FL=2,5cm"), "write 2.5cm"),
        (("--kp", "5deg"), "kp: '5deg' is not a number (unit: N m/rad)"),
        (("--leg-scale", "1,2"), "'1,2' is not a number; write 1.2"),
        (("--leg-scale", "twice"), "'twice' is not a number (see"),
        (("--swing", "FL"), "'FL' is not of the form FOOT=LENGTH, e.g. FR=30mm"),
    ],
    ids=str,
)
def test_error_of_a_wrong_value_shows_a_valid_one(arguments: tuple[str, ...], message: str) -> None:
    assert message in run_refused("stand", "v3", *arguments)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["crosscheck", "sync"])
def test_the_order_of_a_urdf_and_an_mjcf_does_not_matter(command: str, tmp_path: Path) -> None:
    """The output is equal to the last character."""
    files = [str(ROOT / "urdf" / "pupper_v3.urdf"), str(ROOT / "mjcf" / "pupper_v3.xml")]
    shutil.copy(files[0], tmp_path / "robot.xml")  # the root element counts, not the suffix
    expected = answer(command, *files)
    assert expected.returncode == 0
    assert answer(command, *reversed(files)) == expected
    swapped = answer(command, files[1], "robot.xml", folder=tmp_path)
    assert swapped.returncode == 0
    renamed = expected.stdout.replace(files[0], "robot.xml").replace("pupper_v3.urdf", "robot.xml")
    assert swapped.stdout == renamed


@pytest.mark.parametrize(
    ("arguments", "first", "second"),
    [
        (("stand", "v3", "--height", "12cm", "--height=13cm"), "12cm", "13cm"),
        (("stand", "v3", "--kp", "5", "--kp", "6"), "5", "6"),
        (("stand", "v3", "--kp", "*_1=5", "--kp", "3", "--kp", "*_1=6"), "*_1=5", "*_1=6"),
        (("hold", "v3", "--payload", "1kg", "--payload", "2kg"), "1kg", "2kg"),
        (("stand", "a.urdf", "--xacro-arg", "a:=b", "--xacro-arg", "a=c"), "a:=b", "a=c"),
        (
            ("convert", "a.urdf", "-o", "b.xml", "--fixed-base", "--free-base"),
            "--fixed-base",
            "--free-base",
        ),
    ],
    ids=str,
)
def test_an_option_with_two_different_values_is_refused(
    arguments: tuple[str, ...], first: str, second: str
) -> None:
    """Otherwise the last value would silently replace the first."""
    message = run_refused(*arguments)
    assert f"has two different values: {first} and {second}; keep one" in message


def test_an_option_may_be_repeated_with_the_same_value_or_for_another_name(tmp_path: Path) -> None:
    """The file does not exist, which is the only error."""
    repeated = ("--kp", "20", "--kp", "*knee*=30", "--height=12cm", "--height", "12cm")
    feet = ("--foot", "FL", "--foot", "FR", "--swing", "FL=2cm", "--swing", "FR=2cm")
    message = run_refused("stand", "none.urdf", *repeated, *feet, folder=tmp_path)
    assert "none.urdf: there is no such file" in message


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("stand", "v3", "--payload", "-2kg"), "error: --payload: -2.0 kg is not"),
        (("hold", "v3", "--payload", "-2kg"), "error: --payload: -2.0 kg is not"),
        (("stand", "v3", "--kp", "five"), "error: --kp: 'five' is not a number"),
    ],
    ids=str,
)
def test_error_about_a_value_names_its_option(arguments: tuple[str, ...], message: str) -> None:
    """The functions name these arguments `mass` and `kp`."""
    assert run_refused(*arguments).startswith(message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("stand", "v3", "--height", "12CM"), "is not a valid length: write 12cm"),
        (("stand", "v3", "--height", "12", "CM"), "directly behind the number: 12cm"),
        (("stand", "v3", "--pitch", "5°"), "is not a valid angle: write 5deg"),
        (("stand", "v3", "--payload", "2KG"), "is not a valid mass: write 2kg"),
        (("stand", "v3", "--kp", "20", "N/m"), "this option has no unit: write 20"),
        (("stand", "v3", "--kp", "20Nm"), "'20Nm' is not a number; write 20"),
        (("stand", "v3", "--uphill", "90"), "write 90deg or 90rad"),
        (("gains", "v3", "--error", "10"), "write 10deg or 10rad"),
        (("gains", "v3", "--encoder-bits", "14bit"), "is not an integer; write 14"),
        (("stand", "v3", "height=12cm"), "No such option 'height'. Did you mean '--height'?"),
        (("stand", "v3", "-height", "12cm"), "No such option '-height'. Did you mean '--height'?"),
        (("payload", "v3", "--mass", "2kg"), "Did you mean '--payload'?"),
        (("payload", "v3", "--continuous", "-2"), "error: --continuous: -2 N m"),
        (("push", "v3", "--impulse"), "word in its help is '--resolution'. (see"),
        (("gains", "v3", "--rate", "fast"), "'fast' is not a number (unit: Hz) (see"),
        (("study", "a.toml", "--workers", "two"), "'two' is not an integer (see"),
        (("version",), "No such command 'version'. Did you mean --version?"),
        (("push", "v3", "-x"), "No such option '-x'. (see"),
        (("audit", "v3", "--disable", "nosuch"), "more; audit --list-rules lists all"),
        (("best", "utilization", "v3"), "Did you mean 'utilisation'?"),
        (("stand", "v3", "--payload", "1kg", "--payload-at", "0;0;5cm"), "form X,Y,Z (10mm,0,0)"),
        (("hold", "v3", "--joints", "0,0,0"), "NAME=POSITION, e.g. elbow=90deg\n"),
        (
            ("stand", "v3", "--contact", "FL=none"),
            "'FL=none' names no surface; to lift a foot, write --swing FL=30mm",
        ),
        (("audit", "a.urdf", "b.xml"), "b.xml: too many arguments; usage: "),
        (("stand", "v3", "\u2013height", "12cm"), "instead of a hyphen, for example from a web"),
        (("stand", "v3", "\u2014height=12cm"), "write --height=12cm"),
        (("stand", "v3", "--pitch", "\u22125deg"), "write -5deg"),
        (("stand", "v3", "--offset=0,\u20131cm"), "write --offset=0,-1cm"),
        (("best", "v3"), "best {utilisation|margin|payload} [ROBOT]"),
        (("hold", "v3", "--posture", "0"), "Did you mean '--joints'?"),
        (("audit", "v3", "--disable", "mass"), "error: --disable: no rule 'mass'"),
        (("payload", "v3", "--payload-at", "0", "0", "8cm"), "blanks: --payload-at 0,0,8cm (see"),
        (("payload", "v3", "--payload-at=0", "0", "-8cm"), "blanks: --payload-at 0,0,-8cm (see"),
        (("hold", "a.urdf", "--joints", "elbow", "-45deg"), "blanks: --joints elbow=-45deg (see"),
        (("stand", "v3", "--move", "RL=1cm", "-.02"), "blanks: --move RL=1cm,-.02 (see"),
        (("walk", "v3", "--command", "0.5", "0", "0"), "blanks: --command 0.5,0,0 (see"),
        (("v3",), "'v3'. v3 is a robot; type pupper-analysis stand v3 (see"),
        (("my.xml", "--height", "3cm"), "type pupper-analysis stand my.xml --height 3cm (see"),
        (
            ("payload", "v3", "--continuous", "dephy"),
            "no motor 'dephy'; most similar: dephy-actpack",
        ),
        (("convert", "a.urdf"), "option -o is missing: The file to write: .xml"),
    ],
    ids=str,
)
def test_error_of_a_misspelt_value_option_or_unit_shows_the_spelling(
    arguments: tuple[str, ...], message: str
) -> None:
    assert message in run_refused(*arguments)


def test_an_angle_beyond_a_turn_is_accepted_with_its_unit() -> None:
    """90 rad is 14 turns and 116.6 deg, so the direction is valid."""
    assert shared.parse_quantity("angle", "90rad") == 90.0
    assert shared.parse_quantity("angle", "6.28") == 6.28
    with pytest.raises(ValueError, match="90"):
        shared.parse_quantity("angle", "90")


@pytest.mark.parametrize(
    ("typed", "corrected"),
    [
        ("stand v3 --kp 5 --kp leg_frnt_l_1=9", "stand v3 --kp 5 --kp leg_front_l_1=9"),
        (
            "stand v3 --contact leg_frnt_l_3=wall:0.4m",
            "stand v3 --contact leg_front_l_3=wall:0.4m",
        ),
        ("stand v3 --kp hose=9", ""),
        ("fit v3", "fit v3 --plan 12 -o plan.csv"),
        ("stand v4 --height 12cm", "stand v3 --height 12cm"),
        ("diff v3 v3-heav", "diff v3 v3-heavy"),
        ("contract v3-longleg", "contract v3-long-leg"),
        ("stand nobody", ""),
        ("walk v3 --seeds 3", "walk v3 --seeds 3 --policy policy.onnx"),
        ("walk v3 a.onnx b.onnx", "walk v3 a.onnx"),
        ("stand v3 v3-heavy --height 12cm", "stand v3 --height 12cm"),
        ("best payload a/a.urdf a/a.xml v3", "best payload a/a.urdf a/a.xml"),
    ],
)
def test_refusal_of_a_mistake_is_followed_by_the_corrected_command(
    typed: str, corrected: str
) -> None:
    """Reference: the names of v3; no name is similar to ``hose``."""
    result = answer(*typed.split())
    fault, *steps = result.stderr.splitlines()
    assert result.returncode == 2
    assert len(fault) <= MAX_ANSWER_WIDTH
    assert steps == ([f"  next: pupper-analysis {corrected}"] if corrected else [])


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("best v3 --kp 5", "best utilisation v3 --kp 5"),
        ("best a.urdf", "best utilisation a.urdf"),
        ("best utilization v3", "best utilisation v3"),
        ("best speed v3", "best utilisation v3"),
        ("stand a.urdf --take urd", "stand a.urdf --take urdf"),
        ("convert v3", "convert v3 -o v3.xml"),
        ("convert a.urdf --foot x=y", "convert a.urdf --foot x=y -o a.xml"),
        ("convert b.urdf", "convert b.urdf -o b_converted.xml"),
        ("convert b.xml", "convert b.xml -o b_converted.urdf"),
        ("best", "best utilisation"),
        ("crosscheck", "crosscheck v3"),
        ("contract", "contract v3"),
        ("diff", "diff v3 v3-heavy"),
        ("walk v3", "walk v3 --policy mine.onnx"),
    ],
)
def test_refusal_of_a_missing_word_is_followed_by_the_complete_command(
    typed: str, completed: str, tmp_path: Path
) -> None:
    """Reference: the usage lines. A proposed output file does not exist."""
    for name in ("a.urdf", "b.urdf", "b.xml", "mine.onnx"):
        (tmp_path / name).write_text("")
    done = answer(*typed.split(), folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines()[1:] == [f"  next: pupper-analysis {completed}"]


@pytest.mark.parametrize(
    ("typed", "refusal"),
    [(("--height", "6m"), "stance out of reach"), (("--com", "20m,0"), "outside the support")],
)
def test_typed_unit_of_a_length_is_not_questioned(typed: tuple[str, str], refusal: str) -> None:
    """The Python API suggests metres for the same numbers, which have no unit there."""
    refused = answer("stand", "v3", *typed)
    assert refused.returncode == 2
    assert refusal in refused.stderr
    assert "millimetres" not in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("stand", "v3", "--pich", "5deg"), "stand v3 --pitch 5deg"),
        (("stand", "v3", "--pich=5deg", "--kp", "5"), "stand v3 --pitch=5deg --kp 5"),
        (("stand", "v3", "--explan"), "stand v3 --explain"),
        (("payload", "v3", "--mass", "2kg"), "payload v3 --payload 2kg"),
        (("stand", "v3", "height=12cm"), "stand v3 --height=12cm"),
        (("stand", "v3", "-height", "12cm"), "stand v3 --height 12cm"),
        (("stand", "v3", "--pich", "10"), ""),  # 10 rad would be refused
        (("stand", "v3", "--heigth"), ""),
        (("hold", "v3", "--posture", "home"), ""),  # --joints requires NAME=POSITION
    ],
    ids=str,
)
def test_error_of_an_unknown_option_proposes_the_command_with_the_similar_option(
    arguments: tuple[str, ...], line: str
) -> None:
    assert read_proposed_command(*arguments) == line


def read_proposed_command(*arguments: str) -> str:
    """Run a command that must be refused, and return the proposed next command; else empty."""
    result = answer(*arguments)
    assert result.returncode == 2
    return result.stderr.partition("  next: pupper-analysis ")[2].strip()


@pytest.mark.parametrize(
    ("arguments", "example"),
    [
        (("stand", "v3", "--payload"), "0.5kg"),
        (("payload", "v3-heavy", "--continuous"), "0.4"),
        (("stand", "v3", "--height"), "180mm"),
        (("stand", "v3", "--kp"), "20"),
    ],
    ids=str,
)
def test_error_of_an_option_without_value_contains_an_example(
    arguments: tuple[str, ...], example: str
) -> None:
    assert f"{arguments[-1]}' requires an argument, e.g. {example}. (see" in run_refused(*arguments)
    assert read_proposed_command(*arguments) == " ".join((*arguments, example))


def test_error_of_an_option_without_value_proposes_no_file_and_no_name_of_a_joint() -> None:
    assert "requires an argument, e.g. FR=30mm. (see" in run_refused("stand", "v3", "--swing")
    assert read_proposed_command("stand", "v3", "--swing") == ""
    assert read_proposed_command("stand", "v3", "--start") == ""


@pytest.mark.parametrize(
    ("typed", "line"),
    [
        ("path v3 --height 120 --kp 120", "path v3 --height 120mm --kp 120"),
        ("stand v3 --height=120", "stand v3 --height=120mm"),
        ("stand v3 --height 12CM", "stand v3 --height 12cm"),
        ("stand v3 --height 12 cm --kp 5", "stand v3 --height 12cm --kp 5"),
        ("stand v3 --pitch 60", "stand v3 --pitch 60deg"),
        ("stand v3 --swing FL=120", "stand v3 --swing FL=120mm"),
        ("stand v3 --offset 0,120", "stand v3 --offset 0,120mm"),
        ("stand v3 --contact FL=table:120", "stand v3 --contact FL=table:120mm"),
        ("stand v3 --kp leg_*_1=20 N/m", "stand v3 --kp 'leg_*_1=20'"),
        ("stand v3 --kp 20Nm", "stand v3 --kp 20"),
        ("gains v3 --encoder-bits 14bit", "gains v3 --encoder-bits 14"),
        ("stand v3 \u2013height 12cm", "stand v3 --height 12cm"),
        ("payload v3 --payload-at=0 0 8cm --kp 5", "payload v3 --payload-at 0,0,8cm --kp 5"),
        ("gains v3 --rate fast", ""),
    ],
)
def test_error_of_a_value_proposes_the_command_with_the_valid_value(typed: str, line: str) -> None:
    assert read_proposed_command(*typed.split()) == line


@pytest.mark.parametrize(
    ("typed", "line"),
    [
        ("crosschek v3", "crosscheck v3"),
        ("stnad v3 --kp 5", "stand v3 --kp 5"),
        ("v3 --kp 5", "stand v3 --kp 5"),
        ("xyzzy v3", ""),
    ],
)
def test_error_of_a_command_proposes_the_most_similar_command(typed: str, line: str) -> None:
    assert read_proposed_command(*typed.split()) == line
