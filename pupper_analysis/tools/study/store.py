"""A study's folder: what was asked, shards that are there whole or not at all, and a lock."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    InputError,
    MissingPackageError,
    OutputError,
    StudyError,
)
from pupper_analysis.base.files import Writing, remove_stale_files, write_all, write_atomically
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.base.kinds import EDITED, MODEL, OWN
from pupper_analysis.base.locks import lock_file
from pupper_analysis.tools.study.design import FAILURE_COLUMNS, Row

if TYPE_CHECKING:
    import pandas as pd

FOLDER_FORMAT = 1
"""Of the folder; a later one may differ."""


def require_library(library: str) -> None:
    """Checks that a library of the extra ``study`` is there.

    Raises:
        MissingPackageError: If not; says how to install it.
    """
    import importlib.util

    if importlib.util.find_spec(library) is None:
        raise MissingPackageError(library, "study")


class Store:
    """The folder.

    Args:
        folder: Its path.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.shards = folder, folder / "shards"

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the folder for one run. A process that dies, however it dies, holds it no more.

        Raises:
            StudyError: If another run holds it.
            OutputError: If the folder cannot be written to.
        """
        try:
            self.shards.mkdir(parents=True, exist_ok=True)
            with contextlib.ExitStack() as stack:
                if not stack.enter_context(lock_file(self.folder / ".lock")):
                    raise StudyError(self.folder, diagnose("study-is-running"))
                held = stack.pop_all()
        except OSError as error:
            raise OutputError(self.folder, error.strerror or error) from error
        with held:
            for folder in (self.folder, self.shards):
                remove_stale_files(folder)
            yield

    def write_request(self, asked: dict[str, Any]) -> None:
        """Writes what was asked.

        Raises:
            OutputError: If it cannot be written.
        """
        file = self.folder / "study.json"
        known = file.is_file() and bool(self.read_request())
        content = orjson.dumps({"format": FOLDER_FORMAT, **asked}, option=orjson.OPT_INDENT_2)
        write_all([Writing(file, content + b"\n", EDITED if known else MODEL)])

    def read_request(self) -> dict[str, Any]:
        """Reads what was asked.

        Raises:
            StudyError: If it is no study's folder, or of a later version.
        """
        path = self.folder / "study.json"
        try:
            found: dict[str, Any] = orjson.loads(read_input(path, MAX_TEXT_BYTES, own=True))
        except InputError as error:
            finding = error.cause
            if finding.code == "no-such-file":
                finding = diagnose("no-study-here")
            raise StudyError(self.folder, finding) from error
        except ValueError as error:
            finding = diagnose("study-not-readable", problem=str(error))
            raise StudyError(self.folder, finding) from error
        if not isinstance(found, dict) or found.get("format") != FOLDER_FORMAT:
            raise StudyError(self.folder, diagnose("study-of-another-format", format=FOLDER_FORMAT))
        return found

    def write(self, rows: Sequence[Row]) -> None:
        """Writes a shard; its name follows from its designs.

        Raises:
            OutputError: If it cannot be written; the folder is as it was.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        if not rows:
            return
        # A design that failed has fewer columns: those of one that has all are in their order.
        whole = sorted(rows, key=len, reverse=True)
        columns = dict.fromkeys(name for row in whole for name in row)
        fields = [pa.field(name, _kind(pa, name)) for name in columns]
        table = pa.Table.from_pylist(list(rows), schema=pa.schema(fields))
        named = "".join(sorted(row["design"] for row in rows))
        name = hashlib.sha256(named.encode()).hexdigest()[:24]
        with write_atomically(self.shards / f"{name}.parquet", OWN) as file:
            pq.write_table(table, file)

    def designs(self) -> NDArray[np.uint64]:
        """Returns the keys (n,) of the designs that are done, sorted.

        Raises:
            StudyError: If a shard cannot be read.
        """
        parts = [np.zeros(0, np.uint64)]
        for table in self._tables(["design"]):
            parts.append(make_design_keys(table.column("design").to_pylist()))
        return np.unique(np.concatenate(parts))

    def table(self) -> pd.DataFrame:
        """Returns all rows, each design once, sorted by design.

        Raises:
            StudyError: If a shard cannot be read.
        """
        import pandas as pd
        import pyarrow as pa

        tables = sorted(self._tables(None), key=lambda table: -table.num_columns)
        if not tables:
            return pd.DataFrame({"design": pd.Series(dtype=str)})
        joined = pa.concat_tables(tables, promote_options="default")
        frame: pd.DataFrame = joined.to_pandas().drop_duplicates("design")
        return frame.sort_values("design").reset_index(drop=True)

    def _tables(self, columns: list[str] | None) -> Iterator[Any]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        for path in sorted(self.shards.glob("*.parquet")):
            try:
                # Into memory: a mapped file would be held open.
                yield pq.read_table(path, columns=columns, memory_map=False)
            except (OSError, pa.ArrowException) as error:
                finding = diagnose("shard-damaged", file=path.name, problem=str(error))
                raise StudyError(self.folder, finding) from error


def make_design_keys(designs: Sequence[str]) -> NDArray[np.uint64]:
    """Returns the first 64 bits of designs' hashes (n,): a million of them are 8 MB.

    That two of a million share them has a probability of 3e-8.
    """
    found = bytes.fromhex("".join(design[:16] for design in designs))
    return np.frombuffer(found, ">u8").astype(np.uint64)


def _kind(pa: Any, name: str) -> Any:
    return pa.string() if name in ("design", *FAILURE_COLUMNS) else pa.float64()
