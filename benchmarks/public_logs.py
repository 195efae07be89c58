"""Logs that others have published: where they are from, which column is what, and what they tell.

The logs are not here. Clone the repository, and say where it is:

    git clone https://github.com/thanhndv212/figaroh-plus
    python benchmarks/public_logs.py tx40 figaroh-plus -o logs/

writes ``logs/tx40.npz``, which ``pupper-analysis fit --log`` reads, fits it, and compares with what
was published.
"""

from __future__ import annotations

import argparse
import csv
import io
import pickle
import re
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.convert.load import load_robot
from pupper_analysis.errors import FitError
from pupper_analysis.identification.fit import fit
from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.identification.measurements.log_files import read_log
from pupper_analysis.identification.motions.result import MotionFit
from pupper_analysis.identification.parameters import ParameterTable
from pupper_analysis.identification.result import Fit
from pupper_analysis.identification.torques.couplings import Coupling, parse_coupling
from pupper_analysis.identification.torques.equations import TorqueEquations
from pupper_analysis.identification.torques.result import TorqueFit
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class PublicLogs:
    """Logs of a robot that somebody has published.

    Attributes:
        repository: Where they are.
        commit: That they were read of here.
        licence: Theirs.
        model: The robot's, in the repository.
        read: Yields each log's name and arrays as ``read_log`` takes them, of a clone.
        options: Of the fit.
        held_out: The logs that are predicted, by their numbers; a share of each if there are none.
        published: Base parameters that were published, in the repository: name, least squares, its
            relative deviation (%), weighted least squares, its relative deviation (%).
    """

    repository: str
    commit: str
    licence: str
    model: str
    read: Callable[[Path], Iterator[tuple[str, Arrays]]]
    options: Mapping[str, Any] = field(default_factory=dict)
    held_out: Sequence[int] = ()
    published: str = ""


# --- figaroh-plus -----------------------------------------------------------------------------

TX40_GEARS = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
"""Turns of each motor for one of its joint (``config/T40X_config.yaml``)."""


def read_tx40(clone: Path) -> Iterator[tuple[str, Arrays]]:
    """Yields the log of a Staubli TX40: angles of motors and their torques, at 5 kHz.

    ``pos_read_data.csv`` has angles of motors (rad), ``curr_data.csv`` their torques (N m). Motor 6
    turns with joint 5, too, through the wrist's gears, so its torque acts on both. Zeros of joints
    2 and 3 are a quarter of a turn from the URDF's. In the first 0.1 s and from 7.5 s on it rests.
    """
    folder = clone / "examples/staubli_TX40/data"
    motors, torques = (
        np.loadtxt(folder / name, delimiter=",", skiprows=1)
        for name in ("pos_read_data.csv", "curr_data.csv")
    )
    turns = np.diag(TX40_GEARS)
    turns[5, 4] = TX40_GEARS[5]
    position = np.linalg.solve(turns, motors.T).T + np.pi / 2 * np.array([0, -1, 1, 0, 0, 0])
    moving = slice(500, 37500)
    yield (
        "tx40",
        {
            "joints": np.array([f"joint_{number}" for number in range(1, 7)]),
            "time": 2e-4 * np.arange(len(motors))[moving],
            "position": position[moving],
            "torque": (torques @ turns)[moving],  # virtual work
        },
    )


TIAGO_GEARS = np.array([1.0, 100, 100, 100, 100, 336, 336, 336])
TIAGO_MOTORS = np.array([1.0, 0.136, 0.136, -0.087, -0.087, -0.0613, -0.0613, -0.0613])
"""N m/A (``examples/tiago/identification.py``); the torso's effort is a force."""


def read_tiago(clone: Path) -> Iterator[tuple[str, Arrays]]:
    """Yields the log of TIAGo's torso and arm: positions (rad, m), and efforts, at 100 Hz.

    ``tiago_position.csv`` and ``tiago_effort.csv`` have ``t`` and ``- <joint>_position`` or
    ``_effort``; efforts of the arm are currents (A). It moves from sample 921 to 6791. The torso is
    left out: what holds it against its weight is not in its effort.
    """
    folder = clone / "examples/tiago/data/identification/dynamic"
    position, effort = (
        np.loadtxt(folder / f"tiago_{name}.csv", delimiter=",", skiprows=1)[921:6791]
        for name in ("position", "effort")
    )
    arm = slice(1, None)
    yield (
        "tiago",
        {
            "joints": np.array([f"arm_{number}_joint" for number in range(1, 8)]),
            "time": position[:, 0],
            "position": position[:, 1:][:, arm],
            "torque": (TIAGO_GEARS * TIAGO_MOTORS * effort[:, 1:])[:, arm],
        },
    )


# --- sim2real-robot-identification ------------------------------------------------------------

GO2_JOINTS = tuple(
    f"{leg}_{joint}_joint" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")
)
Z1_JOINTS = (*(f"joint{number}" for number in range(1, 7)), "jointGripper")


