"""Changes between two versions of a model, and the effects of the changes.

Both versions are converted to trees with the same joints. Numbers in the trees are compared, and
the effect of each change is evaluated at random states. Elements that are not in a tree (contacts,
options, keyframes, motors) are compared by `elements`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose, format_pair
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.inputs import name_files
from pupper_analysis.base.results import Result, Tabular, shorten_memory_paths
from pupper_analysis.base.units import EFFORT_UNIT, select_joint_units
from pupper_analysis.models.conversion import MujocoTree
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.multibody import MultibodyTree, TreeBody
from pupper_analysis.models.objects import ModelObject
from pupper_analysis.models.places import Place
from pupper_analysis.models.published import make_xacro_request
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.pupper.named_robots import find_model, is_variant
from pupper_analysis.pupper.variants import VariantSpec
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
    align_keyframes,
    find_changed_compiler_settings,
    find_changed_elements,
    match_elements,
)
from pupper_analysis.tools.diff.version import (
    FORCE_RANGES,
    HELD_KIND,
    Version,
    VersionedFile,
    open_version,
    read_version,
)


@dataclass(frozen=True, eq=False)
class ModelChange(Result):
    """Change of a number, a vector or an element between two versions of a model.

    Attributes:
        kind: Kind of a `Difference`; also ``joint`` (only in a single version), ``name`` (renamed
            joint) and the tag of an element outside the tree, for example ``motor`` or ``geom``.
        element: Joint, body (named by the moving joint, or the base), frame or other element, by
            the old name.
        old: Old value; None if the element is new.
        new: New value, in the old link frames; None if the element was removed.
        unit: Unit of both values.
        diagnostic: Message with both values.
        effects: {quantity: effect of this change alone on the dynamics}; empty without an effect,
            or if the effect is not evaluated. The effect of an element such as a contact, option or
            keyframe is known only from a simulation, and only if there is no other change.
        consequences: Further effects of an element such as a contact, option or keyframe:
            displacement of a surface, and effects in a simulation if there is no other change.
        old_place: File and line in the old version; empty if unknown or absent.
        new_place: File and line in the new version; empty if unknown or absent.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("kind", "element")

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
        """Description of the change in an English sentence, with old and new value."""
        return str(self.diagnostic)


