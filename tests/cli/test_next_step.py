"""Next commands: each suggested line runs, for the robot that was typed."""

from __future__ import annotations

import contextlib
import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.base.errors import StanceUnreachableError
from pupper_analysis.cli.next_step import complete_command, complete_relaxed_command
from pupper_analysis.cli.shared import TYPED_WORDS
from pupper_analysis.cli.stance_fields import OPTION_FIELDS, format_as_options, make_task
from pupper_analysis.present.document import NextStep
from pupper_analysis.tools.audit.audit import audit_model
from pupper_analysis.tools.audit.document import audit_document
from tests.prepare.test_imported import four_legs
from tests.support import arm
from tests.support.commands import answer, run_command
from tests.support.legged import biped, rewrite_file
from tests.support.repository import ROOT
from tests.support.robots import quadruped, urdf_text


def complete(typed: str, step: NextStep | None) -> str:
    """Return the command line that follows a typed one."""
    name, *words = shlex.split(typed)
    root = click.Context(cli.group, info_name="pupper-analysis")
    command = cli.find_command(name)
    with click.Context(command, parent=root, info_name=name) as context:
        context.meta[TYPED_WORDS] = tuple(words)
        return complete_command(step)


@pytest.mark.parametrize(
    ("typed", "step", "expected"),
    [
        ("stand v3", NextStep("payload"), "payload v3"),
        ("stand", NextStep("payload"), "payload"),
        (
            "stand --height 12cm 'a b.urdf' c.xml -v --json x.json --swing FL=2cm",
            NextStep("payload"),
            "payload 'a b.urdf' c.xml --height 12cm --swing FL=2cm",
        ),
        ("payload v3 --payload-at=0,0,8cm", NextStep("best", ("payload",)),
         "best payload v3 --payload-at 0,0,8cm"),
        ("payload v3 --payload-at=0,0,8cm", NextStep("push"), "push v3"),
        ("payload v3 --payload-at 0,0,8cm", NextStep("stand", ("--payload", "6kg")),
         "stand v3 --payload-at 0,0,8cm --payload 6kg"),
        ("payload v3 --payload 1kg --payload-at 0,0,8cm", NextStep("stand"),
         "stand v3 --payload 1kg --payload-at 0,0,8cm"),
        ("stand v3 --height 12cm", NextStep("path", ("--height", "18mm")), "path v3 --height 18mm"),
        ("stand a.urdf b.xml", NextStep("audit"), "audit a.urdf"),
        ("stand a.urdf b.xml", NextStep("audit", of_mjcf=True), "audit b.xml"),
        ("stand b.xml a.urdf", NextStep("audit", of_mjcf=True), "audit b.xml"),
        ("stand a.urdf", NextStep("audit", of_mjcf=True), "audit a.urdf"),
        ("stand a.urdf b.xml", NextStep("crosscheck"), "crosscheck a.urdf b.xml"),
        ("crosscheck a.urdf b.xml --frame FL", NextStep("sync"), "sync a.urdf b.xml"),
        ("best margin v3", NextStep("workspace"), "workspace v3"),
        (
            "convert a.urdf -o b.xml",
            NextStep("stand", ("b.xml",), robot_typed=False),
            "stand b.xml",
        ),
        (
            "convert a.urdf -o b.xml",
            NextStep("crosscheck", ("a.urdf", "b.xml"), robot_typed=False),
            "crosscheck a.urdf b.xml",
        ),
        ("study s.toml -o d", NextStep("study", ("-o", "d", "--minimise", "sag")),
         "study s.toml -o d --minimise sag"),
        ("stand --urdf a.urdf --mjcf b.xml", NextStep("payload"),
         "payload --urdf a.urdf --mjcf b.xml"),
        ("stand a.urdf", NextStep("sync"), ""),
        ("stand a.urdf", NextStep("crosscheck"), ""),
        ("stand v3", NextStep("sync"), "sync v3"),
        ("crosscheck v3 b.xml", NextStep("stand"), "stand b.xml"),
        ("stand -", NextStep("payload"), ""),
        ("audit -", NextStep("stand"), ""),
        ("diff a.urdf -", NextStep("audit", ("-",), robot_typed=False), ""),
        ("stand v3 --json -", NextStep("payload"), "payload v3"),
        ("stand v3 --height 12cm --csv - --report -", NextStep("payload"),
         "payload v3 --height 12cm"),
        ("stand arm.urdf --contact base=weld", NextStep("payload"), "hold arm.urdf"),
        ("heat arm.urdf --contact base=weld", NextStep("best", ("utilisation",)), "hold arm.urdf"),
        ("heat v3 --contact FR=weld,place=0/0/0", NextStep("best", ("utilisation",)),
         "payload v3 --contact FR=weld,place=0/0/0"),
        ("payload v3 --contact FR=weld", NextStep("push"), "gains v3 --contact FR=weld"),
        ("stand v3 --contact FR=weld", NextStep("workspace"), "workspace v3 --contact FR=weld"),
        ("stand arm.urdf --contact base=weld", NextStep("workspace"), "hold arm.urdf"),
        ("stand v3 --contact FR=bar:0,0,1,grip=60N", NextStep("push"),
         "payload v3 --contact FR=bar:0,0,1,grip=60N"),
        ("stand v3 --contact FR=weld", NextStep("payload"), "payload v3 --contact FR=weld"),
        ("stand v3 --contact FR=wall:1m", NextStep("best", ("margin",)),
         "best margin v3 --contact FR=wall:1m"),
        ("crosscheck a.urdf b.usda", NextStep("stand"), "stand a.urdf"),
        ("crosscheck a.USD b.xml", NextStep("hold"), "hold b.xml"),
        ("crosscheck a.urdf b.usd", NextStep("sync"), ""),
        ("crosscheck a.usd b.usdz", NextStep("stand"), ""),
        ("audit a.usd", NextStep("audit", ("--fix",)), "audit a.usd --fix"),
        ("stand v3", NextStep("no-such-command"), ""),
        ("contract a.xml policy.json", NextStep("audit"), ""),
        ("stand v3", None, ""),
        ("best margin v3 --swing FL=2cm --kp 9", NextStep("path", stance_found=True),
         "best margin v3 --swing FL=2cm --kp 9 --json best.json"),
        ("best margin v3 --height 1m --swing FL=2cm --kp 9 --com inside --move FL=1cm,0",
         NextStep("path", stance_found=True, stance_words=("--height", "90mm")),
         "path v3 --swing FL=2cm --kp 9 --height 90mm"),
        ("best margin v3 --height 1m --swing FL=2cm --kp 9 --stance s.toml --json 'a b.json'",
         NextStep("path", stance_found=True), "path v3 --kp 9 --stance 'a b.json'"),
        ("payload v3 --continuous 2 --continuous '*_3=1'", NextStep("best", ("payload",)),
         "best payload v3 --continuous 2 --continuous '*_3=1'"),
        ("best margin v3 --json -", NextStep("path", stance_found=True),
         "best margin v3 --json best.json"),
        ("walk v3 --policy p.json --command 0.5,0,0", NextStep("walk", ("--orders",),
         omitted=("--command",)), "walk v3 --policy p.json --orders"),
    ],
)  # fmt: skip
def test_next_command_has_the_typed_robot_and_common_options(
    typed: str, step: NextStep | None, expected: str
) -> None:
    assert complete(typed, step) == (expected and f"pupper-analysis {expected}")


