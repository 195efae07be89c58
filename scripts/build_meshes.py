"""Build the STL parts that draw Pupper v3: torso, hip, thigh and calf.

The parts are our own drawing of the robot, made from a few numbers: they carry no mass and touch
nothing. Every other number here is a choice of looks; the ones below that place a joint, a motor
or a foot come from the Pupper v3 model (MJCF/URDF ``pupper_v3``), with the angles at zero:

* hip centres: position of the ``leg_*_1`` bodies in the base frame;
* knee: offset of the ``leg_*_3`` body, (0, -0.0494, 0.0685) m in the ``leg_*_2`` frame;
* knee housing: collision cylinder of ``leg_*_2``;
* foot: collision sphere of ``leg_*_3``, (0.06231, -0.06216, 0.018) m in that frame;
* torso box: collision box of ``base_link``.

Frames [m]:
    torso: the base frame (x forward, y left, z up).
    hip: origin at the hip centre of a right leg, axes parallel to the base frame.
    thigh: origin at the hip centre of a right leg, z towards the knee, y away from the robot.
    calf: origin at the knee of a right leg, z towards the foot in the plane of the leg, y away
        from the robot; the foot's ball, drawn as a sphere, lies at y = 0.018.

A left leg draws the same files with ``scale="1 -1 1"``.
"""

# trimesh is typed in part, shapely and manifold3d not at all.
# mypy: disable-error-code="import-not-found, import-untyped, no-untyped-call, no-any-return"

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import trimesh
from manifold3d import Manifold, Mesh
from numpy.typing import ArrayLike
from shapely import LineString, Point, Polygon, box
from trimesh import Trimesh
from trimesh.boolean import difference, intersection, union
from trimesh.creation import cylinder, extrude_polygon, icosphere, revolve
from trimesh.geometry import align_vectors
from trimesh.transformations import translation_matrix

DEFAULT_OUTPUT = Path(__file__).resolve().parents[1] / "mjcf" / "meshes"
"""Folder of the meshes in this repository."""


class BoltCircle(NamedTuple):
    """Bolt holes in the face of a motor, around a shallow recess.

    Attributes:
        number: Number of bolts.
        circle: Radius of the circle on which their axes lie [m].
        recess: Radius of the recess, 0 for none [m].
    """

    number: int
    circle: float
    recess: float = 0.0


X = np.array([1.0, 0.0, 0.0])
Y = np.array([0.0, 1.0, 0.0])
Z = np.array([0.0, 0.0, 1.0])

# --- From the Pupper v3 model ------------------------------------------------------------- [m]
TORSO_BOX_CENTRE = np.array([0.02146, 0.0, 0.03345])
"""Centre of the torso's collision box in the base frame [m]."""

TORSO_BOX_HALF_SIZE = np.array([0.129715, 0.04507, 0.06379])
"""Half edge lengths of the torso's collision box [m]."""

HIP_CENTRES_LEFT = np.array([[0.075, 0.0835, 0.0], [-0.075, 0.0725, 0.0]])
"""Centres of the front and rear left hips in the base frame [m]."""

KNEE_BACK, KNEE_DOWN = 0.0685, 0.0494
"""Distance of the knee behind and below the hip centre in the base frame, angles at zero [m]."""

KNEE_HOUSING_RADIUS = 0.025
"""Radius of the housing around the third motor [m]."""

KNEE_HOUSING_HALF_LENGTH = 0.015
"""Half length of the third motor's housing along y [m]."""

FOOT_OUTWARD = 0.018
"""Distance of the foot from the plane of the leg, along y of the calf frame [m]."""

FOOT_DISTANCE = float(np.hypot(0.06231, 0.06216))
"""Distance of the foot from the knee along z of the calf frame [m]."""

FOOT_RADIUS = 0.01995
"""Radius of the foot's ball [m]."""

THIGH_LENGTH = float(np.hypot(KNEE_BACK, KNEE_DOWN))
"""Distance of the knee from the hip centre in the plane of the leg [m]."""

THIGH_BACK = np.array([-KNEE_DOWN, 0.0, KNEE_BACK]) / THIGH_LENGTH
"""Axis of the second motor in the thigh frame, from the hip to the thigh: unit vector, backwards
in the base frame."""

