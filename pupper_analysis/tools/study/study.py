"""A study: what varies, how many designs, what is measured; said in Python or as a file."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_finite, check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    InputError,
    StudyError,
    UnknownNameError,
    VariantError,
)
from pupper_analysis.base.inputs import is_input, read_toml
from pupper_analysis.base.provenance import list_versions
from pupper_analysis.prepare.convert.files import FileSource
from pupper_analysis.robot.joints import placed_joints
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
    METRICS_REVISION,
    MetricFunction,
    fingerprint_metric,
    format_metric,
    make_metric,
    resolve_metric_file,
)
from pupper_analysis.tools.study.parameters import (
    JOINT_STANCE_KINDS,
    LINK_STANCE_KINDS,
    SERVO_KINDS,
    VariablePattern,
    match_joints,
)
from pupper_analysis.tools.study.running import Progress, StudyRun, WorkDefinition
from pupper_analysis.tools.study.store import Store, require_library
from pupper_analysis.tools.study.variables import Sampling, make_variable

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]

STUDY_KEYS = ("robot", "vary", "samples", "seed", "measure", "stand", "payload_point", "time_limit")
"""What a study's file may say."""


class Study:
    """Designs of a robot that are measured alike.

    Attributes:
        source: Where the robots come from.
        variables: {name: what it varies over}.
        sampling: The designs.
        metrics: What is measured.
        task: The stance, where a design does not say otherwise.
        time_limit: Of one design (s).
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
    ) -> None:
        """Checks all that can be checked before anything runs.

        Args:
            robot: A file, two files with a plus between them, a variant's name, a ``VariantSpec``,
                {``base``, ``leg_scale``, ``torso_mass_scale``}, where ``base`` may be files as
                well, with other arguments of ``load_robot``, or {``urdf``: path, ``mjcf``: path,
                and these}. Of variants ``leg_scale`` and ``torso_mass_scale`` can be varied, too.
            vary: {name of a number: a list, a ``linspace``, a distribution, a number}.
            measure: Names of ``METRICS``, or functions of (robot, stand).
            samples: How many designs, where there is a distribution; otherwise they are the product
                of all lists.
            seed: Of the samples.
            stand: The stance, where the designs do not say otherwise.
            payload_point: (3,) where a payload is, in the base's frame (m), or (frame, x, y, z) in
                that of a link, site or body.
            time_limit: Of one design (s); None: none. It ends the worker's process, and so holds
                for processes and Dask, not for threads.

        Raises:
            ConfigurationError: If an argument makes no sense; says what would.
            UnknownNameError: If a name's pattern matches nothing in the robot.
            ModelError: If the robot's files cannot be used.
        """
        check_type("vary", vary, Mapping[str, Any])
        check_type("measure", measure, Sequence[str | MetricFunction])
        check_type("samples", samples, int | None)
        check_type("seed", seed, int)
        check_type("stand", stand, StandTask | None)
        self.source = make_robot_source(robot)
        given = {str(name): make_variable(str(name), one) for name, one in vary.items()}
        for name in given:
            check_variable_name(name, self.source)
        self.variables = given
        self.task = stand or StandTask()
        self._check_variables()
        self.sampling = Sampling(self.variables, samples, seed)
        self.metrics = tuple(make_metric(one) for one in measure)
        self._given = tuple(measure)
        frame, point = split_place(payload_point)
        self.point = (*filter(None, (frame,)), *check_point(point).tolist())
        find_place(self.base, self.point)
        self.time_limit = None if time_limit is None else check_finite("time_limit", time_limit)
        if self.time_limit is not None and self.time_limit <= 0:
            finding = diagnose("time-limit-not-positive", limit=self.time_limit)
            raise ConfigurationError("time_limit", finding)
        if not self.metrics:
            raise ConfigurationError("measure", diagnose("nothing-to-measure"))
        named = [one.name for one in self.metrics]
        twice = next((name for name in named if named.count(name) > 1), None)
        if twice is not None:
            raise ConfigurationError("measure", diagnose("there-twice", name=twice))

    def whole_source(self) -> RobotSource:
        """Returns the source of the same robots with all that is only looked at."""
        if isinstance(self.source, FileSource):
            return FileSource(self.source.files, self.source.files.load())
        return Variants(self.source.spec, whole=True)

    def _check_variables(self) -> None:
        moved = (name for name in self.variables if name in STANCE_VARIABLES)
        offset = next((name for name in moved if STANCE_VARIABLES[name][0].name == "offset"), None)
        if offset is not None and self.task.com not in (None, "centre"):
            raise ConfigurationError(f"vary[{offset!r}]", diagnose("offset-and-com"))
        for name, one in self.variables.items():
            check_variable_range(name, *one.range)
            named = VariablePattern.parse(name)
            if named is not None and named.kind in LINK_STANCE_KINDS:
                known = tuple(of for of, one in self.task.contacts.items() if one.plane is not None)
                if named.pattern not in known:
                    raise UnknownNameError(self.base.name, "contact", named.pattern, known)
            elif named is not None:
                match_joints(self.base, named)
            if named is not None and named.kind in JOINT_STANCE_KINDS:
                placed_joints(self.base, {named.pattern: 0.0})
        servos = {name for name in self.variables if name.partition(":")[0] in SERVO_KINDS}
        if servos:
            from pupper_analysis.robot.servos import servo_gains

            given = {name: 1.0 if name in self.variables else None for name in SERVO_KINDS}
            servo_gains(self.base, given["kp"], given["kd"])

    @cached_property
    def base(self) -> Robot:
        """The robot with nothing changed."""
        return self.source.robot({})

    @cached_property
    def digest(self) -> str:
        """A hash of the robot's files, of the stance, the metrics and the versions."""
        parts = {
            "robot": hash_description(self.base.description),
            "source": repr(self.source.asked()) if self.source.scales else "",
            "stand": {one.name: repr(getattr(self.task, one.name)) for one in fields(self.task)},
            "point": self.point,
            "measures": sorted(fingerprint_metric(one) for one in self.metrics),
            "revision": METRICS_REVISION,
            "versions": list_versions(),
        }
        data = orjson.dumps(parts, option=orjson.OPT_SORT_KEYS)
        return hashlib.sha256(data).hexdigest()

    def __len__(self) -> int:
        return len(self.sampling)

    def designs(self) -> Iterator[tuple[list[str], Array]]:
        """Yields designs block by block: their hashes, and their numbers (n, variables)."""
        for block in self.sampling.blocks():
            yield hash_designs(self.digest, tuple(self.variables), block), block

    def work(self) -> bytes:
        """Returns what workers need to know, pickled."""
        work = WorkDefinition(
            source=self.source,
            metrics=self._given,
            variables=tuple(self.variables),
            task=self.task,
            point=self.point,
            versions=list_versions(),
            limit=self.time_limit,
        )
        return pickle.dumps(work)

    def to_dict(self) -> dict[str, Any]:
        """Returns the study as plain data, from which ``Study.of`` makes it again."""
        given: dict[str, Any] = {
            "robot": self.source.asked(),
            "vary": {name: one.to_dict() for name, one in self.variables.items()},
            "measure": [format_metric(one) for one in self.metrics],
            "seed": self.sampling.seed,
            "payload_point": list(self.point),
            "stand": {
                field.name: getattr(self.task, field.name)
                for field in fields(self.task)
                if getattr(self.task, field.name) != getattr(StandTask(), field.name)
            },
        }
        if self.sampling.samples is not None:
            given["samples"] = self.sampling.samples
        if self.time_limit is not None:
            given["time_limit"] = self.time_limit
        return given

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Study:
        """Makes a study of plain data, as a TOML file has it.

        Raises:
            ConfigurationError: If a key is missing or unknown, or as the constructor does.
        """
        unknown = [key for key in given if key not in STUDY_KEYS]
        if unknown:
            raise ConfigurationError(unknown[0], diagnose("study-key-unknown", known=STUDY_KEYS))
        for key in ("robot", "vary", "measure"):
            if key not in given:
                raise ConfigurationError(key, diagnose("study-must-say"))
        options = dict(given)
        stand = options.pop("stand", {})
        check_type("stand", stand, Mapping[str, Any])
        task = StandTask.of(stand)
        return cls(
            options.pop("robot"), options.pop("vary"), options.pop("measure"), stand=task, **options
        )

    @classmethod
    def read(cls, path: str | Path) -> Study:
        """Reads a study from a TOML file; paths in it are looked for beside it.

        Raises:
            ConfigurationError: If it cannot be read, or makes no sense.
        """
        path = Path(path)
        try:
            _, given = read_toml(path)
        except InputError as error:
            raise ConfigurationError(str(path), error.cause) from error
        robot = given.get("robot")
        if isinstance(robot, dict):
            for name in ("urdf", "mjcf"):
                if isinstance(robot.get(name), str):
                    robot[name] = str(path.parent / robot[name])
            if isinstance(robot.get("base"), str):
                robot["base"] = _beside(path, robot["base"])
        if isinstance(robot, str):
            given["robot"] = _beside(path, robot)
        metrics = given.get("measure")
        if isinstance(metrics, list):
            given["measure"] = [resolve_metric_file(path.parent, one) for one in metrics]
        try:
            return cls.of(given)
        except (ConfigurationError, VariantError) as error:
            raise error.at(str(path)) from error

    def run(
        self,
        folder: str | Path,
        *,
        executor: Executor | None = None,
        workers: int | None = None,
        progress: Callable[[Progress], None] | None = None,
    ) -> pd.DataFrame:
        """Measures all designs that are not there yet, and returns the whole table.

        Args:
            folder: Where results are kept. A run that was ended, killed or changed goes on there.
            executor: What works: any ``concurrent.futures.Executor``, such as Dask's
                ``client.get_executor()``; by default processes of this machine.
            workers: How many processes; by default one per core. Of an executor that is given: how
                many it has, where it does not say.
            progress: Called with how far it has come.

        Returns:
            One row per design, in the study's order: its hash, its numbers, what was measured, and
            ``failure`` and ``reason`` of those that failed.

        Raises:
            StudyError: If another run holds the folder, or the workers are lost; what was done is
                kept.
            OutputError: If the folder cannot be written to.
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
        """Does what ``run`` does, but for the table: memory does not grow with the designs."""
        check_type("folder", folder, str | Path)
        check_type("executor", executor, Executor | None)
        check_type("workers", workers, int | None)
        if workers is not None and workers < 1:
            raise ConfigurationError("workers", diagnose("too-few", count=workers))
        require_library("pyarrow")
        store = Store(Path(folder))
        with store.locked():
            asked = {"study": self.to_dict(), "digest": self.digest, "versions": list_versions()}
            store.write_request(asked)
            tell, variables = progress or (lambda _: None), tuple(self.variables)
            run = StudyRun(self.work(), variables, self.time_limit, store, len(self), tell)
            return run.all(self.designs(), executor, workers)

    def table(self, folder: str | Path) -> pd.DataFrame:
        """Returns the rows of this study's designs that a folder has, in the study's order.

        Raises:
            StudyError: If it is no study's folder, or damaged.
        """
        require_library("pandas")
        return order_rows(Store(Path(folder)).table(), (names for names, _ in self.designs()))


def _beside(path: Path, word: str) -> str:
    """Returns files that are beside a study's with their folder; what is none is a name."""
    there = [(path.parent / part, part) for part in word.split("+")]
    return "+".join(str(file) if is_input(file) else part for file, part in there)


