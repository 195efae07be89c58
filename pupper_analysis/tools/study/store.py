"""Folder of a study: definition, lock, and shards of rows that are written atomically.

A run stores evaluated designs as Parquet files (shards). Each shard is a table with a row per
design. Therefore an interrupted run loses only rows that are not written yet. The stored table is
the union of all shards. The hash of a design identifies the row.
"""

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
from pupper_analysis.base.kinds import EDITED_KIND, MODEL_KIND, OWN_KIND
from pupper_analysis.base.locks import lock_file
from pupper_analysis.tools.study.design import FAILURE_COLUMNS, DesignRow

if TYPE_CHECKING:
    import pandas as pd

FOLDER_FORMAT = 1
"""Format number of the folder of a study. Folders with another number are refused."""


def require_library(library: str) -> None:
    """Check that a library of the extra ``study`` is installed.

    Raises:
        MissingPackageError: If the library is missing; the message contains the install command.
    """
    import importlib.util

    if importlib.util.find_spec(library) is None:
        raise MissingPackageError(library, "study")


class Store:
    """Folder in which a study stores the definition and the results.

    Args:
        folder: Path of the folder.

    Attributes:
        folder: Path of the folder.
        shards: Path of the folder with Parquet files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.shards = folder, folder / "shards"

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the folder of a study for a run, within a ``with`` block.

        The operating system releases the lock if the process ends.

        Raises:
            StudyError: If another run has locked the folder.
            OutputError: If the folder cannot be written.
        """
        try:
            self.shards.mkdir(parents=True, exist_ok=True)
            with contextlib.ExitStack() as stack:
                if not stack.enter_context(lock_file(self.folder / ".lock")):
                    raise StudyError(self.folder, diagnose("study-is-running"))
                lock = stack.pop_all()
        except OSError as error:
            raise OutputError(self.folder, error.strerror or error) from error
        with lock:
            for folder in (self.folder, self.shards):
                remove_stale_files(folder)
            yield

    def write_request(self, request: dict[str, Any]) -> None:
        """Write the definition of the study to ``study.json``; replace an existing definition.

        Args:
            request: Definition: the study, the digest of the study, and versions of libraries.

        Raises:
            OutputError: If the file cannot be written, or an existing file is no JSON (without
                ``force`` of the run).
            StudyError: If an existing definition has another format, for example; the file is then
                unchanged.
        """
        file, is_rerun = self.folder / "study.json", False
        if file.is_file():
            try:
                is_rerun = bool(self.read_request())
            except StudyError as error:
                problem = error.diagnostic.values["problem"]
                if getattr(problem, "code", "") != "study-not-readable":
                    raise
        content = orjson.dumps({"format": FOLDER_FORMAT, **request}, option=orjson.OPT_INDENT_2)
        write_all([Writing(file, content + b"\n", EDITED_KIND if is_rerun else MODEL_KIND)])

    def read_request(self) -> dict[str, Any]:
        """Read the definition: {"format": number, "study": ..., "digest": ..., "versions": ...}.

        Raises:
            StudyError: If the folder contains no readable definition, or the format differs.
        """
        path = self.folder / "study.json"
        try:
            content = read_input(path, MAX_TEXT_BYTES, rewritten=True)
            request: dict[str, Any] = orjson.loads(content)
        except InputError as error:
            finding = error.cause
            if finding.code == "no-such-file":
                finding = diagnose("no-study-here")
            raise StudyError(self.folder, finding) from error
        except ValueError as error:
            finding = diagnose("study-not-readable", problem=str(error))
            raise StudyError(self.folder, finding) from error
        if not isinstance(request, dict) or request.get("format") != FOLDER_FORMAT:
            raise StudyError(self.folder, diagnose("study-of-another-format", format=FOLDER_FORMAT))
        return request

    def write(self, rows: Sequence[DesignRow]) -> None:
        """Write table rows as a shard (Parquet file), whose name is a hash of the designs.

        Raises:
            OutputError: If the shard cannot be written; the folder is then unchanged.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        if not rows:
            return
        # A failed design has fewer columns: the longest row determines the order.
        by_length = sorted(rows, key=len, reverse=True)
        columns = dict.fromkeys(name for row in by_length for name in row)
        fields = [pa.field(name, _column_type(pa, name)) for name in columns]
        table = pa.Table.from_pylist(list(rows), schema=pa.schema(fields))
        all_names = "".join(sorted(row["design"] for row in rows))
        name = hashlib.sha256(all_names.encode()).hexdigest()[:24]
        with write_atomically(self.shards / f"{name}.parquet", OWN_KIND) as file:
            pq.write_table(table, file)

    def designs(self) -> NDArray[np.uint64]:
        """Return the sorted 64-bit keys (`make_design_keys`), shape (n,), of all stored designs.

        Raises:
            StudyError: If a shard cannot be read.
        """
        parts = [np.zeros(0, np.uint64)]
        for table in self._read_tables(["design"]):
            parts.append(make_design_keys(table.column("design").to_pylist()))
        return np.unique(np.concatenate(parts))

    def table(self) -> pd.DataFrame:
        """Return all stored results of a study as a table, a row per design, sorted by hash.

        Raises:
            StudyError: If a shard cannot be read.
        """
        import pandas as pd
        import pyarrow as pa

        tables = sorted(self._read_tables(None), key=lambda table: -table.num_columns)
        if not tables:
            return pd.DataFrame({"design": pd.Series(dtype=str)})
        joined = pa.concat_tables(tables, promote_options="default")
        frame: pd.DataFrame = joined.to_pandas().drop_duplicates("design")
        return frame.sort_values("design").reset_index(drop=True)

    def _read_tables(self, columns: list[str] | None) -> Iterator[Any]:
        """Yield the tables of the Parquet files of results; all columns if ``columns`` is None.

        Raises:
            StudyError: If a file cannot be read.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        for path in sorted(self.shards.glob("*.parquet")):
            try:
                # A memory-mapped file would stay open.
                table = pq.read_table(path, columns=columns, memory_map=False)
                table.column("design")
            except (OSError, KeyError, pa.ArrowException) as error:
                finding = diagnose("shard-damaged", file=path.name, problem=str(error))
                raise StudyError(self.folder, finding) from error
            yield table


def make_design_keys(designs: Sequence[str]) -> NDArray[np.uint64]:
    """Return short keys of n designs: the first 64 bits of the hexadecimal hashes, shape (n,).

    A million keys need 8 MB. The probability that two of a million keys are equal is 3e-8.
    """
    key_bytes = bytes.fromhex("".join(design[:16] for design in designs))
    return np.frombuffer(key_bytes, ">u8").astype(np.uint64)


def _column_type(pa: Any, name: str) -> Any:
    """Return the Parquet type of a column: text for the design and for failures, else float64.

    ``pa`` is the module ``pyarrow``, which is imported only if results are written or read.
    """
    return pa.string() if name in ("design", *FAILURE_COLUMNS) else pa.float64()


def number_truth_values(table: pd.DataFrame) -> pd.DataFrame:
    """Return a copy of the table of a study in which truth values are the stored 1 and 0.

    Missing truth values are NaN.
    """
    columns = table.select_dtypes(["bool", "boolean"]).columns
    return table.astype(dict.fromkeys(columns, float))
