"""Studies on a Dask cluster: a killed worker loses no row; the table is that of a serial run."""

from __future__ import annotations

import os
import signal
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, StudyError
from pupper_analysis.tools.study.cluster import connect_dask
from pupper_analysis.tools.study.running import Progress
from tests.support.commands import check_refusal


def make_study() -> Any:
    return pa.Study("v3", {"kp": [4.0 + 0.25 * k for k in range(24)]}, ["peak_torque"])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Dask and its dependencies
def test_killed_worker_of_a_dask_cluster_loses_no_row(tmp_path: Path) -> None:
    """Reference: the serial run, to the last digit; each design is stored once."""
    with ThreadPoolExecutor(1) as thread:
        serial = make_study().run(tmp_path / "serial", executor=thread)
    killed: list[int] = []
    with connect_dask("local:2") as (executor, workers):
        assert workers == 2
        processes = executor._client.run(os.getpid)  # type: ignore[attr-defined]
        assert len(processes) == 2
        assert os.getpid() not in processes.values()

        def kill_one(progress: Progress) -> None:
            if progress.done >= 4 and not killed:
                killed.append(next(iter(processes.values())))
                os.kill(killed[0], signal.SIGKILL)

        folder = tmp_path / "cluster"
        table = make_study().run(folder, executor=executor, workers=workers, progress=kill_one)
    assert killed
    assert len(table) == 24
    assert table["design"].is_unique
    assert len(pa.read_study(folder)) == 24
    assert table.equals(serial)


class _WithoutModule(ThreadPoolExecutor):
    """Workers on which a module is missing, as on another machine."""

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(ModuleNotFoundError("No module named 'ours'", name="ours"))
        return future


def test_module_that_workers_lack_is_named_with_a_remedy(tmp_path: Path) -> None:
    with (
        _WithoutModule(1) as executor,
        pytest.raises(StudyError, match=r'module ours of a metric.*upload_file\("ours.py"\)'),
    ):
        make_study().run(tmp_path, executor=executor)


@pytest.mark.parametrize("address", ["local:0", "local:two", "local:"])
def test_invalid_local_address_is_refused(address: str) -> None:
    with pytest.raises(ConfigurationError, match="local:4"), connect_dask(address):
        pass


def test_workers_and_dask_exclude_each_other(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "s.toml"
    path.write_text('robot = "v3"\nmeasure = ["stands"]\n[vary]\nkp = { values = [5.0] }\n')
    words = ("study", str(path), "-o", str(tmp_path / "o"), "--dask", "local:2", "--workers", "2")
    check_refusal(capfd, tmp_path, words, "leave out --workers")
