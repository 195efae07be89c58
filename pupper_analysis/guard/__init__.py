"""Keeps the models of a repository right: what is checked, and what is known already."""