THIGH_UP = np.array([-KNEE_BACK, 0.0, -KNEE_DOWN]) / THIGH_LENGTH
"""Unit vector of the base frame's z axis in the thigh frame."""

# --- Fineness ---------------------------------------------------------------------------------
SECTIONS = 30
"""Facets around a motor can."""

RECESS_SECTIONS = 18
"""Facets around the recess in a motor's face, the disc in it, and the axle."""

BOLT_SECTIONS = 6
"""Facets around a bolt hole."""

FINE_BALL_RADIUS = 0.0055
"""Radius [m] from which the edges of a hull are rounded with more facets."""

ARC_SEGMENTS = 2
"""Facets of a quarter circle at a rounded corner; the display's corners have twice as many."""

TOLERANCE = 0.0001
"""Distance [m] by which a surface may change to save triangles."""

FAR = 0.1
"""Reach [m] of cutters that go right through a part."""

OVERSHOOT = 0.001
"""Distance [m] by which a cutter sticks out of what it cuts, or an eye reaches into the head."""

# --- Motor cans --------------------------------------------------------------------------- [m]
CHAMFER = 0.0015
"""Width of the chamfer at the rims of a motor can [m]."""

FIN_GROOVE_WIDTH = 0.0020
"""Width of a cooling groove [m]."""

FIN_GROOVE_DEPTH = 0.0020
"""Depth of a cooling groove [m]."""

BOLT_RADIUS = 0.0014
"""Radius of a bolt hole [m]."""

BOLT_DEPTH = 0.0018
"""Depth of a bolt hole [m]."""

# Torso: all lengths in metres.
SHELL_RADIUS = 0.012
"""Radius of the shell's edges [m]."""

SHELL_BALLS = np.array(
    [
        [-0.0955, 0.020, 0.000], [-0.0955, 0.024, 0.026], [-0.0920, 0.016, 0.048],
        [-0.0600, 0.026, -0.018], [-0.0600, 0.032, 0.030], [-0.0550, 0.020, 0.058],
        [0.0750, 0.028, -0.018], [0.0750, 0.033, 0.030], [0.0700, 0.021, 0.058],
        [0.0980, 0.018, -0.002], [0.1000, 0.024, 0.024], [0.0960, 0.016, 0.050],
    ]
)  # fmt: skip
"""Ball centres of the shell [m]: (x, y, z), each also at -y; rear, haunch, shoulder, chest."""

SEAM_XS = (-0.038, 0.038)
"""x coordinates of the panel lines between haunches, belly and shoulders [m]."""

SEAM_WIDTH = 0.0014
"""Width of a panel line of the shell [m]."""

SEAM_DEPTH = 0.0012
"""Depth of a panel line [m]."""

VENT_XS = (-0.0165, -0.0055, 0.0055, 0.0165)
"""x coordinates of the vents in the shell [m]."""

VENT_RADIUS = 0.0022
"""Half width of a vent [m]."""

VENT_Z = 0.0390
"""Height of the middle of a vent [m]."""

VENT_REACH, VENT_LEAN = 0.012, 0.0035
"""Distance from the middle of a vent to its upper end, along z and x [m]."""

VENT_DEPTH = 0.004
"""Depth of a vent [m]."""

BOSS_RADIUS = 0.0235
"""Radius of the collar on which a hip can turns [m]."""

HEAD_RADIUS = 0.010
"""Radius of the head's edges [m]."""

HEAD_BALLS = np.array(
    [
        [0.0940, 0.029, 0.034], [0.0940, 0.029, 0.066],
        [0.1310, 0.032, 0.026], [0.1260, 0.032, 0.069],
    ]
)  # fmt: skip
"""Centres of the balls of the head's hull [m], each also at -y."""

DISPLAY_WIDTH, DISPLAY_HEIGHT, DISPLAY_CORNER = 0.060, 0.029, 0.010
"""Width, height and corner radius of the display [m]."""

DISPLAY_RISE = 0.007
"""Height of the display's centre over the face's [m]."""

DISPLAY_DEPTH = 0.0025
"""Depth of the display's recess in the face [m]."""

EYE_APART, EYE_RADIUS, EYE_HEIGHT = 0.0155, 0.0088, 0.0022
"""Distance of an eye from the middle, its radius and its height over the display [m]."""

PUPIL_RADIUS, PUPIL_RISE = 0.0045, 0.0015
"""Radius of a pupil, and its height over the eye's centre [m]."""

