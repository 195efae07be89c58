"""Shows results, and never solves."""
