"""Arrays in an npz: bounded before they are unpacked, and never unpickled."""

from __future__ import annotations

import io
import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pupper_analysis.base.errors import InputError, MeasurementError
from pupper_analysis.tools.fit.measurements import columns
from pupper_analysis.tools.fit.measurements.columns import Column, read_columns, read_npz

TIME = np.arange(6.0).reshape(2, 3)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_are_those_that_were_saved(
    tmp_path: Path, save: Callable[..., None], order: str
) -> None:
    save(tmp_path / "a.npz", time=np.array(TIME, order=order), joints=["hip", "knee"], one=3)
    found = read_npz(tmp_path / "a.npz")
    assert (found["time"] == TIME).all()
    assert found["joints"].tolist() == ["hip", "knee"]
    assert found["one"].shape == ()


def _member(content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", content)
    return file.getvalue()


def _npy(values: object) -> bytes:
    file = io.BytesIO()
    np.save(file, np.asarray(values))
    return file.getvalue()


class _Acts:
    def __reduce__(self) -> tuple[object, ...]:
        return (pytest.fail, ("a pickle was loaded",))


def _refused(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(InputError) as refused:
        read_npz(path)
    assert "\n" not in str(refused.value)
    return refused.value.cause.code


def test_zeros_are_refused_before_they_are_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thousandth of what they are: three megabytes would be three gigabytes."""
    monkeypatch.setattr(columns, "MOST_UNPACKED", 30_000_000)
    file = io.BytesIO()
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("time.npy", "w", force_zip64=True) as member,
    ):
        for _ in range(31):
            member.write(bytes(10**6))
    tracemalloc.start()
    code = _refused(tmp_path / "a.npz", file.getvalue())
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert code == "npz-too-large"
    assert most < 10e6


def test_a_directory_that_claims_less_gives_no_more(tmp_path: Path) -> None:
    data = bytearray(_member(_npy(np.zeros(3 * 10**6))))
    size = (24 * 10**6 + 128).to_bytes(4, "little")
    assert data.count(size) == 2  # of the member, and of the directory
    at = data.rindex(size)
    data[at : at + 4] = (200).to_bytes(4, "little")
    tracemalloc.start()
    code = _refused(tmp_path / "a.npz", bytes(data))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert code == "no-npz"
    assert most < 10e6


@pytest.mark.parametrize(
    "content",
    [
        _npy(TIME)[:-1],
        _npy(TIME) + b"\0",
        _npy(TIME).replace(b"(2, 3)", b"(-2,3)"),
        _npy(TIME).replace(b"(2, 3)", b"(9999)"),
        _npy(np.array([None])),
        pickle.dumps(_Acts()),
        b"",
    ],
)
def test_what_is_no_array_of_numbers_is_one_error(tmp_path: Path, content: bytes) -> None:
    assert _refused(tmp_path / "a.npz", _member(content)) == "no-npz"
    assert _refused(tmp_path / "a.npz", content) == "no-npz"


KNOWN = (Column("time", "time"), Column("position.*", "position"), Column("stand", ""))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_columns_may_be_separated_by_semicolons_or_tabs(tmp_path: Path, separator: str) -> None:
    file = tmp_path / "a.csv"
    name = "ab" if separator == "," else "a,b"
    lines = [["stand", "time [ms]", "position.a"], [name, "5", "0.25"]]
    if separator == ";":
        lines.append(["c", "7,5", "-1,5e-1"])
    file.write_text("\ufeff" + "\r\n".join(map(separator.join, lines)), encoding="utf-8")
    found = read_columns(file, KNOWN)
    assert found.words["stand"][0] == name
    assert found.numbers["time"][0] == pytest.approx(0.005)
    if separator == ";":
        assert found.numbers["time"][1] == pytest.approx(0.0075)
        assert found.numbers["position.a"][1] == pytest.approx(-0.15)


@pytest.mark.parametrize(
    ("data", "code", "text"),
    [
        ("time\n1".encode("utf-16"), "encoded-in-utf-16", "UTF-8"),
        (b"time\n1\0", "file-is-binary", "a.csv:2"),
        (b"time\n\xe4", "not-utf-8", "a.csv:2"),
        (b"time\n" + b"1" * 200_000, "no-csv", "field"),
        (b"x" * 100_000 + b"\n1", "measurement-unknown", "..."),
        (b"time\n" + b"x" * 100_000, "cell-no-number", "line 2"),
    ],
)
def test_a_csv_that_is_none_is_told_in_few_words(
    tmp_path: Path, data: bytes, code: str, text: str
) -> None:
    (tmp_path / "a.csv").write_bytes(data)
    with pytest.raises(MeasurementError) as refused:
        read_columns(tmp_path / "a.csv", KNOWN)
    assert refused.value.cause.code == code
    assert text in str(refused.value)
    assert len(str(refused.value)) < 400 + len(str(tmp_path))
