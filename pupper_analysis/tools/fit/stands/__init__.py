"""Fit of stands at rest: a soft servo is a torque sensor."""
