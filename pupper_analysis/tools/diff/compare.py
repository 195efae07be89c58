"""What has changed between two versions of a model, and what it does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.models.conversion import MujocoTree
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.multibody import MultibodyTree, TreeBody
from pupper_analysis.models.places import Place
from pupper_analysis.robot.compare.attribution import MAX_RESIDUAL
from pupper_analysis.robot.compare.differences import (
    VERSION_NAMES,
    Difference,
    Effect,
    RelativeError,
    apply_changes,
    changes_between,
    convention_changes,
)
from pupper_analysis.robot.matching.alignment import align_frames
from pupper_analysis.robot.matching.conventions import find_conventions
from pupper_analysis.robot.matching.pairs import match_by_structure
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.diff.elements import (
    ElementDifference,
    SimulatedPair,
    find_changed_compiler_settings,
    find_changed_elements,
    match_elements,
)
from pupper_analysis.tools.diff.version import Version, VersionedFile, open_version, read_version

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ModelChange(Result):
    """One number, vector or element that has changed.

    Attributes:
        kind: As of a `Difference` between a URDF and an MJCF; also ``joint``, which one version
            lacks, ``name`` of a joint that is called otherwise, and ``motor``.
        element: The joint, the body (named by the joint that moves it, or the base), the frame or
            the motor, by its old name.
        old: The old value; None if it was not there.
        new: The new value, in the old link frames; None if it is not there any more.
        unit: Of both.
        diagnostic: The change, with both values, as a message.
        effects: {quantity: what it does alone}; empty for what is not in a tree of joints, nor felt
            by a simulation.
        consequences: Of what touches, options and keyframes: what it does in a simulation.
        old_place: File and line, where known.
        new_place: File and line, where known.
    """

    kind: str
    element: str
    old: Any
    new: Any
    unit: str
    diagnostic: Diagnostic
    effects: dict[str, Effect]
    consequences: tuple[Diagnostic, ...]
    old_place: str
    new_place: str

    @property
    def message(self) -> str:
        """The change in a sentence."""
        return str(self.diagnostic)


@dataclass(frozen=True, eq=False)
class ModelDiff(Result):
    """What has changed between two versions of a model.

    Attributes:
        old: The old file.
        new: The new file.
        same: Whether nothing has changed, within the tolerances.
        changes: What has, the greatest effect first.
        mass: The old and the new total mass (kg).
        torques: {joint: (old, new) greatest torque against gravity (N m; of slides N)} with the
            base level and held, at random positions; of all joints that both have.
        deviations: {quantity: relative deviation between the two}.
        residual: {quantity: relative deviation that no change explains}.
        complete: Whether nothing is left.
        combined: Of two MJCFs: what all changes do when both files are simulated as they are; none
            if it is reported of the only one.
        notes: What was assumed or left out.
    """

    old: str
    new: str
    same: bool
    changes: tuple[ModelChange, ...]
    mass: tuple[float, float] = field(metadata={"unit": "kg"})
    torques: dict[str, tuple[float, float]] = field(metadata={"unit": "N m"})
    deviations: dict[str, float] = field(metadata={"unit": "1"})
    residual: dict[str, float] = field(metadata={"unit": "1"})
    complete: bool
    combined: tuple[Diagnostic, ...]
    notes: tuple[Diagnostic, ...]


@check_arguments
@silence_mujoco()
def diff_models(
    old: str | Path,
    new: str | Path,
    *,
    packages: Mapping[str, Path] | None = None,
    tolerances: Tolerances | None = None,
) -> ModelDiff:
    """Compares two URDFs or two MJCFs: two versions of one file, or two files.

    What is a matter of choice (link frames, where a hinge's origin is on its axis) is no change.
    Shapes count where they touch: where their surfaces are, and of an MJCF their numbers of
    contact, with its pairs, options, flags and keyframes. What is only seen, and sensors, do not.

    Args:
        old: The old file, or ``REVISION:PATH`` for one that git has.
        new: The new one, likewise.
        packages: {ROS package: its folder}, for ``package://`` paths.
        tolerances: What counts as a change; by default rounding errors alone do not.

    Raises:
        ModelError: If a file cannot be read, git does not have it, or only one is a URDF.
    """
    tolerances = tolerances or Tolerances.strict()
    with open_version(old) as before, open_version(new) as after:
        one, two = (
            read_version(source.read(lambda path: read_model(path, packages)))
            for source in (before, after)
        )
        if type(one.file) is not type(two.file):
            raise ModelError(after.name, diagnose("formats-differ", other=before.name))
        return _Comparison(one, two, (before, after), tolerances).result()


class _Comparison:
    """Two versions, with the same joints."""

    def __init__(
        self,
        one: Version,
        two: Version,
        sources: tuple[VersionedFile, VersionedFile],
        tolerances: Tolerances,
    ) -> None:
        self.one, self.two, self.sources, self.tolerances = one, two, sources, tolerances
        self.differences: list[Difference] = []
        # The new version by the old names.
        second = rename_joints(two.tree, {two.tree.base: one.tree.base})
        second = replace(second, base=one.tree.base)
        # By name, and by structure; {old name: new name} of the joints that both have.
        alike = {name: name for name in one.tree.joints if name in second.joints}
        self.pairs = alike | dict(match_by_structure(one.tree, second, alike).pairs)
        self.new_name = {**self.pairs, one.tree.base: two.tree.base}
        self.old_name = {new: old for old, new in self.new_name.items()}
        self.first, self.second = self._alike(one.tree, second)

    def _alike(self, one: MultibodyTree, two: MultibodyTree) -> tuple[MultibodyTree, MultibodyTree]:
        """Fixes the joints that one version lacks, and gives the new one the old names."""
        if one.joints and two.joints and not self.pairs:
            message = diagnose("no-joint-in-common", other=self.sources[0].name)
            raise ModelError(self.sources[1].name, message)
        gone = [name for name in one.joints if name not in self.pairs]
        come = [name for name in two.joints if name not in self.pairs.values()]
        for joints, where in ((gone, VERSION_NAMES.first), (come, VERSION_NAMES.second)):
            for name in joints:
                old, new = ("there", None) if joints is gone else (None, "there")
                message = diagnose("joint-in-one-version", subject=("joint", name), file=where)
                self.differences.append(Difference("joint", name, old, new, "", message, {}))
        for old, new in self.pairs.items():
            if old != new:
                message = diagnose("joint-renamed", subject=("joint", old), new=new)
                self.differences.append(Difference("name", old, old, new, "", message, {}))
        for name in reversed(gone):
            one = fix_joint(one, name)
        for name in reversed(come):
            two = fix_joint(two, name)
        two = rename_joints(two, {new: old for old, new in self.pairs.items()})
        two = replace(two, joints={name: two.joints[name] for name in two.parents_first()})
        if one.floating != two.floating:
            before, after = ("free" if tree.floating else "fixed" for tree in (one, two))
            both = {"one": Term(before), "two": Term(after), **VERSION_NAMES.named}
            message = diagnose("base-type-differs", subject=("body", one.base), **both)
            self.differences.append(Difference("type", one.base, before, after, "", message, {}))
            one, two = replace(one, floating=True), replace(two, floating=True)
        common = [frame for frame in one.frames if frame in two.frames]
        one, two = (
            replace(tree, frames={frame: tree.frames[frame] for frame in common})
            for tree in (one, two)
        )
        return one, two

    def result(self) -> ModelDiff:
        """Compares the trees, and what is not in them."""
        first, second, tolerances = self.first, self.second, self.tolerances
        # The comparison is fair in one convention; that it was another one is a change.
        meant = find_conventions(first, second, tolerances, fixed=not first.floating)
        first = meant.done(first)
        second = align_frames(second, first, tolerances).values
        trial = RandomStates(first)
        before, after = trial.evaluate_tree(first), trial.evaluate_tree(second)
        judge = RelativeError(before, after)
        for convention, undone in convention_changes(meant, first, VERSION_NAMES):
            effects = judge.effects(before, trial.evaluate_tree(undone))
            self.differences.append(replace(convention, effects=effects))
        for change in changes_between(first, second, tolerances, VERSION_NAMES):
            effects = {}
            if change.felt:
                effects = judge.effects(before, trial.evaluate_tree(change.apply(first, second)))
            self.differences.append(change.difference(effects))
        self.differences += self._others()
        renamed = {self.two.bodies[new]: self.one.bodies[old] for new, old in self.old_name.items()}
        there = match_elements(self.one.elements, self.two.elements, renamed, self.old_name)
        self.differences += find_changed_elements(self.one.elements, there)
        combined: tuple[Diagnostic, ...] = ()
        one, two = self.one.file, self.two.file
        if isinstance(one, MjcfFile) and isinstance(two, MjcfFile):
            effects, combined = SimulatedPair.from_files(one, two).compute_effects(
                explained=bool(self.differences)
            )
            match self.differences:
                case [ElementDifference() as only]:  # what one does alone is told of it
                    told = (*only.consequences, *combined)
                    self.differences = [replace(only, effects=effects, consequences=told)]
                    combined = ()
            if self.differences or combined:
                self.differences += find_changed_compiler_settings(one, two)
        patched = trial.evaluate_tree(apply_changes(first, second, VERSION_NAMES))
        left = {name: judge.relative(name, patched[name], after[name]) for name in patched}
        holding = trial.compute_holding_torques(first), trial.compute_holding_torques(second)
        self.differences.sort(key=lambda difference: difference.rank)
        return ModelDiff(
            old=self.sources[0].name,
            new=self.sources[1].name,
            same=not (self.differences or combined),
            changes=tuple(map(self._change, self.differences)),
            mass=(_mass(first), _mass(second)),
            torques={name: (holding[0][name], holding[1][name]) for name in first.joints},
            deviations={name: judge.relative(name, before[name], after[name]) for name in before},
            residual=left,
            complete=all(value <= MAX_RESIDUAL for value in left.values()),
            combined=combined,
            notes=tuple(dict.fromkeys((*self.one.notes, *self.two.notes))),
        )

    def _others(self) -> Iterator[Difference]:
        """Yields changes of what is not in a tree: motors, springs, tendons, mimics ..."""
        here = self.one.extra_values
        there = {
            (kind, self.old_name.get(element, element)): _with_names(value, self.old_name)
            for (kind, element), value in self.two.extra_values.items()
        }
        for key in dict.fromkeys((*here, *there)):
            kind, element = key
            old, new = here.get(key), there.get(key)
            if _values(old) != _values(new):
                both = {
                    "one": _stated_value(old, new),
                    "two": _stated_value(new, old),
                    **VERSION_NAMES.named,
                }
                message = diagnose("element-differs", subject=(kind, element), **both)
                yield Difference(kind, element, old, new, "", message, {})

    def _change(self, difference: Difference) -> ModelChange:
        """Returns a difference as a change, with where it stands in both files."""
        kind, element = difference.kind, difference.element
        found: Sequence[Place | None]
        if isinstance(difference, ElementDifference):
            found, consequences = difference.places, difference.consequences
        else:
            new, consequences = self.new_name.get(element, element), ()
            found = self.one.sources.place(kind, element), self.two.sources.place(kind, new)
        places = [
            "" if place is None else source.label(place)
            for source, place in zip(self.sources, found, strict=True)
        ]
        return ModelChange(
            kind,
            element,
            difference.urdf,
            difference.mjcf,
            difference.unit,
            difference.diagnostic,
            difference.effects,
            consequences,
            *places,
        )


def _mass(values: MultibodyTree) -> float:
    return float(sum(body.mass for body in values.bodies.values()))


def _with_names(value: Any, names: Mapping[str, str]) -> Any:
    """Returns what a mimic joint or a motor follows by its old name."""
    if isinstance(value, list) and value and isinstance(value[0], str):
        return [names.get(value[0], value[0]), *value[1:]]
    if isinstance(value, dict) and str(value.get("at", "")).startswith("joint "):
        name = value["at"].removeprefix("joint ")
        return {**value, "at": f"joint {names.get(name, name)}"}
    return value


def _values(value: Any) -> Any:
    """Returns a value in lists, by which two are compared."""
    if isinstance(value, Mapping):
        return {key: _values(each) for key, each in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return list(value) if isinstance(value, list | tuple) else value


def _stated_value(value: Any, other: Any) -> Diagnostic | Term | str:
    """Says a value; of a table, what is another in the other."""
    value, other = _values(value), _values(other)
    if value is None:
        return Term("none")
    if isinstance(value, dict):
        other = other if isinstance(other, dict) else {}
        keys = [key for key in value if value[key] != other.get(key)]
        entries = [diagnose("entry", entry=key, value=_words(value[key])) for key in keys]
        return diagnose("entries", entries=entries) if entries else Term("nothing of the like")
    return _words(value)


def _words(value: Any) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(map(_words, value)) + ")"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


# What changes are judged by: quantities of a tree of joints at random states, in MuJoCo.


_COUNT = 10
"""States: as many as those that differences of a URDF and an MJCF are judged at."""


@dataclass(frozen=True, eq=False)
class RandomStates:
    """Random states of a tree, the same for every tree with joints of these names.

    Attributes:
        values: Whose limits the joints keep.
    """

    values: MultibodyTree

    @cached_property
    def qpos(self) -> Array:
        """(n, nq) positions: the base's place and quaternion, if it is free, and the joints'."""
        rng = np.random.default_rng(0)
        joints = self.values.joints.values()
        lower = [joint.lower if np.isfinite(joint.lower) else -np.pi for joint in joints]
        upper = [joint.upper if np.isfinite(joint.upper) else np.pi for joint in joints]
        turns = rng.normal(size=(_COUNT, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        base = [rng.uniform(-1, 1, (_COUNT, 3)), turns] if self.values.floating else []
        ends = np.minimum(lower, upper), np.maximum(lower, upper)
        return np.hstack([*base, rng.uniform(*ends, (_COUNT, len(joints)))])

    @cached_property
    def qvel(self) -> Array:
        """(n, nv) velocities, likewise (m/s, rad/s)."""
        size = len(self.values.joints) + 6 * self.values.floating
        return np.random.default_rng(1).normal(size=(_COUNT, size))

    @cached_property
    def _tree(self) -> MujocoTree:
        return MujocoTree(self.values)

    def _load_tree(self, values: MultibodyTree) -> tuple[mujoco.MjModel, list[int], list[int]]:
        """Returns a tree in MuJoCo, and where the states' positions and velocities are in it."""
        tree = self._tree if self._tree.fits(values) else MujocoTree(values)
        tree.take(values)
        ids = [tree.model.joint(name).id for name in self.values.joints]
        base = self.values.floating
        places = [*range(7 * base), *tree.model.jnt_qposadr[ids].tolist()]
        return tree.model, places, [*range(6 * base), *tree.model.jnt_dofadr[ids].tolist()]

    def evaluate_tree(self, values: MultibodyTree) -> dict[str, Array]:
        """Evaluates a tree of the same joints at all states; damping is among the bias forces."""
        model, places, dofs = self._load_tree(values)
        data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        bodies = [int(model.joint(name).bodyid[0]) for name in self.values.joints]
        sites = [model.site(name).id for name in values.frames]
        rows: dict[str, list[Array]] = {}
        for qpos, qvel in zip(self.qpos, self.qvel, strict=True):
            data.qpos[places], data.qvel[:] = qpos, 0.0
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, full)
            result = {
                "mass matrix": full[np.ix_(dofs, dofs)],
                "gravity": data.qfrc_bias[dofs],
                "com": data.xipos.T @ model.body_mass / max(float(model.body_mass.sum()), 1e-300),
                "joint positions": data.xpos[bodies],
                "foot positions": data.site_xpos[sites],
            }
            data.qvel[dofs] = qvel
            mujoco.mj_forward(model, data)
            result["bias forces"] = (data.qfrc_bias - data.qfrc_passive)[dofs]
            for name, value in result.items():
                if value.size:
                    rows.setdefault(name, []).append(np.array(value))
        return {name: np.array(found) for name, found in rows.items()}

    def compute_holding_torques(self, values: MultibodyTree) -> dict[str, float]:
        """Returns {joint: the greatest torque (N m) or force (N) against gravity}.

        With the base level and held, at the positions of the states: what a motor must give to
        hold its links in the air.
        """
        model, places, dofs = self._load_tree(values)
        data, count = mujoco.MjData(model), len(self.values.joints)
        greatest = np.zeros(count)
        for qpos in self.qpos:
            data.qpos[places] = qpos
            if self.values.floating:
                data.qpos[:7] = 0, 0, 0, 1, 0, 0, 0
            mujoco.mj_forward(model, data)
            held = np.abs(data.qfrc_bias[dofs[len(dofs) - count :]])
            greatest = np.maximum(greatest, held)
        return dict(zip(self.values.joints, greatest.tolist(), strict=True))


