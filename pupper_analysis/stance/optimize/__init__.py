"""The best stance."""