# A study's table: the hashes of its designs, and its rows in their order.


def hash_designs(digest: str, variables: Sequence[str], block: Array) -> list[str]:
    """Returns the hashes of designs (n, variables): of all that their results depend on.

    The order in which a study names its variables does not count.
    """
    order = sorted(range(len(variables)), key=lambda index: variables[index])
    head = "\0".join([digest, *(variables[index] for index in order)]).encode()
    rows = np.ascontiguousarray(block[:, order] + 0.0, dtype="<f8")  # 0.0: -0.0 is the same number
    return [hashlib.sha256(head + row.tobytes()).hexdigest()[:32] for row in rows]


def order_rows(frame: pd.DataFrame, blocks: Iterable[list[str]]) -> pd.DataFrame:
    """Returns the rows of designs, by their hashes, in their order; empty columns are left out."""
    order = {name: place for place, name in enumerate(dict.fromkeys(chain.from_iterable(blocks)))}
    kept = frame[frame["design"].isin(order.keys())]
    placed = kept.assign(_at=kept["design"].map(order)).sort_values("_at").drop(columns="_at")
    ends = [name for name in FAILURE_COLUMNS if name in placed]
    front = [name for name in placed.columns if name not in ends]
    return (
        placed[[*front, *ends]]
        .dropna(axis="columns", how="all")
        .reset_index(drop=True)
        .pipe(
            lambda table: table.assign(**{end: None for end in FAILURE_COLUMNS if end not in table})
        )
    )


def read_study(folder: str | Path) -> pd.DataFrame:
    """Reads the results in a study's folder.

    Returns:
        One row per design, as ``Study.run`` returns it; those that are there.

    Raises:
        StudyError: If it is no study's folder, or damaged.
    """
    check_type("folder", folder, str | Path)
    require_library("pandas")
    store = Store(Path(folder))
    stored = store.read_request()
    try:
        study, digest = stored["study"], str(stored["digest"])
        variables = {name: make_variable(name, given) for name, given in study["vary"].items()}
        check_type("seed", study["seed"], int)
        sampling = Sampling(variables, study.get("samples"), study["seed"])
    except (AttributeError, KeyError, TypeError, ValueError, ConfigurationError) as error:
        what = getattr(error, "diagnostic", str(error))
        if isinstance(error, KeyError):
            what = diagnose("key-missing", key=str(error))
        raise StudyError(folder, diagnose("study-does-not-say", what=what)) from error
    blocks = (hash_designs(digest, tuple(variables), block) for block in sampling.blocks())
    return order_rows(store.table(), blocks)
