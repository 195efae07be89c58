"""Fuzz every command in one process: damaged files, unusual names and unusual arguments.

For each input, a command must end within ``MAX_PROCESSOR_TIME``, with a documented exit status and
without a traceback. The command must print no control character and no line that a CI service
executes, must leave all files complete, and must not accept an MJCF that MuJoCo rejects. ::

    python tests/fuzz.py 20000            # number of inputs (make fuzz N=20000)
    python tests/fuzz.py 500 --seed 1     # inputs of a seed, as in CI
    python tests/fuzz.py --again FILE     # one failure, as it was kept

Inputs that fail are written to build/fuzz. Inputs of repaired failures are in tests/fuzz_seeds, and
run as tests.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import functools
import io
import json
import os
import re
import secrets
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import unicodedata
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from xml.sax.saxutils import quoteattr

import click
import hypothesis
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parent.parent
FAILURE_FOLDER = ROOT / "build" / "fuzz"
"""Folder of the inputs that fail."""

MAX_PROCESSOR_TIME = 60
"""Processor time [s] above which a command counts as hanging. The limit of the elapsed time is five
times as long, because other processes share the processor. Chosen, not tuned: the slowest input
needed 26 s."""

EXIT_STATUSES = (0, 1, 2)
"""Documented exit statuses: verified, not verified, bad input. Status 3, an internal error, is a
failure."""


EXISTING_OUTPUTS = {
    "out.json": b'{\n  "generator": "pupper-analysis 0",\n  "written": "before"\n}\n',
    "out.csv": b"time (s),q a (rad),tau a (N m)\n",
    "out.png": b"\x89PNG\r\n\x1a\n tEXtSoftware\0pupper-analysis 0",
    "out.html": b'<meta name="generator" content="pupper_analysis 0">\n',
    "new.xml": b"<mujoco/>\n",
    "new.urdf": b"<robot/>\n",
}
"""{output file: content before the command runs}: an older result, or a model."""

STDIN_FILE = "stdin"
"""Name of the file whose content is the standard input of the command."""


class Hang(BaseException):
    """Raised in a command that has not ended in time."""


@dataclass(frozen=True)
class Case:
    """Input of one command.

    Attributes:
        arguments: Arguments of the command line.
        files: {name: content} of the folder in which the command runs.
    """

    arguments: tuple[str, ...]
    files: Mapping[str, bytes]

    def to_json(self) -> str:
        """Return this input as JSON; contents that are not UTF-8 are in base 64."""
        files = {}
        for name, content in self.files.items():
            try:
                files[name] = {"text": content.decode()}
            except UnicodeDecodeError:
                files[name] = {"base64": base64.b64encode(content).decode()}
        return json.dumps({"arguments": self.arguments, "files": files}, indent=1)

    @staticmethod
    def from_json(text: str) -> Case:
        """Return the input that ``to_json`` has written."""
        said = json.loads(text)
        files = {
            name: content["text"].encode()
            if "text" in content
            else base64.b64decode(content["base64"])
            for name, content in said["files"].items()
        }
        return Case(tuple(said["arguments"]), files)


# ------------------------------------------------------------------------------------- checks


def find_problems(case: Case, folder: Path) -> Iterator[str]:
    """Run a command in an empty folder; yield each violation of the rules of this module."""
    for name, content in case.files.items():
        (folder / name).write_bytes(content)
    before = dict(case.files)
    before |= EXISTING_OUTPUTS
    for name, content in EXISTING_OUTPUTS.items():
        (folder / name).write_bytes(content)
    status, said, taken = _run_command(case.arguments, folder)
    command = case.arguments[0] if case.arguments else ""
    if status is None:
        yield f"no end within {MAX_PROCESSOR_TIME} s"
        return
    if status not in EXIT_STATUSES:
        yield f"exit status {status}: {said[-500:]}"
    if taken > MAX_PROCESSOR_TIME:
        yield f"it took {taken:.0f} s"
    if "Traceback (most recent call last)" in said:
        yield f"a traceback: {said[-500:]}"
    yield from find_unsafe_output(said, case.arguments)
    yield from find_wrong_files(folder, before, case.arguments)
    if status == 0 and command in ("audit", "crosscheck", "stand", "convert", "check"):
        refusal = read_mujoco_refusal(folder, case)
        if refusal and "--help" not in case.arguments and "-h" not in case.arguments:
            yield f"accepted, and MuJoCo refuses it: {refusal}"


def _run_command(arguments: tuple[str, ...], folder: Path) -> tuple[int | None, str, float]:
    """Run a command; return exit status (None if it hangs), printed text and processor time [s]."""
    from pupper_analysis import cli

    def hang(_number: int, _frame: FrameType | None) -> None:
        raise Hang

    out = io.StringIO()
    given = (folder / STDIN_FILE).read_bytes() if (folder / STDIN_FILE).is_file() else b""
    usual, sys.stdin = sys.stdin, io.TextIOWrapper(io.BytesIO(given))
    status: int | None = None
    timers = {
        signal.SIGPROF: (signal.ITIMER_PROF, MAX_PROCESSOR_TIME + 1),
        signal.SIGALRM: (signal.ITIMER_REAL, 5 * MAX_PROCESSOR_TIME + 5),
    }
    before = {number: signal.signal(number, hang) for number in timers}
    start = time.process_time()
    for timer, seconds in timers.values():
        signal.setitimer(timer, seconds)
    try:
        with (
            contextlib.chdir(folder),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(out),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error", RuntimeWarning)  # NumPy's, of what is no number
            cli.run(cli.group, list(arguments))
    except SystemExit as leaving:
        status = leaving.code if isinstance(leaving.code, int) else 0
    except Hang:
        pass
    except BaseException as error:
        status, _ = -1, out.write(f"\n{type(error).__name__} went through: {error}")
    finally:
        sys.stdin = usual
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])
    return status, out.getvalue(), time.process_time() - start


def find_unsafe_output(output: str, arguments: tuple[str, ...]) -> Iterator[str]:
    """Yield control characters in the printed text, and lines that a CI service executes."""
    github = "github" in arguments
    joiner = "\u2060" if "markdown" in arguments else ""  # word joiner, which disables markup
    for letter in sorted(set(output) - {"\n", joiner}):
        if unicodedata.category(letter) in ("Cc", "Cf", "Cs", "Zl", "Zp"):
            yield f"{letter!a} is shown as it is: {quote_around(output, letter)!a}"
    obeyed = re.search(r"(?m)^\s*(::|##\[).*$", output)
    if obeyed and not github:
        yield f"a line that CI obeys: {obeyed[0]!a}"
    if github:
        for line in output.splitlines():
            if re.match(r"\s*(::|##\[)", line) and not re.match(r"::(error|warning|notice) ", line):
                yield f"a line that CI obeys: {line!a}"


def quote_around(output: str, letter: str) -> str:
    """Return the text around the first occurrence of a character."""
    place = output.index(letter)
    return output[max(0, place - 40) : place + 40]


def find_wrong_files(
    folder: Path, before: Mapping[str, bytes], arguments: tuple[str, ...]
) -> Iterator[str]:
    """Yield files that are missing, incomplete, temporary, or changed without permission."""
    read = list_checked_mjcfs(folder, arguments) if arguments else []
    for name, content in before.items():
        path = folder / name
        if not path.is_file():
            yield f"{name} is gone"
            continue
        now = path.read_bytes()
        if now == content:
            continue
        if name in EXISTING_OUTPUTS:
            ends = {
                "out.json": (b"}\n", b"]\n", b"}", b"]"),
                "out.csv": (b"\n",),
                "out.html": (b"</html>\n", b"</html>"),
                "new.xml": (b"</mujoco>\n", b"</mujoco>"),
                "new.urdf": (b"</robot>\n", b"</robot>"),
            }
            begins = {"out.png": b"\x89PNG", "out.html": b"<!"}
            whole = now.endswith(ends.get(name, b"")) and now.startswith(begins.get(name, b""))
            if name == "out.json" and whole:
                try:
                    json.loads(now, parse_constant=_no_constant)
                except ValueError as error:
                    yield f"out.json is no JSON: {error}"
            elif not whole:
                yield f"{name} is not whole: {now[:40]!r} … {now[-40:]!r}"
        elif arguments[:1] != ("sync",):
            # With --force, a file on the command line once, as an output, is not an input:
            # "audit - --force --json FILE".
            named = [argument for argument in arguments if Path(argument).name == name]
            if "--force" not in arguments or len(named) != 1 or name in read:
                yield f"{name} was written to"
    for path in folder.rglob("*"):
        if path.name not in before and path.suffix == ".tmp":
            yield f"{path.name} was left"


def _no_constant(word: str) -> None:
    """Reject NaN and infinity in JSON."""
    raise ValueError(f"{word} is in it")


def read_mujoco_refusal(folder: Path, case: Case) -> str | None:
    """Return the error with which MuJoCo refuses the MJCF on a command line.

    None if there is no error or no MJCF, or if the command has overwritten the file, for example
    with ``--force --json robot.xml``.
    """
    import mujoco

    given, arguments = folder / "robot.xml", case.arguments
    if not given.is_file() or given.read_bytes() != case.files.get("robot.xml"):
        return None
    for name in (*arguments, *list_checked_mjcfs(folder, arguments)):
        if name in ("robot.xml", "--mjcf=robot.xml"):
            mujoco.set_mju_user_warning(lambda _: None)
            try:
                mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
            except (ValueError, RuntimeError) as error:
                return " ".join(str(error).split())
    return None


def list_checked_mjcfs(folder: Path, arguments: tuple[str, ...]) -> list[str]:
    """Return the MJCFs in the configuration of ``check``; empty for other commands."""
    if arguments[0] != "check":
        return []
    try:
        found = tomllib.loads((folder / "pupper-analysis.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError):  # not for --help
        return []
    pairs = found.get("pair", [])
    return [str(pair["mjcf"]) for pair in pairs if isinstance(pair, dict) and "mjcf" in pair]


# ------------------------------------------------------------------------------------- files


def _split_words(text: str) -> list[str]:
    return text.split()


UNUSUAL_VALUES = (
    *("1e308", "-1e308", "1e-320", "nan", "inf", "-inf", "-1", "0", "", " ", "1e400", "0x10"),
    *("1,5", "1_000", "\u0661", "1 2", "1 2 3 4 5 6 7", "a", "true", "-0", "1e5", "1e-9"),
    *("999999999999999999999", "../../etc", "%s%n", "\u00e9"),
)
"""Unusual numbers and texts as values of attributes and options."""

UNUSUAL_NAMES = (
    *("", " ", "a b", "a/b", "../x", "a:b", "\n", "\u009b", "a\n::error::owned"),
    "\n##[error]owned",
    *("\u202ename", "\u2028", "<script>alert(1)</script>", "::error::owned", "[red]name[/red]"),
    *("[/]", "%s", "{0}", "--help", "\ufeff", "x" * 3000, "world", "base", "universe", "NaN"),
    *("root_joint", "__free__", "__root__", "null", "'", '"', "&", "]]>", "-->", "\U0001f980"),
)
"""Unusual names: empty, long, reserved, with control characters, markup or commands of CI
services."""

_REFERENCES = _split_words("""
joint joint1 joint2 site body body1 body2 geom geom1 geom2 link mesh material class childclass
tendon actuator objname file reftype refname name key texture hfield target refsite cranksite
""")
"""Attributes whose value is the name of an element."""

_RICH = """
<default><default class="leg"><geom rgba="1 0 0 1"/></default></default>
<asset><material name="grey" rgba=".5 .5 .5 1"/></asset>
<contact><exclude body1="base" body2="shank0"/><pair geom1="ball0" geom2="ball1"/></contact>
<equality><connect body1="shank0" body2="shank1" anchor="0 0 0" active="false"/>
<joint joint1="hip0" joint2="hip1" active="false"/></equality>
<tendon><fixed name="coupled"><joint joint="hip2" coef="0"/><joint joint="hip3" coef="0"/></fixed>
<spatial name="string"><site site="foot0"/><site site="foot1"/></spatial></tendon>
<actuator><motor name="drive" joint="knee0"/>
<position name="servo" joint="knee1" kp="9"/></actuator>
<sensor><gyro site="foot0"/><jointpos joint="knee0"/><framepos objtype="body" objname="base"/>
<tendonpos tendon="string"/><actuatorfrc actuator="drive"/></sensor>
<custom><numeric name="n" data="1 2"/><tuple name="t"><element objtype="body" objname="base"/>
</tuple></custom>
"""
"""Sections of an MJCF with many references between elements."""

_ATTRIBUTE = re.compile(rb'([\w:]+)=(["\'])(.*?)\2', re.DOTALL)
"""Pattern of an XML attribute: name, quotation mark and value."""

_ELEMENT = re.compile(rb"<(\w+)[^<>]*/>")
"""Pattern of an XML element without children, with its tag."""


def _format_attribute(chosen: re.Match[bytes], value: str) -> bytes:
    """Return an attribute with another value, escaped for XML."""
    return chosen[1] + b"=" + quoteattr(value, {"\n": "&#10;"}).encode("utf-8", "surrogatepass")


def _spoil_value(draw: st.DrawFn, text: bytes) -> bytes:
    """Replace one value, or one number of a list, by an unusual value or by a plausible mistake."""
    found = list(_ATTRIBUTE.finditer(text))
    if not found:
        return text
    chosen = draw(st.sampled_from(found))
    value = chosen[3].decode("utf-8", "replace")
    words = value.split(" ")
    at = draw(st.integers(0, len(words) - 1))
    try:
        number = float(words[at])
        slips = [-number, 10 * number, number / 1000, 57.29578 * number, 1.01 * number, number + 1]
        words[at] = draw(st.sampled_from([*map(repr, slips), *UNUSUAL_VALUES]))
        value = " ".join(words)
    except ValueError:
        value = draw(st.sampled_from(UNUSUAL_VALUES))
    return text[: chosen.start()] + _format_attribute(chosen, value) + text[chosen.end() :]


def _replace_reference(draw: st.DrawFn, text: bytes) -> bytes:
    """Replace the value of a random attribute of `_REFERENCES` by another name."""
    found = [at for at in _ATTRIBUTE.finditer(text) if at[1].decode() in _REFERENCES]
    if not found:
        return text
    chosen = draw(st.sampled_from(found))
    other = draw(st.sampled_from(found))[3].decode("utf-8", "replace")
    value = draw(st.sampled_from(["nowhere", other, *UNUSUAL_NAMES]))
    return text[: chosen.start()] + _format_attribute(chosen, value) + text[chosen.end() :]


def _flip_bits(draw: st.DrawFn, text: bytes) -> bytes:
    """Invert up to six bits."""
    spoilt = bytearray(text)
    for _ in range(draw(st.integers(1, 6))):
        if spoilt:
            spoilt[draw(st.integers(0, len(spoilt) - 1))] ^= 1 << draw(st.integers(0, 7))
    return bytes(spoilt)


def _cut_end(draw: st.DrawFn, text: bytes) -> bytes:
    """Cut off the end."""
    return text[: draw(st.integers(0, len(text)))]


def _edit_element(draw: st.DrawFn, text: bytes) -> bytes:
    """Delete, duplicate or move an element, or change its tag."""
    found = list(_ELEMENT.finditer(text))
    if not found:
        return text
    chosen, other = draw(st.sampled_from(found)), draw(st.sampled_from(found))
    rest = text[: chosen.start()] + text[chosen.end() :]
    moved = rest[: other.start()] + chosen[0] + rest[other.start() :]
    renamed = chosen[0].replace(chosen[1], other[1], 1)
    tag = text[: chosen.start()] + renamed + text[chosen.end() :]
    return draw(st.sampled_from([rest, rest + chosen[0], moved, tag, text.replace(chosen[0], b"")]))


def _delete_attribute(draw: st.DrawFn, text: bytes) -> bytes:
    """Delete one attribute."""
    found = list(_ATTRIBUTE.finditer(text))
    chosen = draw(st.sampled_from(found)) if found else None
    return text[: chosen.start()] + text[chosen.end() :] if chosen else text


def _wrap_element(draw: st.DrawFn, text: bytes) -> bytes:
    """Put an element into another element, such as a frame or a body."""
    found = list(_ELEMENT.finditer(text))
    if not found:
        return text
    chosen = draw(st.sampled_from(found))
    around = draw(st.sampled_from(["frame", "replicate", "body", "link", "worldbody", "default"]))
    more = draw(st.sampled_from(["", ' name="w"', ' count="2"', ' pos="1 0 0"', ' count="99999"']))
    wrapped = f"<{around}{more}>".encode() + chosen[0] + f"</{around}>".encode()
    return text[: chosen.start()] + wrapped + text[chosen.end() :]


def _encode_text(draw: st.DrawFn, text: bytes) -> bytes:
    """Encode the text, with a declaration of the same or another encoding."""
    said = draw(st.sampled_from(["utf-8", "latin-1", "utf-16", "ascii", "nonsense", "utf-7"]))
    real = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1", "utf-32"]))
    letters = f'<?xml version="1.0" encoding="{said}"?>\n<!-- \u00e9 -->\n' + text.decode(
        "utf-8", "replace"
    )
    return letters.encode(real, "replace")


DAMAGE_FUNCTIONS: tuple[Callable[[st.DrawFn, bytes], bytes], ...] = (
    *(_spoil_value,) * 9,
    *(_replace_reference,) * 5,
    *(_edit_element, _delete_attribute, _wrap_element) * 2,
    *(_flip_bits, _cut_end, _encode_text),
)
"""Functions that damage a file; a function that occurs more often is drawn more often."""


@functools.cache
def _base_files() -> list[tuple[bytes, bytes]]:
    """Return (URDF, MJCF) of small robots, also with many references."""
    from tests.support.robots import arm, mjcf_text, quadruped, urdf_text

    pairs = []
    for parts in (quadruped(), arm()):
        pairs.append((urdf_text(parts), mjcf_text(parts)))
    urdf, mjcf = pairs[0]
    for leg in range(4):
        site = f'<site name="foot{leg}"'
        mjcf = mjcf.replace(site, f'<geom name="ball{leg}" size=".02" pos="0 0 -.2"/>{site}')
    pairs += [(urdf, mjcf.replace("</worldbody>", f"</worldbody>{_RICH}"))] * 2
    return [(first.encode(), second.encode()) for first, second in pairs]


@functools.cache
def _read_skeleton() -> tuple[bytes, bytes]:
    """Return the URDF and the MJCF of Pupper's skeleton, which stands."""
    skeleton = ROOT / "urdf" / "pupper_skeleton.urdf", ROOT / "mjcf" / "pupper_skeleton.xml"
    return skeleton[0].read_bytes(), skeleton[1].read_bytes()


