"""What acts on a robot in MuJoCo and has no words in a URDF."""
