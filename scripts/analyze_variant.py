"""Analyse variants of Pupper: ``pupper-analysis analyze`` as a script."""

from environment import run_command

if __name__ == "__main__":
    run_command("analyze")
