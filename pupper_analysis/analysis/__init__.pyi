from .best import BestStance as BestStance
from .hold import Hold as Hold
from .payload import PayloadLimit as PayloadLimit
from .robot import Analysis as Analysis
