"""The file ``pupper-analysis.toml``: all keys are read, and invalid keys are refused with their
line.
"""

from __future__ import annotations

import csv
import os
import pickle
import re
import tomllib
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.tools import find_tool_modules
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.audit.audit import Severity
from pupper_analysis.tools.check import config
from pupper_analysis.tools.check.config import (
    find_config,
    read_config,
)
from tests.support.repository import ROOT

LEAST = '[[pair]]\nname = "a"\nurdf = "a.urdf"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a.urdf", "a.xml", "b.urdf"):
        (tmp_path / name).write_text("<robot/>")
    (tmp_path / "meshes").mkdir()
    return tmp_path


def write_config(folder: Path, text: str) -> Path:
    path = folder / "pupper-analysis.toml"
    path.write_text(text)
    return path


def test_missing_keys_have_defaults(folder: Path) -> None:
    read = read_config(write_config(folder, LEAST))
    assert read.baseline == folder / "pupper-analysis-baseline.txt"
    assert read.fail_on is Severity.ERROR
    (pair,) = read.pairs
    assert (pair.names, pair.feet, pair.packages, pair.disabled) == ({}, (), {}, {})
    assert pair.tolerances == Tolerances()


def test_configuration_that_is_empty_or_unreadable_is_refused(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"no \[\[pair\]\]; add"):
        read_config(write_config(folder, "# nothing\n"))
    with pytest.raises(ModelError, match="no such file"):
        read_config(folder / "none.toml")
    (folder / "latin.toml").write_bytes(b'name = "\xe4"\n')
    with pytest.raises(ModelError, match=r"latin.toml:1: byte 0xe4 is not UTF-8"):
        read_config(folder / "latin.toml")


def test_configuration_with_all_keys_is_read(folder: Path) -> None:
    text = """
baseline = "known.txt"
fail-on = "warning"
strict = true
packages = { robot = "meshes" }
tolerances = { mass = 1e-2, com = 1e-3 }
[disable]
armature-zero = "direct drive"

[[pair]]
name = "a"
urdf = "a.urdf"
mjcf = "a.xml"
feet = ["FL", "FR"]
[pair.map]
two = "zwei"
[pair.tolerances]
mass = 0.5
[pair.disable]
gravity-unusual = "it hangs"
[[pair]]
name = "b"
urdf = "b.urdf"
strict = false
"""
    read = read_config(write_config(folder, text))
    assert read.baseline == folder / "known.txt"
    assert read.fail_on is Severity.WARNING
    a, b = read.pairs
    assert (a.name, a.urdf, a.mjcf) == ("a", folder / "a.urdf", folder / "a.xml")
    assert a.names == {"two": "zwei"}
    assert (a.feet, a.strict) == (("FL", "FR"), True)
    assert a.packages == {"robot": folder / "meshes"}
    assert a.disabled == {"armature-zero": "direct drive", "gravity-unusual": "it hangs"}
    assert a.tolerances == Tolerances.strict().with_values({"mass": 0.5, "com": 1e-3})
    assert (b.name, b.mjcf, b.strict) == ("b", None, False)
    assert b.disabled == {"armature-zero": "direct drive"}
    assert b.tolerances == Tolerances().with_values({"mass": 1e-2, "com": 1e-3})


REFUSED = {
    "an unknown key": ('bas = "x"\n' + LEAST, 1, "no key 'bas'; valid: baseline, fail-on"),
    "one of a pair": (LEAST + 'foot = "x"\n', 4, "no key 'foot' in pair; valid: name, urdf"),
    "of the second pair": (
        LEAST + '[[pair]]\nname = "b"\nurdf = "b.urdf"\n\n# well\nfeed = []\n',
        9,
        "no key 'feed' in pair",
    ),
    "an inline table": (LEAST + "tolerances = { mas = 1 }\n", 4, "in pair.tolerances; valid: mass"),
    "a table": (LEAST + "[pair.tolerances]\nmass = 1\nmas = 1\n", 6, "no key 'mas'"),
    "after a long text": (
        'baseline = """\\\n  [[pair]] # not\n  x.toml"""\n\n' + LEAST + "strct = true\n",
        8,
        "no key 'strct'",
    ),
    "a rule": (LEAST + "[pair.disable]\nmass = 'x'\n", 5, "no audit rule 'mass'"),
    "no reason": (
        LEAST + "[pair.disable]\ngravity-unusual = ' '\n",
        5,
        "give the reason, in quotes",
    ),
    "a reason that is none": (LEAST + "[disable]\ngravity-unusual = true\n", 5, "give the reason"),
    "a missing file": (LEAST.replace("a.urdf", "c.urdf"), 3, "no such file"),
    "a missing MJCF": (LEAST + 'mjcf = "no.xml"\n', 4, "mjcf = 'no.xml'"),
    "no name": ('\n[[pair]]\nurdf = "a.urdf"\n', 2, "requires a name"),
    "no model": ('[[pair]]\nname = "a"\n', 1, "requires a urdf, an mjcf, or both"),
    "a name twice": (LEAST + LEAST, 5, "duplicate pair 'a'"),
    "no severity": ('fail-on = "bad"\n' + LEAST, 1, "one of error, warning, note"),
    "no number": (LEAST + "tolerances.mass = 'x'\n", 4, "a positive number"),
    "a negative one": (LEAST + "tolerances.mass = -1\n", 4, "a positive number"),
    "an infinite one": (LEAST + "tolerances.mass = inf\n", 4, "a positive number"),
    "a switch as one": (LEAST + "tolerances.mass = true\n", 4, "a positive number"),
    "no switch": (LEAST + "strict = 1\n", 4, "true or false"),
    "no switch above": ("strict = 'yes'\n" + LEAST, 1, "true or false"),
    "feet": (LEAST + "feet = 'FL'\n", 4, "a list of names"),
    "a folder": (LEAST + "packages.x = 'nowhere'\n", 4, "a folder that exists"),
    "a mapping": (LEAST + "map.x = 1\n", 4, "the name in the MJCF"),
    "no tables": ("pair = 1\n", 1, "tables that begin with [[pair]]"),
    "a table that is none": (LEAST + "map = 1\n", 4, "give a table"),
    "an empty text": (LEAST + 'mjcf = ""\n', 4, "a text, in quotes"),
    "no TOML": (LEAST + "mjcf = \n", 4, "not a TOML file"),
    "a table above": ("[tolerances]\nmas = 1\n" + LEAST, 2, "no key 'mas' in tolerances"),
    "a huge one": (LEAST + f"tolerances.mass = 1{'0' * 400}\n", 4, "a positive number"),
    "no file of a pattern": (LEAST.replace("a.urdf", "no/*.urdf"), 3, "no file matches"),
}