@st.composite
def spoilt_files(draw: st.DrawFn, pair: tuple[bytes, bytes] | None = None) -> dict[str, bytes]:
    """Draw the URDF and the MJCF of a robot; at least one of the files is damaged.

    A damage may leave a file unchanged.
    """
    urdf, mjcf = draw(
        st.sampled_from([*_base_files(), _read_skeleton()] if pair is None else [pair])
    )
    which = draw(st.sampled_from(["urdf", "mjcf", "mjcf", "both"]))
    for _ in range(draw(st.sampled_from([1, 1, 2, 3]))):
        spoil = draw(st.sampled_from(DAMAGE_FUNCTIONS))
        if which == "urdf" or (which == "both" and draw(st.booleans())):
            urdf = spoil(draw, urdf)
        else:
            mjcf = spoil(draw, mjcf)
    return {"robot.urdf": urdf, "robot.xml": mjcf}


# ------------------------------------------------------------------------------------- commands

_TEXTS = (
    *UNUSUAL_VALUES,
    "5 deg",
    *_split_words("""
0.1 0.2 5deg 10cm 90deg 1e6 -0.3 3.2 cm 50 0.01,0.02 0,0 1e308,0 nan,0 , 1,2,3 inf,inf 1cm,2cm
a,b centre inside FL=2cm FL=1e9 FL=nan FL =1 XX=1cm FL=1cm,2cm FL=0,0,0 = a=b *=5 x=5 *_3=1e9
*=nan *=-1 hip0=hip1 hip0=knee0 foot0 home x=. mass=1 mass=nan mass=-1 mass=1e308 v3 skeleton
1.1 1e-6 1kg
"""),
)
"""Values for options whose type allows any text."""

