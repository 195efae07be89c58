"""Solve a stance: its cost, and if it holds."""
