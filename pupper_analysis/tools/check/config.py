"""Configuration ``pupper-analysis.toml``: models to be checked, and settings.

`read_config` converts the file to a `GuardConfig`: the pairs of files, with patterns expanded, and
the settings. `write_config` writes a first configuration from the models below a folder.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path, PurePath
from typing import Any, Final, NamedTuple

from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, Severity, Term, diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError, ModelError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.inputs import (
    CONFIG_NAME,
    GENERATED_FOLDERS,
    MAX_TEXT_BYTES,
    is_folder,
    is_input,
    read_input,
    read_toml,
)
from pupper_analysis.base.kinds import MODEL_KIND
from pupper_analysis.base.tools import find_tool_modules
from pupper_analysis.models.loading import kind_of
from pupper_analysis.models.places import source_name
from pupper_analysis.models.xml import blank_faulty_declaration
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.audit.audit import RULES

BASELINE_NAME: Final = "pupper-analysis-baseline.txt"
"""Default file name of the baseline, next to the configuration."""


@dataclass(frozen=True, eq=False)
class GuardedPair:
    """Files of a robot: URDF, MJCF, or both.

    Attributes:
        name: Name in remarks and in the baseline.
        urdf: URDF; None without.
        mjcf: MJCF; None without. With both, the files are compared.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        feet: Frames that are compared, as named in the MJCF; all common frames if empty.
        packages: {ROS package: folder}.
        tolerances: Tolerances of the comparison.
        strict: Whether names, damping and friction that a URDF does not state, and tilts of a fixed
            base are differences. The default of all tolerances is then 1e-9.
        disabled: {disabled audit rule: reason}.
        guards: {tool: sources to compare with the models}, for tools with a ``guard.py``.
    """

    name: str
    urdf: Path | None
    mjcf: Path | None
    names: Mapping[str, str]
    feet: tuple[str, ...]
    packages: Mapping[str, Path]
    tolerances: Tolerances
    strict: bool
    disabled: Mapping[str, str]
    guards: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class GuardConfig:
    """Content of a configuration file of `check`: pairs of models, and settings.

    Attributes:
        path: Path of the configuration. Relative paths in the file refer to its folder.
        pairs: Files of each robot.
        fail_on: Lowest severity of a failing finding.
        baseline: Path of the baseline, which need not exist.
    """

    path: Path
    pairs: tuple[GuardedPair, ...]
    fail_on: Severity
    baseline: Path


def find_config(start: Path | None = None) -> Path:
    """Return the path of the configuration file (`CONFIG_NAME`) in a folder or the folders above.

    Default: the current folder.

    Raises:
        ConfigurationError: If none of these folders contains a configuration.
    """
    folder = (start or Path.cwd()).absolute()
    for parent in (folder, *folder.parents):
        if (parent / CONFIG_NAME).is_file():
            return parent / CONFIG_NAME
    raise ConfigurationError("config", diagnose("no-config", file=CONFIG_NAME, folder=folder))


def is_include_part(path: Path) -> bool:
    """Return True if a file is a part that other MJCFs include (root element ``mujocoinclude``).

    False for a file that cannot be read, or that is no valid XML.
    """
    try:
        # No entities and no network access: the files are not trusted.
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
        data = blank_faulty_declaration(read_input(path, MAX_TEXT_BYTES))
        return bool(etree.fromstring(data, parser).tag == "mujocoinclude")
    except (etree.XMLSyntaxError, InputError):
        return False  # the error is reported by the check


def read_config(path: Path) -> GuardConfig:
    """Read a ``pupper-analysis.toml``: pairs of model files, tolerances and settings.

    Raises:
        ModelError: If the file cannot be read, or a key, value or named file is missing or not
            valid. The message states the line, if known.
    """
    try:
        text, values = read_toml(path)
    except InputError as error:
        raise ModelError(source_name(path, error.line), error.cause) from error
    return _ConfigReader(path, text, values).read()


_WILDCARDS: Final = "*?["
"""Characters that mark the path of a model file as a pattern for several files."""


class _ValueKind(NamedTuple):
    """Required kind of a value in the configuration: description for errors, and test function."""

    valid: Term
    check: Callable[[Any], bool]


def _is_text(value: Any) -> bool:
    """Return True for a string that is not blank and has no zero byte."""
    return isinstance(value, str) and bool(value.strip()) and "\0" not in value


def _is_positive_number(value: Any) -> bool:
    """Return True for a positive number below 1e300."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and 0 < value < 1e300


