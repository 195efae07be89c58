"""A study: variables, designs and metrics, defined in Python or by a TOML file.

`Study.run` evaluates the metrics of all designs that the folder does not contain yet, and returns a
table with a row per design. A hash of the study's definition and of the variable values identifies
a design. Therefore an interrupted or extended study can be continued.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson

from pupper_analysis.base.arguments import check_finite, check_type
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    StudyError,
    UnknownNameError,
    VariantError,
)
from pupper_analysis.base.inputs import is_input, read_toml
from pupper_analysis.base.notebook import format_value, render_table
from pupper_analysis.base.provenance import list_versions
from pupper_analysis.base.results import MAX_REPR_LENGTH
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.prepare.convert.files import FileSource
from pupper_analysis.robot.joints import resolve_posture
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import check_point, find_place, split_place
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.study.design import (
    FAILURE_COLUMNS,
    STANCE_VARIABLES,
    RobotSource,
    Variants,
    check_variable_name,
    check_variable_range,
    hash_description,
    make_robot_source,
)
from pupper_analysis.tools.study.measures import (
    METRICS,
    METRICS_REVISION,
    MetricFunction,
    fingerprint_metric,
    format_metric,
    make_metric,
    resolve_metric_file,
)
from pupper_analysis.tools.study.motors import (
    assign_motors,
    encode_motor,
    is_motor_variable,
    make_motor_variable,
)
from pupper_analysis.tools.study.parameters import (
    JOINT_STANCE_KINDS,
    LINK_STANCE_KINDS,
    SERVO_KINDS,
    VariablePattern,
    find_moving_joints,
)
from pupper_analysis.tools.study.requirements import Requirement
from pupper_analysis.tools.study.running import Progress, StudyRun, WorkDefinition
from pupper_analysis.tools.study.store import Store, require_library
from pupper_analysis.tools.study.variables import Sampling, Variable, make_variable

if TYPE_CHECKING:
    import pandas as pd

_REQUIRED_KEYS = {
    "robot": 'robot = "v3"',
    "vary": "vary = {leg_scale = [1.0, 1.2]}",
    "measure": 'measure = ["peak_utilisation"]',
}
"""{required key of a study: example of the line in a TOML file}."""

STUDY_KEYS = (
    "robot",
    "vary",
    "samples",
    "seed",
    "measure",
    "stand",
    "payload_point",
    "time_limit",
    "present_motor",
    "require",
    "minimise",
    "maximise",
)
"""Valid keys of a study file; a file with another key is refused."""


class Study:
    """Parameter study of a robot: variables, and metrics that are evaluated for each design.

    Attributes:
        source: Source of the robots.
        variables: {name: variable}.
        task: Stand task; values of stance variables take precedence.
        sampling: Generator of the designs: product of lists, or samples.
        metrics: Metrics.
        point: Position of a payload: (x, y, z) [m] in the base frame, or (frame, x, y, z).
        time_limit: Time limit per design [s], or None.
        motors: {code: motor} of the motor variables (`encode_motor`).
        present_motor: Motor whose mass the robot's files include; None without motor variables.
        requirements: Requirements on the designs.
        minimise: Columns that the Pareto front minimises.
        maximise: Columns that the Pareto front maximises.
    """

    def __init__(
        self,
        robot: Any,
        vary: Mapping[str, Any],
        measure: Sequence[str | MetricFunction],
        *,
        samples: int | None = None,
        seed: int = 0,
        stand: StandTask | None = None,
        payload_point: Sequence[float] | Sequence[str | float] = (0.0, 0.0, 0.0),
        time_limit: float | None = 60.0,
        present_motor: str | Motor | None = None,
        require: Mapping[str, bool | float | str] | None = None,
        minimise: str | Sequence[str] = (),
        maximise: str | Sequence[str] = (),
    ) -> None:
        """Check all arguments that can be checked before a design is evaluated.

        Args:
            robot: A file, two files joined by a plus, the name of a variant, or a ``VariantSpec``.
                Or a mapping {``base``, ``leg_scale``, ``torso_mass_scale``}, whose ``base`` is a
                variant or files. Or a mapping {``urdf``: path, ``mjcf``: path}, with other
                arguments of `load_robot`. ``leg_scale`` and ``torso_mass_scale`` can be varied for
                variants only.
            vary: {name of a variable: values}. Values are a list, a ``linspace``, a distribution,
                or a number. The values of a motor variable are names or files of motors.
            measure: Names of ``METRICS`` (``NAME:FILE`` if the metric needs a file), or functions
                of (robot, stand).
            samples: Number of designs, required if a variable has a distribution. Otherwise None:
                the designs are the product of all lists.
            seed: Seed of the samples.
            stand: Stand task; variables of the stance take precedence.
            payload_point: Position of a payload, shape (3,) [m] in the frame of the base, or
                (frame, x, y, z) in the frame of a link, site, body or geom.
            time_limit: Time limit per design [s]; None for no limit. If a design exceeds the limit,
                the worker process ends. Therefore the limit applies to processes and Dask, but not
                to threads.
            present_motor: Motor at the joints with motor variables, whose mass the robot's files
                include: a name, a file, or a motor. Required if a motor is varied.
            require: Requirements on the designs on the Pareto front: {metric or variable: true,
                false, a number, or a text such as ``"< 1"``}.
            minimise: Columns that the Pareto front minimises.
            maximise: Columns that the Pareto front maximises.

        Raises:
            ConfigurationError: If an argument is not valid; the message lists valid values.
            UnknownNameError: If the pattern of a variable matches nothing in the robot, the frame
                of ``payload_point`` does not exist, or no motor has a name.
            VariantError: If the variant of the robot does not exist, or a scale is not valid.
            ModelError: If the files of the robot or of a motor cannot be used, or the mass of
                ``present_motor`` is unknown.
        """
        check_type("vary", vary, Mapping[str, Any])
        check_type("measure", measure, Sequence[str | MetricFunction])
        check_type("samples", samples, int | None)
        check_type("seed", seed, int)
        check_type("stand", stand, StandTask | None)
        check_type("present_motor", present_motor, str | Motor | None)
        check_type("minimise", minimise, str | Sequence[str])
        check_type("maximise", maximise, str | Sequence[str])
        self.source = make_robot_source(robot)
        check_type("require", require, Mapping[str, Any] | None)
        self.motors: dict[float, Motor] = {}
        variables: dict[str, Variable] = {}
        for name, values in vary.items():
            check_variable_name(str(name), self.source)
            if is_motor_variable(str(name)):
                variables[str(name)], motors = make_motor_variable(str(name), values)
                self.motors |= motors
            else:
                variables[str(name)] = make_variable(str(name), values)
        self.variables = variables
        self.present_motor = self._choose_present_motor(present_motor)
        self.task = stand or StandTask()
        self._check_variables()
        self.sampling = Sampling(self.variables, samples, seed)
        self.metrics = tuple(make_metric(metric) for metric in measure)
        self._requested_metrics = tuple(measure)
        frame, point = split_place(payload_point)
        self.point = (*filter(None, (frame,)), *check_point(point).tolist())
        find_place(self.base, self.point)
        self.time_limit = None if time_limit is None else check_finite("time_limit", time_limit)
        if self.time_limit is not None and self.time_limit <= 0:
            finding = diagnose("time-limit-not-positive", limit=self.time_limit)
            raise ConfigurationError("time_limit", finding)
        if not self.metrics:
            raise ConfigurationError("measure", diagnose("nothing-to-measure"))
        metric_names = [metric.name for metric in self.metrics]
        repeated = next((name for name in metric_names if metric_names.count(name) > 1), None)
        if repeated is not None:
            raise ConfigurationError("measure", diagnose("there-twice", name=repeated))
        self.requirements = tuple(
            Requirement.parse(str(name), value) for name, value in (require or {}).items()
        )
        self._check_columns("require", [item.column for item in self.requirements])
        self.minimise = (minimise,) if isinstance(minimise, str) else tuple(minimise)
        self.maximise = (maximise,) if isinstance(maximise, str) else tuple(maximise)
        objectives = [*self.minimise, *self.maximise]
        self._check_columns("minimise, maximise", objectives)
        if len(set(objectives)) < len(objectives):
            raise ConfigurationError("minimise, maximise", diagnose("column-there-twice"))

    def _check_columns(self, argument: str, columns: Sequence[str]) -> None:
        """Check that columns belong to metrics of the study, or to variables other than motors."""
        measured = [metric.name for metric in self.metrics]
        numbers = [name for name in self.variables if not is_motor_variable(name)]
        for name in columns:
            if name.partition(".")[0] not in measured and name not in numbers:
                finding = diagnose("study-has-no-such", column=name, known=(*measured, *numbers))
                raise ConfigurationError(argument, finding)

    def _choose_present_motor(self, present: str | Motor | None) -> Motor | None:
        """Return the motor whose mass the files include; None if no motor is varied."""
        if bool(self.motors) != (present is not None):
            code = "present-motor-missing" if self.motors else "present-motor-unused"
            raise ConfigurationError("present_motor", diagnose(code))
        if present is None:
            return None
        motor = find_motor(present) if isinstance(present, str) else present
        motor.get("mass")
        return motor

    def make_source_with_visuals(self) -> RobotSource:
        """Create a source of the study's robots with visual geoms, to write a design as files."""
        if isinstance(self.source, FileSource):
            return FileSource(self.source.files, self.source.files.load())
        return Variants(self.source.spec, whole=True)

    def _check_variables(self) -> None:
        """Check ranges and patterns of the variables against the robot and the stand task."""
        stance_variables = (name for name in self.variables if name in STANCE_VARIABLES)
        offset = next(
            (name for name in stance_variables if STANCE_VARIABLES[name][0].name == "offset"), None
        )
        if offset is not None and self.task.com not in (None, "centre"):
            raise ConfigurationError(f"vary[{offset!r}]", diagnose("offset-and-com"))
        for name, variable in self.variables.items():
            check_variable_range(name, *variable.range)
            pattern = VariablePattern.parse(name)
            if pattern is not None and pattern.kind in LINK_STANCE_KINDS:
                contact_links = tuple(
                    link
                    for link, contact in self.task.contacts.items()
                    if contact.plane is not None
                )
                if pattern.pattern not in contact_links:
                    raise UnknownNameError(
                        self.base.name, "contact", pattern.pattern, contact_links
                    )
            elif pattern is not None:
                find_moving_joints(self.base, pattern)
            if pattern is not None and pattern.kind in JOINT_STANCE_KINDS:
                resolve_posture(self.base, {pattern.pattern: 0.0})
        motors = filter(is_motor_variable, self.variables)
        assign_motors(
            self.base, {name: self.variables[name].range[0] for name in motors}, self.motors
        )
        servo_kinds = {name for name in self.variables if name.partition(":")[0] in SERVO_KINDS}
        if servo_kinds:
            from pupper_analysis.robot.servos import resolve_servo_gains

            gains = {name: 1.0 if name in self.variables else None for name in SERVO_KINDS}
            resolve_servo_gains(self.base, gains["kp"], gains["kd"])

    @cached_property
    def base(self) -> Robot:
        """Robot of the study without changes by variables."""
        return self.source.robot({})

    @cached_property
    def digest(self) -> str:
        """SHA-256 hash (hexadecimal) of the data that determine the results of a given design.

        The hash contains, for example, robot, stand task, payload position, metrics and package
        versions, but no variables and no time limit.
        """
        parts = {
            "robot": hash_description(self.base.description),
            "source": repr(self.source.to_dict()) if self.source.scales else "",
            "stand": {item.name: repr(getattr(self.task, item.name)) for item in fields(self.task)},
            "point": self.point,
            "measures": sorted(fingerprint_metric(item) for item in self.metrics),
            "revision": METRICS_REVISION,
            "versions": list_versions(),
        }
        if self.present_motor is not None:
            parts["present_motor"] = encode_motor(self.present_motor)
        data = orjson.dumps(parts, option=orjson.OPT_SORT_KEYS)
        return hashlib.sha256(data).hexdigest()

    def __len__(self) -> int:
        return len(self.sampling)

    def __repr__(self) -> str:
        metrics = ", ".join(metric.name for metric in self.metrics)
        text = (
            f"Study of {self._robot_name!r}: {len(self)} designs, "
            f"vary {', '.join(self.variables)}, measure {metrics}"
        )
        return f"<{textwrap.shorten(text, MAX_REPR_LENGTH - 2, placeholder=' ...')}>"

    @property
    def _robot_name(self) -> str:
        """Name of the varied variant, or of the robot in the files."""
        return str(self.source.to_dict().get("base", self.base.name))

    def _repr_html_(self) -> str:
        """Return a table of the definition of the study, for notebooks."""
        variables = {
            name: " ".join(f"{kind} {values}" for kind, values in variable.to_dict().items())
            for name, variable in self.variables.items()
        }
        rows = [
            ("robot", format_value(self._robot_name), ""),
            ("designs", format_value(len(self)), ""),
            ("variables", format_value(variables), ""),
            ("metrics", format_value([metric.name for metric in self.metrics]), ""),
            ("task", format_value(self.task), ""),
            ("requirements", format_value([item.text for item in self.requirements]), ""),
            ("minimise", format_value(self.minimise), ""),
            ("maximise", format_value(self.maximise), ""),
            ("time_limit", format_value(self.time_limit), "s"),
        ]
        return render_table("Study", rows)

    def designs(self) -> Iterator[tuple[list[str], Array]]:
        """Yield the designs of this study in blocks of n designs.

        Yields:
            Hashes of the designs, and values of the variables, shape (n, number of variables), in
            the units of the variables.
        """
        for block in self.sampling.blocks():
            yield hash_designs(self.digest, tuple(self.variables), block), block

    def work(self) -> bytes:
        """Return the data that each worker needs, a `WorkDefinition`, as pickled bytes."""
        work = WorkDefinition(
            source=self.source,
            metrics=self._requested_metrics,
            variables=tuple(self.variables),
            task=self.task,
            point=self.point,
            versions=list_versions(),
            process=(platform.node(), os.getpid()),
            limit=self.time_limit,
            motors=self.motors,
            present_motor=self.present_motor,
        )
        return pickle.dumps(work)

    def to_dict(self) -> dict[str, Any]:
        """Return the study as {key of a study file: value}, data for `Study.of`.

        ``time_limit`` is None for no time limit. Motors and functions of the user are represented
        by name, so `Study.of` may be unable to restore them.
        """
        data: dict[str, Any] = {
            "robot": self.source.to_dict(),
            "vary": {name: item.to_dict() for name, item in self.variables.items()},
            "measure": [format_metric(item) for item in self.metrics],
            "seed": self.sampling.seed,
            "payload_point": list(self.point),
            "time_limit": self.time_limit,
            "stand": {
                field.name: getattr(self.task, field.name)
                for field in fields(self.task)
                if getattr(self.task, field.name) != getattr(StandTask(), field.name)
            },
        }
        if self.sampling.samples is not None:
            data["samples"] = self.sampling.samples
        if self.present_motor is not None:
            data["present_motor"] = self.present_motor.name
        if self.requirements:
            data["require"] = {
                item.column: f"{item.comparison} {item.limit!r}" for item in self.requirements
            }
        objectives = {"minimise": list(self.minimise), "maximise": list(self.maximise)}
        return data | {name: columns for name, columns in objectives.items() if columns}

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Study:
        """Create a study from plain data with the keys of a study file.

        Raises:
            ConfigurationError: If a key is missing or unknown, or an argument is not valid.
            VariantError: If the variant of the robot is not valid.
            ModelError: If the files of the robot cannot be used.
        """
        unknown = [key for key in data if key not in STUDY_KEYS]
        if unknown:
            raise ConfigurationError(unknown[0], diagnose("study-key-unknown", known=STUDY_KEYS))
        for key, example in _REQUIRED_KEYS.items():
            if key not in data:
                raise ConfigurationError(key, diagnose("study-key-missing", example=example))
        options = dict(data)
        stand = options.pop("stand", {})
        check_type("stand", stand, Mapping[str, Any])
        task = StandTask.from_dict(stand)
        return cls(
            options.pop("robot"), options.pop("vary"), options.pop("measure"), stand=task, **options
        )

    @classmethod
    def read(cls, path: str | Path) -> Study:
        """Read a study from a TOML file.

        Relative paths of robot files, motor files and files of metrics are relative to the folder
        of the study file.

        Raises:
            ConfigurationError: If the file cannot be read, or the study is not valid.
            VariantError: If the variant of the robot is not valid.
            ModelError: If the files of the robot cannot be used.
        """
        path = Path(path)
        try:
            _, data = read_toml(path)
        except InputError as error:
            raise ConfigurationError(str(path), error.cause) from error
        robot = data.get("robot")
        if isinstance(robot, dict):
            for name in ("urdf", "mjcf"):
                if isinstance(robot.get(name), str):
                    robot[name] = str(path.parent / robot[name])
            if isinstance(robot.get("models"), list):
                robot["models"] = [
                    _resolve_files(path, file) if isinstance(file, str) else file
                    for file in robot["models"]
                ]
            if isinstance(robot.get("base"), str):
                robot["base"] = _resolve_files(path, robot["base"])
        if isinstance(robot, str):
            data["robot"] = _resolve_files(path, robot)
        _resolve_motor_files(path.parent, data)
        metrics = data.get("measure")
        if isinstance(metrics, list):
            data["measure"] = [resolve_metric_file(path.parent, metric) for metric in metrics]
        try:
            return cls.of(data)
        except (ConfigurationError, VariantError) as error:
            raise error.with_location(str(path)) from error

    def run(
        self,
        folder: str | Path,
        *,
        executor: Executor | None = None,
        workers: int | None = None,
        progress: Callable[[Progress], None] | None = None,
    ) -> pd.DataFrame:
        """Evaluate all designs that are not stored yet, and return the complete table.

        Args:
            folder: Folder of the results. An interrupted or changed study resumes there.
            executor: Any `concurrent.futures.Executor`, such as Dask's ``client.get_executor()``;
                by default processes on this machine.
            workers: Number of processes; by default the number of cores. With ``executor``, the
                number of workers of the executor; by default the number that the executor reports.
            progress: Function that is called with the progress.

        Returns:
            A row per different design, in the order of the study: hash, variable values, measured
            values, and the failure columns. Metrics such as ``stands`` are truth values.

        Raises:
            ConfigurationError: If an argument is not valid.
            StudyError: If another run has locked the folder, a stored file cannot be read or has
                another format, or the workers do not start, have other package versions, or are
                lost. Measured rows are stored.
            OutputError: If the folder cannot be written.
            MissingPackageError: If pyarrow or pandas is not installed.
        """
        self.execute(folder, executor=executor, workers=workers, progress=progress)
        return self.table(folder)

    def execute(
        self,
        folder: str | Path,
        *,
        executor: Executor | None = None,
        workers: int | None = None,
        progress: Callable[[Progress], None] | None = None,
    ) -> Progress:
        """Evaluate all designs that are not stored yet, without loading the table.

        The arguments are the same as in `run`.

        Returns:
            Number of evaluated designs, failures and elapsed time.

        Raises:
            ConfigurationError: If an argument is not valid.
            StudyError: If another run has locked the folder, a stored file cannot be read or has
                another format, or the workers do not start, have other package versions, or are
                lost. Measured rows are stored.
            OutputError: If the folder cannot be written.
            MissingPackageError: If pyarrow is not installed.
        """
        check_type("folder", folder, str | Path)
        check_type("executor", executor, Executor | None)
        check_type("workers", workers, int | None)
        if workers is not None and workers < 1:
            raise ConfigurationError("workers", diagnose("too-few", count=workers))
        require_library("pyarrow")
        store = Store(Path(folder))
        with store.locked():
            request = {"study": self.to_dict(), "digest": self.digest, "versions": list_versions()}
            store.write_request(request)
            report, variables = progress or (lambda _: None), tuple(self.variables)
            run = StudyRun(self.work(), variables, self.time_limit, store, len(self), report)
            return run.measure_missing(self.designs(), executor, workers)

    def table(self, folder: str | Path) -> pd.DataFrame:
        """Return the stored rows of the designs of this study, as `run` returns the rows.

        Args:
            folder: Folder in which the study stores the results.

        Raises:
            StudyError: If a file with results (shard) is damaged.
            MissingPackageError: If pandas is not installed.
        """
        return restore_truth_values(self.stored_table(folder))

    def stored_table(self, folder: str | Path) -> pd.DataFrame:
        """Return the same rows as `table`, with the stored 1 and 0 for truth values.

        Args:
            folder: Folder in which the study stores the results.

        Raises:
            StudyError: If a file with results (shard) is damaged.
            MissingPackageError: If pandas is not installed.
        """
        require_library("pandas")
        rows = order_rows(Store(Path(folder)).table(), (names for names, _ in self.designs()))
        return name_motors(rows, self.variables)