SNOUT_RADIUS = 0.0054
"""Radius of the snout's edges [m]."""

SNOUT_HALF_WIDTH = 0.009
"""Half width of the snout without its edges [m]."""

SNOUT_DROP = 0.0165
"""Depth of the snout's centre below the face's [m]."""

SNOUT_REACH = 0.0045
"""Distance of the snout's front balls from the face [m]."""

LENS_RADIUS, LENS_DEPTH = 0.0036, 0.0015
"""Radius and depth of the hole for the camera's lens [m]."""

EAR_RADIUS = 0.0025
"""Radius of the ears' edges [m]."""

EAR_BALLS = np.array([[0.100, 0.036, 0.070], [0.122, 0.036, 0.072], [0.104, 0.031, 0.0930]])
"""Centres of the balls of an ear's hull [m]."""

PAD_RADIUS = 0.004
"""Radius of the edges of the battery cover on the back [m]."""

PAD_BALLS = np.array([[-0.078, 0.016, 0.052], [-0.074, 0.014, 0.070],
                      [0.062, 0.016, 0.052], [0.058, 0.014, 0.070]])  # fmt: skip
"""Centres of the balls of the battery cover's hull [m], each also at -y."""

HANDLE_PATH = (
    (-0.0600, 0.0, 0.0680, 0.0042, 0.007),
    (-0.0460, 0.0, 0.0915, 0.0042, 0.007),
    (0.0260, 0.0, 0.0915, 0.0042, 0.007),
    (0.0440, 0.0, 0.0680, 0.0042, 0.007),
)
"""Chain of the handle [m]; rows as in ``rounded_bar``."""

TAIL_PATH = (
    (-0.0860, 0.0, 0.0480, 0.0054, 0.0),
    (-0.0985, 0.0, 0.0680, 0.005, 0.0),
    (-0.1020, 0.0, 0.0900, 0.004, 0.0),
)
"""Chain of the tail [m]; rows as in ``rounded_bar``."""

# Hip: all lengths in metres.
HIP_CAN_RADIUS = 0.026
"""Radius of the first motor's can [m]."""

HIP_CAN_INWARD = 0.022
"""Distance that the first motor's can reaches towards the torso [m]."""

HIP_CAN_OUTWARD = 0.020
"""Distance that the first motor's can reaches away from the torso [m]."""

HIP_FINS = (0.0165, 0.0215, 0.0265)
"""Positions of the grooves along the first motor's can [m]."""

HIP_BOLTS = BoltCircle(8, 0.0195, 0.012)
"""Bolts in the outer face of the first motor's can."""

HIP_BADGE_RADIUS, HIP_BADGE_SUNK = 0.009, 0.0006
"""Radius of the disc in the recess, and its depth below the can's face [m]."""

ROLL_CAN_RADIUS = 0.019
"""Radius of the second motor's can [m]."""

ROLL_CAN_HALF_LENGTH = 0.030
"""Half length of the second motor's can along x [m]."""

ROLL_BOLTS = BoltCircle(6, 0.013, 0.007)
"""Bolts in the face of the second motor's can."""

# Thigh: all lengths in metres.
AXLE_RADIUS = 0.013
"""Radius of the axle [m], which connects hip and cap, also if the thigh is stretched."""

CAP_NEAR, CAP_FAR = 0.0305, 0.040
"""Ends of the cap along the second motor's axis [m]."""

CAP_RADIUS = 0.0185
"""Radius of the cap on the second motor [m]."""

CAP_BOLTS = BoltCircle(6, 0.0135)
"""Bolts in the cap."""

KNEE_FINS = (0.0102, 0.015, 0.0198)
"""Positions of the grooves along the third motor's housing [m]."""

KNEE_BOLTS = BoltCircle(6, 0.018, 0.0115)
"""Bolts in the housing of the third motor."""

BAR_RADIUS = 0.005
"""Radius of the edges of the thigh's bar [m]."""

BAR_HALF_WIDTH = 0.011
"""Half width of the thigh's bar along y [m]."""

BAR_KNEE_CORNERS = ((-0.017, 0.0), (0.016, 0.008))
"""Corners of the thigh's bar at the knee [m]: backwards and upwards from the knee, angles at zero.
"""

