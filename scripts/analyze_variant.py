"""Analyses variants of Pupper: ``pupper-analysis analyze`` as a script."""

from environment import run

if __name__ == "__main__":
    run("analyze")
