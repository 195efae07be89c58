from .estimate import Posterior as Posterior
from .estimate import estimate_parameters as estimate_parameters
from .log import Log as Log
from .log import read_log as read_log
from .parameters import Parameter as Parameter
from .parameters import Prior as Prior
from .parameters import parse_prior as parse_prior
from .stands import MeasuredStands as MeasuredStands
