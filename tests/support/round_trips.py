"""Conversions from URDF to MJCF and back, or the other way round: find losses that are not
reported.

The original and the file converted back are read into tables: a URDF as XML without the package, an
MJCF by MuJoCo. A difference that no message of the two conversions mentions is a silent loss.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

import pupper_analysis as pa

Table = dict[tuple[str, str], object]
"""{(name of an element, attribute): value}."""

NEAR = 1e-6
"""Relative and absolute difference up to which two values count as equal."""


def of_urdf(path: Path) -> Table:
    """Return the masses, limits, dynamics, couplings and collision shapes that a URDF states."""
    found: Table = {}
    root = etree.parse(path).getroot()
    for link in root.findall("link"):
        name = str(link.get("name"))
        mass = link.find("inertial/mass")
        if mass is not None and float(mass.get("value")) > 0:
            found[name, "mass"] = float(mass.get("value"))
        for shape in link.findall("collision"):
            geometry = shape.find("geometry")
            kinds = sorted(child.tag for child in geometry) if geometry is not None else []
            counted = found.setdefault((name, "collision"), [])
            counted += kinds  # type: ignore[operator]
    for joint in root.findall("joint"):
        name = str(joint.get("name"))
        if joint.get("type") in ("fixed", "floating"):
            continue
        for tag, words in (
            ("limit", ("lower", "upper", "effort", "velocity")),
            ("dynamics", ("damping", "friction")),
            ("mimic", ("multiplier", "offset")),
            ("safety_controller", ("k_velocity", "soft_lower_limit")),
            ("calibration", ("rising", "falling")),
        ):
            element = joint.find(tag)
            for word in words if element is not None else ():
                value = element.get(word)
                ends = word in ("lower", "upper") and joint.get("type") == "continuous"
                if value is not None and float(value) != 0.0 and not ends:
                    found[name, word] = float(value)
    for word in ("transmission", "gazebo", "sensor"):
        if root.find(word) is not None:
            found["robot", word] = "there"
    return found


_ARRAYS = {
    "friction": "geom_friction", "condim": "geom_condim", "solref": "geom_solref",
    "solimp": "geom_solimp", "margin": "geom_margin", "gap": "geom_gap",
    "priority": "geom_priority", "solmix": "geom_solmix",
}  # fmt: skip
"""{attribute of a geom: array of MuJoCo's model}."""

_OPTIONS = (
    "timestep", "integrator", "cone", "impratio", "solver", "iterations", "noslip_iterations",
    "density", "viscosity",
)  # fmt: skip
"""Compared attributes of MuJoCo's options."""


def of_mjcf(path: Path) -> Table:
    """Return joints, contact parameters of geoms, options and numbers of elements by MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(path))
    found: Table = {}
    for word in _OPTIONS:
        found["option", word] = float(np.ravel(getattr(model.opt, word))[0])
    for joint in range(model.njnt):
        if model.jnt_type[joint] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            name, dof = model.joint(joint).name, model.jnt_dofadr[joint]
            found[name, "armature"] = float(model.dof_armature[dof])
            found[name, "stiffness"] = float(model.jnt_stiffness[joint])
            found[name, "damping"] = float(np.ravel(model.dof_damping[dof])[0])
            found[name, "frictionloss"] = float(model.dof_frictionloss[dof])
            found[name, "range"] = tuple(model.jnt_range[joint].tolist())
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if model.body_weldid[body] and touches:
            for word, array in _ARRAYS.items():
                values = np.ravel(getattr(model, array)[geom])
                used = 1 if word == "friction" else len(values)
                # A capsule is a cylinder and two balls in a URDF: values count, not how often.
                carrier = model.body(model.body_weldid[body]).name
                row = found.setdefault((carrier, word), set())
                row.add(tuple(values[:used].tolist()))  # type: ignore[attr-defined]
    counts = {
        "tendon": model.ntendon, "equality": model.neq, "sensor": model.nsensor,
        "exclude": model.nexclude, "pair": model.npair, "keyframe": model.nkey,
        "flex": model.nflex, "camera": model.ncam,
    }  # fmt: skip
    found |= {("number", word): count for word, count in counts.items()}
    frames = [model.site(n).name for n in range(model.nsite)]
    frames += [model.body(n).name for n in range(model.nbody)]  # what a site becomes in a URDF
    found |= {(name, "site"): "there" for name in frames if name}
    for motor in range(model.nu):
        name = model.joint(model.actuator_trnid[motor, 0]).name
        found[name, "gain"] = float(model.actuator_gainprm[motor, 0])
    return found


_SAID_AS = {
    "effort": ("effort", "torque", "force"), "velocity": ("velocity",),
    "k_velocity": ("safety",), "soft_lower_limit": ("safety",), "rising": ("calibration",),
    "falling": ("calibration",), "multiplier": ("mimic", "coupl", "follow"),
    "offset": ("mimic", "coupl", "follow"), "collision": ("shape", "mesh", "ball", "collision"),
    "gain": ("servo", "actuator", "motor"), "stiffness": ("spring", "stiffness"),
    "timestep": ("timestep", " ms"), "site": ("site",), "keyframe": ("keyframe", "key"),
    "frictionloss": ("friction",),
    "noslip_iterations": ("noslip",), "camera": ("camera",),
    "exclude": ("exclude", "overlap", "touch"), "density": ("density", "fluid", "medium"),
    "viscosity": ("viscosity", "fluid", "medium"), "range": ("range", "limit"),
    "armature": ("armature",), "mass": ("mass", "inert", "gram"), "sensor": ("sensor",),
}  # fmt: skip
"""{attribute: words of which a message must contain one to report its loss}; others by their name.
"""


def _is_equal(one: object, two: object) -> bool:
    """Return whether two values are equal up to ``NEAR``."""
    if isinstance(one, list) and isinstance(two, list):
        return len(one) == len(two) and all(map(_is_equal, sorted(one), sorted(two)))
    if isinstance(one, set) and isinstance(two, set):
        return _is_equal(sorted(one), sorted(two))
    if isinstance(one, str) or isinstance(two, str) or two is None:
        return one == two
    return bool(np.allclose(one, two, rtol=NEAR, atol=NEAR))  # type: ignore[arg-type]


def silent_losses(before: Table, after: Table, said: str) -> dict[str, list[str]]:
    """Return {attribute: elements whose value has changed without a message}."""
    lost: dict[str, list[str]] = {}
    for (name, word), value in before.items():
        more = name == "number" and int(value) <= int(after[name, word])  # type: ignore[call-overload]
        if not (more or _is_equal(value, after.get((name, word)))):
            words = _SAID_AS.get(word, (word,))
            if not any(word in said for word in words):
                lost.setdefault(word, []).append(name)
    return lost


def round_trip(source: Path, folder: Path) -> tuple[dict[str, list[str]], int]:
    """Convert a file to the other format and back; return the silent losses, and the number of
    values.
    """
    endings = (".xml", ".urdf") if source.suffix == ".urdf" else (".urdf", ".xml")
    there, back = (folder / f"{name}{end}" for name, end in zip("ab", endings, strict=True))
    said = []
    for first, second in ((source, there), (there, back)):
        done = pa.convert_model(first, second, force=True, repair_inertia=first.suffix == ".urdf")
        said += [*done.not_converted, *done.notes, *done.failures]
        said += [repair.diagnostic for repair in done.repairs]
    read = of_urdf if source.suffix == ".urdf" else of_mjcf
    before, after = read(source), read(back)
    return silent_losses(before, after, " ".join(map(str, said)).lower()), len(before)
