"""Comparison of two files of the same robot in both engines, and explanation of the differences."""
