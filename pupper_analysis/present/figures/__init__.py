"""Figures, as PNG files. No pyplot: no window, and nobody's backend is touched."""
