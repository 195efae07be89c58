from .optimize.search import Objective as Objective
from .path.stance_path import StancePath as StancePath
from .path.stance_path import stance_path as stance_path
from .sag.band import SteadyStateBand as SteadyStateBand
from .sag.band import steady_state_band as steady_state_band
from .sag.steady_state import SteadyState as SteadyState
from .sag.steady_state import minimum_stiffness as minimum_stiffness
from .soft_ground import (
    solve_stand_as_simulated as solve_stand_as_simulated,
)
from .soft_ground import (
    solve_stand_on_soft_ground as solve_stand_on_soft_ground,
)
from .stand import stand_statics as stand_statics
from .workspace import (
    BaseWorkspace as BaseWorkspace,
)
from .workspace import (
    Interval as Interval,
)
from .workspace import (
    base_workspace as base_workspace,
)
from .workspace import (
    reachable_heights as reachable_heights,
)