def read_tensors(path: Path) -> dict[str, NDArray[Any]]:
    """Returns the arrays of a dictionary that ``torch.save`` wrote, without torch.

    Nothing else is made of it: a pickle may ask for any function to be called.
    """
    kinds = {"FloatStorage": np.float32, "DoubleStorage": np.float64, "LongStorage": np.int64}
    plain = {
        ("numpy._core.multiarray", "_reconstruct"), ("numpy", "ndarray"), ("numpy", "dtype"),
        ("_codecs", "encode"),
    }  # fmt: skip

    def tensor(
        values: NDArray[Any],
        first: int,
        shape: tuple[int, ...],
        strides: tuple[int, ...],
        *_: object,
    ) -> NDArray[Any]:
        steps = [step * values.itemsize for step in strides]
        return np.lib.stride_tricks.as_strided(values[first:], shape, steps).copy()

    with zipfile.ZipFile(path) as archive:
        root = archive.namelist()[0].split("/")[0]

        class Reader(pickle.Unpickler):
            def find_class(self, module: str, name: str) -> Any:
                module = module.replace("numpy.core", "numpy._core")  # before NumPy 2
                if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
                    return tensor
                if module == "torch" and name in kinds:
                    return kinds[name]
                if (module, name) == ("collections", "OrderedDict"):
                    return dict
                if (module, name) in plain:
                    return super().find_class(module, name)
                raise pickle.UnpicklingError(f"{module}.{name}")

            def persistent_load(self, pid: Any) -> Any:
                return np.frombuffer(archive.read(f"{root}/data/{pid[2]}"), dtype=pid[1])

        found: dict[str, NDArray[Any]] = Reader(io.BytesIO(archive.read(f"{root}/data.pkl"))).load()
    return found


def read_rx(name: str, joints: Sequence[str]) -> Callable[[Path], Iterator[tuple[str, Arrays]]]:
    """Returns what reads the logs of a robot of sim2real-robot-identification.

    ``datasets/<robot>/traj_<n>.pt``: ``time`` (s), ``dof_pos`` (rad), ``des_dof_pos`` (rad) of the
    joints in ``joints``' order, and of the Z1 ``des_dof_torque`` (N m), which its servos asked for.
    """

    def read(clone: Path) -> Iterator[tuple[str, Arrays]]:
        files = sorted((clone / "datasets" / name).glob("traj_*.pt"))
        for number, file in enumerate(files):
            found = read_tensors(file)
            arrays: dict[str, NDArray[Any]] = {
                "joints": np.array(joints),
                "time": found["time"].astype(float),
                "position": found["dof_pos"].astype(float),
                "command": found["des_dof_pos"].astype(float),
            }
            if "des_dof_torque" in found:
                arrays["torque"] = found["des_dof_torque"].astype(float)
            yield f"{name}_{number}", arrays

    return read


FIGAROH = {
    "repository": "https://github.com/thanhndv212/figaroh-plus",
    "commit": "c3b5172849b744984b7181fd9d517c83fb4242e1",
    "licence": "Apache-2.0",
}
RX = {
    "repository": "https://github.com/RX-00/sim2real-robot-identification",
    "commit": "1a22bd03a70ed3f542d6979bd8d0e73888391c48",
    "licence": "BSD-3-Clause",
}
LOGS = {
    "tx40": PublicLogs(
        **FIGAROH,
        model="models/staubli_tx40_description/urdf/tx40_mdh_modified.urdf",
        read=read_tx40,
        options={"couplings": ("motor_6=joint_5+joint_6",)},
        published="examples/staubli_TX40/results/TX40_bp_5.csv",
    ),
    "tiago": PublicLogs(
        **FIGAROH, model="examples/tiago/urdf/tiago_48_schunk.urdf", read=read_tiago
    ),
    "go2": PublicLogs(
        **RX,
        model="robot_model/go2/go2.xml",
        read=read_rx("go2", GO2_JOINTS),
        options={"kp": [20.0, 20.0, 40.0] * 4, "kd": [1.0, 1.0, 2.0] * 4},
        held_out=range(5, 10),
    ),
    "z1": PublicLogs(
        **RX,
        model="robot_model/z1/z1.xml",
        read=read_rx("z1", Z1_JOINTS),
        options={"by": "torque"},
    ),
}


def fit_public(name: str, clone: Path, folder: Path) -> None:
    """Writes a robot's logs as ours, fits them, and prints what came of it."""
    public = LOGS[name]
    print(f"{name}: {public.repository} at {public.commit[:12]}, {public.licence}")
    folder.mkdir(parents=True, exist_ok=True)
    logs: list[Log] = []
    for title, arrays in public.read(clone):
        path = folder / f"{title}.npz"
        np.savez(path, **arrays)
        logs.append(read_log(path))
        print(f"wrote {path}: {logs[-1].duration:.1f} s, {len(logs[-1].joints)} joints")
    robot = load_robot(clone / public.model)
    options = dict(public.options)
    for gain in ("kp", "kd"):
        if gain in options:
            given = dict(zip(logs[0].joints, options[gain], strict=True))
            options[gain] = [given.get(joint, 0.0) for joint in robot.joint_names]
    if public.held_out:
        options["hold_out"] = [logs[number] for number in public.held_out]
        logs = [log for number, log in enumerate(logs) if number not in public.held_out]
    start = time.perf_counter()
    try:
        found = fit(robot, logs, **options)
    except FitError as error:
        print(f"not fitted: {error}")
        return
    print(f"fitted in {time.perf_counter() - start:.1f} s")
    show(found)
    if public.published and isinstance(found, TorqueFit):
        couplings = [parse_coupling(one) for one in public.options["couplings"]]
        compare(robot, found, clone / public.published, couplings)


