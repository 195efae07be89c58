"""Shows Pupper v3 in MuJoCo's viewer: ``pupper-analysis view`` as a script."""

from pupper_analysis.cli import run, view

if __name__ == "__main__":
    run(view)
