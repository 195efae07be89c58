"""Drops Pupper v3 and sees that it stands: ``pupper-analysis live --drop`` as a script."""

from environment import run

if __name__ == "__main__":
    run("live", "--drop")
