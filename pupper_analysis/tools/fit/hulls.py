"""The convex hulls of links: where a centre of mass can be."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.parameters import ParameterTable

Array = NDArray[np.float64]

_G = mujoco.mjtGeom

_UNBOUNDED = (_G.mjGEOM_PLANE.value, _G.mjGEOM_HFIELD.value)

_DIRECTIONS = np.array(
    [d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)], dtype=float
)
"""To the faces, edges and corners of a cube: between them a hull is off by a tenth of its size."""


def hull_of(robot: Robot, link: str) -> tuple[Array, Array]:
    """Returns a polytope around all shapes that move with a link: N c <= b.

    All shapes of MuJoCo's model count, also those that touch nothing. The polytope has faces along
    the link's axes and diagonals, and along the axes of each shape: boxes are exact.

    Args:
        robot: The robot; at zero angles both of its models are one robot.
        link: A link of the URDF.

    Returns:
        N (n, 3) of length 1, and b (n,), in the frame of the joint that moves the link (m); empty
        if it has no shapes.
    """
    model, pin_model = robot.mj_model, robot.pin_model
    frame = pin_model.frames[pin_model.getFrameId(link, pin.FrameType.BODY)]
    here = _joint_pose(robot, link, frame)
    body = _body_of(robot, int(frame.parentJoint))
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(model, data)
    group = np.flatnonzero(model.body_weldid == model.body_weldid[body])
    geoms = [
        geom
        for geom in np.flatnonzero(np.isin(model.geom_bodyid, group)).tolist()
        if model.geom_bodyid[geom] and model.geom_type[geom] not in _UNBOUNDED
    ]
    if not geoms:
        return np.zeros((0, 3)), np.zeros(0)
    placed = []
    for geom in geoms:
        there = pin.SE3(data.geom_xmat[geom].reshape(3, 3), np.array(data.geom_xpos[geom]))
        placed.append((geom, here.actInv(there)))
    turns = [np.array(place.rotation).T for _, place in placed]
    own = np.unique(np.round(np.concatenate([*turns, *(-turn for turn in turns)]), 9), axis=0)
    directions = np.concatenate([_DIRECTIONS, own])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = np.max(
        [
            directions @ place.translation + _reach(model, geom, directions @ place.rotation)
            for geom, place in placed
        ],
        axis=0,
    )
    return directions, reach


def unbounded_coms(robot: Robot, table: ParameterTable) -> Iterator[Diagnostic]:
    """Yields one diagnostic of the links whose com is estimated, and which no shape bounds.

    Args:
        robot: The robot.
        table: What is estimated.
    """
    links = dict.fromkeys(one.subject for one in table if one.kind == "com")
    bare = [link for link in links if not len(hull_of(robot, link)[1])]
    if bare:
        yield diagnose("links-without-shapes", links=bare)


def _joint_pose(robot: Robot, link: str, frame: pin.Frame) -> pin.SE3:
    config = Configuration(robot, robot.neutral())
    pose = pin.SE3(config.frame_rotation(link), config.frame_position(link))
    return pose * frame.placement.inverse()


def _body_of(robot: Robot, joint: int) -> int:
    """Returns the body (MuJoCo's id) that a joint of Pinocchio moves; the base's of others."""
    name, model = str(robot.pin_model.names[joint]), robot.mj_model
    if name not in robot.joint_names:
        return int(model.body(robot.mj_base).id)
    return int(model.jnt_bodyid[model.joint(name).id])


def _reach(model: mujoco.MjModel, geom: int, directions: Array) -> Array:
    """Returns how far a shape reaches along directions (n, 3) in its frame (m)."""
    kind, (x, y, z) = model.geom_type[geom], model.geom_size[geom].tolist()
    along, size = np.abs(directions), np.array([x, y, z])
    if kind == _G.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start = int(model.mesh_vertadr[mesh])
        corners = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])]
        return np.asarray((directions @ corners.T).max(axis=1), dtype=float)
    if kind == _G.mjGEOM_SPHERE:
        return np.full(len(directions), x)
    if kind == _G.mjGEOM_CAPSULE:
        return np.asarray(x + y * along[:, 2], dtype=float)
    if kind == _G.mjGEOM_CYLINDER:
        return np.asarray(x * np.hypot(along[:, 0], along[:, 1]) + y * along[:, 2], dtype=float)
    if kind == _G.mjGEOM_ELLIPSOID:
        return np.asarray(np.linalg.norm(directions * size, axis=1), dtype=float)
    if kind == _G.mjGEOM_BOX:
        return np.asarray(along @ size, dtype=float)
    return np.full(len(directions), float(model.geom_rbound[geom]))
