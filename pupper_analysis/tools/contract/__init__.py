"""Find where trainer, deployment and model disagree.

What trained a policy, what runs it, what drives the motors, and what models the robot.
"""

from pupper_analysis.base.exports import exports_of

HEADING = "Files"

__getattr__, __dir__, __all__ = exports_of(__name__, __file__)