@pytest.mark.parametrize(("text", "line", "said"), REFUSED.values(), ids=REFUSED)
def test_invalid_configuration_is_refused_with_its_line(
    folder: Path, text: str, line: int, said: str
) -> None:
    path = write_config(folder, text)
    with pytest.raises(ModelError) as caught:
        read_config(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{path}:{line}: ")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_configuration_without_pairs_is_refused(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"no \[\[pair\]\]; add"):
        read_config(write_config(folder, "# nothing\n"))


def test_table_of_a_tool_is_accepted(folder: Path) -> None:
    entry = '\n[[contract.key]]\nquantity = "kp"\nnames = ["gain"]\n'
    (pair, *_) = read_config(write_config(folder, f"{LEAST}{entry}")).pairs
    assert pair.name
    with pytest.raises(ModelError, match="contract"):
        read_config(write_config(folder, f"contract = 3\n{LEAST}"))


def test_page_of_configuration_lists_exactly_the_valid_keys(folder: Path) -> None:
    values: dict[str, set[str]] = {"the file": set(), "a pair": set(), "both": set()}
    with (ROOT / "docs/data/config-keys.csv").open(newline="") as table:
        for row in csv.DictReader(table):
            values[row["of"]] |= {name.strip() for name in row["key"].split(",")}
    guards = find_tool_modules("guard")
    assert values["the file"] | values["both"] == {*config._TOP_KEYS, *guards}
    assert values["a pair"] | values["both"] == {*config._PAIR_KEYS, *find_tool_modules("guard")}
    page = (ROOT / "docs/how-to/check.md").read_text()
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.S)
    for name in ("urdf/go1.urdf", "mjcf/go1.xml"):
        (folder / name).parent.mkdir()
        (folder / name).write_text("")
    (pair,) = read_config(write_config(folder, example)).pairs
    assert pair.names == {"lf_haa": "FL_hip"}
    assert pair.tolerances.mass == 1e-3


def test_the_config_is_found_in_a_folder_above(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, below = write_config(folder, LEAST), folder / "x" / "y"
    below.mkdir(parents=True)
    assert find_config(below) == path
    monkeypatch.chdir(below)
    assert find_config() == path
    (below / path.name).mkdir()  # a folder of that name is none
    assert find_config() == path


def test_missing_configuration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=re.escape(os.fspath(tmp_path))):
        find_config(tmp_path)


@pytest.mark.slow
def test_line_of_each_key_is_that_of_its_statement() -> None:
    """Reference: the text of pyproject.toml, a long file with nested tables and arrays."""
    text = (ROOT / "pyproject.toml").read_text()
    lines = text.split("\n")
    for name in tomllib.loads(text)["project"]:
        line = config.find_key_line(text, ("project", name))
        assert line is not None
        assert lines[line - 1].startswith((name, f"[project.{name}"))
    line = config.find_key_line(text, ("tool", "mypy", "overrides", 0, "module"))
    assert line is not None
    assert lines[line - 1].startswith("module = ")
    for key in (("tool", "nothing"), ("project", "dependencies", 99), ("project", 0)):
        assert config.find_key_line(text, key) is None


def test_pattern_with_a_leading_dot_keeps_all_pairs_and_their_names(tmp_path: Path) -> None:
    """Two names with the same third letter: the prefix is cut from the path without "./"."""
    for name in ("abc", "xyc"):
        for kind, suffix in (("urdf", "urdf"), ("mjcf", "xml")):
            (tmp_path / kind).mkdir(exist_ok=True)
            (tmp_path / kind / f"{name}.{suffix}").write_text("<robot/>")
    text = '[[pair]]\nname = "all"\nurdf = "./urdf/*.urdf"\nmjcf = "mjcf//*.xml"\n'
    pairs = read_config(write_config(tmp_path, text)).pairs
    assert [pair.name for pair in pairs] == ["all/abc", "all/xyc"]
    assert all(pair.urdf is not None and pair.mjcf is not None for pair in pairs)
