"""Find where trainer, deployment and model disagree.

Compares the numbers that are specified for each joint by the training configuration of a policy,
its deployment, the motor drivers, and the model of the robot.
"""

from pupper_analysis.base.exports import make_lazy_exports

HELP_HEADING = "Files"
"""Section of ``--help`` that lists this tool."""

__getattr__, __dir__, __all__ = make_lazy_exports(__name__, __file__)
