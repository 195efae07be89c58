"""From stance to stance, at rest and at speed."""