@dataclass(frozen=True, eq=False)
class ModelDiff(Tabular):
    """Changes between two versions of a model, with the effects on mass, torques and dynamics.

    Attributes:
        old: Old file.
        new: New file.
        same: Whether nothing has changed, within the tolerances.
        changes: Changes, the most urgent first. The order is structure and conventions, large
            effects or mass differences, limits, other changes; each group is sorted by effect.
        mass: Total mass of the old and the new version.
        torques: {joint: (old, new)} of the largest torque or force (N m or N) against gravity, at
            random positions, with a level and fixed base. Only joints in both versions are
            included.
        torque_units: {joint: unit of the torques: N m for a hinge, N for a slide}.
        deviations: {quantity: relative deviation between both versions}.
        residual: {quantity: relative deviation that no change explains}.
        complete: Whether all residuals are within 1e-9.
        floating: Whether the effects were computed with a free base. The base of a URDF counts as
            free if two or more moving links are attached to the base, for example.
        combined: For two MJCFs: effects of all changes together in a simulation of the files
            (`SimulatedPair`). Empty if the effect is reported for the only change, for example.
        notes: Assumptions, and ignored content.
        edited_masses: {link of a URDF: (old, new) stated mass}, if stated masses are the only
            differences of all stated inertials; empty otherwise. ``changes`` concern moving links
            with the links fixed to these.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("same", "changes")

    old: str
    new: str
    same: bool
    changes: tuple[ModelChange, ...]
    mass: tuple[float, float] = field(metadata={"unit": "kg"})
    torques: dict[str, tuple[float, float]] = field(metadata={"unit": EFFORT_UNIT})
    torque_units: dict[str, str]
    deviations: dict[str, float] = field(metadata={"unit": "1"})
    residual: dict[str, float] = field(metadata={"unit": "1"})
    complete: bool
    floating: bool
    combined: tuple[Diagnostic, ...]
    notes: tuple[Diagnostic, ...]
    edited_masses: dict[str, tuple[float, float]] = field(metadata={"unit": "kg"})

    def _columns(self) -> dict[str, list[object]]:
        """Return {column: values} of a table with a row per change, and the unit of the row."""
        names = ("kind", "element", "old", "new", "unit", "message", "old_place", "new_place")
        return {name: [getattr(change, name) for change in self.changes] for name in names}


@check_arguments
@silence_mujoco()
def diff_models(
    old: str | Path | ModelObject | VariantSpec,
    new: str | Path | ModelObject | VariantSpec,
    *,
    packages: Mapping[str, Path] | None = None,
    tolerances: Tolerances | None = None,
    xacro: bool = False,
    xacro_args: Mapping[str, str] | None = None,
) -> ModelDiff:
    """List the changes between two versions of a model (two URDFs or two MJCFs), with effects.

    Another frame of a moving link, or another position of a hinge along the axis, is no change of
    joints and masses. Collision shapes are compared by surface, in the frames of the links. The
    comparison of MJCFs includes contact parameters, pairs, options, flags, keyframes, motors,
    tendons and equalities. Compiler settings are compared if there is another change, or an effect
    in a simulation. Visual shapes and sensors are ignored.

    Args:
        old: Old file, ``REVISION:PATH`` for a file in git, a variant, the name of a published
            robot, or a robot in memory, as for ``load_robot``. The model of a variant has the
            format of the other version, or MJCF if both are variants. Changes of scaled variants
            and of robots in memory have no lines.
        new: New version, in the same forms as ``old``.
        packages: {ROS package: folder}, for ``package://`` paths.
        tolerances: Largest ignored changes; by default rounding errors.
        xacro: True to expand xacro files, which evaluates the Python expressions in the files.
        xacro_args: {argument of a xacro file: value}, with ``xacro=True``.

    Returns:
        Changes, with effects.

    Raises:
        ModelError: If a file cannot be read, git does not contain the file, the formats differ, or
            the versions have no joint in common, for example.
        ConfigurationError: If an argument has a wrong type, or there are ``xacro_args`` without
            ``xacro``, for example.
        VariantError: If an argument is probably a misspelled variant name.
        UnknownNameError: If MuJoCo Menagerie has no robot with the name in an argument.
    """
    tolerances = tolerances or Tolerances.strict()
    request = make_xacro_request([old, new], packages, xacro=xacro, arguments=xacro_args)
    with (
        _open_version_or_variant(old, new, packages, request) as before,
        _open_version_or_variant(new, old, packages, request) as after,
    ):
        old_version, new_version = (
            read_version(source.read(lambda path: read_model(path, packages, request)))
            for source in (before, after)
        )
        before, after = (
            source if source.name else replace(source, name=str(version.file.path))
            for source, version in ((before, old_version), (after, new_version))
        )
        if type(old_version.file) is not type(new_version.file):
            raise ModelError(after.name, diagnose("formats-differ", other=Path(before.name).name))
        result = _Comparison(old_version, new_version, (before, after), tolerances).result()
        return shorten_memory_paths(result, old_version.file.path, new_version.file.path)


@contextmanager
def _open_version_or_variant(
    given: str | Path | ModelObject | VariantSpec,
    other: str | Path | ModelObject | VariantSpec,
    packages: Mapping[str, Path] | None,
    xacro: Mapping[str, str] | None,
) -> Iterator[VersionedFile]:
    """Yield a version of a model; the file of a variant gets the format of ``other``, or MJCF."""
    if not is_variant(given):
        with open_version(find_model(given, "mjcf")) as version:
            yield version
        return
    is_urdf = False
    if not is_variant(other):
        with open_version(find_model(other, "mjcf")) as version:
            file = version.read(lambda path: read_model(path, packages, xacro))
            is_urdf = isinstance(file, UrdfFile)
    name = given.name if isinstance(given, VariantSpec) else str(given)
    yield VersionedFile(find_model(given, "urdf" if is_urdf else "mjcf"), name)


class _Comparison:
    """Comparison of two versions of a model whose trees are reduced to common joints."""

    def __init__(
        self,
        one: Version,
        two: Version,
        sources: tuple[VersionedFile, VersionedFile],
        tolerances: Tolerances,
    ) -> None:
        self.one, self.two, self.sources, self.tolerances = one, two, sources, tolerances
        self.differences: list[Difference] = []
        # New version with the old name of the base.
        second = rename_joints(two.tree, {two.tree.base: one.tree.base})
        second = replace(second, base=one.tree.base)
        # Match joints by name and by structure: {old name: new name}.
        alike = {name: name for name in one.tree.joints if name in second.joints}
        self.pairs = alike | dict(match_by_structure(one.tree, second, alike).pairs)
        self.new_name = {**self.pairs, one.tree.base: two.tree.base}
        self.old_name = {new: old for old, new in self.new_name.items()}
        self.first, self.second = self._unify_joints(one.tree, second)

    def _unify_joints(
        self, old_tree: MultibodyTree, new_tree: MultibodyTree
    ) -> tuple[MultibodyTree, MultibodyTree]:
        """Reduce both trees to the joints of both versions, with the names of the old version.

        Differences of the structure, such as a fixed or renamed joint, are stored in `differences`.

        Raises:
            ModelError: If both versions have joints, but no joint in common.
        """
        if old_tree.joints and new_tree.joints and not self.pairs:
            before, after = name_files(*(source.name for source in self.sources))
            message = diagnose(
                "no-joint-in-common",
                other=after,
                old=tuple(old_tree.joints),
                new=tuple(new_tree.joints),
            )
            raise ModelError(before, message)
        gone = [name for name in old_tree.joints if name not in self.pairs]
        come = [name for name in new_tree.joints if name not in self.pairs.values()]
        for joints, where, other_version in (
            (gone, VERSION_NAMES.first, self.two),
            (come, VERSION_NAMES.second, self.one),
        ):
            for name in joints:
                if (HELD_KIND, name) in other_version.extra_values:
                    continue  # reported by `_compare_extra_values`
                old, new = ("there", None) if joints is gone else (None, "there")
                message = diagnose("joint-in-one-version", subject=("joint", name), file=where)
                self.differences.append(Difference("joint", name, old, new, "", message, {}))
        for old, new in self.pairs.items():
            if old != new:
                message = diagnose("joint-renamed", subject=("joint", old), new=new)
                self.differences.append(Difference("name", old, old, new, "", message, {}))
        for name in reversed(gone):
            old_tree = fix_joint(old_tree, name)
        for name in reversed(come):
            new_tree = fix_joint(new_tree, name)
        new_tree = rename_joints(new_tree, {new: old for old, new in self.pairs.items()})
        new_tree = replace(
            new_tree, joints={name: new_tree.joints[name] for name in new_tree.parents_first()}
        )
        if old_tree.floating != new_tree.floating:
            if not isinstance(self.one.file, UrdfFile):  # a URDF does not state the type
                before, after = (
                    "free" if tree.floating else "fixed" for tree in (old_tree, new_tree)
                )
                both = {"one": Term(before), "two": Term(after), **VERSION_NAMES.message_values}
                message = diagnose("base-type-differs", subject=("body", old_tree.base), **both)
                difference = Difference("type", old_tree.base, before, after, "", message, {})
                self.differences.append(difference)
            old_tree, new_tree = replace(old_tree, floating=True), replace(new_tree, floating=True)
        common = [frame for frame in old_tree.frames if frame in new_tree.frames]
        old_tree, new_tree = (
            replace(tree, frames={frame: tree.frames[frame] for frame in common})
            for tree in (old_tree, new_tree)
        )
        return old_tree, new_tree

    def result(self) -> ModelDiff:
        """Compare joints, bodies and other elements of both versions, and return the changes."""
        first, second, tolerances = self.first, self.second, self.tolerances
        # Compare in the same convention; a different convention is a change of its own.
        meant = find_conventions(first, second, tolerances, fixed=not first.floating)
        first = meant.convert_to_mjcf(first)
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
            self.differences.append(change.to_difference(effects))
        self.differences += self._compare_extra_values()
        renamed = {self.two.bodies[new]: self.one.bodies[old] for new, old in self.old_name.items()}
        elements = self.two.elements
        if isinstance(self.one.file, MjcfFile) and isinstance(self.two.file, MjcfFile):
            models = self.one.file.model, self.two.file.model
            elements = align_keyframes(*models, elements, self.old_name)
        matched = match_elements(self.one.elements, elements, renamed, self.old_name)
        self.differences += find_changed_elements(self.one.elements, matched)
        combined = self._simulate_versions()
        patched = trial.evaluate_tree(apply_changes(first, second, VERSION_NAMES))
        residual = {
            name: judge.relative_deviation(name, patched[name], after[name]) for name in patched
        }
        holding = trial.compute_holding_torques(first), trial.compute_holding_torques(second)
        self.differences.sort(key=lambda difference: difference.rank)
        return ModelDiff(
            old=self.sources[0].name,
            new=self.sources[1].name,
            same=not (self.differences or combined),
            changes=tuple(map(self._make_change, self.differences)),
            mass=(_sum_mass(first), _sum_mass(second)),
            torques={name: (holding[0][name], holding[1][name]) for name in first.joints},
            torque_units={
                name: select_joint_units(slides=joint.slides).effort
                for name, joint in first.joints.items()
            },
            deviations={
                name: judge.relative_deviation(name, before[name], after[name]) for name in before
            },
            residual=residual,
            complete=all(value <= MAX_RESIDUAL for value in residual.values()),
            floating=first.floating,
            combined=combined,
            notes=tuple(dict.fromkeys((*self.one.notes, *self.two.notes))),
            edited_masses=_find_edited_masses(self.one, self.two),
        )

    def _simulate_versions(self) -> tuple[Diagnostic, ...]:
        """Simulate both versions of an MJCF, and return messages on the effects of all changes.

        If there is a single change, of an element, the effects are stored in this change instead.
        Changed settings of the compiler are added to the changes if the versions differ otherwise.
        """
        old_file, new_file = self.one.file, self.two.file
        if not (isinstance(old_file, MjcfFile) and isinstance(new_file, MjcfFile)):
            return ()
        effects, combined = SimulatedPair.from_files(old_file, new_file).compute_effects(
            explained=bool(self.differences)
        )
        match self.differences:
            case [ElementDifference() as only]:
                consequences = (*only.consequences, *combined)
                self.differences = [replace(only, effects=effects, consequences=consequences)]
                combined = ()
        # A compiled model does not contain the settings of its compiler.
        compiled = any(isinstance(source.path, mujoco.MjModel) for source in self.sources)
        if (self.differences or combined) and not compiled:
            self.differences += find_changed_compiler_settings(old_file, new_file)
        return combined

    def _compare_extra_values(self) -> Iterator[Difference]:
        """Yield changes of values that a tree lacks, such as motors, springs and mimic joints."""
        old_values = self.one.extra_values
        new_values = {
            (kind, self.old_name.get(element, element)): _rename_targets(value, self.old_name)
            for (kind, element), value in self.two.extra_values.items()
        }
        for key in dict.fromkeys((*old_values, *new_values)):
            kind, element = key
            old, new = old_values.get(key), new_values.get(key)
            if kind == HELD_KIND:
                old = old or _get_joint_type(self.one.tree, element)
                new = new or _get_joint_type(self.two.tree, self.new_name.get(element, element))
            old, new = _drop_symmetric_ranges(old, new), _drop_symmetric_ranges(new, old)
            if _to_lists(old) != _to_lists(new):
                both = {
                    "one": _describe_changed_value(old, new),
                    "two": _describe_changed_value(new, old),
                    **VERSION_NAMES.message_values,
                }
                message = diagnose("element-differs", subject=(kind, element), **both)
                yield Difference(kind, element, old, new, "", message, {})

    def _make_change(self, difference: Difference) -> ModelChange:
        """Convert a difference to a `ModelChange`, with file and line in both versions."""
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


def _find_edited_masses(
    old_version: Version, new_version: Version
) -> dict[str, tuple[float, float]]:
    """Return {link: (old, new) stated mass [kg]} of the masses that differ.

    Empty if a stated CoM, a stated moment of inertia or the set of links differs.
    """
    old, new = old_version.inertials, new_version.inertials
    is_same_otherwise = old.keys() == new.keys() and all(
        np.array_equal(old[link].com, new[link].com)
        and np.array_equal(old[link].inertia, new[link].inertia)
        for link in old
    )
    if not is_same_otherwise:
        return {}
    masses = {link: (old[link].mass, new[link].mass) for link in old}
    return {link: pair for link, pair in masses.items() if pair[0] != pair[1]}


def _sum_mass(values: MultibodyTree) -> float:
    """Return the total mass of a tree [kg]."""
    return float(sum(body.mass for body in values.bodies.values()))


def _get_joint_type(tree: MultibodyTree, name: str) -> dict[str, str] | None:
    """Return the type of a joint of a tree, in MuJoCo's words; None if the tree lacks the joint."""
    joint = tree.joints.get(name)
    return None if joint is None else {"type": "slide" if joint.slides else "hinge"}


