"""Are the model files right, and if not, why not."""
