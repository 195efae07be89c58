"""Classes of the engines' models, as annotations of ``Robot``.

At run time these are the classes of Pinocchio and MuJoCo. Neither package contains type
information, so ``engine_types.pyi`` states the types of their attributes for type checkers.
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
