"""Why a simulation does not come to rest: what grows, stiff servos, feet that creep, in words."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servo_stability import servo_stability
from pupper_analysis.robot.servos import Servos
from pupper_analysis.robot.stability import Mode, Stability
from pupper_analysis.simulation.monitor import Watcher
from pupper_analysis.simulation.nudge import LEFT, Nudge
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]

_JOLTS = 50
"""States at the end of a rollout at whose contact forces are looked, one by one."""

_EVEN = 0.05
"""The ground's force on a robot that stands varies by less of its weight from step to step."""

_CREEPING = 1e-3
"""Feet that creep faster are said to (m/s): 5 mm in the 5 s of a simulation."""


def too_stiff(robot: Robot, stand: Stand, drive: Servos) -> list[str]:
    """Says whether the servos alone are too stiff for the time step, and which would do.

    Args:
        robot: The robot.
        stand: Where it stands.
        drive: Its servos.
    """
    model, data = drive.model, mujoco.MjData(drive.model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_forward(model, data)
    stiffness, damping = np.zeros(model.nv), np.zeros(model.nv)
    dofs = robot.mj_convention.qvel_index[robot.nv - robot.nu :]
    stiffness[dofs], damping[dofs] = drive.kp, drive.kd
    found = servo_stability(model, data, stiffness, damping, np.array(model.dof_damping))
    if found is None or found.ratio <= 1:
        return []
    worst = robot.joint_names[int(np.argmax(found.shares[dofs]))]
    other = "" if drive.implicit else ", or the integrator implicitfast"
    return [
        f"the servos are {found.ratio:.3g} times beyond the limit of stability "
        f"({drive.integrator}, {1e3 * model.opt.timestep:g} ms), most of all at {worst}: a time "
        f"step of {1e3 * found.timestep:.2g} ms is stable{other}, or less kp and kd"
    ]


_NOISE = 0.2
"""Part of the nudge up to which what goes on is the solver's error, where no mode grows: with CG
and PGS, as MuJoCo sets them, a robot at rest moves by 0.02 to 0.12 of it for ever, and stays."""


def unstable(stability: Stability, nudge: Nudge | None) -> list[str]:
    """Says so if a stand would not last, or a nudge did not decay.

    Args:
        stability: Of where it settled; what still moves there is not judged by it.
        nudge: What became of the nudge, if it was given.
    """
    leaving = stability.leaving() if stability.at_rest else ()
    said = [growing(mode) for mode in leaving[:1]]
    quiet = nudge is not None and nudge.left <= _NOISE * nudge.speed
    if nudge is not None and not nudge.decayed and not quiet and not said:
        said.append(
            f"a nudge of {nudge.speed:g} m/s and rad/s does not decay: after "
            f"{nudge.duration:.3g} s {nudge.left:.1g} is left of it"
        )
    if nudge is not None and not nudge.moved < LEFT:
        after = f"{nudge.duration:.3g} s after a nudge"
        said.append(f"{after} a joint is {nudge.moved:.1g} rad from where it was")
    elif nudge is not None and not nudge.stays:
        who = nudge.farthest_joint or "a joint"
        said.append(
            f"{nudge.farthest_time:.2g} s after a nudge {who} is {nudge.farthest:.1g} rad from "
            "where it was, and comes back"
        )
    return said


def growing(mode: Mode) -> str:
    """Says how a mode grows."""
    where = f", most of all at {', '.join(mode.joints)}" if mode.joints else ""
    how = f"it shakes at {mode.frequency:.3g} Hz" if mode.shakes else "it buckles"
    how += " once dry friction is overcome" if mode.freed else ""
    return f"{how}{where}: a deviation doubles every {mode.doubling_time:.2g} s"


def rattling(robot: Robot, drive: Servos, states: Array, ctrl: Array) -> list[str]:
    """Says so if the ground pushes by jolts, from step to step, where it should push evenly.

    MuJoCo's solver meets the edges of pyramidal cones with an ``impratio`` above 1 only so far, and
    hard ground answers each step's error.

    Args:
        robot: The robot.
        drive: Its servos, and what was simulated.
        states: (n, ...) of a rollout, to its end.
        ctrl: What was commanded.
    """
    watcher = Watcher(robot, drive.model)
    pushed = []
    for state in states[-_JOLTS:]:
        seen = watcher.look(state, ctrl)
        pushed.append(sum(float(force[2]) for force in seen.forces.values()))
    share = float(np.std(pushed)) / (robot.total_mass * float(np.linalg.norm(robot.gravity)))
    if not share > _EVEN:
        return []
    option = drive.model.opt
    pyramidal = option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL.value
    mend = "try a longer solref of the feet's geoms, or a shorter time step"
    if pyramidal and option.impratio > 1:
        mend = f"the MJCF's impratio of {option.impratio:g}"
        mend += ' is meant for cone="elliptic": try it, or 1'
    return [f"contacts rattle: the ground's forces vary by {share:.0%} from step to step; {mend}"]


def creeping(robot: Robot, stand: Stand, prediction: GravityCompensation) -> list[str]:
    """Says so if feet creep, as MuJoCo's friction, which is viscous, lets them.

    Args:
        robot: The robot.
        stand: The stand.
        prediction: Its contact forces.
    """
    speeds: dict[str, float] = {}
    for foot, force in prediction.contact_forces.items():
        normal = stand.normals[foot]
        tangential = float(np.linalg.norm(force - (force @ normal) * normal))
        viscosity = GroundLaw.of(robot, foot).viscosity(stand.depths[foot])
        speeds[foot] = tangential / viscosity if viscosity > 0 else np.inf
    foot = max(speeds, key=speeds.__getitem__)
    if not speeds[foot] > _CREEPING:
        return []
    return [
        f"MuJoCo's friction gives way to any force, so that {foot} creeps by "
        f"{1e3 * speeds[foot]:.1f} mm/s: a greater impratio, or noslip_iterations, in the MJCF's "
        "<option> makes it stick"
    ]
