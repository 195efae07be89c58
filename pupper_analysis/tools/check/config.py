"""``pupper-analysis.toml``: which models of a repository are checked, and how."""

from __future__ import annotations

import json
import os
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from lxml import etree

from pupper_analysis.base import inputs
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Severity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ConfigurationError, InputError, ModelError
from pupper_analysis.base.files import whole_file
from pupper_analysis.base.inputs import MOST_TEXT, is_input, read_input
from pupper_analysis.base.kinds import MODEL
from pupper_analysis.base.tools import offering
from pupper_analysis.models.loading import kind_of
from pupper_analysis.models.places import source_name
from pupper_analysis.robot.matching.match import read_mapping
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.audit.audit import RULES

# Where in a TOML file a key is: what Python's reader leaves out.

Key = tuple[str | int, ...]
"""The way to a value: names of keys, and numbers (from 0) in arrays."""


@dataclass(frozen=True, eq=False)
class TomlFile:
    """A TOML file that was read.

    Attributes:
        path: The file.
        text: Its text.
        values: Its values.
    """

    path: Path
    text: str = field(repr=False)
    values: dict[str, Any]

    def line_of(self, key: Key) -> int | None:
        """Returns the line, from 1, of the statement that brings in a key; None if none does.

        The text is read from its beginning to the end of each line, as far as that is TOML: the
        statement after which the key is there, is its own.
        """
        start = None
        lines = self.text.split("\n")
        for number, line in enumerate(lines, start=1):
            if start is None and line.strip() and not line.lstrip().startswith("#"):
                start = number
            try:
                values = tomllib.loads("\n".join(lines[:number]))
            except tomllib.TOMLDecodeError:
                continue  # in the middle of a statement
            if _has(values, key):
                return start
            start = None
        return None

    def error(self, key: Key, problem: Diagnostic) -> ModelError:
        """Returns the error that tells the line of a key, and what is wrong with it."""
        return ModelError(source_name(self.path, self.line_of(key)), problem)


def _has(values: Any, key: Key) -> bool:
    for part in key:
        if isinstance(part, int):
            if not isinstance(values, list) or len(values) <= part:
                return False
        elif not isinstance(values, dict) or part not in values:
            return False
        values = values[part]
    return True


def read_toml(path: Path) -> TomlFile:
    """Reads a TOML file.

    Raises:
        ModelError: If it cannot be read; the message tells the line.
    """
    try:
        return TomlFile(path, *inputs.read_toml(path))
    except InputError as error:
        raise ModelError(source_name(path, error.line), error.cause) from error


CONFIG: Final = "pupper-analysis.toml"
"""The name under which it is looked for."""

BASELINE: Final = "pupper-analysis-baseline.txt"
"""Where the baseline is, beside it, unless it says otherwise."""


@dataclass(frozen=True, eq=False)
class GuardedPair:
    """One robot: its URDF, its MJCF, or both.

    Attributes:
        name: Its name in remarks and in the baseline.
        urdf: The URDF; None if there is none.
        mjcf: The MJCF; None if there is none. With both, they are compared.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        feet: Frames that are compared; all that both files have, if empty.
        packages: {ROS package: its folder}.
        base: What the base is called, by the comparison; None if any will do.
        tolerances: Of the comparison.
        strict: Whether names, damping that a URDF does not state, and tilts are differences.
        disabled: {rule of the audit that is not run: the reason}.
        guards: {tool: what it is asked to hold against the models}, of tools that have a
            ``guard.py``.
    """

    name: str
    urdf: Path | None
    mjcf: Path | None
    names: Mapping[str, str]
    feet: tuple[str, ...]
    packages: Mapping[str, Path]
    base: str | None
    tolerances: Tolerances
    strict: bool
    disabled: Mapping[str, str]
    guards: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class GuardConfig:
    """What is checked.

    Attributes:
        path: The file that says so; paths in it are relative to its folder.
        pairs: The robots.
        fail_on: The least severity of a finding that fails.
        baseline: The file of what is known already; it need not exist.
    """

    path: Path
    pairs: tuple[GuardedPair, ...]
    fail_on: Severity
    baseline: Path
    file: TomlFile = field(repr=False)


def find_config(start: Path | None = None) -> Path:
    """Looks for the file in a folder, then in those above it.

    Args:
        start: The folder; the current one by default.

    Raises:
        ConfigurationError: If there is none.
    """
    folder = (start or Path.cwd()).absolute()
    for each in (folder, *folder.parents):
        if (each / CONFIG).is_file():
            return each / CONFIG
    raise ConfigurationError("config", diagnose("no-config", file=CONFIG, folder=folder))