_VALUES = {
    "--json": ("out.json", "-", "", "no/such/x.json", ".", "x" * 300, "robot.xml", "./robot.urdf"),
    "--figure": ("out.png", ".", ""),
    "--report": ("out.html", "-", ".", "no/such/x.html"),
    "--csv": ("out.csv", "-", "."),
    "--take": ("urdf", "mjcf", "mjcf:*", "urdf:x", "1", "", "0", "urdf:1"),
    "--config": ("pupper-analysis.toml", "none.toml", "."),
}
"""{option: values to draw}; for other options ``options_of`` chooses by their type."""


@functools.cache
def options_of(command: str) -> dict[str, tuple[str, ...]]:
    """Return {option of a command: values to draw}; none for a flag."""
    from pupper_analysis import cli

    found = {}
    for param in cli.find_command(command).params:
        if not isinstance(param, click.Option):
            continue
        name = max(param.opts, key=len)
        if param.is_flag:
            found[name] = ()
        elif isinstance(param.type, click.Choice):
            found[name] = (*map(str, param.type.choices), "x", "")
        elif isinstance(param.type, click.Path) and name not in _VALUES:
            found[name] = ("robot.xml", "none.toml", ".", "")
        else:
            found[name] = _VALUES.get(name, _TEXTS)
    left = ("--output", "--write", "--list-rules", "--list-metrics")
    return {name: given for name, given in found.items() if name not in left}


