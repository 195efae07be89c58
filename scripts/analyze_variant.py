"""Analyses variants of Pupper: ``pupper-analysis analyze`` as a script."""

from pupper_analysis.cli import analyze, run

if __name__ == "__main__":
    run(analyze)
