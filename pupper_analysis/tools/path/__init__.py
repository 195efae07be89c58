"""Move to a stance, in balance all the way."""

HEADING = "Stance"
