"""Drop a robot, and see that it stands."""

HEADING = "Look"
