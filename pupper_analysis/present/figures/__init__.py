"""Figures as PNG files, without Matplotlib's pyplot: no window opens, and its backend is kept."""
