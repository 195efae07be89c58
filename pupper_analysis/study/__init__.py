"""Many designs: which numbers vary, what is measured, and the engine that loses nothing."""