def rename_joints(values: MultibodyTree, names: Mapping[str, str]) -> MultibodyTree:
    """Returns the same robot with other names of joints, {name: new name}; others stay."""

    def new(name: str) -> str:
        return names.get(name, name)

    return replace(
        values,
        bodies={new(name): body for name, body in values.bodies.items()},
        joints={
            new(name): replace(joint, parent=new(joint.parent))
            for name, joint in values.joints.items()
        },
        frames={name: (new(owner), place) for name, (owner, place) in values.frames.items()},
    )


def fix_joint(values: MultibodyTree, name: str) -> MultibodyTree:
    """Returns the robot with a joint that is fixed at zero: its body is its parent's."""
    joint = values.joints[name]
    pose, joints = joint.placement, {}
    for other, child in values.joints.items():
        if child.parent == name:
            child = replace(child.placed(pose * child.placement), parent=joint.parent)
        if other != name:
            joints[other] = child
    bodies = {other: body for other, body in values.bodies.items() if other != name}
    carried = pose.act(values.bodies[name].rigid)
    parent = values.bodies[joint.parent]
    bodies[joint.parent] = TreeBody.of(parent.rigid + carried, parent.link)
    frames = {
        frame: (joint.parent, np.array(pose.act(place))) if owner == name else (owner, place)
        for frame, (owner, place) in values.frames.items()
    }
    return replace(values, joints=joints, bodies=bodies, frames=frames)