def is_part(path: Path) -> bool:
    """Whether a file is a part that other MJCFs include, and no model."""
    try:
        # Neither entities nor the network: what stands in a repository may be anybody's.
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
        return bool(etree.fromstring(read_input(path, MOST_TEXT), parser).tag == "mujocoinclude")
    except (etree.XMLSyntaxError, InputError):
        return False  # what is wrong with it is said when it is checked


def read_config(path: Path) -> GuardConfig:
    """Reads it.

    Raises:
        ModelError: If it cannot be read, or says what is not valid; it tells the line, and what
            would be valid.
    """
    return _Reader(read_toml(path)).config()


_WILD: Final = "*?["
_SHARED: Final = ("strict", "tolerances", "packages", "disable")
_TOP: Final = ("baseline", "fail-on", *_SHARED, "pair")
_PAIR: Final = ("name", "urdf", "mjcf", "map", "map-file", "feet", "base", *_SHARED)


_KINDS: Final = tuple(kind.name for kind in fields(Tolerances))


class _Reader:
    """Reads one file, and refuses what it does not know."""

    def __init__(self, file: TomlFile) -> None:
        self.file, self.folder = file, file.path.parent

    def config(self) -> GuardConfig:
        top = self.file.values
        self.check_keys(top, (), _TOP)
        stated = self.text(top, (), "fail-on") or str(Severity.ERROR)
        try:
            fail_on = Severity(stated)
        except ValueError:
            severities = diagnose("one-of", names=[str(each) for each in Severity])
            raise self.invalid(("fail-on",), stated, severities) from None
        entries = top.get("pair", [])
        if not isinstance(entries, list) or not all(isinstance(each, dict) for each in entries):
            raise self.invalid(("pair",), entries, Term("tables that begin with [[pair]]"))
        if not entries:
            raise ModelError(self.file.path, diagnose("config-without-pair"))
        pairs: tuple[GuardedPair, ...] = ()
        for number, entry in enumerate(entries):
            for pair in self.pairs(entry, ("pair", number)):
                if pair.name in [other.name for other in pairs]:
                    message = diagnose("pair-twice", pair=pair.name)
                    raise self.file.error(("pair", number, "name"), message)
                pairs = (*pairs, pair)
        baseline = self.folder / (self.text(top, (), "baseline") or BASELINE)
        return GuardConfig(self.file.path, pairs, fail_on, baseline, self.file)

    def pairs(self, entry: dict[str, Any], key: Key) -> Iterator[GuardedPair]:
        """Yields the robots of an entry: one, or one for each file that its pattern matches."""
        self.check_keys(entry, key, (*_PAIR, *offering("guard")))
        given = {kind: self.text(entry, key, kind) for kind in ("urdf", "mjcf")}
        patterns = {kind: text for kind, text in given.items() if text is not None}
        if not any(char in text for text in patterns.values() for char in _WILD):
            yield self.pair(entry, key)
            return
        stars = [text.count("*") for text in patterns.values()]
        if len(patterns) == 2 and (stars != [1, 1] or any(c in t for t in patterns.values()
                                                          for c in "?[")):  # fmt: skip
            valid = Term("one * in each, which stands for the same in both")
            raise self.invalid((*key, "urdf"), patterns["urdf"], valid)
        found: dict[str, dict[str, str]] = {}
        for kind, pattern in patterns.items():
            for file in self.matches(pattern, (*key, kind)):
                part = file
                if len(patterns) == 2:
                    head, tail = pattern.split("*")
                    part = file[len(head) : len(file) - len(tail)]
                found.setdefault(part, {})[kind] = file
        for part, files in found.items():
            others = {name: value for name, value in entry.items() if name not in patterns}
            name = f"{entry.get('name', '')}/{part}" if entry.get("name") else ""
            yield self.pair({**others, "name": name, **files}, key)

    def matches(self, pattern: str, key: Key) -> list[str]:
        """Returns the files that a pattern matches, relative to the configuration."""
        try:
            files = (path for path in self.folder.glob(pattern) if path.is_file())
            paths = sorted(path for path in files if not is_part(path))
        except (NotImplementedError, ValueError) as error:
            raise self.invalid(key, pattern, Term("a pattern relative to this file")) from error
        if not paths:
            message = diagnose("no-file-matches", key=str(key[-1]), pattern=pattern)
            raise self.file.error(key, message)
        return [path.relative_to(self.folder).as_posix() for path in paths]

    def pair(self, entry: dict[str, Any], key: Key) -> GuardedPair:
        self.check_keys(entry, key, (*_PAIR, *offering("guard")))
        name = self.text(entry, key, "name")
        urdf, mjcf = (self.model(entry, key, kind) for kind in ("urdf", "mjcf"))
        if not name:
            raise self.file.error(key, diagnose("pair-without-name"))
        if urdf is None and mjcf is None:
            raise self.file.error(key, diagnose("pair-without-file", pair=name))
        top = self.file.values
        tolerances = Tolerances.strict() if self.flag(entry, key, "strict") else Tolerances()
        given = {**self.tolerances(top, ()), **self.tolerances(entry, key)}
        return GuardedPair(
            name=name,
            urdf=urdf,
            mjcf=mjcf,
            names=self.names(entry, key),
            feet=self.texts(entry, key, "feet"),
            packages={**self.packages(top, ()), **self.packages(entry, key)},
            base=self.text(entry, key, "base"),
            tolerances=tolerances.changed(given),
            strict=self.flag(entry, key, "strict"),
            disabled={**self.disabled(top, ()), **self.disabled(entry, key)},
            guards={
                tool: self.sources(entry, key, tool) for tool in offering("guard") if tool in entry
            },
        )

    def sources(self, entry: dict[str, Any], key: Key, tool: str) -> tuple[Path, ...]:
        """Returns files or folders that a tool is asked for; of a file also FILE:NAME."""
        found = self.texts(entry, key, tool)
        for text in found:
            path = self.folder / text
            if not path.exists() and not (self.folder / text.rpartition(":")[0]).is_file():
                message = diagnose("pair-file-missing", key=tool, file=text)
                raise self.file.error((*key, tool), message)
        return tuple(self.folder / text for text in found)

    def model(self, entry: dict[str, Any], key: Key, kind: str) -> Path | None:
        text = self.text(entry, key, kind)
        if text is None:
            return None
        path = self.folder / text
        if not is_input(path):
            message = diagnose("pair-file-missing", key=kind, file=text)
            raise self.file.error((*key, kind), message)
        return path

    def names(self, entry: dict[str, Any], key: Key) -> dict[str, str]:
        file = self.text(entry, key, "map-file")
        names = read_mapping(self.folder / file) if file is not None else {}
        for old, new in self.table(entry, key, "map").items():
            if not isinstance(new, str):
                raise self.invalid((*key, "map", old), new, Term("the name in the MJCF, in quotes"))
            if names.setdefault(old, new) != new:
                message = diagnose("mapped-to-both", joint=old, one=names[old], other=new)
                raise self.file.error((*key, "map", old), message)
        return names

    def packages(self, entry: dict[str, Any], key: Key) -> dict[str, Path]:
        found = {}
        for name, folder in self.table(entry, key, "packages").items():
            if not isinstance(folder, str) or not (self.folder / folder).is_dir():
                raise self.invalid((*key, "packages", name), folder, Term("a folder that exists"))
            found[name] = self.folder / folder
        return found

    def tolerances(self, entry: dict[str, Any], key: Key) -> dict[str, float]:
        table = self.table(entry, key, "tolerances")
        self.check_keys(table, (*key, "tolerances"), _KINDS)
        for name, value in table.items():
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not 0 < value < float("inf"):
                valid = Term("a positive number")
                raise self.invalid((*key, "tolerances", name), value, valid)
        return {name: float(value) for name, value in table.items()}

    def disabled(self, entry: dict[str, Any], key: Key) -> dict[str, str]:
        table = self.table(entry, key, "disable")
        self.check_keys(table, (*key, "disable"), tuple(RULES), rules=True)
        for rule, reason in table.items():
            if not isinstance(reason, str) or not reason.strip():
                valid = Term("the reason, in quotes")
                raise self.invalid((*key, "disable", rule), reason, valid)
        return dict(table)

    def check_keys(
        self, table: Mapping[str, Any], key: Key, valid: tuple[str, ...], *, rules: bool = False
    ) -> None:
        """Refuses keys that are not valid."""
        for name in table:
            if name not in valid:
                inside = ".".join(part for part in key if isinstance(part, str))
                message = diagnose(
                    "rule-unknown" if rules else "key-unknown",
                    key=name,
                    within=inside,
                    known=valid,
                )
                raise self.file.error((*key, name), message)

    def text(self, table: dict[str, Any], key: Key, name: str) -> str | None:
        value = table.get(name)
        if value is not None and (not isinstance(value, str) or not value or "\0" in value):
            raise self.invalid((*key, name), value, Term("a text, in quotes"))
        return value

    def texts(self, table: dict[str, Any], key: Key, name: str) -> tuple[str, ...]:
        values = table.get(name, [])
        if not isinstance(values, list) or not all(isinstance(each, str) for each in values):
            raise self.invalid((*key, name), values, Term("a list of names, in quotes"))
        return tuple(values)

    def flag(self, table: dict[str, Any], key: Key, name: str) -> bool:
        """Returns a switch of a pair, or of the whole file."""
        for values, way in ((table, key), (self.file.values, ())):
            value = values.get(name)
            if value is not None and not isinstance(value, bool):
                raise self.invalid((*way, name), value, Term("true or false"))
            if value is not None:
                return value
        return False

    def table(self, table: dict[str, Any], key: Key, name: str) -> dict[str, Any]:
        value = table.get(name, {})
        if not isinstance(value, dict):
            raise self.invalid((*key, name), value, Term("a table"))
        return value

    def invalid(self, key: Key, value: object, valid: Term | Diagnostic) -> ModelError:
        message = diagnose("setting-not-valid", key=str(key[-1]), value=repr(value), valid=valid)
        return self.file.error(key, message)


