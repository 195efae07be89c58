"""Figures as PNG files, without Matplotlib's pyplot: no window opens, and the backend is kept."""
