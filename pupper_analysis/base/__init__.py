"""Errors, diagnostics, files, arrays, arguments and results, independent of any robot."""
