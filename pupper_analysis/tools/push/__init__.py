"""Find how hard a push it withstands, and where."""

HEADING = "Stance"