def _resolve_files(path: Path, word: str) -> str:
    """Prepend the study file's folder to existing files in ``word``, names joined by ``+``."""
    parts = [(path.parent / part, part) for part in word.split("+")]
    return "+".join(str(file) if is_input(file) else part for file, part in parts)


def _resolve_motor_files(folder: Path, data: dict[str, Any]) -> None:
    """Prepend the study file's folder to the motor files in its content, in place."""

    def resolve(text: Any) -> Any:
        """Return the path of an existing file; otherwise the text."""
        return str(folder / text) if isinstance(text, str) and (folder / text).is_file() else text

    if "present_motor" in data:
        data["present_motor"] = resolve(data["present_motor"])
    variables = data.get("vary")
    for name in filter(is_motor_variable, variables if isinstance(variables, dict) else ()):
        values = data["vary"][name]
        if isinstance(values, dict) and isinstance(values.get("values"), list):
            values = values["values"]
        data["vary"][name] = (
            [resolve(text) for text in values] if isinstance(values, list) else resolve(values)
        )


# Table of a study: hashes of its designs, and order of its rows.


def name_motors(table: pd.DataFrame, variables: Mapping[str, Variable]) -> pd.DataFrame:
    """Return the table of a study with names of motors in place of their codes.

    ``variables`` is {column: variable}.
    """
    named = {
        name: variable.name_values(table[name])
        for name, variable in variables.items()
        if variable.labels and name in table
    }
    return table.assign(**named) if named else table


