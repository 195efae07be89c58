"""Predict the rest position of a standing robot on position servos, without feed-forward."""
