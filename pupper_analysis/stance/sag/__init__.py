"""Where position servos let a robot come to rest."""