def restore_truth_values(table: pd.DataFrame) -> pd.DataFrame:
    """Return a copy of the table of a study in which the stored 1 and 0 are truth values.

    The type is ``bool``, or pandas' ``boolean`` if a value is missing.
    """
    columns = [name for name, metric in METRICS.items() if metric.is_truth and name in table]
    types = {name: "boolean" if table[name].hasnans else "bool" for name in columns}
    return table.astype(types)


def hash_designs(digest: str, variables: Sequence[str], block: Array) -> list[str]:
    """Compute a hash per design from the study's digest, the variable names and the values.

    The order of the variables does not affect the hash. ``block`` contains the variable values,
    shape (n, variables).
    """
    order = sorted(range(len(variables)), key=lambda index: variables[index])
    head = "\0".join([digest, *(variables[index] for index in order)]).encode()
    rows = np.ascontiguousarray(
        block[:, order] + 0.0, dtype="<f8"
    )  # adding 0.0 turns -0.0 into 0.0
    return [hashlib.sha256(head + row.tobytes()).hexdigest()[:32] for row in rows]


def order_rows(frame: pd.DataFrame, blocks: Iterable[list[str]]) -> pd.DataFrame:
    """Select the table rows of given designs, in the given order, without empty columns.

    Empty failure columns are kept. ``blocks`` are lists of design hashes.
    """
    order = {name: index for index, name in enumerate(dict.fromkeys(chain.from_iterable(blocks)))}
    selected = frame[frame["design"].isin(order.keys())]
    ordered = (
        selected.assign(_at=selected["design"].map(order)).sort_values("_at").drop(columns="_at")
    )
    failure_columns = [name for name in FAILURE_COLUMNS if name in ordered]
    columns = [name for name in ordered.columns if name not in failure_columns]
    return (
        ordered[[*columns, *failure_columns]]
        .dropna(axis="columns", how="all")
        .reset_index(drop=True)
        .pipe(
            lambda table: table.assign(
                **{column: None for column in FAILURE_COLUMNS if column not in table}
            )
        )
    )