POCKET_DEPTH = 0.0035
"""Depth of the pockets in both sides of the thigh's bar [m]."""

POCKET_RIM = 0.0045
"""Width of the bar's rim around a pocket [m]."""

POCKET_GAP = 0.003
"""Distance between a pocket and the knee housing [m]."""

POCKET_CORNER = 0.003
"""Corner radius of a pocket [m]."""

HOLE_RIM = 0.0025
"""Width of the pocket around the hole through the bar [m]."""

# Calf: all lengths in metres.
DISC_RADIUS = 0.0225
"""Radius of the disc on the knee [m]."""

DISC_BOLTS = BoltCircle(6, 0.0165, 0.0095)
"""Bolts in the disc on the knee."""

DISC_NEAR, DISC_FAR = 0.0135, 0.0255
"""Ends of the disc along y [m]; the knee housing ends at 0.015."""

SHANK_PATH = (
    (0.0000, 0.0190, 0.0000, 0.0046, 0.0155),
    (-0.0045, 0.0190, 0.0260, 0.0046, 0.0085),
    (-0.0045, 0.0186, 0.0440, 0.0046, 0.0050),
    (-0.0015, FOOT_OUTWARD, 0.0640, 0.0050, 0.0030),
    (0.0000, FOOT_OUTWARD, FOOT_DISTANCE - 0.0050, 0.0050, 0.0020),
)
"""Chain of the shank from the knee to the middle of the foot [m], curved backwards; rows as in
``rounded_bar``."""

SLOT = ((-0.0046, 0.0265), (-0.0046, 0.0420))
"""Ends (x, z) of the slot in the shank [m]."""

SLOT_RADIUS = 0.0034
"""Half width of the slot through the shank [m]."""

COLLAR_NEAR, COLLAR_FAR = FOOT_DISTANCE - 1.25 * FOOT_RADIUS, FOOT_DISTANCE - 0.7 * FOOT_RADIUS
"""Ends of the calf's collar along z [m], across the surface of the foot's ball."""

COLLAR_RADIUS = 0.0115
"""Radius of the calf's collar [m]."""


def place(mesh: Trimesh, axis: ArrayLike, at: ArrayLike = (0.0, 0.0, 0.0)) -> Trimesh:
    """Turn a mesh's z axis to `axis`, then move its origin to `at` [m]; returns the mesh."""
    return mesh.apply_transform(translation_matrix(at) @ align_vectors(Z, axis))


def rounded_hull(balls: ArrayLike, radius: ArrayLike) -> Trimesh:
    """Return the convex hull of balls, a shape with round edges.

    Args:
        balls: Centres of the balls, shape (n, 3) [m].
        radius: Radius of all balls, or of each [m].
    """
    sphere = icosphere(subdivisions=2 if np.max(radius) >= FINE_BALL_RADIUS else 1).vertices
    surface = np.asarray(balls)[:, None] + np.reshape(radius, (-1, 1, 1)) * sphere
    return trimesh.convex.convex_hull(surface.reshape(-1, 3))


def both_sides(points: ArrayLike) -> np.ndarray:
    """Return the points and their mirror images in the plane y = 0, shape (2 n, 3) [m]."""
    right = np.asarray(points)
    return np.vstack([right, right * [1, -1, 1]])


def rounded_bar(path: ArrayLike, across: np.ndarray) -> Trimesh:
    """Return a bar with round edges along a chain of points.

    Args:
        path: A row (x, y, z, radius, half width) per point of the bar's middle [m]: ``radius`` is
            that of the edges, and the half width excludes this radius.
        across: Unit vector of the width.
    """
    middle, radius, half_width = np.split(np.asarray(path, dtype=float), [3, 4], axis=1)
    edges = np.stack([middle - half_width * across, middle + half_width * across], axis=1)
    radii = np.repeat(radius, 2, axis=1)
    links = [slice(start, start + 2) for start in range(len(edges) - 1)]
    return union([rounded_hull(edges[link].reshape(-1, 3), radii[link]) for link in links])


