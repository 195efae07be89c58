"""Readers of sources, each a module with ``SUFFIXES`` and ``read``; found by their files."""