# The first `pupper-analysis.toml` of a repository: the models that its folders have.

_PASSED_OVER: Final = ("node_modules", "site-packages", "build", "install", "log")
"""Folders of what was made or installed; those that begin with a dot are passed over too."""

_HEAD: Final = """\
# What pupper-analysis check checks. A pair is one robot's two files, which are compared: here, a
# URDF and an MJCF of one name. The guide of `check` lists all keys.
"""


def write_config(folder: Path) -> tuple[Path, tuple[str, ...]]:
    """Writes a configuration that names all models in a folder and those below it.

    Args:
        folder: The repository's top folder.

    Returns:
        The file, and the names of the models in it.

    Raises:
        ConfigurationError: If there is a configuration already, or no model.
        OutputError: If it cannot be written.
    """
    path = folder / CONFIG
    if path.exists():
        raise ConfigurationError("--init", diagnose("config-there-already", file=path))
    entries = entries_of(folder)
    if not entries:
        raise ConfigurationError("--init", diagnose("no-models", folder=folder.absolute()))
    with whole_file(path, MODEL) as file:
        file.write("\n".join([_HEAD, *map(_table, entries)]).encode(errors="replace"))
    return path, tuple(entry["name"] for entry in entries)


def _table(entry: dict[str, str]) -> str:
    # JSON's text is TOML's, but for this one.
    texts = {k: json.dumps(v, ensure_ascii=False) for k, v in entry.items()}
    keys = [f"{key} = {text}\n".replace("\x7f", "\\u007f") for key, text in texts.items()]
    return "".join(["[[pair]]\n", *keys])