def motor_can(radius: float, length: float, fins: Iterable[float] = ()) -> Trimesh:
    """Return a motor housing along z from 0 to ``length``, with chamfered rims and cooling grooves.

    Args:
        radius: Outer radius [m].
        length: Length along z [m].
        fins: Position of the middle of each groove along z, in rising order [m].
    """
    profile = [(0.0, 0.0), (radius - CHAMFER, 0.0), (radius, CHAMFER)]
    for middle in fins:
        profile += [
            (radius, middle - FIN_GROOVE_WIDTH / 2),
            (radius - FIN_GROOVE_DEPTH, middle),
            (radius, middle + FIN_GROOVE_WIDTH / 2),
        ]
    profile += [(radius, length - CHAMFER), (radius - CHAMFER, length), (0.0, length)]
    return revolve(profile, sections=SECTIONS)


def bolt_holes(bolts: BoltCircle, top: float) -> Trimesh:
    """Return the cutter for a bolt circle in a face towards z, at the height ``top`` [m]."""
    ends = np.array([[0, 0, top - BOLT_DEPTH], [0, 0, top + OVERSHOOT]])
    angles = 2 * np.pi * (np.arange(bolts.number) + 0.5) / bolts.number
    axes = bolts.circle * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    cutters = [cylinder(BOLT_RADIUS, segment=ends + at, sections=BOLT_SECTIONS) for at in axes]
    if bolts.recess:
        cutters.append(cylinder(bolts.recess, segment=ends, sections=RECESS_SECTIONS))
    return union(cutters)


def prism(outline: Polygon, low: float, high: float) -> Trimesh:
    """Extrude an outline drawn in (x, z) along y, from `low` to `high` [m]."""
    # Outline in x and y, thickness along z.
    solid = extrude_polygon(outline, high - low, engine="manifold")
    # (u, v, w) -> (u, high - w, v) turns the drawing upright without mirroring it.
    upright = np.array([[1, 0, 0, 0], [0, 0, -1, high], [0, 1, 0, 0], [0, 0, 0, 1]])
    return solid.apply_transform(upright)


def tidied(mesh: Trimesh) -> Trimesh:
    """Return the mesh without slivers of boolean operations; surfaces move at most TOLERANCE."""
    solid = Manifold(Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)))
    slim = solid.simplify(TOLERANCE).to_mesh()
    return Trimesh(slim.vert_properties, slim.tri_verts, process=False)


def build_shell() -> Trimesh:
    """Build the torso's shell, with seams and vents."""
    shell = rounded_hull(both_sides(SHELL_BALLS), SHELL_RADIUS)
    # What lies under a groove of some depth: the same shell with smaller balls.
    under_seams, under_vents = (
        rounded_hull(both_sides(SHELL_BALLS), SHELL_RADIUS - depth)
        for depth in (SEAM_DEPTH, VENT_DEPTH)
    )
    seams = union(
        [
            trimesh.creation.box((SEAM_WIDTH, 2 * FAR, 2 * FAR), translation_matrix([x, 0, 0]))
            for x in SEAM_XS
        ]
    )
    slots = [
        LineString([(x + lean * VENT_LEAN, VENT_Z + lean * VENT_REACH) for lean in (-1, 1)])
        for x in VENT_XS
    ]
    vents = union(
        [prism(slot.buffer(VENT_RADIUS, quad_segs=ARC_SEGMENTS), -FAR, FAR) for slot in slots]
    )
    return difference([shell, difference([seams, under_seams]), difference([vents, under_vents])])


def build_collars() -> Trimesh:
    """Build the collars that carry the hip cans: two bars across the torso."""
    collars = []
    for x, y, z in HIP_CENTRES_LEFT:
        flank = y - HIP_CAN_INWARD
        ends = [[x, -flank, z], [x, flank, z]]
        collars.append(cylinder(BOSS_RADIUS, segment=ends, sections=SECTIONS))
    return union(collars)


