"""Drops Pupper v3 and sees that it stands: ``pupper-analysis drop`` as a script."""

from environment import run

if __name__ == "__main__":
    run("drop")
