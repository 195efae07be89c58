"""One quantity, many backends: Pinocchio, MuJoCo, yourdfpy."""