def build_head() -> Trimesh:
    """Build the head with a display face, two eyes, a snout with a camera, and ears."""
    head = rounded_hull(both_sides(HEAD_BALLS), HEAD_RADIUS)
    # The face's plane: y is its first direction, `up` its second and `out` its normal.
    up = HEAD_BALLS[3] * [1, 0, 1] - HEAD_BALLS[2] * [1, 0, 1]
    up /= np.linalg.norm(up)
    out = np.cross(Y, up)
    middle = (HEAD_BALLS[2] + HEAD_BALLS[3]) / 2 * [1, 0, 1] + HEAD_RADIUS * out
    face = np.eye(4)
    face[:3, :] = np.column_stack([Y, up, out, middle])

    def on_face(mesh: Trimesh, right: float, rise: float, lift: float) -> Trimesh:
        """Move a mesh from the origin to a point of the face [m]: along y, upwards and outwards."""
        return mesh.apply_transform(face @ translation_matrix([right, rise, lift]))

    window = box(-DISPLAY_WIDTH / 2, -DISPLAY_HEIGHT / 2, DISPLAY_WIDTH / 2, DISPLAY_HEIGHT / 2)
    window = window.buffer(-DISPLAY_CORNER).buffer(DISPLAY_CORNER, quad_segs=2 * ARC_SEGMENTS)
    display = on_face(
        extrude_polygon(window, FAR, engine="manifold"), 0, DISPLAY_RISE, -DISPLAY_DEPTH
    )
    head = difference([head, display])
    iris = Point(0, 0).buffer(EYE_RADIUS, quad_segs=5)
    pupil = Point(0, PUPIL_RISE).buffer(PUPIL_RADIUS, quad_segs=4)
    eye = extrude_polygon(iris.difference(pupil), EYE_HEIGHT + OVERSHOOT, engine="manifold")
    sunk = -DISPLAY_DEPTH - OVERSHOOT
    eyes = [on_face(eye.copy(), side * EYE_APART, DISPLAY_RISE, sunk) for side in (-1, 1)]
    nose = middle - SNOUT_DROP * up
    snout = rounded_hull(
        both_sides(
            [nose + reach * out + SNOUT_HALF_WIDTH * Y for reach in (-SNOUT_RADIUS, SNOUT_REACH)]
        ),
        SNOUT_RADIUS,
    )
    tip = SNOUT_REACH + SNOUT_RADIUS
    lens = extrude_polygon(Point(0, 0).buffer(LENS_RADIUS, quad_segs=4), FAR, engine="manifold")
    snout = difference([snout, on_face(lens, 0, -SNOUT_DROP, tip - LENS_DEPTH)])
    ears = [rounded_hull(EAR_BALLS * [1, side, 1], EAR_RADIUS) for side in (-1, 1)]
    return union([head, *eyes, snout, *ears])


def build_torso() -> Trimesh:
    """Build the torso: shell, head, battery cover, handle and tail, with collars for the hips.

    All but the collars is cut to the torso's collision box.
    """
    pad = rounded_hull(both_sides(PAD_BALLS), PAD_RADIUS)
    handle = rounded_bar(HANDLE_PATH, Y)
    tail = rounded_bar(TAIL_PATH, Y)
    bounds = trimesh.creation.box(2 * TORSO_BOX_HALF_SIZE, translation_matrix(TORSO_BOX_CENTRE))
    body = intersection([union([build_shell(), build_head(), pad, handle, tail]), bounds])
    return tidied(union([body, build_collars()]))


def build_hip() -> Trimesh:
    """Build a right hip: the first motor's can along y, and the second motor's along x."""
    length = HIP_CAN_INWARD + HIP_CAN_OUTWARD
    can = motor_can(HIP_CAN_RADIUS, length, HIP_FINS)
    badge = cylinder(
        HIP_BADGE_RADIUS,
        segment=[[0, 0, length / 2], [0, 0, length - HIP_BADGE_SUNK]],
        sections=RECESS_SECTIONS,
    )
    can = union([difference([can, bolt_holes(HIP_BOLTS, length)]), badge])
    place(can, -Y, at=HIP_CAN_INWARD * Y)
    roll = motor_can(ROLL_CAN_RADIUS, 2 * ROLL_CAN_HALF_LENGTH)
    roll = difference([roll, bolt_holes(ROLL_BOLTS, 2 * ROLL_CAN_HALF_LENGTH)])
    return tidied(union([can, place(roll, X, at=-ROLL_CAN_HALF_LENGTH * X)]))


