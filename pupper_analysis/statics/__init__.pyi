from ..tools.path.dynamics import InverseDynamics as InverseDynamics
from ..tools.path.dynamics import inverse_dynamics as inverse_dynamics
from .equilibrium import ForceDistribution as ForceDistribution
from .equilibrium import GravityCompensation as GravityCompensation
from .polytope import ForcePolytope as ForcePolytope
from .polytope import force_polytope as force_polytope
from .region import SupportRegion as SupportRegion
from .region import support_region as support_region
