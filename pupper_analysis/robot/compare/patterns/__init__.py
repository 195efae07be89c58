"""One slip that explains many differences: units, an Euler sequence, left for right, a lost tensor.

Each is tried out: the slip is undone, and what is gone of the differences is what it explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.compare.differences import OF_INERTIALS, Difference
from pupper_analysis.robot.compare.links import mjcf_links, urdf_links
from pupper_analysis.robot.compare.patterns.angles import other_angles
from pupper_analysis.robot.compare.patterns.case import PatternCase
from pupper_analysis.robot.compare.patterns.dropped import find_dropped
from pupper_analysis.robot.compare.patterns.exchanged import find_exchanged
from pupper_analysis.robot.compare.patterns.inertials import other_inertials
from pupper_analysis.robot.compare.patterns.lines import other_lines
from pupper_analysis.robot.compare.patterns.links import other_links
from pupper_analysis.robot.compare.patterns.units import before_gears, other_units
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class PatternCause(Result):
    """One slip that explains several differences.

    Attributes:
        kind: ``units``, ``gears``, ``angles``, ``exchanged``, ``products``, ``coms``, ``links``,
            ``scaled links``, ``inertial`` or ``line``.
        diagnostic: What it is, with its numbers.
        differences: Which of the differences it explains, by number, from 0.
    """

    kind: str
    diagnostic: Diagnostic
    differences: tuple[int, ...]

    @property
    def message(self) -> str:
        """What it is, in plain words."""
        return str(self.diagnostic)

    @property
    def leads(self) -> bool:
        """Whether it is told before all else.

        So are efforts of another place on the drive: the dynamics do not feel them, but whatever is
        said of what the motors hold is false by the gear.
        """
        return self.kind == "gears"


def find_causes(
    robot: Robot,
    second: MultibodyTree,
    differences: Sequence[Difference],
    tolerances: Tolerances,
) -> tuple[PatternCause, ...]:
    """Finds slips that explain several differences each.

    Args:
        robot: The robot.
        second: The MJCF's tree, in the URDF's link frames.
        differences: All differences.
        tolerances: What counts as one.
    """
    if len(differences) < 2:
        return ()
    first, raw = kinematic_trees(robot)
    keys = [(each.kind, each.element) for each in differences]
    bodies = any(kind in OF_INERTIALS for kind, _ in keys)
    urdf = urdf_links(robot) if bodies else {}
    mjcf = mjcf_links(robot, raw, second) if bodies else {}
    raw = replace(raw, gravity=first.gravity)
    case = PatternCase(robot, first, raw, second, keys, tolerances, urdf, mjcf)
    found: list[PatternCause] = []
    taken: set[int] = set()
    for look in _LOOKS:
        for each in look(replace(case, taken={keys[n] for n in taken})):
            numbers = tuple(
                n for n, key in enumerate(keys) if key in each.explained and n not in taken
            )
            if len(numbers) > 1:
                taken |= set(numbers)
                found.append(PatternCause(each.kind, each.diagnostic, numbers))
                case = each.undone or case
    return tuple(sorted(found, key=lambda cause: (not cause.leads, cause.differences)))


_LOOKS = (
    other_angles,
    find_exchanged,
    other_units,
    before_gears,
    find_dropped,
    other_links,
    other_inertials,
    other_lines,
)
"""From what explains most at once to what explains a single body."""
