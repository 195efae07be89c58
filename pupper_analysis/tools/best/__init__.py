"""Search for the best stance."""
