from .robot import Analysis as Analysis
