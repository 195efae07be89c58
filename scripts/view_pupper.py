"""Shows Pupper v3 in MuJoCo's viewer: ``pupper-analysis live --mujoco`` as a script."""

from environment import run

if __name__ == "__main__":
    run("live", "--mujoco")
