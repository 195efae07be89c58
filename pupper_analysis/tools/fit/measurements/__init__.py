"""Read measurements: stands at rest, and logs of motions."""