def _draw_options(draw: st.DrawFn, command: str, most: int, least: int = 0) -> list[str]:
    """Draw between ``least`` and ``most`` options of a command, with values."""
    known = options_of(command)
    names = st.sampled_from(sorted(known))
    chosen = draw(st.lists(names, min_size=least, max_size=most, unique=True))
    return [
        word
        for name in chosen
        for word in ([name, draw(st.sampled_from(known[name]))] if known[name] else [name])
    ]


@st.composite
def on_files(draw: st.DrawFn) -> Case:
    """Draw a command on damaged files."""
    models = ["audit"] * 20 + ["crosscheck"] * 18 + ["sync"] * 10
    command = draw(st.sampled_from([*models, *["stand"] * 6, "payload"]))
    files = draw(spoilt_files(None if command in models else _read_skeleton()))
    more: list[str] = []
    if command in models:
        more = _draw_options(draw, command, draw(st.sampled_from([0, 0, 0, 1, 2])))
        if command == "sync" and "--take" not in more:
            more += ["--take", draw(st.sampled_from(["urdf", "mjcf"]))]
    if command == "audit":
        paths = [draw(st.sampled_from(["robot.urdf", "robot.xml"]))]
    elif command in models:
        paths = ["robot.urdf", "robot.xml"]
    else:
        paths = ["--urdf", "robot.urdf", "--mjcf", "robot.xml"]
    return Case((command, *paths, *more), files)


