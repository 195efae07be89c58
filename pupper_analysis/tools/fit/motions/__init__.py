"""Fit of motions: simulation of logs and estimation of parameters."""
