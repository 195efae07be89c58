"""Time limits of tests that wait for another process, a thread or a browser."""

PATIENCE = 300.0
"""Longest time [s] that a test waits for something that must happen. Chosen, not tuned: far above
the time on a machine that is ten times slower than usual, so that no test depends on the speed."""