_TOML = {
    "pupper-analysis.toml": """
baseline = "known.txt"
[[pair]]
name = "machine"
urdf = "robot.urdf"
mjcf = "robot.xml"
feet = ["foot0"]
[pair.tolerances]
mass = 1e-3
[pair.disable]
armature-zero = "none was measured"
[pair.map]
hip0 = "hip0"
""",
    "study.toml": """
robot = "skeleton"
measure = ["peak_utilisation", "com_margin"]
seed = 1
samples = 4
[vary]
height = { linspace = [0.14, 0.17, 3] }
pitch = [0.0, 0.05]
kp = { uniform = [20.0, 40.0] }
[stand]
ground_clearance = 0.0
""",
}
"""{configuration file: valid content}."""

_TOML_VALUES = (
    *("nan", "inf", "-1", "0", '""', "[]", "{}", "true", "1e400", "99999999999999999999"),
    *("[1, 'a']", "{ grid = [0, 1, 1e9] }", "{ grid = [1, 0, -1] }", "{ uniform = [1, 0] }"),
    *('"../x"', '"\\u202e"', '"\\n::error::owned"', "{ normal = [0, -1] }", "[[1]]", '"v3"'),
    "1979-05-27",
)
"""Unusual values of a TOML file."""


def _spoil_toml(draw: st.DrawFn, text: bytes) -> bytes:
    """Damage a line or some bits of a TOML file."""
    rows = text.decode("utf-8", "replace").split("\n")
    at = draw(st.integers(0, len(rows) - 1))
    name, equals, _ = rows[at].partition("=")
    value = draw(st.sampled_from(_TOML_VALUES))
    what = draw(
        st.sampled_from(["value", "value", "value", "name", "drop", "double", "bits", "cut"])
    )
    if what == "bits":
        return _flip_bits(draw, text)
    if what == "cut":
        return _cut_end(draw, text)
    if what == "value" and equals:
        rows[at] = f"{name}= {value}"
    elif what == "name" and equals:
        rows[at] = f"{draw(st.sampled_from(['x', 'seed', 'robot', 'pair']))} ={value}"
    elif what == "drop":
        del rows[at]
    else:
        rows.insert(draw(st.integers(0, len(rows))), rows[at])
    return "\n".join(rows).encode()


