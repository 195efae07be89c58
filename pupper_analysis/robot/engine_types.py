"""Classes of the engines' models, for type annotations of ``Robot``.

At run time, the names are classes of Pinocchio and MuJoCo. Neither package contains type
information: ``engine_types.pyi`` states the types of their attributes for type checkers.
"""

from mujoco import MjModel as MujocoModel
from mujoco import MjSpec as MujocoSpec
from pinocchio import Data as PinocchioData
from pinocchio import GeometryModel as PinocchioGeometryModel
from pinocchio import Model as PinocchioModel

__all__ = [
    "MujocoModel",
    "MujocoSpec",
    "PinocchioData",
    "PinocchioGeometryModel",
    "PinocchioModel",
]
