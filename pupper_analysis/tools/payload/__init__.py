"""Find how much a stance carries, and what fails."""

HEADING = "Stance"
