from .audit import Audit as Audit
from .compare import Comparison as Comparison
from .engines import CrossCheck as CrossCheck
from .versions.compare import ModelDiff as ModelDiff
