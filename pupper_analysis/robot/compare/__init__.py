"""Comparison of two files of one robot in both engines, and explanation of the differences."""
