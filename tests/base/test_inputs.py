"""Input files are checked for type, size and encoding before they are read."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, PupperAnalysisError
from pupper_analysis.base.inputs import check_input, decode_input, is_input, read_input, read_toml
from tests import damaged


def get_refusal_code(path: Path, most: int = 100) -> str:
    """Return the code of the error by which both functions refuse a path."""
    for read in (check_input, read_input):
        with pytest.raises(InputError) as error:
            read(path, most)
    return error.value.cause.code


def test_input_is_read_through_symbolic_links(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to("file")
    assert read_input(tmp_path / "link", 7) == b"content"
    assert get_refusal_code(tmp_path / "link", 6) == "file-too-large"


def test_pipes_folders_and_devices_are_refused_as_input(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "loop").symlink_to("loop")
    assert (
        get_refusal_code(tmp_path / "pipe")
        == get_refusal_code(tmp_path / "link")
        == "file-not-regular"
    )
    assert get_refusal_code(tmp_path) == "file-is-folder"
    assert get_refusal_code(Path("/dev/null")) == "file-not-regular"
    assert (
        get_refusal_code(tmp_path / "none") == get_refusal_code(tmp_path / "a\0b") == "no-such-file"
    )
    assert get_refusal_code(tmp_path / "loop") == "file-not-read"


def test_read_does_not_block_if_a_pipe_replaces_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`check_input` is skipped, as if the pipe replaced the file after this check."""
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr("pupper_analysis.base.inputs.check_input", lambda *_, **__: None)
    assert read_input(tmp_path / "pipe", 10) == b""


@pytest.mark.skipif(not Path("/proc/self/maps").is_file(), reason="only Linux has /proc")
def test_size_limit_holds_for_a_file_without_a_stated_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of /proc have a size of 0 bytes and some content."""
    path = Path("/proc/self/maps")
    assert path.stat().st_size == 0
    with pytest.raises(InputError) as error:
        read_input(path, 10)
    assert error.value.cause.code == "file-too-large"


@pytest.mark.parametrize(
    ("data", "code", "line"),
    [
        (b"a\nb\n\xe4", "not-utf-8", 3),
        (b"a\n\0", "file-is-binary", 2),
        ("a".encode("utf-16"), "encoded-in-utf-16", None),
    ],
)
def test_invalid_text_raises_with_its_line(data: bytes, code: str, line: int | None) -> None:
    with pytest.raises(InputError) as error:
        decode_input(Path("a.csv"), data)
    assert (error.value.cause.code, error.value.line) == (code, line)
    assert decode_input(Path("a.csv"), "\ufeffä".encode()) == "ä"


@pytest.mark.parametrize(
    ("data", "text"), [(b"<robot/>\r\n\0", "<robot/>\r\n"), (b"<robot/>\0\0", "<robot/>")]
)
def test_zero_bytes_behind_the_last_element_are_removed(data: bytes, text: str) -> None:
    """As in humanoid.urdf of PyBullet, which MuJoCo 4.0.0 reads."""
    assert decode_input(Path("a.urdf"), data) == text


@pytest.mark.slow
@pytest.mark.parametrize("kind", damaged.kinds(), ids=lambda kind: kind.name)
def test_damaged_files_are_read_or_refused_in_one_line(
    kind: damaged.Kind, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Eight random damages per kind of file, judged by `damaged.problems_of`."""
    assert damaged.problems_of(kind, count=8, seed=3, folder=tmp_path) == []


def test_is_input_is_false_for_an_impossible_name(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    assert is_input(tmp_path / "file")
    assert not is_input(tmp_path / ("x" * 5000))
    assert not is_input(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in damaged.kinds() if kind.name.endswith(".toml")])
@pytest.mark.parametrize("place", ["first", "last", "value"])
def test_error_line_is_short_for_a_huge_word(
    kind: damaged.Kind, place: str, tmp_path: Path
) -> None:
    """A key or a text of 1 MB is refused in a message of less than 2,000 characters."""
    huge = b"k" * 1_000_000
    texts = {
        "first": huge + b" = 1\n" + kind.sound,
        "last": kind.sound + huge + b" = 1\n",
        "value": re.sub(rb"(?m)^(height|robot|urdf) = ['\"].*", rb'\1 = "%s"' % huge, kind.sound),
    }
    assert huge in texts[place]
    path = tmp_path / kind.name
    path.write_bytes(texts[place])
    with pytest.raises(PupperAnalysisError) as error:
        kind.read(path)
    assert len(str(error.value)) < 2000


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a = 1\nb = ]", 2),
        ("a = " + "[" * 5000, None),
        ("a = " + "9" * 5000, None),
        ("a = 2020-02-31", 1),
    ],
)
def test_invalid_toml_is_refused_in_one_line(tmp_path: Path, text: str, line: int | None) -> None:
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError) as error:
        read_toml(tmp_path / "a.toml")
    assert error.value.cause.code == "not-toml"
    assert error.value.line == line
    assert "\n" not in str(error.value)


def test_defects_of_a_reader_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The judgement of damaged files finds a crash, an error of two lines, and an endless loop."""

    def crash(path: Path) -> None:
        raise KeyError(path.name)

    def refuse_in_two_lines(path: Path) -> None:
        raise InputError(path.name, diagnose("no-csv", problem="one\ntwo"))

    def hang(_path: Path) -> None:
        while True:
            pass

    monkeypatch.setattr(damaged, "SECONDS", 0.2)
    for read, message in ((crash, "KeyError"), (refuse_in_two_lines, "no line"), (hang, "no end")):
        kind = damaged.Kind("a.csv", b"a,b\n", read)
        assert message in str(damaged.problem_of(kind, b"", tmp_path))
