"""Makes a robot of two files as they are published: matched, on feet, with servos and a start."""