def read_study(folder: str | Path) -> pd.DataFrame:
    """Read the stored results of a study, from the folder alone.

    Returns:
        A row per stored design of the stored definition, as `Study.run` returns.

    Raises:
        StudyError: If the folder contains no study, the definition is damaged or has another
            format, or a file with results (shard) is damaged.
        MissingPackageError: If pandas or pyarrow is not installed.
    """
    check_type("folder", folder, str | Path)
    for library in ("pandas", "pyarrow"):
        require_library(library)
    store = Store(Path(folder))
    request = store.read_request()
    try:
        study, digest = request["study"], str(request["digest"])
        variables = {name: make_variable(name, values) for name, values in study["vary"].items()}
        check_type("seed", study["seed"], int)
        check_type("samples", study.get("samples"), int | None)
        sampling = Sampling(variables, study.get("samples"), study["seed"])
    except (AttributeError, KeyError, TypeError, ValueError, ConfigurationError) as error:
        problem = getattr(error, "diagnostic", str(error))
        if isinstance(error, KeyError):
            problem = diagnose("key-missing", key=str(error))
        raise StudyError(folder, diagnose("study-does-not-say", what=problem)) from error
    blocks = (hash_designs(digest, tuple(variables), block) for block in sampling.blocks())
    return restore_truth_values(name_motors(order_rows(store.table(), blocks), variables))
