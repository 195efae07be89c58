"""Show a robot in MuJoCo's viewer."""
