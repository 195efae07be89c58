"""Errors, diagnostics, files, arrays, arguments, results: knows no robot."""
