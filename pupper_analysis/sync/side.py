"""What it takes to write numbers into either file."""

# Annotations are types, not texts: who inherits the fields has them in a signature elsewhere.
from dataclasses import dataclass, field

from pupper_analysis.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.digits import Digits
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.sync.frames import Key, MatchedRobots


@dataclass(eq=False, kw_only=True)
class Side:
    """A file that gets numbers of the other one.

    Attributes:
        sides: Both robots.
        wanted: What this file's shall be.
        digits: Writes the numbers.
        left: {difference: why it cannot be written}.
        notes: What else is to be said, per difference.
    """

    sides: MatchedRobots
    wanted: MultibodyTree
    digits: Digits
    left: dict[Key, Diagnostic] = field(default_factory=dict)
    notes: dict[Key, Diagnostic] = field(default_factory=dict)

    def on_same_body(self, key: Key) -> bool:
        """Says whether a frame is on one body in both files; notes why it is left, if not."""
        name = key[1]
        same = bool(self.sides.urdf.frames[name][0] == self.sides.mjcf.frames[name][0])
        if not same:
            self.left[key] = diagnose("frame-on-other-body-unwritten")
        return same
