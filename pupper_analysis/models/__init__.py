"""Reading, writing and converting model files."""
