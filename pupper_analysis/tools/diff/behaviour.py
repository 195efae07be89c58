"""What changes are judged by: quantities of a tree of joints at random states, in Pinocchio.

In Pinocchio's own coordinates, with the base's velocity in its own axes: two trees are compared
with each other, and no other engine is asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models.multibody import MultibodyTree, to_pinocchio

Array = NDArray[np.float64]

_COUNT = 10
"""States: as many as those that differences of a URDF and an MJCF are judged at."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Random states of a tree, the same for every tree with joints of these names.

    Attributes:
        values: Whose limits the joints keep.
    """

    values: MultibodyTree

    @cached_property
    def undefined(self) -> tuple[str, ...]:
        """Quantities that are no numbers: links without mass move by themselves."""
        found = self._evaluated(self.values)
        return tuple(name for name, value in found.items() if not np.isfinite(value).all())

    @cached_property
    def joints(self) -> dict[str, Array]:
        """{joint: (n,) positions inside its limits (rad or m)}."""
        rng, found = np.random.default_rng(0), {}
        for name, joint in self.values.joints.items():
            lower = joint.lower if np.isfinite(joint.lower) else -np.pi
            upper = joint.upper if np.isfinite(joint.upper) else np.pi
            found[name] = rng.uniform(min(lower, upper), max(lower, upper), _COUNT)
        return found

    @cached_property
    def rates(self) -> dict[str, Array]:
        """{joint: (n,) velocities (rad/s or m/s)}."""
        rng = np.random.default_rng(1)
        return {name: rng.normal(size=_COUNT) for name in self.values.joints}

    @cached_property
    def efforts(self) -> dict[str, Array]:
        """{joint: (n,) torques (N m) or forces (N) of its motor}."""
        rng = np.random.default_rng(2)
        return {
            name: rng.uniform(-1, 1, _COUNT)
            * (joint.effort if np.isfinite(joint.effort) and joint.effort > 0 else 1.0)
            for name, joint in self.values.joints.items()
        }

    @cached_property
    def base(self) -> tuple[Array, Array]:
        """The base's place and quaternion (n, 7), and its velocity (n, 6)."""
        rng = np.random.default_rng(3)
        turns = rng.normal(size=(_COUNT, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        places = np.hstack([rng.uniform(-1, 1, (_COUNT, 3)), turns])
        return places, rng.normal(size=(_COUNT, 6))

    def behaviour(self, values: MultibodyTree) -> dict[str, Array]:
        """Evaluates a tree of the same joints at all states, without what is undefined."""
        found = self._evaluated(values)
        return {name: value for name, value in found.items() if name not in self.undefined}

    def _evaluated(self, values: MultibodyTree) -> dict[str, Array]:
        model = to_pinocchio(values)
        data, order = model.createData(), _dofs(model, values)
        rows: dict[str, list[Array]] = {}
        damping = np.array(model.damping)
        for number in range(_COUNT):
            q, v, tau = self._state(model, values, number)
            upper = np.triu(np.atleast_2d(pin.crba(model, data, q)))
            result = {"mass matrix": (upper + np.triu(upper, 1).T)[np.ix_(order, order)]}
            gravity = pin.computeGeneralizedGravity(model, data, q)
            result["gravity"] = gravity[order]
            result["bias forces"] = pin.nonLinearEffects(model, data, q, v)[order]
            result["forward dynamics"] = pin.aba(model, data, q, v, tau - damping * v)[order]
            pin.framesForwardKinematics(model, data, q)
            result["com"] = _com(model, data)
            if values.joints:
                joints = [model.getJointId(name) for name in self.values.joints]
                result["joint positions"] = np.array([data.oMi[j].translation for j in joints])
            if values.frames:
                frames = [model.getFrameId(name, pin.FrameType.BODY) for name in values.frames]
                places = [data.oMf[frame].translation for frame in frames]
                result["foot positions"] = np.array(places)
            for name, value in result.items():
                rows.setdefault(name, []).append(np.array(value))
        return {name: np.array(found) for name, found in rows.items()}

    def holding_torques(self, values: MultibodyTree) -> dict[str, float]:
        """Returns {joint: the greatest torque (N m) or force (N) against gravity}.

        With the base level and held, at the positions of the states: what a motor must give to
        hold its links in the air.
        """
        model = to_pinocchio(values)
        data, greatest = model.createData(), dict.fromkeys(self.values.joints, 0.0)
        for number in range(_COUNT):
            q, _, _ = self._state(model, values, number)
            if values.floating:
                q[:7] = 0, 0, 0, 0, 0, 0, 1
            gravity = pin.computeGeneralizedGravity(model, data, q)
            for name in greatest:
                here = abs(float(gravity[model.joints[model.getJointId(name)].idx_v]))
                greatest[name] = max(greatest[name], here)
        return greatest

    def _state(
        self, model: pin.Model, values: MultibodyTree, number: int
    ) -> tuple[Array, Array, Array]:
        """Returns q, v and the generalised force of the motors, in the model's order."""
        q, v, tau = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
        if values.floating:
            q[:7], v[:6] = self.base[0][number], self.base[1][number]
        for name in values.joints:
            joint = model.joints[model.getJointId(name)]
            q[joint.idx_q] = self.joints[name][number]
            v[joint.idx_v] = self.rates[name][number]
            tau[joint.idx_v] = self.efforts[name][number]
        return q, v, tau


def _dofs(model: pin.Model, values: MultibodyTree) -> list[int]:
    """Returns where the base's and the joints' velocities are: in the order of the values."""
    base = list(range(6)) if values.floating else []
    return base + [model.joints[model.getJointId(name)].idx_v for name in values.joints]


def _com(model: pin.Model, data: pin.Data) -> Array:
    """Returns the com (3,) of all that has mass, a fixed base's too (m)."""
    masses = [float(inertia.mass) for inertia in model.inertias]
    coms = [
        place.act(inertia.lever) for place, inertia in zip(data.oMi, model.inertias, strict=True)
    ]
    return np.asarray(np.average(coms, axis=0, weights=masses) if any(masses) else np.zeros(3))