@st.composite
def on_projects(draw: st.DrawFn) -> Case:
    """Draw a command on several files or standard input; some files are damaged."""
    command = draw(st.sampled_from(["diff", "diff", "check", "check", "convert", "study", "-"]))
    files = draw(spoilt_files())
    of = "audit" if command == "-" else command
    more = _draw_options(draw, of, draw(st.sampled_from([0, 0, 1, 2])))
    which = draw(st.sampled_from(["robot.urdf", "robot.xml"]))
    if command == "diff":
        whole = draw(st.sampled_from(_base_files()))
        suffix = Path(which).suffix
        files[f"old{suffix}"] = whole[which == "robot.xml"]
        return Case((command, *draw(st.permutations([f"old{suffix}", which])), *more), files)
    if command == "convert":
        new = "new.xml" if which == "robot.urdf" else "new.urdf"
        return Case((command, which, "-o", new, "--force", *more), files)
    if command == "-":
        files[STDIN_FILE] = files[which]
        others = ["-", "robot.xml"] if which == "robot.urdf" else ["robot.urdf", "-"]
        if draw(st.booleans()):
            return Case(("crosscheck", *others, "--json", "out.json"), files)
        return Case(("audit", "-", *more), files)
    name = "study.toml" if command == "study" else "pupper-analysis.toml"
    text = _TOML[name].encode()
    for _ in range(draw(st.sampled_from([0, 1, 1, 2]))):
        text = _spoil_toml(draw, text)
    if command == "study":
        # The metric does not exist, so the study is refused before it runs a simulation.
        words = ("study", name, "-o", "results", "--maximise", "no-such-metric")
        return Case((*words, *more), {name: text})
    return Case((command, *more), {**files, name: text})


