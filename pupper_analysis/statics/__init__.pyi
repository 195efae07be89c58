from ..tools.path.dynamics import InverseDynamics as InverseDynamics
from ..tools.path.dynamics import inverse_dynamics as inverse_dynamics
from .equilibrium import ForceDistribution as ForceDistribution
from .equilibrium import GravityCompensation as GravityCompensation
