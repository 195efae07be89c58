"""Search for the best stance."""

HEADING = "Stance"
