"""Find what a learnt policy asks of the motors, and how far the robot may change."""

HEADING = "Real robot"
