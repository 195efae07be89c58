"""Record planned stands with a robot: connection, operator and output file."""
