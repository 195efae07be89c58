"""Fit of stands at rest: residual equations, parameters, plan of stands and wiring."""
