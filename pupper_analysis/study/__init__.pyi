from .outcome import StudyOutcome as StudyOutcome
from .outcome import study_outcome as study_outcome
from .pareto import pareto_front as pareto_front
from .randomisation import write_randomisation as write_randomisation
from .sensitivity import linear_shares as linear_shares
from .sensitivity import sobol_indices as sobol_indices
from .tolerance import certainty as certainty
from .tolerance import tightest_tolerance as tightest_tolerance
from .variables import (
    linspace as linspace,
)
from .variables import (
    log_uniform as log_uniform,
)
from .variables import (
    normal as normal,
)
from .variables import (
    uniform as uniform,
)
from .variables import (
    values as values,
)