def test_next_steps_in_the_tools_name_commands_with_such_options() -> None:
    """Reference: the options and arguments that click parses."""
    pattern = re.compile(r"NextStep\(\"([\w-]+)\"(?:, \(((?:\"[^\"]+\",? ?)+)\))?")
    found = [
        (path, match)
        for path in sorted(Path(ROOT, "pupper_analysis", "tools").rglob("*.py"))
        for match in pattern.finditer(path.read_text(encoding="utf-8"))
    ]
    assert len(found) > 20
    for path, match in found:
        command = cli.group.get_command(None, match[1])
        assert command is not None, (path, match[0])
        options = {name for option in command.params for name in option.opts}
        typed = set(re.findall(r"\"(--[\w-]+)\"", match[2] or ""))
        assert typed <= options, (path, match[0])


_LIMB = """<body name="{name}" pos="{x} 0 0"><joint name="j{name}" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body>"""


@pytest.mark.parametrize(("count", "command"), [(1, "hold"), (2, "stand")])
def test_audit_of_a_fixed_base_names_hold_unless_loading_frees_it(
    tmp_path: Path, count: int, command: str
) -> None:
    """Reference: loading frees a base with two limbs or more (`prepare.base.free_base`)."""
    limbs = "".join(_LIMB.format(name=f"limb{index}", x=index) for index in range(count))
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><body name="base"><inertial pos="0 0 0" mass="2" '
        f'diaginertia="0.01 0.01 0.01"/>{limbs}</body></worldbody></mujoco>'
    )
    audit = audit_model(path)
    assert audit.floating is (count > 1)
    step = audit_document(replace(audit, passed=True)).next_step
    assert step is not None
    assert step.command == command


