"""Drops Pupper v3 and sees that it stands: ``pupper-analysis stand`` as a script."""

from pupper_analysis.cli import run, stand

if __name__ == "__main__":
    run(stand)
