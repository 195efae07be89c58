"""Backend evaluations: one quantity, many backends (Pinocchio, MuJoCo, yourdfpy)."""