def test_audit_with_errors_names_fix_if_an_error_has_a_single_repair(tmp_path: Path) -> None:
    """Reference: a negative effort has one repair, its absolute value."""
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
    path = tmp_path / "robot.urdf"
    path.write_text(re.sub(r'effort="([^"]+)"', r'effort="-\1"', text, count=1))
    step = audit_document(audit_model(path)).next_step
    assert step == NextStep("audit", ("--fix",))


def test_audit_with_missing_meshes_names_the_folder_of_their_package(tmp_path: Path) -> None:
    """Reference: the folder with the file of the URI, whatever its name; -v without such a folder.

    A placeholder for the folder cannot be copied.
    """
    home = tmp_path / "robots" / "dog"  # the folders of other tests are not searched
    home.mkdir(parents=True)
    file = home / "robot.urdf"
    mesh = '<visual><geometry><mesh filename="package://dog/foot.stl"/></geometry></visual></link>'
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
    text = re.sub(r"<(visual).*?</visual>", "", text, flags=re.DOTALL)
    file.write_text(text.replace("</link>", mesh, 1))
    lines = answer("audit", "robot.urdf", folder=home).stdout.splitlines()
    assert lines[1].endswith("file dog/foot.stl missing; --package dog=DIR")
    assert lines[2] == "  next: pupper-analysis audit robot.urdf -v"
    folder = home / "stuff" / "a dog"
    folder.mkdir(parents=True)
    (folder / "foot.stl").write_text("")
    lines = answer("audit", "robot.urdf", folder=home).stdout.splitlines()
    assert lines[2] == "  next: pupper-analysis audit robot.urdf --package 'dog=stuff/a dog'"
    _, *words = shlex.split(lines[2].removeprefix("  next: "))
    assert "missing" not in answer(*words, folder=home).stdout


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("stand --payload 1kg --height 1m", "hold {path} --payload 1kg"),
        ("heat --motor mit-mini-cheetah",
         "heat {path} --motor mit-mini-cheetah --contact base=weld --limit 100"),
        ("gains --payload 1kg --delay 1ms",
         "gains {path} --payload 1kg --delay 1ms --contact base=weld"),
        ("live --no-browser", "hold {path}"),
        ("live --drop --headless", "live {path} --headless --mujoco"),
        ("live --drop", "live {path} --mujoco"),
        ("walk policy.pt", "hold {path}"),
        ("walk", "hold {path}"),
        ("fit --stands none.csv --weight 1kg", "fit {path} --log motion.csv"),
        ("push --contact base=weld", "hold {path}"),
        ("payload --contact base=weld", "hold {path}"),
    ],
)  # fmt: skip
def test_refusal_of_a_fixed_base_prints_a_command_for_fixed_bases(
    typed: str, expected: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: the options that both commands have; `gains` accepts a welded base."""
    limb = _LIMB.format(name="limb", x=0)
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body name="base"><inertial pos="0 0 0" mass="2" '
        f'diaginertia="0.01 0.01 0.01"/>{limb}</body></worldbody></mujoco>'
    )
    name, *options = typed.split()
    status, _, err = run_command(capfd, name, str(path), *options)
    assert status == 2
    assert err.splitlines()[-1] == f"  next: pupper-analysis {expected.format(path=path)}"
    if "--drop" in typed:  # the answer advised `hold`, and the next command was `live`
        assert "cannot be dropped; --mujoco" in err


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("analyze v3 arm.xml --height 12cm", "analyze v3 --height 12cm"),
        ("analyze v3 arm.urdf arm.xml v3-heavy", "analyze v3 v3-heavy"),
        ("analyze v3 arm.urdf+arm.xml", "analyze v3"),
        ("analyze v3 --mjcf arm.xml", "analyze v3"),
        ("analyze copy.xml arm.xml --no-figures", "hold copy.xml"),
        ("push arm.xml v3", "push v3"),
    ],
)
def test_refusal_of_one_of_several_robots_prints_the_command_without_it(
    typed: str, expected: str, tmp_path: Path
) -> None:
    """The line was `hold` of all robots, which accepts a single robot."""
    (tmp_path / "arm.urdf").write_text(arm.URDF)
    for name in ("arm.xml", "copy.xml"):
        (tmp_path / name).write_text(arm.MJCF)
    done = answer(*shlex.split(typed), folder=tmp_path)
    assert done.returncode == 2
    error, step = done.stderr.splitlines()
    assert "has a fixed base" in error
    assert step == f"  next: pupper-analysis {expected}"


@pytest.mark.parametrize("typed", ["fit --plan 3 -o plan.csv", "heat", "gains", "workspace"])
def test_base_on_undriven_joints_is_refused_by_its_joints(
    typed: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The base of a hopper is neither free nor fixed: it falls on a slide without motor."""
    path = tmp_path / "hopper.xml"
    path.write_text(
        '<mujoco><worldbody><body name="torso"><joint name="rise" type="slide" axis="0 0 1"/>'
        '<inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>'
        f"{_LIMB.format(name='limb', x=0)}</body></worldbody>"
        '<actuator><motor joint="jlimb"/></actuator></mujoco>'
    )
    name, *options = typed.split()
    status, _, err = run_command(capfd, name, str(path), *options)
    assert status == 2
    assert "neither a free nor a fixed base: its base falls on the joints rise" in err


@pytest.mark.parametrize(
    "typed",
    ["stand", "push", "heat --motor mit-mini-cheetah", "live --no-browser",
     "live --drop --headless", "walk policy.pt", "fit --plan 3", "fit --record no.csv", "study"],
)  # fmt: skip
@pytest.mark.parametrize("joint", ["", "floating"])
def test_crossed_limits_are_the_cause_in_every_refusal(
    typed: str, joint: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The refusals stated a fixed base or missing feet, and next commands that repair neither."""
    path = tmp_path / "robot.urdf"
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
    text = re.sub(r"<(visual).*?</visual>", "", text, flags=re.DOTALL)
    if joint:
        free = '<link name="map"/><joint name="free" type="floating"><parent link="map"/><child '
        text = text.replace("<link", f'{free}link="base_link"/></joint><link', 1)
    found = re.search(r'lower="([^"]+)" upper="([^"]+)"', text)
    assert found is not None
    start, end = found.span()
    path.write_text(f'{text[:start]}lower="{found[2]}" upper="{found[1]}"{text[end:]}')
    line = text[:start].count("\n") + 1
    name, *words = typed.split()
    words = [str(path), *words]
    if name == "study":
        study = tmp_path / "study.toml"
        study.write_text(
            'robot = "robot.urdf"\nmeasure = ["stands"]\n[vary]\npayload_mass = [0.0, 0.1]\n'
        )
        words = [str(study), "-o", str(tmp_path / "out")]
    status, _, err = run_command(capfd, name, *words)
    fault, step = err.splitlines()[-2:]
    assert status == 2
    assert fault.startswith(f"error: {path}:{line}: joint "), err
    assert f"lower limit {float(found[2]):.4g} rad above upper {float(found[1]):.4g} rad" in fault
    assert step == f"  next: pupper-analysis audit {path} --fix"


def test_refusal_of_a_base_without_mass_prints_audit(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """MuJoCo refuses the free base. The audit reports the same link as an error."""
    parts = quadruped()
    parts["base"] = replace(parts["base"], mass=0.0)
    path = tmp_path / "robot.urdf"
    path.write_text(urdf_text(parts))
    status, _, err = run_command(capfd, "stand", str(path))
    assert status == 2
    assert err.splitlines()[-1] == f"  next: pupper-analysis audit {path}"
    audit = audit_model(path)
    assert not audit.passed
    assert audit.findings[0].element == "link 'base'"


@pytest.mark.parametrize("command", ["stand", "hold", "gains", "payload", "workspace", "push"])
def test_refusal_of_crossed_joint_limits_prints_line_limits_and_repair(
    command: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """No position is above the lower and below the upper limit: no posture can be computed."""
    path = tmp_path / "robot.urdf"
    crossed = 'lower="0.8" upper="-0.8"'
    text = four_legs(tmp_path).read_text().replace('lower="-0.8" upper="0.8"', crossed, 1)
    path.write_text(text)
    line = 1 + text[: text.index(crossed)].count("\n")
    status, out, err = run_command(capfd, command, str(path))
    assert status == 2
    assert not out
    assert err.splitlines() == [
        f"error: {path}:{line}: joint FL_roll: lower limit 0.8 rad above upper -0.8 rad; "
        "exchange them",
        f"  next: pupper-analysis audit {path} --fix",
    ]
    repair = audit_document(audit_model(path)).next_step
    assert repair == NextStep("audit", ("--fix",))


@pytest.mark.parametrize("command", ["stand", "hold"])
def test_refusal_of_an_mjcf_by_mujoco_prints_audit(
    command: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Moments of 1, 1 and 3 kg m^2 violate A + B >= C, which MuJoCo 4.0.0 refuses."""
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body name="rod"><joint name="turn"/><inertial pos="0 0 0" mass="2" '
        'diaginertia="1 1 3"/></body></worldbody></mujoco>'
    )
    status, _, err = run_command(capfd, command, str(path))
    assert status == 2
    assert err.splitlines()[-1] == f"  next: pupper-analysis audit {path}"


def list_next_lines(output: str) -> list[list[str]]:
    """Return the words of each suggested command line in the output of a command."""
    found = re.findall(r"^ *next: pupper-analysis (.+)$", output, flags=re.M)
    return [shlex.split(line) for line in found]


PRINTED = [
    "audit v3", "contract v3 --no-stand", "crosscheck v3", "diff v3 v3-heavy", "diff v3 v3",
    "sync v3", "stand v3", "check", "audit arm.urdf", "audit arm.xml",
    "contract arm.xml", "contract arm.urdf arm.xml", "crosscheck arm.xml arm.urdf",
    "diff arm.xml arm.xml", "sync arm.xml arm.urdf", "convert arm.urdf -o new.xml",
    "convert arm.xml -o new.urdf", "hold arm.xml arm.urdf", "stand arm.xml", "payload arm.urdf",
    "gains arm.urdf", "fit arm.urdf --plan 2 -o plan.csv",
]  # fmt: skip
"""Command lines whose next commands are tested: a legged robot, and an arm with a fixed base."""

TESTED = {"audit", "contract", "crosscheck", "sync", "check", "hold"}
"""Commands that are also run as the next command; the parsers of the others check their words."""


@pytest.mark.slow
def test_check_with_known_differences_names_a_command_that_compares_the_pair() -> None:
    """`stand` refuses the hopper of the example: it has a single foot."""
    done = answer("check", folder=ROOT / "examples" / "guarded")
    assert list_next_lines(done.stdout) == [["crosscheck", "hopper.urdf", "hopper.xml"]]


@pytest.mark.slow
@pytest.mark.parametrize("line", PRINTED)
def test_printed_next_command_is_accepted(line: str, tmp_path: Path) -> None:
    """Reference: exit status of the next command, or click's parser for slow commands."""
    (tmp_path / "arm.urdf").write_text(arm.URDF)
    (tmp_path / "arm.xml").write_text(arm.MJCF)
    done = answer(*shlex.split(line), folder=tmp_path)
    steps = list_next_lines(done.stdout + done.stderr)
    assert len(steps) == 1, done
    [step] = steps
    if step[0] in TESTED and step[0] not in line:
        assert answer(*step, folder=tmp_path).returncode in (0, 1), step
    else:
        with contextlib.chdir(tmp_path):
            cli.find_command(step[0]).make_context(step[0], step[1:]).close()
    assert ("arm" in line or "new" in line) <= (step[0] not in ("stand", "payload")), step


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("stand v3 --height 20cm --kp 8", "stand v3 --kp 8 --height 0.15m"),
        ("best payload v3 --swing FL=2cm", "best payload v3 --height 150mm --swing FL=2cm"),
    ],
)
def test_refusal_is_followed_by_the_command_for_the_nearest_stance(
    typed: str, expected: str
) -> None:
    """Reference: the task that click parses from the suggested command."""
    name, *words = shlex.split(typed)
    reachable = pa.StandTask(height=0.15)
    error = StanceUnreachableError(
        reachable.phrase(), {}, {}, nearest=SimpleNamespace(task=reachable),
        limits={"pitch": {"pitch": 0.1}, "height": {"height": 0.15}},
    )  # fmt: skip
    root = click.Context(cli.group, info_name="pupper-analysis")
    command = cli.find_command(name)
    with command.make_context(name, [*words], parent=root) as context:
        context.meta[TYPED_WORDS] = tuple(words)
        line = complete_relaxed_command(error)
    _, *suggested = shlex.split(line)
    parsed, wanted = (
        command.make_context(name, given[1:], parent=root).params
        for given in (suggested, shlex.split(expected))
    )
    assert {key: parsed[key] for key in ("words", "height", "swing", "kp")} == {
        key: wanted[key] for key in ("words", "height", "swing", "kp")
    }