def _is_list(value: Any, kind: type) -> bool:
    """Return True for a list whose items all have a type."""
    return isinstance(value, list) and all(isinstance(item, kind) for item in value)


_TEXT_VALUE: Final = _ValueKind(Term("a text, in quotes"), _is_text)
"""Kind of a value in the configuration: text."""
_NAMES_VALUE: Final = _ValueKind(
    Term("a list of names, in quotes"), lambda value: _is_list(value, str)
)
"""Kind of a value in the configuration: list of names."""
_TABLE_VALUE: Final = _ValueKind(Term("a table"), lambda value: isinstance(value, dict))
"""Kind of a value in the configuration: table."""
_COMMON_KEYS: Final = {
    "strict": _ValueKind(Term("true or false"), lambda value: isinstance(value, bool)),
    **dict.fromkeys(("tolerances", "packages", "disable"), _TABLE_VALUE),
}
"""{key: required kind of its value} at the top of a configuration and in each [[pair]]."""
_PAIRS_VALUE: Final = _ValueKind(
    Term("tables that begin with [[pair]]"), lambda value: _is_list(value, dict)
)
"""Kind of a value in the configuration: array of tables."""
_TOP_KEYS: Final = {
    "baseline": _TEXT_VALUE,
    "fail-on": _TEXT_VALUE,
    **_COMMON_KEYS,
    "pair": _PAIRS_VALUE,
}
"""{key: required kind of its value} at the top of a configuration, without the tables of tools."""
_ENTRY_KEYS: Final = {**dict.fromkeys(("name", "urdf", "mjcf"), _TEXT_VALUE), "feet": _NAMES_VALUE}
"""{key: required kind of its value} of the keys that are valid in a ``[[pair]]`` entry but not at
the top, except ``map``."""
_PAIR_KEYS: Final = {**_ENTRY_KEYS, "map": _TABLE_VALUE, **_COMMON_KEYS}
"""{key: required kind of its value} in a ``[[pair]]`` entry (URDF and MJCF of one robot), without
the keys that tools add by a module ``guard``."""
_TABLE_VALUES: Final = {
    "tolerances": _ValueKind(Term("a positive number"), _is_positive_number),
    "packages": _ValueKind(Term("a folder that exists"), _is_text),
    "disable": _ValueKind(Term("the reason, in quotes"), _is_text),
    "map": _ValueKind(Term("the name in the MJCF, in quotes"), _is_text),
}
"""{key of a table: required kind of the values in this table}."""
_TABLE_KEYS: Final = {"tolerances": [kind.name for kind in fields(Tolerances)], "disable": [*RULES]}
"""{table of ``pupper-analysis.toml``: valid keys in this table}. The tables ``packages`` and
``map`` accept any key."""


KeyPath = tuple[str | int, ...]
"""Path of a value in a TOML file: names of keys, and indices (from 0) in arrays of tables."""


def find_key_line(text: str, key: KeyPath) -> int | None:
    """Return the line, from 1, of the TOML statement that defines a key; None if undefined."""
    start = None
    lines = text.split("\n")
    for number, line in enumerate(lines, start=1):
        if start is None and line.strip() and not line.lstrip().startswith("#"):
            start = number
        try:
            values = tomllib.loads("\n".join(lines[:number]))
        except tomllib.TOMLDecodeError:
            continue  # inside a statement
        if _contains_path(values, key):
            return start
        start = None
    return None


def _contains_path(values: Any, key: KeyPath) -> bool:
    """Return True if nested tables and arrays have a value at the path ``key``."""
    for part in key:
        if isinstance(part, int):
            if not isinstance(values, list) or len(values) <= part:
                return False
        elif not isinstance(values, dict) or part not in values:
            return False
        values = values[part]
    return True


