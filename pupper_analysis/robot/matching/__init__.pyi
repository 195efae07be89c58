from .tolerances import Tolerances as Tolerances
