"""Modes of commands: each typed option is used, or refused by name."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import click
import pytest

from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli import COMMAND_NAMES, find_command
from pupper_analysis.cli.modes import refuse_unused
from pupper_analysis.cli.robots import RobotOptions
from pupper_analysis.stance.fields import FIELDS
from tests.support.commands import answer
from tests.support.repository import ROOT


def test_typed_option_without_effect_is_refused_and_a_default_is_not() -> None:
    @click.command()
    @click.option("--mode", is_flag=True)
    @click.option("--new", default="x")
    def command(mode: bool, new: str) -> None:
        refuse_unused("--mode", {"--mode": {"mode"}})

    command.main(args=["--mode"], standalone_mode=False)
    with pytest.raises(ConfigurationError, match="--new: the option has no effect with --mode"):
        command.main(args=["--mode", "--new", "x"], standalone_mode=False)


V3 = (str(ROOT / "urdf/pupper_v3.urdf"), str(ROOT / "mjcf/pupper_v3.xml"))
_IDLE: dict[tuple[str, ...], tuple[tuple[str, ...], ...]] = {
    ("analyze", "v3", "--no-figures"): (("-o", "out"),),
    ("stand", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm"), ("--uphill", "1rad")),
    ("stand", "--leg-scale", "1.1"): (("--as-is",),),
    ("workspace", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm"), ("--uphill", "1rad")),
    ("payload", "v3"): (("--as-is",), ("--uphill", "1rad")),
    ("stand", "v3", "--contact", "FR=weld"): (("--swing", "FR=2cm"),),
    ("stand", "v3", "--contact", "FR=slope:5deg,force=5N"): (("--swing", "FR=2cm"),),
    ("path", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm"), ("--uphill", "1rad")),
    ("push", "v3", "v3-heavy"): (("--as-is",), ("--payload-at", "0,0,1cm"), ("--uphill", "1rad")),
    ("hold", "v3"): (("--as-is",),),
    ("gains", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm"), ("--uphill", "1rad")),
    ("heat", "--list-motors"): (("--motor", "dephy-actpack"), ("--battery", "3")),
    ("heat", "v3", "--motor", "dephy-actpack"): (("--as-is",), ("--payload-at", "0,0,1cm")),
    ("best", "margin", "v3"): (("--as-is",), ("--payload-at", "0,0,1cm"), ("--uphill", "1rad")),
    ("best", "utilisation"): (("--payload-at", "0,0,1cm"),),
    ("sync", *V3): (("--partial",), ("--backup",)),
    ("sync", *V3, "--take", "urdf", "--dry-run"): (("--backup",),),
    ("convert", V3[1], "-o", "new.urdf"): (
        *(("--foot", "FL"), ("--fixed-base",), ("--free-base",)),
        *(("--armature", "1"), ("--repair-inertia",), ("--copy-meshes",)),
    ),
    ("walk", "v3", "--policy", "policy.json"): (("--fit", "fit.json"),),
    ("walk", "v3", "--policy", "policy.json", "--orders"): (
        *(("--command", "1,0,0"), ("--seeds", "2"), ("--vary", "mass"), ("--fit", "fit.json")),
        ("--motor", "dephy-actpack"),
    ),
    ("walk", "v3", "--policy", "policy.json", "--response"): (
        *(("--vary", "mass"), ("--orders",), ("--trace", "trace.npz")),
    ),
    ("walk", "v3", "--policy", "policy.json", "--init"): (
        *(("--contract", "policy.toml"), ("--effort", "3"), ("--response",)),
        *(("--trace", "trace.npz"), ("--json", "a.json"), ("--orders",)),
    ),
    ("live", "v3", "--drop", "--headless"): (("--port", "1"), ("--fixed-base",)),
    ("live", "v3", "--mujoco", "--headless"): (("--port", "1"),),
    ("live", "v3", "--no-browser"): (("--headless",),),
    ("check", "--init"): (("--format", "sarif"), ("--json", "a.json")),
    ("audit", "--list-rules"): (("--json", "a.json"),),
    ("fit", "v3", "--plan", "2"): (
        *(("--weight", "3kg"), ("--hold-out", "0.3")),
        ("--kd", "1"),
    ),
    ("fit", "v3", "--stands", "stands.csv"): (
        *(("--hold-out", "0.3"), ("--kd", "1")),
        *(("--added", "1kg"),),
    ),
    ("fit", "v3", "--log", "stands.csv"): (*(("--weight", "3kg"), ("--added", "1kg")),),
}
IDLE = {line: several for line, several in _IDLE.items() if line[0] in COMMAND_NAMES}
"""{command line: options that have no effect in it}."""


@pytest.mark.parametrize("line", IDLE, ids=lambda line: " ".join(Path(word).name for word in line))
def test_option_without_effect_is_refused_before_any_computation(
    line: tuple[str, ...], tmp_path: Path
) -> None:
    """No file is written, and nothing is printed on standard output."""
    (tmp_path / "stands.csv").touch()
    for more in IDLE[line]:
        given = answer(*line, *more, folder=tmp_path)
        assert (given.returncode, given.stdout) == (2, ""), (line, more, given)
        assert len(given.stderr.strip().splitlines()) == 1
        option = {"-o": "--output", "--free-base": "--fixed-base"}
        shown = option.get(more[0], more[0])
        assert given.stderr.startswith(f"error: {shown}: "), given
    assert {path.name for path in tmp_path.iterdir()} == {"stands.csv"}


@pytest.mark.slow
def test_unused_entries_of_a_stance_file_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "stance.toml").write_text("payload-at = '0,0,1cm'\nkp = 20\nheight = '17cm'\n")
    given = answer("workspace", "v3", "--stance", "stance.toml", folder=tmp_path)
    assert given.returncode == 0, given


_OUTPUT = {"style", "everything", "force", "json_path", "report_path", "figure", "output", "csv"}
_SERVO = {"kp", "kd", "integrator", "timestep", "cone", "impratio"}
_POLICY = {"policy", "contract", "command_text", "seeds", "seconds"}
_ROBOT = {field.name for field in fields(RobotOptions)}
_LOAD = {"payload", "effort"}
USED: dict[str, set[str]] = {
    "analyze": {"no_figures", "write_folder"},
    "audit": {"disabled", "list_rules", "fail_on", "fix", "confirmed"},
    "best": _SERVO | _LOAD | {"continuous"},
    "check": {"config", "update_baseline", "since", "first"},
    "contract": {"pairs", "unstood", "fail_on"},
    "convert": set(),
    "crosscheck": {"changes", "strict"},
    "diff": {"changes"},
    "fit": {
        *(
            "stands",
            "logs",
            "count",
            "added_at",
            "record",
            "listen",
            "bridge",
            "priors",
            "anyway",
            "kp",
        ),
    },
    "gains": _SERVO | _LOAD | {"rate", "delay", "error", "encoder_bits", "folder"},
    "heat": _LOAD | {"motors", "list_motors", "ambient", "limit", "battery"},
    "hold": _SERVO | _LOAD | {"positions", "tool", "continuous"},
    "live": {*("language", "host", "no_browser", "viewer", "dropped"), *_POLICY} - {"seeds"},
    "path": _SERVO | _LOAD | {"seconds", "motors"},
    "payload": _SERVO | _LOAD | {"continuous", "payload_at"},
    "push": _SERVO | _LOAD | {"directions", "resolution", "motors"},
    "stand": _SERVO | _LOAD | {"minimum_stiffness", "explain", "start"},
    "study": {"folder", "workers", "dask", "minimise", "maximise", "numbers"},
    "sync": {"dry_run", "changes"},
    "walk": {"policy", "seconds", "init"},
    "workspace": _LOAD,
}
"""{command: options that are used whenever the command accepts these options}."""


@pytest.mark.parametrize("name", COMMAND_NAMES)
def test_each_option_is_always_used_or_has_a_case_in_which_it_is_refused(name: str) -> None:
    """A new option needs an entry in ``USED``, or a command line in ``_IDLE`` that refuses it."""
    known = USED[name] | _OUTPUT | _ROBOT | {"stance", *FIELDS}
    refused = {more[0] for line, cases in _IDLE.items() if line[0] == name for more in cases}
    options = [
        option
        for option in find_command(name).params
        if isinstance(option, click.Option) and option.expose_value
    ]
    assert options
    assert [
        option.opts
        for option in options
        if option.name not in known and not refused & set(option.opts)
    ] == []


@pytest.mark.parametrize("name", COMMAND_NAMES)
def test_command_with_json_has_markdown_and_verbose(name: str) -> None:
    options = {option.name: option for option in find_command(name).params}
    assert ("style" in options) == ("json_path" in options)
    if "style" in options:
        assert "markdown" in options["style"].type.choices  # type: ignore[attr-defined]
        assert "everything" in options


@pytest.mark.parametrize("name", sorted(set(COMMAND_NAMES) - {"study", "check"}))
def test_command_that_reads_a_urdf_accepts_packages(name: str) -> None:
    """Except ``study`` and ``check``, whose files contain the packages."""
    names = {str(parameter.name) for parameter in find_command(name).params}
    assert "packages" in names or not names & {"urdf", "source", "file", "old"}