def build_thigh() -> Trimesh:
    """Build a right thigh: axle and cap of the second motor, bar, housing of the third motor."""
    knee = THIGH_LENGTH * Z
    cap = motor_can(CAP_RADIUS, CAP_FAR - CAP_NEAR)
    cap = difference([cap, bolt_holes(CAP_BOLTS, CAP_FAR - CAP_NEAR)])
    place(cap, THIGH_BACK, at=CAP_NEAR * THIGH_BACK)
    axle_end = (CAP_NEAR + CAP_FAR) / 2 * THIGH_BACK
    axle = cylinder(AXLE_RADIUS, segment=[0 * Z, axle_end], sections=RECESS_SECTIONS)
    housing = motor_can(KNEE_HOUSING_RADIUS, 2 * KNEE_HOUSING_HALF_LENGTH, KNEE_FINS)
    housing = difference([housing, bolt_holes(KNEE_BOLTS, 2 * KNEE_HOUSING_HALF_LENGTH)])
    place(housing, -Y, at=knee + KNEE_HOUSING_HALF_LENGTH * Y)

    near, reach = CAP_NEAR + BAR_RADIUS, CAP_RADIUS - BAR_RADIUS
    corners = np.array(
        [
            near * THIGH_BACK + reach * THIGH_UP,
            near * THIGH_BACK - reach * THIGH_UP,
            *(knee + back * THIGH_BACK + up * THIGH_UP for back, up in BAR_KNEE_CORNERS),
        ]
    )
    sideways = (BAR_HALF_WIDTH - BAR_RADIUS) * Y
    bar = rounded_hull(both_sides(corners + sideways), BAR_RADIUS)
    outline = Polygon(corners[:, [0, 2]])
    around_knee = Point(0, THIGH_LENGTH).buffer(KNEE_HOUSING_RADIUS + POCKET_GAP, quad_segs=8)
    pocket = outline.buffer(BAR_RADIUS - POCKET_RIM).difference(around_knee)
    pocket = pocket.buffer(-POCKET_CORNER).buffer(POCKET_CORNER, quad_segs=ARC_SEGMENTS)
    hole = pocket.buffer(-HOLE_RIM)
    bar = difference(
        [
            bar,
            prism(pocket, BAR_HALF_WIDTH - POCKET_DEPTH, FAR),
            prism(pocket, -FAR, POCKET_DEPTH - BAR_HALF_WIDTH),
            prism(hole, -FAR, FAR),
        ]
    )
    return tidied(union([axle, cap, bar, housing]))


def build_calf() -> Trimesh:
    """Build a right calf: the knee's disc, a tapered shank, and a collar on the foot's ball."""
    disc = motor_can(DISC_RADIUS, DISC_FAR - DISC_NEAR)
    disc = difference([disc, bolt_holes(DISC_BOLTS, DISC_FAR - DISC_NEAR)])
    place(disc, Y, at=DISC_NEAR * Y)
    slot = LineString(SLOT).buffer(SLOT_RADIUS, quad_segs=ARC_SEGMENTS)
    shank = difference([rounded_bar(SHANK_PATH, X), prism(slot, 0.0, FAR)])
    collar = motor_can(COLLAR_RADIUS, COLLAR_FAR - COLLAR_NEAR)
    place(collar, Z, at=FOOT_OUTWARD * Y + COLLAR_NEAR * Z)
    return tidied(union([disc, shank, collar]))


PARTS: dict[str, Callable[[], Trimesh]] = {
    "torso": build_torso,
    "hip": build_hip,
    "thigh": build_thigh,
    "calf": build_calf,
}
"""{name of the STL file: function that builds the part}."""


@click.command()
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    default=DEFAULT_OUTPUT,
    show_default="mjcf/meshes of this repository",
    help="Folder to write torso.stl, hip.stl, thigh.stl and calf.stl into; made if missing.",
)
def main(output: Path) -> None:
    """Build the STL parts that draw Pupper v3.

    Four binary STL files in metres, each one closed solid: the torso in the base frame, and hip,
    thigh and calf of a right leg (a left leg mirrors them: scale="1 -1 1"). The models only draw
    them; mass and contact come from the numbers in the URDF and MJCF. The same library versions
    give the same bytes on every run, so build, look and commit:

        python scripts/build_meshes.py

    Look at a changed part before committing it, without touching the repository's:

        python scripts/build_meshes.py --output my_meshes

    To change the looks, edit the named constants at the top of this file, but not those that place
    joints, motors and feet (see the docstring of this module).
    """
    output.mkdir(parents=True, exist_ok=True)
    for name, build in PARTS.items():
        part = build()
        path = output / f"{name}.stl"
        part.export(path)
        size = path.stat().st_size
        click.echo(f"{path}: {len(part.faces)} triangles, {size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
