"""Several files are written together, or none of them."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from pupper_analysis.base.errors import OutputError
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.kinds import OWN

OLD = {"a": b"old a", "b": b"old b"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in OLD.items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def both(folder: Path, **options: bool) -> tuple[Path, ...]:
    wanted = [
        Writing(folder / name, b"new " + name.encode(), OWN, old) for name, old in OLD.items()
    ]
    return write_all(wanted, **options)


def fails_at(what: str, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Lets renames onto a file of that name fail once."""
    real = Path.replace
    left = [error]

    def replace(self: Path, target: Path) -> Path:
        if Path(target).name == what and left:
            raise left.pop()
        return real(self, target)

    monkeypatch.setattr(Path, "replace", replace)


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()]
)
def test_if_the_second_fails_the_first_is_put_back(
    error: BaseException, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (folder / "a").stat()
    fails_at("b", monkeypatch, error)
    expected = KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else OutputError
    with pytest.raises(expected) as raised:
        both(folder, backup=True)
    assert contents(folder) == OLD
    assert (folder / "a").stat().st_ino == before.st_ino  # the file itself, not a copy
    if expected is OutputError:
        assert str(raised.value) == f"cannot write {folder / 'b'}: No space left on device"


def test_without_hard_links_the_first_is_put_back_as_a_copy(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    (folder / "a").chmod(0o640)
    monkeypatch.setattr(os, "link", no_links)
    fails_at("b", monkeypatch, OSError(errno.EIO, "Input/output error"))
    with pytest.raises(OutputError, match="Input/output error"):
        both(folder)
    assert contents(folder) == OLD
    assert (folder / "a").stat().st_mode & 0o777 == 0o640


def test_what_cannot_be_put_back_is_named_and_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = Path.replace, list[Path]()

    def only_once(self: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) > 1:
            raise OSError(errno.EIO, "Input/output error")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", only_once)
    with pytest.raises(OutputError, match="cannot be put back") as raised:
        both(folder)
    hidden = [path for path in folder.iterdir() if path.name.startswith(".")]
    assert [path.read_bytes() for path in hidden] == [b"old a"]
    assert str(hidden[0]) in str(raised.value)


def test_new_files_go_again_if_a_later_one_fails(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails_at("b", monkeypatch, OSError(errno.EIO, "Input/output error"))
    with pytest.raises(OutputError):
        write_all([Writing(folder / "new", b"x", OWN), Writing(folder / "b", b"y", OWN)])
    assert contents(folder) == OLD


def deny(path: Path) -> Callable[[Path, int], bool]:
    real = os.access
    return lambda other, mode: Path(other) != path and bool(real(other, mode))


@pytest.mark.parametrize("problem", ["read-only", "changed", "a folder"])
def test_what_is_known_before_leaves_all_as_it_was(
    problem: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = dict(OLD)
    if problem == "read-only":
        monkeypatch.setattr(os, "access", deny(folder / "b"))
    elif problem == "changed":
        (folder / "b").write_bytes(b"another's")
        expected["b"] = b"another's"
    else:
        (folder / "b").unlink()
        (folder / "b").mkdir()
        del expected["b"]
    with pytest.raises(OutputError) as raised:
        both(folder, backup=True)
    assert raised.value.path == folder / "b"
    if problem == "a folder":
        (folder / "b").rmdir()
    assert contents(folder) == expected


def test_what_changes_while_it_is_written_is_not_lost(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program writes to the second file when the first has been replaced."""
    real = Path.replace

    def replace(self: Path, target: Path) -> Path:
        if Path(target).name == "a" and (folder / "b").read_bytes() == OLD["b"]:
            (folder / "other").write_bytes(b"another's")
            real(folder / "other", folder / "b")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(OutputError, match="changed meanwhile"):
        both(folder)
    assert contents(folder) == {"a": b"old a", "b": b"another's"}


def test_contents_are_on_the_disk_before_any_file_is_replaced(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    sync, replace = os.fsync, Path.replace

    def synced(handle: int) -> None:
        sync(handle)
        done.append("fsync")

    def replaced(self: Path, target: Path) -> Path:
        done.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    both(folder)
    assert done[:4] == ["fsync", "fsync", "rename", "rename"]