class _ConfigReader:
    """Reader of a configuration file. Unknown keys and invalid values are refused."""

    def __init__(self, path: Path, text: str, values: dict[str, Any]) -> None:
        self.path, self.folder, self.top = path, path.parent, values
        self._text, self._entry = text, 0  # index of the current [[pair]]

    def make_error(self, key: KeyPath, message: Diagnostic) -> ModelError:
        """Return the error for a key of the configuration, with the line of the key, if found."""
        return ModelError(source_name(self.path, find_key_line(self._text, key)), message)

    def locate_key(self, *key: str) -> KeyPath:
        """Return the full path of a key in the configuration, for a message.

        The path starts with the current ``[[pair]]`` if this table contains the key.
        """
        own: KeyPath = ("pair", self._entry, *key)
        return own if _contains_path(self.top, own) else key

    def read(self) -> GuardConfig:
        """Return the model pairs and settings of the configuration file.

        Raises:
            ModelError: At the first key or value that is missing or not valid.
        """
        # A tool reads its own table.
        tools = dict.fromkeys(find_tool_modules("guard"), _TABLE_VALUE)
        self.check_table(self.top, (), {**_TOP_KEYS, **tools})
        entries = self.top.get("pair", [])
        if not entries:
            raise ModelError(self.path, diagnose("config-without-pair"))
        pairs: dict[str, GuardedPair] = {}
        for self._entry, entry in enumerate(entries):
            for pair in self.list_pairs(entry):
                if pair.name in pairs:
                    raise self.make_error(
                        self.locate_key("name"), diagnose("pair-twice", pair=pair.name)
                    )
                pairs[pair.name] = pair
        stated = self.top.get("fail-on", str(Severity.ERROR))
        try:
            fail_on = Severity(stated)
        except ValueError:
            severities = diagnose("one-of", names=[str(severity) for severity in Severity])
            raise self.make_value_error(("fail-on",), stated, severities) from None
        baseline = self.folder / self.top.get("baseline", BASELINE_NAME)
        return GuardConfig(self.path, tuple(pairs.values()), fail_on, baseline)

    def list_pairs(self, entry: dict[str, Any]) -> Iterator[GuardedPair]:
        """Yield the pair of models of a ``[[pair]]`` entry; with wildcards, a pair per match.

        Raises:
            ModelError: If a key or value is not valid, a file is missing, or no file matches.
        """
        self.check_table(
            entry,
            ("pair", self._entry),
            {**_PAIR_KEYS, **dict.fromkeys(find_tool_modules("guard"), _NAMES_VALUE)},
        )
        patterns = {
            kind: PurePath(entry[kind]).as_posix() for kind in ("urdf", "mjcf") if kind in entry
        }  # without "./" and "//", as in the paths of the matches
        if not any(char in text for text in patterns.values() for char in _WILDCARDS):
            yield self.make_pair(entry)
            return
        if len(patterns) == 2 and any(
            text.count("*") != 1 or "?" in text or "[" in text for text in patterns.values()
        ):
            valid = Term("one * in each, which stands for the same in both")
            raise self.make_value_error(self.locate_key("urdf"), patterns["urdf"], valid)
        files_by_part: dict[str, dict[str, str]] = {}
        for kind, pattern in patterns.items():
            for file in self.match_files(pattern, kind):
                part = file
                if len(patterns) == 2:
                    head, tail = pattern.split("*")
                    part = file[len(head) : len(file) - len(tail)]
                files_by_part.setdefault(part, {})[kind] = file
        for part, files in files_by_part.items():
            other_entries = {name: value for name, value in entry.items() if name not in patterns}
            name = {"name": f"{entry['name']}/{part}"} if "name" in entry else {}
            yield self.make_pair({**other_entries, **name, **files})

    def match_files(self, pattern: str, key: str) -> list[str]:
        """Return the paths of the files that a pattern matches, relative to the configuration.

        Files with the root element ``mujocoinclude`` are left out. ``key`` names the pattern in an
        error.

        Raises:
            ModelError: If no file matches, or the pattern is not valid.
        """
        try:
            files = (path for path in self.folder.glob(pattern) if path.is_file())
            paths = sorted(path for path in files if not is_include_part(path))
        except (NotImplementedError, ValueError) as error:
            valid = Term("a pattern relative to this file")
            raise self.make_value_error(self.locate_key(key), pattern, valid) from error
        if not paths:
            message = diagnose("no-file-matches", key=key, pattern=pattern)
            raise self.make_error(self.locate_key(key), message)
        return [path.relative_to(self.folder).as_posix() for path in paths]

    def make_pair(self, entry: dict[str, Any]) -> GuardedPair:
        """Convert an entry [[pair]] of the configuration to a `GuardedPair`.

        Raises:
            ModelError: If the entry has no name or no model, or a file or folder is missing.
        """
        if "name" not in entry:
            raise self.make_error(("pair", self._entry), diagnose("pair-without-name"))
        if not {"urdf", "mjcf"} & entry.keys():
            message = diagnose("pair-without-file", pair=entry["name"])
            raise self.make_error(("pair", self._entry), message)
        urdf, mjcf = (
            self.resolve_file(kind, entry[kind]) if kind in entry else None
            for kind in ("urdf", "mjcf")
        )
        both = {key: {**self.top.get(key, {}), **entry.get(key, {})} for key in _TABLE_VALUES}
        strict = entry.get("strict", self.top.get("strict", False))
        tolerances = Tolerances.strict() if strict else Tolerances()
        return GuardedPair(
            name=entry["name"],
            urdf=urdf,
            mjcf=mjcf,
            names=both["map"],
            feet=tuple(entry.get("feet", ())),
            packages={
                name: self.resolve_package(name, to) for name, to in both["packages"].items()
            },
            tolerances=tolerances.with_values(
                {name: float(value) for name, value in both["tolerances"].items()}
            ),
            strict=strict,
            disabled=both["disable"],
            guards={
                tool: tuple(self.resolve_file(tool, text) for text in entry[tool])
                for tool in find_tool_modules("guard")
                if tool in entry
            },
        )

    def resolve_file(self, key: str, text: str) -> Path:
        """Convert a file name in the configuration to a path, and check that the file exists.

        Relative paths refer to the folder of the configuration. If ``key`` is the name of a tool,
        ``text`` may also be a folder, or ``FILE:NAME``.

        Raises:
            ModelError: If there is no such file (or, for a tool, folder).
        """
        path, source = self.folder / text, self.folder / text.rpartition(":")[0]
        if not is_input(path) and (key in _PAIR_KEYS or not (is_folder(path) or is_input(source))):
            message = diagnose("pair-file-missing", key=key, file=text)
            raise self.make_error(self.locate_key(key), message)
        return path

    def resolve_package(self, name: str, folder: str) -> Path:
        """Return the folder of the ROS package ``name``.

        A relative path in the configuration refers to the folder of the configuration.

        Raises:
            ModelError: If there is no such folder.
        """
        if not is_folder(self.folder / folder):
            raise self.make_value_error(
                self.locate_key("packages", name), folder, _TABLE_VALUES["packages"].valid
            )
        return self.folder / folder

    def check_table(
        self, table: dict[str, Any], within: KeyPath, valid: Mapping[str, _ValueKind]
    ) -> None:
        """Raise an error for an invalid key or value of a table or of its `_TABLE_VALUES`.

        ``within`` is the path of the table, ``valid`` is {valid key: required kind of its value}.
        """
        for key, value in table.items():
            if key not in valid:
                raise self.make_key_error((*within, key), valid)
            if not valid[key].check(value):
                raise self.make_value_error((*within, key), value, valid[key].valid)
            for name, item in value.items() if key in _TABLE_VALUES else ():
                if name not in _TABLE_KEYS.get(key, value):
                    raise self.make_key_error(
                        (*within, key, name), _TABLE_KEYS[key], rule=key == "disable"
                    )
                if not _TABLE_VALUES[key].check(item):
                    raise self.make_value_error(
                        (*within, key, name), item, _TABLE_VALUES[key].valid
                    )

    def make_key_error(
        self, key: KeyPath, valid: Iterable[str], *, rule: bool = False
    ) -> ModelError:
        """Return the error for a key that its table does not allow, with the ``valid`` keys.

        ``rule`` is True if the key should be the name of an audit rule.
        """
        within = ".".join(part for part in key[:-1] if isinstance(part, str))
        code = "rule-unknown" if rule else "key-unknown"
        return self.make_error(key, diagnose(code, key=key[-1], within=within, known=tuple(valid)))

    def make_value_error(self, key: KeyPath, value: object, valid: Term | Diagnostic) -> ModelError:
        """Return the error for an invalid value of a key, with the valid values."""
        message = diagnose("setting-not-valid", key=key[-1], value=repr(value), valid=valid)
        return self.make_error(key, message)