@st.composite
def on_variants(draw: st.DrawFn) -> Case:
    """Draw a command with unusual arguments on a variant of Pupper."""
    # A push with valid arguments is simulated for half a minute.
    commands = ["stand"] * 5 + ["payload"] * 3 + ["workspace", "best", "path", "push", "analyze"]
    command = draw(st.sampled_from([*commands, "live"]))
    words = _draw_options(draw, command, 3, least=1)
    odd = ["nobody", "", "\u202e", "\n::error::x", "../v3"]
    if command == "best":
        words.insert(0, draw(st.sampled_from(["utilisation", "margin", "payload", "x"])))
        words += ["--height", "nan"] if draw(st.booleans()) else []
    if command in ("push", "workspace", "best", "path", "analyze"):  # slow with valid arguments
        words += ["--pitch", draw(st.sampled_from(["nan", "1e9", "x", "1e308"]))]
    if command != "live":
        words.insert(
            0 if command != "best" else 1,
            draw(st.sampled_from(["v3", "v3", "v3", "original", "v3-heavy", *odd])),
        )
    else:
        words += ["--drop", "--headless"]
    stray = draw(st.sampled_from(["", "", "", "--nonsense", "stray", "--help", "--debug"]))
    return Case((command, *words, *([stray] if stray else [])), {})


