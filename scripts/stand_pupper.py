"""Drop Pupper v3, and check that it stands: ``pupper-analysis live --drop`` as a script."""

from environment import run_command

if __name__ == "__main__":
    run_command("live", "--drop")
