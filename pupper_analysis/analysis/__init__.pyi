from .hold import Hold as Hold
from .robot import Analysis as Analysis
