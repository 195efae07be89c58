"""Output files are written completely or not at all, through links and pipes, and replace only
files of their kind.
"""

from __future__ import annotations

import errno
import io
import json
import os
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

import pupper_analysis as pa
from pupper_analysis.base import files
from pupper_analysis.base.errors import OutputError, VariantError
from pupper_analysis.base.files import Writing, write_all, write_atomically
from pupper_analysis.base.kinds import EDITED_KIND, MODEL_KIND, OWN_KIND, RESULTS_KIND, OutputKind
from pupper_analysis.base.provenance import to_marked_json
from pupper_analysis.base.runs import ensure_run, register_input
from tests.support.commands import run_command
from tests.support.hidden_files import leave_hidden_file
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT


def write(path: Path, kind: OutputKind = OWN_KIND, text: str = "all of it") -> None:
    with write_atomically(path, kind) as file:
        file.write(text.encode())


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_old_content_is_kept_if_a_write_fails(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")

    def fail() -> None:
        with write_atomically(path, OWN_KIND) as file:
            file.write(b"half of")
            raise KeyError("stop")

    with pytest.raises(KeyError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_old_content_is_kept_if_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")

    class FullFile(io.BytesIO):
        def write(self, data: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    def open_full_file(handle: int, how: str) -> FullFile:
        os.close(handle)
        return FullFile()

    monkeypatch.setattr(os, "fdopen", open_full_file)
    with pytest.raises(OutputError, match="No space left"):
        write(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_hard_link_keeps_the_old_content(tmp_path: Path) -> None:
    """The new file replaces one name in one step: docs/how-to/output.md."""
    path, link = tmp_path / "given", tmp_path / "link"
    path.write_text("old")
    link.hardlink_to(path)
    write(path, text="new")
    assert (path.read_text(), link.read_text()) == ("new", "old")


def test_replaced_output_is_removed_from_the_outputs(tmp_path: Path) -> None:
    """A later input may reuse the inode number of the replaced file."""
    out = tmp_path / "out"
    out.write_text("old")
    with ensure_run() as run:
        files.check_writable(out, OWN_KIND)
        known = next(iter(run.outputs))
        write(out)
        assert known not in run.outputs


def test_write_follows_symbolic_links(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "real", tmp_path / "link"
    link.symlink_to(real)
    for text in ("made through the link", "replaced through it"):
        write(link, text=text)
        assert link.is_symlink()
        assert real.read_text() == text
        assert not real.is_symlink()
    assert sorted(tmp_path.rglob("*")) == [link, real.parent, real]


def test_pipe_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    files.check_writable(pipe, OWN_KIND)
    write(pipe)
    reader.join(10)
    assert read == ["all of it"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_target_file_of_a_stream_is_not_replaced(stream: str, tmp_path: Path) -> None:
    """The result is in the file between the texts printed before and after."""
    code = (
        "import sys; from pathlib import Path\n"
        "from pupper_analysis.base.files import write_atomically\n"
        "from pupper_analysis.base.kinds import OWN_KIND\n"
        f"print('before', file=sys.{stream})\n"
        "with write_atomically(Path('out'), OWN_KIND) as file: file.write(b'result\\n')\n"
        f"print('after', file=sys.{stream})"
    )
    with (tmp_path / "out").open("w") as out:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run(
            [sys.executable, "-c", code],
            **{stream: out},  # type: ignore[call-overload]
            cwd=tmp_path,
            env=environment,
            check=True,
        )
    assert (tmp_path / "out").read_text() == "before\nresult\nafter\n"


def test_file_mode_follows_the_umask_or_is_kept(tmp_path: Path) -> None:
    new, old = tmp_path / "new", tmp_path / "old"
    old.touch()
    old.chmod(0o640)
    before = os.umask(0o027)
    try:
        write(new)
        write(old)
    finally:
        os.umask(before)
    assert (mode(new), mode(old)) == (0o640, 0o640)
    before = os.umask(0o077)
    try:
        write(tmp_path / "secret")
        write(old)
    finally:
        os.umask(before)
    assert (mode(tmp_path / "secret"), mode(old)) == (0o600, 0o640)


@pytest.mark.parametrize("suffix", ["", ".png", "." + "y" * 150])
def test_file_name_of_the_maximum_length_is_written(suffix: str, tmp_path: Path) -> None:
    """255 bytes, the limit of common file systems; the temporary file has a shorter name."""
    path = tmp_path / f"{'x' * (255 - len(suffix))}{suffix}"
    write(path)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "problem"),
    [("x" * 300, "too long"), ("x\0y", "null"), ("folder", "a folder"), ("file/x", "not a folder")],
)
def test_check_writable_raises_for_an_invalid_path(name: str, problem: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=problem):
        files.check_writable(tmp_path / name, OWN_KIND)


def test_links_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    for refuse in (files.check_writable, write):
        with pytest.raises(OutputError, match="symbolic links"):
            refuse(tmp_path / "a", OWN_KIND)
    assert (tmp_path / "a").is_symlink()


@pytest.mark.parametrize("kind", [stat.S_IFCHR, stat.S_IFBLK, stat.S_IFIFO, stat.S_IFSOCK])
def test_only_a_regular_file_is_replaceable(kind: int) -> None:
    """Devices, pipes and sockets are written to in place."""
    special, regular = (
        SimpleNamespace(st_mode=mode | 0o666, st_dev=-1, st_ino=-1) for mode in (kind, stat.S_IFREG)
    )
    assert not files.is_replaceable(special)  # type: ignore[arg-type]
    assert files.is_replaceable(regular)  # type: ignore[arg-type]


@pytest.mark.parametrize("denied", [os.W_OK, os.X_OK])
def test_check_writable_raises_without_folder_permission(
    denied: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # os.access is replaced, since the tests may run as root, who has all permissions.
    monkeypatch.setattr(os, "access", lambda path, how: not how & denied)
    with pytest.raises(OutputError, match="no permission to create a file"):
        files.check_writable(tmp_path / "new", OWN_KIND)
    if denied == os.W_OK:
        (tmp_path / "file").touch()
        with pytest.raises(OutputError, match="no permission to write"):
            files.check_writable(tmp_path / "file", OWN_KIND)
        with pytest.raises(OutputError, match="no permission to write"):
            write(tmp_path / "file")


def test_output_error_is_raised_if_a_folder_cannot_be_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def deny(path: Path, **_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "stat", deny)
    with pytest.raises(OutputError, match="Permission denied"):
        files.check_writable(tmp_path / "folder" / "new", OWN_KIND)
    with pytest.raises(OutputError, match="Permission denied"):
        files.check_folder(tmp_path / "folder" / "new")


@pytest.mark.slow
def test_dash_writes_to_standard_output(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """JSON is on standard output, the printed table on standard error, and no file is written."""
    monkeypatch.chdir(tmp_path)
    status, out, err = run_command(capfd, "workspace", "v3", "--json", "-")
    assert status == 0
    assert {"roll", "pitch", "yaw"} <= set(json.loads(out)["intervals"])
    assert "height" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["../../x", "/x", "a/b", "a\\b", ".", "..", ".x", "a\nb", "a\0b", "x" * 250, 5, "c:x"]
)
def test_variant_name_that_is_no_valid_file_name_is_refused(name: str) -> None:
    with pytest.raises(VariantError, match="name"):
        pa.pupper.VariantSpec(name=name)


HELD = """
import os, time
from pathlib import Path
import click
from pupper_analysis import cli
from pupper_analysis.base import files, kinds
real = os.fdopen
def held(*a):
    print("writing", flush=True); time.sleep(60); return real(*a)
os.fdopen = held
@click.command()
def slow():
    with files.write_atomically(Path("out"), kinds.OWN_KIND) as file: file.write(b"x")
cli.run(slow, [])
"""
"""Command that sleeps for 60 s while its temporary file exists."""


def held_in(folder: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HELD],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "writing\n"
    return process


def test_terminated_write_leaves_no_file(tmp_path: Path) -> None:
    """SIGTERM while the temporary file exists: the command line removes the file."""
    process = held_in(tmp_path)
    time.sleep(0.1)
    assert len(list(tmp_path.iterdir())) == 1
    process.terminate()
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 143
    assert err.strip().splitlines() == ["terminated"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("link", [None, os.symlink, os.link])
def test_input_of_a_run_is_not_overwritten(
    link: Callable[..., None] | None, tmp_path: Path
) -> None:
    """Also through symbolic and hard links, and with --force.

    Files that the run itself writes, and edited models, are exceptions.
    """
    read, other = tmp_path / "robot.xml", tmp_path / "out.json"
    read.write_text("<mujoco/>")
    if link is None:
        other = read
    else:
        link(read, other)
    with ensure_run() as run:
        register_input(read)
        run.force = True
        for refuse in (files.check_writable, write):
            with pytest.raises(OutputError, match="an input of this run"):
                refuse(other, RESULTS_KIND)
        with write_atomically(tmp_path / "new", OWN_KIND) as file:
            file.write(b"made here")
        register_input(tmp_path / "new")  # an output of this run, read again
        write(tmp_path / "new", text="again")
        write(read, EDITED_KIND, "edited")
        with pytest.raises(OutputError, match="an input of this run"):
            write(read, RESULTS_KIND)
    assert read.read_text() == "edited"
    write(read)  # no run, no inputs


def test_output_of_a_run_is_not_read(tmp_path: Path) -> None:
    """Refused before any work, although included files are known only when the model is read."""
    mesh, out = tmp_path / "foot.stl", tmp_path / "out.json"
    mesh.write_text("solid")
    out.symlink_to(mesh)
    with ensure_run() as run:
        run.force = True
        files.check_writable(out, RESULTS_KIND)
        with pytest.raises(OutputError, match=r"out\.json.*foot\.stl"):
            register_input(mesh)


def test_result_replaces_only_files_of_its_kind(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    ours = to_marked_json({"a": 1})
    for before, replaced in ((ours, True), ("", True), ('{"a": 1}\n', False), ("<mujoco/>", False)):
        path.write_text(before)
        for attempt in (files.check_writable, write):
            if replaced:
                attempt(path, RESULTS_KIND)
            else:
                with pytest.raises(OutputError, match="not a JSON result of this package"):
                    attempt(path, RESULTS_KIND)
                assert path.read_text() == before
    write(path, MODEL_KIND, "<mujoco/>")  # the same content: nothing is lost
    with pytest.raises(OutputError, match="the file exists"):
        write(path, MODEL_KIND, "<mujoco />")
    with write_atomically(path, MODEL_KIND, force=True) as file:
        file.write(b"<robot/>")
    assert path.read_text() == "<robot/>"


def test_files_of_killed_runs_are_removed_by_the_next_run(tmp_path: Path) -> None:
    """SIGKILL while the temporary file exists; the file of a running process is kept."""
    dead, alive = held_in(tmp_path), held_in(tmp_path)
    dead.kill()
    dead.communicate(timeout=PATIENCE)
    assert len(list(tmp_path.iterdir())) == 2
    (tmp_path / ".mine-pupper.tmp").touch()
    write(tmp_path / "new")
    left = {path.name for path in tmp_path.iterdir()} - {"new", ".mine-pupper.tmp"}
    assert len(left) == 1
    assert f"-{alive.pid:x}-" in left.pop()
    alive.kill()
    alive.communicate(timeout=PATIENCE)


def test_hidden_files_are_removed_if_a_run_writes_nothing(tmp_path: Path) -> None:
    """Cases: a refused output, and a folder of results; files of a running process remain."""
    (tmp_path / "out.json").write_text("mine")
    left = leave_hidden_file(tmp_path)
    with pytest.raises(OutputError):
        files.check_writable(tmp_path / "out.json", RESULTS_KIND)
    assert not left.exists()
    left = leave_hidden_file(tmp_path)
    files.check_folder(tmp_path)
    assert not left.exists()
    left = leave_hidden_file(tmp_path, alive=True)
    files.check_folder(tmp_path)
    assert left.exists()


def test_hidden_files_of_a_removed_container_are_removed_after_a_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Process ids of another container cannot be looked up.

    A hard link to an old file is not old itself.
    """
    name = files.hidden_token().split("-")
    left = tmp_path / f".{'-'.join([name[0], '0' * 8, *name[2:]])}.tmp"
    (tmp_path / "model.xml").write_text("<mujoco/>")
    os.utime(tmp_path / "model.xml", (0, 0))
    os.link(tmp_path / "model.xml", left)
    files._cleaned_folders.clear()
    files.check_folder(tmp_path)
    assert left.exists()
    files._cleaned_folders.clear()
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + files.MAX_TEMPORARY_AGE + 1)
    files.check_folder(tmp_path)
    assert not left.exists()


OLD = {"a": b"old a", "b": b"old b"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in OLD.items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def write_both(folder: Path, **options: bool) -> tuple[Path, ...]:
    return write_all(
        [Writing(folder / x, b"new", OWN_KIND, old) for x, old in OLD.items()], **options
    )


def fails_at(what: str, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Make the first rename onto a file of this name fail."""
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
def test_first_file_is_restored_if_the_second_fails(
    error: BaseException, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The inode of the first file is unchanged."""
    before = (folder / "a").stat()
    fails_at("b", monkeypatch, error)
    expected = KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else OutputError
    with pytest.raises(expected) as raised:
        write_both(folder, backup=True)
    assert contents(folder) == OLD
    assert (folder / "a").stat().st_ino == before.st_ino  # the file itself, not a copy
    if expected is OutputError:
        assert str(raised.value) == f"cannot write {folder / 'b'}: No space left on device"


def test_earlier_backup_is_kept_if_the_file_cannot_be_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file can be linked and written, but not read, for example with mode 0o200."""
    (folder / "a.bak").write_bytes(b"earlier backup")
    real = Path.read_bytes

    def read_bytes(path: Path) -> bytes:
        if path.name == "a":
            raise PermissionError(errno.EACCES, "Permission denied")
        return real(path)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", read_bytes)
        with pytest.raises(OutputError, match="Permission denied"):
            write_both(folder, backup=True)
    assert contents(folder) == {**OLD, "a.bak": b"earlier backup"}


def test_backup_with_too_long_name_is_an_output_error(tmp_path: Path) -> None:
    """The name with ``.bak`` has 257 letters; file systems permit 255."""
    path = tmp_path / ("a" * 253)
    path.write_bytes(b"old")
    with pytest.raises(OutputError, match="File name too long"):
        write_all([Writing(path, b"new", OWN_KIND)], backup=True)
    assert contents(tmp_path) == {path.name: b"old"}


def test_backup_is_written_if_times_cannot_be_set(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "utime", refuse)
    write_both(folder, backup=True)
    assert (folder / "a.bak").read_bytes() == b"old a"


def test_first_file_is_restored_from_a_copy_without_hard_links(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    (folder / "a").chmod(0o640)
    monkeypatch.setattr(os, "link", no_links)
    fails_at("b", monkeypatch, OSError(errno.EIO, "Input/output error"))
    with pytest.raises(OutputError, match="Input/output error"):
        write_both(folder)
    assert contents(folder) == OLD
    assert (folder / "a").stat().st_mode & 0o777 == 0o640


def test_backup_is_named_and_kept_if_it_cannot_be_restored(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = Path.replace, list[Path]()

    def only_once(self: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) > 1:
            raise OSError(errno.EIO, "Input/output error")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", only_once)
    with pytest.raises(OutputError, match="could not be restored") as raised:
        write_both(folder)
    assert (folder / "a.old1").read_bytes() == b"old a"  # not hidden: no later run removes it
    assert str(folder / "a.old1") in str(raised.value)
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


def test_new_files_are_removed_if_a_later_one_fails(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails_at("b", monkeypatch, OSError(errno.EIO, "Input/output error"))
    with pytest.raises(OutputError):
        write_all([Writing(folder / "new", b"x", OWN_KIND), Writing(folder / "b", b"y", OWN_KIND)])
    assert contents(folder) == OLD


@pytest.mark.parametrize("problem", ["read-only", "changed", "a folder"])
def test_no_file_is_changed_if_a_problem_is_known_before(
    problem: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = dict(OLD)
    if problem == "read-only":
        real = os.access

        def may(path: Path, how: int) -> bool:
            return Path(path) != folder / "b" and real(path, how)

        monkeypatch.setattr(os, "access", may)
    elif problem == "changed":
        (folder / "b").write_bytes(b"another's")
        expected["b"] = b"another's"
    else:
        (folder / "b").unlink()
        (folder / "b").mkdir()
        del expected["b"]
    with pytest.raises(OutputError) as raised:
        write_both(folder, backup=True)
    assert raised.value.path == folder / "b"
    if problem == "a folder":
        (folder / "b").rmdir()
    assert contents(folder) == expected


def test_concurrent_change_of_a_file_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another program writes to the second file when the first has been replaced."""
    real = Path.replace

    def replace(self: Path, target: Path) -> Path:
        if Path(target).name == "a" and (folder / "b").read_bytes() == OLD["b"]:
            (folder / "other").write_bytes(b"another's")
            real(folder / "other", folder / "b")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(OutputError, match="changed meanwhile"):
        write_both(folder)
    assert contents(folder) == {"a": b"old a", "b": b"another's"}


def test_contents_are_synced_before_files_are_replaced(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Order of the calls of fsync and rename."""
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
    write_both(folder)
    assert done[:4] == ["fsync", "fsync", "rename", "rename"]
