"""Show Pupper v3 in MuJoCo's viewer: ``pupper-analysis live --mujoco`` as a script."""

from environment import run_command

if __name__ == "__main__":
    run_command("live", "--mujoco")
