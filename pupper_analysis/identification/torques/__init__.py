"""Fit of measured torques, by Pinocchio's joint-torque regressor."""
