"""Random stands that a robot's servos hold, with numbers that are not known yet."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.stand import solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.fit.links import AXES, bodies_of
from pupper_analysis.tools.fit.parameters import Prior, give_widths
from pupper_analysis.tools.fit.stands.fit import SURE

_TRIES = 8
"""Per stand: one in two to four is in reach, in balance and lasts."""

_IN_VAIN = 24
"""Tries, of which none is a stand: even the nominal one, nearly, was tried then."""

_NARROWER, _WIDER = 0.85, 1.2
"""After a stand that the robot does not come to, the next one is drawn nearer to the nominal one,
after one that it holds further away: one in two is held, from robots with much reach and little."""

_UTILISED = 0.6
"""Of a motor's limit, at most: what is measured is a robot that stands for minutes."""

_LOWEST, _HIGHEST = 0.75, 1.1
"""Of the nominal stand's height."""

_TILT = 0.25
"""rad: roll and pitch, either way."""

_STEP = 0.15
"""Of the height: how far a foot stands from its nominal place, either way."""

_LIFTED = 0.15
"""Of the height: how high a foot is swung."""

_ON_THREE = 0.4
"""Share of candidates with a foot in the air, of robots with four feet and more."""

_CLEAR = 0.005
"""m: between links, in a stand that a robot comes to: by so much knees of v3 are off with encoders
that are by 3 deg."""

_PASSES = 0.5
"""Of what is between links in the nominal stand, where that is little: thighs pass by bodies."""

_MARGIN = 0.05
"""Of the height: how far the com is from the polygon's edge, at least."""


class RandomStands:
    """Draws stands within 60 % of the motors' limits, in reach, in balance, clear of themselves.

    Joints keep off their limits: one whose encoder is off may be at a stop that nobody sees. The
    com keeps off the polygon's edge by as much as it may be aside, where that leaves it any place.

    Args:
        robot: The robot, with a free base and feet.
        rng: Of the stands.
        kp: Stiffness of the servos (N m/rad); the model's own by default.
        priors: What is known of the robot before.
    """

    def __init__(
        self,
        robot: Robot,
        rng: np.random.Generator,
        kp: ArrayLike | None,
        priors: Sequence[Prior] = (),
    ) -> None:
        self._robot, self._rng, self._kp = robot, rng, kp
        self._off_limits = SURE * _offset_width(robot, priors)
        self._off_edge = _com_width(robot, priors)
        self._clear = _clearance(robot)
        self._far, self._found = 1.0, 0
        self._refused: Counter[str] = Counter()

    def draw(self, count: int) -> list[tuple[Stand, SteadyState]]:
        """Returns stands, and where the servos let them sag to; fewer if there are too few."""
        found: list[tuple[Stand, SteadyState]] = []
        for tries in range(_TRIES * count):
            if len(found) == count or (tries == _IN_VAIN and not found):
                break
            stand = self._held(self._task())
            self._far = min(1.0, self._far * (_NARROWER if stand is None else _WIDER))
            found += [] if stand is None else [stand]
        self._found = len(found)
        return found

    def explain(self, wanted: int) -> Diagnostic:
        """Returns why there are fewer than that: what most stands failed in."""
        code = max(self._refused, key=lambda one: self._refused[one])
        if code == "too-few-in-reach":
            off = Quantity(self._off_limits, "rad")
            return diagnose("too-few-in-reach", found=self._found, wanted=wanted, off=off)
        if code == "too-few-within-limits":
            return diagnose("too-few-within-limits", found=self._found, wanted=wanted)
        return diagnose("too-few-are-held", found=self._found, wanted=wanted)

    def _task(self) -> StandTask:
        rng, size, feet = self._rng, self._robot.stand_height, list(self._robot.feet)
        swing = {}
        if len(feet) > 3 and rng.random() < _ON_THREE:
            swing = {feet[rng.integers(len(feet))]: _LIFTED * size}

        def either(most: float) -> tuple[float, float]:
            one, two = self._far * rng.uniform(-most, most, 2)
            return float(one), float(two)

        higher = rng.uniform(_LOWEST - 1, _HIGHEST - 1)
        roll, pitch = either(_TILT)
        return StandTask(
            height=size * (1 + self._far * higher),
            roll=roll,
            pitch=pitch,
            swing=swing,
            foot_offsets={foot: either(_STEP * size) for foot in feet},
            com="inside",
            com_margin=max(self._off_edge, _MARGIN * size),
            self_clearance=self._clear,
            joint_margin=self._off_limits,
        )

    def _held(self, task: StandTask) -> tuple[Stand, SteadyState] | None:
        """Returns the stand and where it sags to; None, and counts why, if it is not held."""
        robot, nearer = self._robot, _MARGIN * self._robot.stand_height
        try:
            try:
                stand = solve_stand(robot, task, explain=False)
            except PupperAnalysisError:
                stand = solve_stand(robot, replace(task, com_margin=nearer), explain=False)
        except PupperAnalysisError:
            self._refused["too-few-in-reach"] += 1
            return None
        try:
            sagged = steady_state(robot, stand, kp=self._kp, feedforward=True)
        except PupperAnalysisError:
            self._refused["too-few-are-held"] += 1
            return None
        carries = set(sagged.stance_feet) == set(stand.stance_feet)
        if sagged.failures or not carries:
            self._refused["too-few-are-held"] += 1
            return None
        if (np.abs(sagged.joint_torques) > _UTILISED * robot.effort_limits).any():
            self._refused["too-few-within-limits"] += 1
            return None
        return stand, sagged


def _clearance(robot: Robot) -> float | None:
    """Returns how far links are to be from each other (m); None if they touch as it is."""
    try:
        near = solve_stand(robot, StandTask(self_clearance=0.0), explain=False).self_clearance
    except PupperAnalysisError:  # of its shapes none are apart
        return None
    return None if near is None else min(_CLEAR, _PASSES * near.distance)


def _offset_width(robot: Robot, priors: Sequence[Prior]) -> float:
    """Returns how far an encoder's zero may be off (rad), as a standard deviation."""
    offsets = [("offset", name, "", 0.0) for name in robot.joint_names]
    named = [prior for prior in priors if prior.kind == "offset"]
    return max((one.width for one in give_widths(offsets, named)), default=0.0)


def _com_width(robot: Robot, priors: Sequence[Prior]) -> float:
    """Returns how far aside the com of the whole robot may be (m), as a standard deviation.

    At home, along the worse of the base's x and y, by what is known of masses and coms.
    """
    model = robot.structure.model
    data, bodies = model.createData(), dict(bodies_of(robot))
    pin.forwardKinematics(model, data, robot.structure.convention.unit_q(robot.home))
    own = {link: model.inertias[at] for link, at in bodies.items()}
    places = {link: data.oMi[at].act(own[link].lever) for link, at in bodies.items()}
    whole = sum(one.mass * places[link] for link, one in own.items()) / robot.total_mass
    stated = [("mass", link, "", one.mass) for link, one in own.items()]
    for link, one in own.items():
        stated += [("com", link, *of) for of in zip(AXES, one.lever, strict=True)]
    variance = np.zeros(3)
    for width in give_widths(stated, [one for one in priors if one.kind in ("mass", "com")]):
        link, share = width.subject, width.width / robot.total_mass
        if width.kind == "mass":
            variance += (share * (places[link] - whole)) ** 2
        else:
            axis = data.oMi[bodies[link]].rotation[:, AXES.index(width.component)]
            variance += (share * own[link].mass * axis) ** 2
    return math.sqrt(float(variance[:2].max()))
