"""A missing OpenGL library affects only commands that draw with it."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

import pupper_analysis as pa
from tests.support.commands import answer
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT


def run_python(*arguments: str, folder: Path, gl: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder with a value of MUJOCO_GL, and return the completed process."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MUJOCO_GL": gl}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        timeout=PATIENCE,
        check=False,
    )


BROKEN = """
import sys
class Broken:
    '''OpenGL as PyOpenGL is without its libraries, whatever this machine has.'''
    def find_spec(self, name, path=None, target=None):
        if name == "OpenGL" or name == "mujoco.osmesa" or name == "mujoco.egl":
            raise AttributeError("'NoneType' object has no attribute 'glGetError'")
sys.meta_path.insert(0, Broken())
sys.argv = ["pupper-analysis", *sys.argv[1:]]
from pupper_analysis.__main__ import main
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("gl", ["osmesa", "egl", "bogus"])
def test_commands_run_without_opengl(gl: str, tmp_path: Path) -> None:
    """The import of OpenGL fails as PyOpenGL does without its libraries."""
    result = run_python(
        "-c", BROKEN, "audit", str(ROOT / "mjcf" / "pupper_v3.xml"), folder=tmp_path, gl=gl
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert "rules" in result.stdout


@pytest.mark.slow
def test_pictures_are_drawn_without_opengl(tmp_path: Path) -> None:
    """The picture is written, and one line names the missing library."""
    command = ("analyze", "original", "--output", "out")
    result = run_python("-c", BROKEN, *command, folder=tmp_path, gl="osmesa")
    assert result.returncode == 0
    assert result.stderr.startswith("note: no OpenGL (osmesa: ")
    assert result.stderr.count("\n") == 1
    assert (tmp_path / "out" / "variants.png").is_file()


@pytest.mark.slow
def test_study_process_runs_without_opengl(tmp_path: Path) -> None:
    """Modules that are imported directly, as when a robot is unpickled, without the package's
    command line."""
    broken = BROKEN.partition("sys.argv")[0]
    code = "import os, pupper_analysis.robot.robot, mujoco; print(os.environ['MUJOCO_GL'])"
    result = run_python("-c", broken + code, folder=tmp_path, gl="osmesa")
    assert (result.stdout, result.stderr) == ("osmesa\n", "")


@pytest.mark.slow
def test_command_imports_opengl_only_to_draw(tmp_path: Path) -> None:
    """Loading GLFW starts another process, which takes a tenth of the time of `stand v3`."""
    code = """
import atexit, os, sys
loaded = lambda: [name for name in ("mujoco", "glfw", "OpenGL") if name in sys.modules]
atexit.register(lambda: print(loaded(), repr(os.environ["MUJOCO_GL"])))
from pupper_analysis.__main__ import main
main()
"""
    command = ("stand", "--explain", str(ROOT / "mjcf" / "pupper_v3.xml"))
    result = run_python("-c", code, *command, folder=tmp_path, gl="")
    assert result.stderr == ""
    assert result.stdout.splitlines()[-1] == "['mujoco'] ''"


DIVERGES = """
import mujoco
def diverge():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint type="slide"/><geom size=".1"/></body>'
        '</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qpos[:] = float("nan")
    mujoco.mj_step(model, data)
    print("warnings:", sum(one.number for one in data.warning))
"""
"""Code with a diverging step, for which MuJoCo writes a warning to MUJOCO_LOG.TXT."""
COMMAND = (
    DIVERGES
    + """
from pupper_analysis.cli import run, shared
@shared.command()
def command():
    diverge()
try:
    run(command, [])
finally:
    print("restored:", mujoco.MjLogConfig.get().logto_file)
"""
)
WORKER = f"""
{DIVERGES}
from pupper_analysis.tools.study.running import initialise_worker
initialise_worker()
diverge()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "log"),
    [(DIVERGES + "diverge()", True), (COMMAND, False), (WORKER, False)],
    ids=["MuJoCo", "command", "worker of a study"],
)
def test_commands_write_no_mujoco_log(code: str, log: bool, tmp_path: Path) -> None:
    """Reference: MuJoCo alone writes a log of the same divergence; each run counts the warning."""
    result = run_python("-c", code, folder=tmp_path, gl="")
    assert "warnings: 1\n" in result.stdout
    assert "restored: False" not in result.stdout
    assert [path.name for path in tmp_path.iterdir()] == (["MUJOCO_LOG.TXT"] if log else [])


NAMED_NAN = """<mujoco><worldbody><body name="NaN"><joint axis="0 1 0" pos="NaN 0 0"/>
<geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("command", [False, True], ids=["function", "command"])
def test_no_log_is_written_if_a_model_has_warnings(
    command: bool, mujoco_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: MuJoCo by itself writes a log for a number that is NaN."""
    monkeypatch.chdir(tmp_path)
    Path("nan.xml").write_text(NAMED_NAN)
    mujoco_log.unlink(missing_ok=True)
    with contextlib.suppress(ValueError):
        mujoco.MjModel.from_xml_path("nan.xml")
    assert "NaN" in mujoco_log.read_text()
    mujoco_log.unlink()
    if command:
        answer("audit", "nan.xml")
    else:
        with contextlib.suppress(pa.ModelError):
            pa.audit_model("nan.xml")
    assert not mujoco_log.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["nan.xml"]


@pytest.mark.slow
def test_mujoco_is_imported_without_a_driver_if_drawing_is_disabled(tmp_path: Path) -> None:
    code = "import pupper_analysis, mujoco; print(mujoco.MjModel.__name__)"
    result = run_python("-c", code, folder=tmp_path, gl="disable")
    assert result.stdout == "MjModel\n", result.stderr


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "1"),
        ({"OPENBLAS_NUM_THREADS": ""}, "1"),
        ({"OPENBLAS_NUM_THREADS": "3"}, "3"),
        ({"OMP_NUM_THREADS": "3"}, None),
    ],
)
def test_commands_use_one_thread_of_blas_unless_the_user_chose_a_number(
    given: dict[str, str], expected: str | None
) -> None:
    """Reference: the environment at the end of a command, in a process of its own."""
    variables = ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS")
    kept = {name: value for name, value in os.environ.items() if name not in variables}
    program = """
import atexit, os, sys
atexit.register(lambda: print(os.environ.get("OPENBLAS_NUM_THREADS")))
from pupper_analysis.__main__ import main
sys.argv[1:] = ["--version"]
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env={**kept, "PYTHONPATH": str(ROOT), **given},
        timeout=PATIENCE,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == str(expected)
