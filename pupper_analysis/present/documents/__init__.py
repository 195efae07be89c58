"""Documents of results: one builder per type, in a module of its name."""
