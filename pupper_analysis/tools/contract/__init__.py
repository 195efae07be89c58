"""Find where trainer, deployment and model disagree.

What trained a policy, what runs it, what drives the motors, and what models the robot.
"""

from pupper_analysis.base.exports import make_lazy_exports

HEADING = "Files"

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
