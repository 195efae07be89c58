"""Takes planned stands with a robot, and writes down what its encoders show."""
