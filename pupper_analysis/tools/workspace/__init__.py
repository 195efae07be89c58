"""Map how far the base goes, feet planted."""

HEADING = "Stance"
