"""Show a robot in MuJoCo's viewer."""

HEADING = "Look"