def _rename_targets(value: Any, names: Mapping[str, str]) -> Any:
    """Rename the joint to which the value of a mimic joint or a motor refers.

    ``names`` is {name in the value: new name}.
    """
    if isinstance(value, list) and value and isinstance(value[0], str):
        return [names.get(value[0], value[0]), *value[1:]]
    if isinstance(value, dict) and str(value.get("at", "")).startswith("joint "):
        name = value["at"].removeprefix("joint ")
        return {**value, "at": f"joint {names.get(name, name)}"}
    return value


def _drop_symmetric_ranges(value: Any, other: Any) -> Any:
    """Return the values of a motor without force ranges that the efforts of joints represent.

    An effort represents the range of an actuator at a joint if the ends have equal magnitudes in
    both versions. ``other`` contains the values of the other version.
    """
    if not isinstance(value, dict) or not str(value.get("at", "")).startswith("joint "):
        return value
    compared = dict(value)
    for word in FORCE_RANGES:
        ranges = [table[word] for table in (value, other) if table and word in table]
        if not any(sum(ends) for ends in ranges):
            compared.pop(word, None)
    return compared


def _to_lists(value: Any) -> Any:
    """Convert arrays and tuples, also in a table, to lists, which ``==`` can compare."""
    if isinstance(value, Mapping):
        return {key: _to_lists(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return list(value) if isinstance(value, list | tuple) else value


def _describe_changed_value(value: Any, other: Any) -> Diagnostic | Term | str:
    """Describe a value of one version for a message; of a table, only entries that differ."""
    value, other = _to_lists(value), _to_lists(other)
    if value is None:
        return Term("none")
    if isinstance(value, dict):
        other = other if isinstance(other, dict) else {}
        keys = [key for key in value if value[key] != other.get(key)]
        entries = [
            diagnose("entry", entry=key, value=_format_value(value[key], other.get(key)))
            for key in keys
        ]
        return diagnose("entries", entries=entries) if entries else Term("nothing of the like")
    return _format_value(value, other)


def _format_value(value: Any, other: Any) -> str:
    """Format a value of a version with six digits; with more if ``other`` would look equal.

    ``other`` is the value in the other version. Lists are in brackets.
    """
    if isinstance(value, list):
        others = other if isinstance(other, list) and len(other) == len(value) else value
        return "(" + ", ".join(map(_format_value, value, others)) + ")"
    if not isinstance(value, float):
        return str(value)
    return format_pair(value, other if isinstance(other, float) else value, ".6g")[0]


# Evaluation of a tree at random states in MuJoCo.


_NUM_STATES = 10
"""Number of random states at which the old and the new version are compared. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class RandomStates:
    """Random states at which the dynamics of an old and a new tree are compared in MuJoCo.

    Attributes:
        values: Tree that defines the joint limits.
    """

    values: MultibodyTree

    @cached_property
    def qpos(self) -> Array:
        """Random configurations with a fixed seed, shape (n, nq).

        A floating base is within 1 m of the origin along each axis, with a random orientation.
        Joint positions are between the limits; a missing limit is replaced by -pi or pi [rad or m].
        """
        rng = np.random.default_rng(0)
        joints = self.values.joints.values()
        lower = [joint.lower if np.isfinite(joint.lower) else -np.pi for joint in joints]
        upper = [joint.upper if np.isfinite(joint.upper) else np.pi for joint in joints]
        turns = rng.normal(size=(_NUM_STATES, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        base = [rng.uniform(-1, 1, (_NUM_STATES, 3)), turns] if self.values.floating else []
        ends = np.minimum(lower, upper), np.maximum(lower, upper)
        return np.hstack([*base, rng.uniform(*ends, (_NUM_STATES, len(joints)))])

    @cached_property
    def qvel(self) -> Array:
        """Random velocities of the compared states, shape (n, nv) [m/s, rad/s].

        The velocities are normally distributed with a standard deviation of 1; the seed is fixed.
        """
        size = len(self.values.joints) + 6 * self.values.floating
        return np.random.default_rng(1).normal(size=(_NUM_STATES, size))

    @cached_property
    def _mujoco_tree(self) -> MujocoTree:
        """MuJoCo model of ``values``, reused for other trees with the structure of ``values``."""
        return MujocoTree(self.values)

    def _load_tree(self, values: MultibodyTree) -> tuple[mujoco.MjModel, list[int], list[int]]:
        """Return the MuJoCo model of a tree, and indices into the model's qpos and qvel.

        Index k is the place of column k of `qpos` (`qvel`) in the model's qpos (qvel).
        """
        tree = (
            self._mujoco_tree if self._mujoco_tree.has_structure_of(values) else MujocoTree(values)
        )
        tree.copy_parameters(values)
        ids = [tree.model.joint(name).id for name in self.values.joints]
        base = self.values.floating
        places = [*range(7 * base), *tree.model.jnt_qposadr[ids].tolist()]
        return tree.model, places, [*range(6 * base), *tree.model.jnt_dofadr[ids].tolist()]

    def evaluate_tree(self, values: MultibodyTree) -> dict[str, Array]:
        """Evaluate the dynamics of a tree at all random states, in MuJoCo.

        Args:
            values: Tree with the same joints as the tree whose limits define the states.

        Returns:
            {quantity: values, shape (n, ...)}: mass matrix [kg, kg m, kg m^2], gravity [N, N m],
            bias forces minus passive forces such as damping [N, N m], CoM [m], and positions in the
            world frame [m]: "joint positions" of the bodies that the joints move, and "foot
            positions" of the frames. Quantities without values are left out.
        """
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
        """Compute the largest joint torques [N m] or forces [N] that hold the links' weight.

        The maximum is over all random states. A floating base is fixed in a level pose.

        Returns:
            {joint: largest absolute torque or force}.
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
    """Return a tree with renamed joints, in joints, parents, bodies and frame owners.

    The field ``base`` of the tree is not changed.

    Args:
        values: Tree.
        names: {name of a joint or of the base: new name}.
    """

    def new(name: str) -> str:
        """Return the new name of a joint or body; the old name if the name has not changed."""
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
    """Return a tree with the joint ``name`` fixed at position zero.

    The body that the joint moves becomes part of the parent body: the inertias are added, and child
    joints and frames belong to the parent.
    """
    joint = values.joints[name]
    pose, joints = joint.placement, {}
    for other_name, child in values.joints.items():
        if child.parent == name:
            child = replace(child.with_placement(pose * child.placement), parent=joint.parent)
        if other_name != name:
            joints[other_name] = child
    bodies = {other_name: body for other_name, body in values.bodies.items() if other_name != name}
    carried = pose.act(values.bodies[name].spatial_inertia)
    parent = values.bodies[joint.parent]
    bodies[joint.parent] = TreeBody.of(parent.spatial_inertia + carried, parent.link)
    frames = {
        frame: (joint.parent, np.array(pose.act(place))) if owner == name else (owner, place)
        for frame, (owner, place) in values.frames.items()
    }
    return replace(values, joints=joints, bodies=bodies, frames=frames)