def cases() -> st.SearchStrategy[Case]:
    """Draw inputs; one in six consists of arguments only."""
    return st.one_of(*[on_files()] * 4, on_projects(), on_variants())


# ------------------------------------------------------------------------------------- runs


def run_case(case: Case) -> list[str]:
    """Run an input in a temporary folder; return its problems."""
    with tempfile.TemporaryDirectory() as folder:
        return list(find_problems(case, Path(folder)))


def run_chunk(seed: int, count: int, seconds: float) -> int:
    """Run inputs in this process, write inputs that fail, and return the number of runs."""
    end = time.monotonic() + seconds
    ran = 0
    now = FAILURE_FOLDER / f"running-{os.getpid()}.json"

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=count,
        database=None,
        deadline=None,
        derandomize=False,
        phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(cases())
    def attempt(case: Case) -> None:
        nonlocal ran
        if time.monotonic() > end:
            return
        ran += 1
        now.write_text(case.to_json())
        found = run_case(case)
        if found:
            keep_case(case, found)

    attempt()
    now.unlink(missing_ok=True)
    return ran


def keep_case(case: Case, found: list[str]) -> None:
    """Write an input that fails to ``FAILURE_FOLDER``, and print its problems."""
    path = FAILURE_FOLDER / f"{secrets.token_hex(4)}.json"
    path.write_text(json.dumps({**json.loads(case.to_json()), "found": found}, indent=1))
    print(f"{path.name}: {' '.join(case.arguments)[:120]!a}")
    for problem in found:
        print(f"    {problem[:400]}", flush=True)


def run(count: int, seconds: float, seed: int, size: int = 250) -> int:
    """Run inputs in processes of ``size`` inputs each; return the number of failed inputs.

    If a process dies or hangs, its current input counts as failed.

    Args:
        count: Number of inputs.
        seconds: Time after which no further process is started [s].
        seed: Seed of the first process.
        size: Inputs per process.
    """
    FAILURE_FOLDER.mkdir(parents=True, exist_ok=True)
    kept = set(FAILURE_FOLDER.glob("[!r]*.json"))
    end, ran = time.monotonic() + seconds, 0
    while ran < count and time.monotonic() < end:
        left = end - time.monotonic()
        words = [str(seed), str(min(size, count - ran)), str(left)]
        process = subprocess.Popen([sys.executable, __file__, "--chunk", *words])
        running = FAILURE_FOLDER / f"running-{process.pid}.json"
        at, since = "", time.monotonic()
        while process.poll() is None:
            time.sleep(0.2)
            here = running.read_text() if running.is_file() else ""
            if here != at:
                at, since = here, time.monotonic()
            elif time.monotonic() - since > 6 * MAX_PROCESSOR_TIME:  # start-up counts, too
                process.kill()
        if running.is_file():
            text = running.read_text()
            running.unlink()
            keep_case(Case.from_json(text), [f"the process ended with {process.returncode}"])
        ran, seed = ran + min(size, count - ran), seed + 1
        print(
            f"{ran} inputs, {len(set(FAILURE_FOLDER.glob('[!r]*.json')) - kept)} failed", flush=True
        )
    return len(set(FAILURE_FOLDER.glob("[!r]*.json")) - kept)


def main() -> None:
    """Run the fuzzer by its command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("count", nargs="?", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so long")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--chunk", nargs=3, metavar=("SEED", "COUNT", "SECONDS"))
    parser.add_argument("--again", type=Path, help="run a kept input once more")
    arguments = parser.parse_args()
    if arguments.again:
        found = run_case(Case.from_json(arguments.again.read_text()))
        print("\n".join(found) or "nothing is wrong")
        sys.exit(bool(found))
    if arguments.chunk:
        seed, count, seconds = arguments.chunk
        run_chunk(int(seed), int(count), float(seconds))
        return
    print(f"seed {arguments.seed}")
    sys.exit(bool(run(arguments.count, arguments.seconds, arguments.seed)))


if __name__ == "__main__":
    main()