def test_options_of_a_task_are_parsed_to_the_same_task() -> None:
    """Reference: `make_task`, the inverse. A contact surface has no such options."""
    task = pa.StandTask(height=0.1415, pitch=-0.1, swing={"FL": 0.02}, offset=(0.01, -0.02),
                        foot_offsets={"FR": (0.0, 0.003)})  # fmt: skip
    attributes = ["height", "pitch", "swing", "offset", "foot_offsets"]
    options = format_as_options(task, attributes)
    words = [word for name, values in options.items() for value in values for word in (name, value)]
    command = cli.find_command("stand")
    parsed = command.make_context("stand", ["v3", *words]).params
    made = make_task({name: parsed[name] for name in OPTION_FIELDS})
    for attribute in attributes:
        given, found = getattr(task, attribute), getattr(made, attribute)
        assert repr(found) == repr(given) or found == pytest.approx(given, rel=1e-9)
    assert format_as_options(task, ["contacts"]) == {}


def test_best_without_torque_limits_names_audit(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The error stated no next command. Reference: the code of the error, and the typed file."""
    mjcf = biped(tmp_path).mjcf
    rewrite_file(mjcf, (' ctrlrange="-80 80"', ""), count=12)
    status, _, err = run_command(capfd, "best", "payload", str(mjcf), "--kp", "300", "--kd", "3")
    assert status == 2
    assert "has an effort limit: set limits with --effort [JOINTS=]NM" in err
    assert f"next: pupper-analysis audit {mjcf}" in err
