"""Program that draws a MuJoCo model without a window: ``python -P offscreen.py FOLDER``.

`pictures` starts this program in a separate process, for two reasons. MuJoCo selects OpenGL during
the import, and an OpenGL driver may end the process. The folder contains ``model.mjb`` and
``views.npz``; the program writes ``frames.npy``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np

MIN_AMBIENT_LIGHT, MIN_DIFFUSE_LIGHT = 0.4, 0.6
"""Lower bounds of the ambient and diffuse intensity of the camera's light (MuJoCo's headlight), 0
to 1. Chosen so that a black robot, such as Go1, is visible in front of a file's dark floor."""


def draw_frames(folder: Path) -> None:
    """Draw the configurations of ``views.npz`` in a folder, and write the images to the folder.

    - ``model.mjb``: MuJoCo model
    - ``views.npz``, ``qpos``: configurations of this model, shape (n, nq)
    - ``views.npz``, ``cameras``: looked-at point [m], distance [m], azimuth and elevation [deg] in
      MuJoCo's convention, shape (n, 6)
    - ``views.npz``, ``size``: width and height [pixel]
    - ``views.npz``, ``shadows``: whether to draw shadows and reflections
    - ``frames.npy`` (output): images, shape (n, height, width, 3), 8 bits per colour

    Args:
        folder: Folder of these files.
    """
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    with np.load(folder / "views.npz") as views:
        qpos, cameras, size = views["qpos"], views["cameras"], views["size"]
        shadows = bool(views["shadows"])
    width, height = map(int, size)
    # The model is this program's own copy.
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    headlight = model.vis.headlight
    headlight.ambient[:] = np.maximum(headlight.ambient, MIN_AMBIENT_LIGHT)
    headlight.diffuse[:] = np.maximum(headlight.diffuse, MIN_DIFFUSE_LIGHT)
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    frames = np.empty((len(qpos), height, width, 3), np.uint8)
    with mujoco.Renderer(model, height, width) as renderer:
        for index, (state, view) in enumerate(zip(qpos, cameras, strict=True)):
            data.qpos[:] = state
            mujoco.mj_forward(model, data)
            camera.lookat[:] = view[:3]
            camera.distance, camera.azimuth, camera.elevation = view[3:]
            renderer.update_scene(data, camera)
            for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
                renderer.scene.flags[flag] &= shadows
            renderer.render(out=frames[index])
    np.save(folder / "frames.npy", frames)


if __name__ == "__main__":
    draw_frames(Path(sys.argv[1]))