def show(found: Fit) -> None:
    """Prints how well a fit predicts what it has not seen."""
    if isinstance(found, MotionFit):
        print(f"held out {1e3 * found.held_out:.2f} mrad, file {1e3 * found.held_out_before:.2f},")
        if np.isfinite(found.repeatability):  # of runs with the same commands
            print(f"the robot itself repeats to {1e3 * found.repeatability:.2f} mrad")
    if isinstance(found, TorqueFit):
        print(f"held out {found.held_out:.3g} N m, {100 * found.held_out / found.torque:.1f} %,")
        print(f"file {found.held_out_before:.3g} N m; {found.equations} equations")
        (lag,) = (one for one in found.estimates if one.kind == "lag")
        print(f"torques are told {1e3 * lag.mean:.2f} +- {1e3 * (lag.high - lag.mean):.2f} ms late")
        print("joint: off, file's own, noise (N m); cut-off (Hz)")
        for joint, off in found.by_joint.items():
            print(
                f"  {joint}: {off:.3g}, {found.by_joint_before[joint]:.3g}, "
                f"{found.torque_noise[joint]:.2g}; {found.cutoff[joint]:.1f}"
            )
    for one in (*found.failures, *found.diagnostics):
        print(one)


# --- published base parameters ----------------------------------------------------------------

OF_BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
OF_DRIVE = ("fs", "fv", "Ia")
OF_MOTOR = ("fsm", "fvm", "Iam")
COUPLED = (5, 6)
"""Joints whose published viscous friction and armature are with those of the motor of both: they
have it give joint 5 fvm6 q6' alone, where here it gives both fvm6 (q5' + q6')."""


def weights_of(text: str, joints: int) -> Array | None:
    """Returns which sum of numbers ``m1 + 0.5*mx2`` is, (numbers,); None if one is none of ours."""
    first = len(OF_BODY) * joints
    motor = first + len(OF_DRIVE) * joints
    bias = motor + len(OF_MOTOR)
    found = np.zeros(bias + joints + 1)
    for term in text.replace(" - ", " + -").split(" + "):
        match = re.fullmatch(r"(-?)(?:([\d.]+)\*)?([A-Za-z]+)(\d+)", term.strip())
        if match is None:
            return None
        sign, factor, kind, number = match.groups()
        if kind in OF_BODY:
            place = len(OF_BODY) * (int(number) - 1) + OF_BODY.index(kind)
        elif kind in OF_DRIVE:
            if kind != "fs" and int(number) in COUPLED:
                found[motor + OF_DRIVE.index(kind)] += 1.0
            place = first + len(OF_DRIVE) * (int(number) - 1) + OF_DRIVE.index(kind)
        elif kind in OF_MOTOR:
            place = motor + OF_MOTOR.index(kind)
        elif kind == "off":
            place = bias + int(number) - 1
        else:
            return None
        found[place] += float(factor or 1) * (-1 if sign else 1)
    return found


def compare(robot: Robot, found: TorqueFit, path: Path, couplings: Sequence[Coupling]) -> None:
    """Prints base parameters beside those that were published, with half of 95 % intervals."""
    table = ParameterTable(found.posterior.parameters)
    equations = TorqueEquations(robot, list(range(robot.nu)), couplings)
    numbers, slopes = equations.numbers(table, found.posterior.mean)
    stated, _ = equations.numbers(table, table.stated)
    covariance = slopes @ found.posterior.covariance @ slopes.T
    print(f"{'base parameter':32}{'file':>9}{'fitted':>10} ±      {'published':>9} ±")
    with path.open(encoding="utf-8") as file:
        for name, _, _, value, percent in csv.reader(file):
            weights = weights_of(name, robot.nu)
            if weights is None:
                print(f"{name[:30]:32} is none of this model's, published {float(value):9.4f}")
                continue
            half = 1.96 * np.sqrt(weights @ covariance @ weights)
            theirs = 1.96 * abs(float(value)) * float(percent) / 100
            print(
                f"{name[:30]:32}{weights @ stated:9.4f}{weights @ numbers:10.4f} {half:<7.4f}"
                f"{float(value):9.4f} {theirs:.4f}"
            )


def main() -> None:
    """Fits the logs of one robot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=sorted(LOGS))
    parser.add_argument("clone", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("logs"))
    given = parser.parse_args()
    fit_public(given.name, given.clone, given.output)


if __name__ == "__main__":
    main()