# First `pupper-analysis.toml` of a repository, with all models in the folders.

_CONFIG_HEADER: Final = """\
# What pupper-analysis check checks. A pair is one robot's two files, which are compared: here, a
# URDF and an MJCF of one name. The guide of `check` lists all keys.
"""
"""Comment at the top of a new configuration."""


def write_config(folder: Path) -> tuple[Path, tuple[str, ...], dict[str, str]]:
    """Write a configuration that lists the models found in a folder and below.

    Returns:
        Path of the file, names of the pairs of a URDF and an MJCF, and {name of a single file:
        missing format, ``urdf`` or ``mjcf``}.

    Raises:
        ConfigurationError: If there is a configuration already, or no model.
        OutputError: If the file cannot be written.
    """
    path = folder / CONFIG_NAME
    if path.exists():
        raise ConfigurationError("--init", diagnose("config-there-already", file=path))
    entries = list_pair_entries(folder)
    if not entries:
        raise ConfigurationError("--init", diagnose("no-models", folder=folder.absolute()))
    with write_atomically(path, MODEL_KIND) as file:
        file.write(
            "\n".join([_CONFIG_HEADER, *map(_format_pair, entries)]).encode(errors="replace")
        )
    pairs = tuple(entry["name"] for entry in entries if {"urdf", "mjcf"} <= entry.keys())
    singles = {
        entry["name"]: "mjcf" if "urdf" in entry else "urdf"
        for entry in entries
        if entry["name"] not in pairs
    }
    return path, pairs, singles


