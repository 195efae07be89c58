from .analyze.analysis import Analysis as Analysis
from .audit.audit import Audit as Audit
from .best.best import BestStance as BestStance
from .crosscheck.crosscheck import Comparison as Comparison
from .crosscheck.crosscheck import CrossCheck as CrossCheck
from .diff.compare import ModelDiff as ModelDiff
from .hold.hold import Hold as Hold
from .payload.limit import PayloadLimit as PayloadLimit