def entries_of(folder: Path) -> list[dict[str, str]]:
    """Returns the models of a folder and those below it: a URDF, an MJCF, or both of one stem."""
    found: dict[str, list[Path]] = {"urdf": [], "mjcf": []}
    for path in _files(folder):
        kind = kind_of(path)
        if kind:
            found[kind].append(path.relative_to(folder))
    stems = Counter(path.stem.lower() for paths in found.values() for path in paths)
    entries = []
    for urdf in found["urdf"]:
        stem = urdf.stem.lower()
        alike = {kind: [o for o in found[kind] if o.stem.lower() == stem] for kind in found}
        beside = {kind: [o for o in alike[kind] if o.parent == urdf.parent] for kind in alike}
        # Those of one folder are one robot's, whatever else bears the name elsewhere.
        pairs = [one for one in (beside, alike) if all(len(paths) == 1 for paths in one.values())]
        name = urdf.stem if stems[stem] == (2 if pairs else 1) else urdf.as_posix()
        mjcf = {"mjcf": pairs[0]["mjcf"][0].as_posix()} if pairs else {}
        entries.append({"name": name, "urdf": urdf.as_posix(), **mjcf})
    compared = {entry["mjcf"] for entry in entries if "mjcf" in entry}
    for mjcf_path in found["mjcf"]:
        if mjcf_path.as_posix() not in compared:
            alone = stems[mjcf_path.stem.lower()] == 1
            name = mjcf_path.stem if alone else mjcf_path.as_posix()
            entries.append({"name": name, "mjcf": mjcf_path.as_posix()})
    return entries


def _files(folder: Path) -> Iterator[Path]:
    """Yields the files that may be models, in the order of their names."""
    for top, folders, files in os.walk(folder):
        kept = (name for name in folders if name[0] != "." and name not in _PASSED_OVER)
        folders[:] = sorted(kept)
        for name in sorted(files):
            if Path(name).suffix.lower() in (".urdf", ".xml", ".mjcf"):
                yield Path(top) / name
