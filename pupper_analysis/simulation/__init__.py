"""Does it hold, and what does it survive, in MuJoCo."""
