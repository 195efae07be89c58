"""How a robot can stand."""