def _format_pair(entry: dict[str, str]) -> str:
    """Return a pair of model files, {key: text}, as a [[pair]] table in TOML."""
    # JSON strings are TOML strings, except for DEL.
    texts = {k: json.dumps(v, ensure_ascii=False) for k, v in entry.items()}
    keys = [f"{key} = {text}\n".replace("\x7f", "\\u007f") for key, text in texts.items()]
    return "".join(["[[pair]]\n", *keys])


def list_pair_entries(folder: Path) -> list[dict[str, str]]:
    """List the models found in a folder and below as entries of a configuration.

    An entry is a URDF, an MJCF, or a URDF and an MJCF with the same stem (name without suffix).

    Returns:
        The keys ``name``, ``urdf`` and ``mjcf`` of each [[pair]], paths relative to ``folder``.
    """
    files_by_key: dict[Path, dict[str, str]] = {}
    for path in _list_model_files(folder):
        kind, local = kind_of(path), path.relative_to(folder)
        stem = local.with_suffix("")
        if kind:
            key = local if kind in files_by_key.get(stem, {}) else stem
            files_by_key.setdefault(key, {})[kind] = local.as_posix()
    single_files: dict[str, list[Path]] = {}
    for key, files in files_by_key.items():
        single_files.setdefault(key.name, []).extend([key] * (len(files) == 1))
    for keys in single_files.values():
        if len(keys) == 2 and files_by_key[keys[0]].keys() != files_by_key[keys[1]].keys():
            files_by_key[keys[0]] |= files_by_key.pop(keys[1])
    count = Counter(key.name for key in files_by_key)
    return [
        {
            "name": key.name if count[key.name] == 1 else key.as_posix(),
            **dict(sorted(files.items(), reverse=True)),
        }
        for key, files in files_by_key.items()
    ]


def _list_model_files(folder: Path) -> Iterator[Path]:
    """Yield files that may be models (.urdf, .xml, .mjcf), sorted by name in each folder.

    Hidden and generated folders (`GENERATED_FOLDERS`) are skipped.
    """
    for top, folders, files in os.walk(folder):
        kept = (name for name in folders if name[0] != "." and name not in GENERATED_FOLDERS)
        folders[:] = sorted(kept)
        for name in sorted(files):
            if Path(name).suffix.lower() in (".urdf", ".xml", ".mjcf"):
                yield Path(top) / name
