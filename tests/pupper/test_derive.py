"""Variants derived from the URDF and from the MJCF, compared with each other and with integration
over point masses.
"""

import itertools
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from pupper_analysis.models.mjcf import to_xml
from pupper_analysis.pupper import derive as urdf
from pupper_analysis.pupper.variant_files import describe_variant
from tests.support.bodies import BODIES, Body, assert_same_bodies, mujoco_bodies, pinocchio_bodies
from tests.support.engines import evaluate_mujoco
from tests.support.repository import ROOT
from tests.support.variants import BASES, load

leg_scales = st.floats(0.3, 3.0)
torso_scales = st.floats(0.2, 5.0)
bases = st.sampled_from(["skeleton", "v3"])


def bodies_of(source: str, *spec: object) -> dict[str, Body]:
    return BODIES[source](pa.load_variant(pa.pupper.VariantSpec(*spec)))  # type: ignore[arg-type]


def second_moments(inertia: np.ndarray) -> np.ndarray:
    """Return the integral of x x^T dm, shape (3, 3) [kg m^2], from the inertia tensor."""
    return np.trace(inertia) / 2 * np.eye(3) - inertia


# ------------------------------------------------------------------------------------- two routes


@pytest.mark.slow
@settings(max_examples=30)
@given(base=bases, leg_scale=leg_scales, torso_mass_scale=torso_scales)
def test_urdf_and_mjcf_agree_at_any_scale(
    base: str, leg_scale: float, torso_mass_scale: float
) -> None:
    """Masses, CoMs and inertias of all bodies in both engines within 1e-9, and foot positions
    [m].
    """
    robot = pa.load_variant(pa.pupper.VariantSpec(base, leg_scale, torso_mass_scale))
    assert_same_bodies(pinocchio_bodies(robot), mujoco_bodies(robot), 1e-9)
    config, mj = pa.Configuration(robot, robot.neutral()), evaluate_mujoco(robot, robot.neutral())
    for foot, frame in robot.contact_frames.items():
        np.testing.assert_allclose(config.foot_positions()[foot], mj.site(frame).xpos, atol=1e-12)


# ------------------------------------------------------------------------------------- stretching


def point_masses(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and masses of eight points with the mass, CoM and inertia of a body: the
    Gauss points of a solid box.
    """
    moments, axes = np.linalg.eigh(second_moments(body.inertia))
    corners = np.array(list(itertools.product((-1, 1), repeat=3)))
    points = body.com + corners * np.sqrt(moments / body.mass) @ axes.T
    return points, np.full(8, body.mass / 8)


def lump(points: np.ndarray, masses: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, CoM and inertia of point masses, by summation."""
    mass = float(masses.sum())
    com = masses @ points / mass
    inertia = sum(
        m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        for m, arm in zip(masses, points - com, strict=True)
    )
    return mass, com, np.asarray(inertia)


@pytest.mark.slow
@pytest.mark.parametrize("source", BODIES)
@settings(max_examples=15)
@given(first=leg_scales, second=leg_scales)
def test_v3_links_are_stretched_matter(source: str, first: float, second: float) -> None:
    """Reference: each point mass of v3 at one scale, stretched, gives v3 at another scale."""
    start, end = (bodies_of(source, "v3", scale) for scale in (first, second))
    ratio = second / first
    for leg in ("leg_front_r", "leg_front_l", "leg_back_r", "leg_back_l"):
        hip, knee = (start[leg + number].position for number in ("_2", "_3"))
        robot = load("v3")
        foot = pa.Configuration(robot, robot.neutral()).frame_position(f"{leg}_3_foot_site")
        thigh = knee - hip
        assert thigh[1] == pytest.approx(0, abs=1e-12)
        calf = foot - pinocchio_bodies(robot)[f"{leg}_3"].position
        calf[1] = 0.0  # in the plane of the leg
        for number, along in (("_2", thigh), ("_3", calf)):
            body, stretched = start[leg + number], end[leg + number]
            axis = along / np.linalg.norm(along)
            points, masses = point_masses(body)
            lengths = (points - body.position) @ axis
            points = points - body.position + (ratio - 1) * np.outer(lengths, axis)
            mass, com, inertia = lump(points, ratio * masses)
            assert stretched.mass == pytest.approx(mass, rel=1e-12)
            np.testing.assert_allclose(stretched.com - stretched.position, com, atol=1e-12)
            size = np.abs(inertia).max()
            np.testing.assert_allclose(stretched.inertia, inertia, rtol=0, atol=1e-10 * size)
        np.testing.assert_allclose(end[f"{leg}_3"].position - hip, ratio * thigh, atol=1e-12)


# ------------------------------------------------------------------------------------- capsules


def integrated_capsule(mass: float, radius: float, length: float) -> tuple[float, float]:
    """Return axial and lateral moment of a solid capsule about its centre, summed over discs."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    total = axial = lateral = 0.0
    half = length / 2
    for low, high in ((-half - radius, -half), (-half, half), (half, half + radius)):
        x = (low + high) / 2 + nodes * (high - low) / 2
        beyond = np.maximum(np.abs(x) - half, 0.0)
        square = radius**2 - beyond**2  # of the disc's radius
        disc = np.pi * square * weights * (high - low) / 2
        total += disc.sum()
        axial += disc @ (square / 2)
        lateral += disc @ (square / 4 + x**2)
    return mass / total * axial, mass / total * lateral


@pytest.mark.slow
@given(mass=st.floats(0.01, 5), radius=st.floats(0.001, 0.2), length=st.floats(0, 1))
def test_capsule_inertia_equals_the_integral_over_discs(
    mass: float, radius: float, length: float
) -> None:
    """Reference: axial and lateral moments [kg m^2], summed over discs."""
    tensor = urdf.compute_capsule_inertia(mass, radius, length, np.array([1.0, 0, 0]))
    axial, lateral = integrated_capsule(mass, radius, length)
    np.testing.assert_allclose(tensor, np.diag([axial, lateral, lateral]), rtol=1e-11, atol=1e-18)


@pytest.mark.slow
@pytest.mark.parametrize("source", BODIES)
@settings(max_examples=15)
@given(scale=leg_scales)
def test_scaled_skeleton_links_have_the_inertia_of_solid_capsules(
    source: str, scale: float
) -> None:
    """Reference: integrals over discs, of capsules that are longer but not wider. Their ends stay
    hemispheres; the sphere of the foot is at the lower end.
    """
    bodies = bodies_of(source, "skeleton", scale)
    thigh_axial, thigh_lateral = integrated_capsule(0.186 * scale, 0.013, 0.08 * scale)
    calf_axial, calf_lateral = integrated_capsule(0.05 * scale, 0.011, 0.11 * scale)
    sphere = 0.4 * 0.02 * 0.018**2
    calf_mass = 0.05 * scale + 0.02
    com = -(0.05 * scale * 0.055 * scale + 0.02 * 0.11 * scale) / calf_mass
    gap = 0.055 * scale  # between the capsule's centre and the foot
    lateral = calf_lateral + sphere + 0.05 * scale * 0.02 / calf_mass * gap**2
    for leg in ("FL", "FR", "RL", "RR"):
        thigh, calf = bodies[f"{leg}_HFE"], bodies[f"{leg}_KFE"]
        np.testing.assert_allclose(
            thigh.inertia,
            np.diag([thigh_lateral, thigh_lateral, thigh_axial]),
            rtol=1e-10,
            atol=1e-18,
        )
        np.testing.assert_allclose(thigh.com - thigh.position, [0, 0, -0.04 * scale], atol=1e-12)
        np.testing.assert_allclose(
            calf.inertia, np.diag([lateral, lateral, calf_axial + sphere]), rtol=1e-10, atol=1e-18
        )
        np.testing.assert_allclose(calf.com - calf.position, [0, 0, com], atol=1e-12)
        assert calf.mass == pytest.approx(calf_mass, rel=1e-12)


# ------------------------------------------------------------------------------------- shapes


def mujoco_extent(robot: pa.Robot, qpos: np.ndarray) -> dict[str, np.ndarray]:
    """Return the bounds of the meshes of each body, shape (2, 3) [m] in the world frame."""
    model, data = robot.mj_model, evaluate_mujoco(robot, qpos)
    extents = {}
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH.value):
        mesh = int(model.geom_dataid[geom])
        start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        vertices = model.mesh_vert[start : start + count]
        points = data.geom_xpos[geom] + vertices @ data.geom_xmat[geom].reshape(3, 3).T
        name = model.body(int(model.geom_bodyid[geom])).name
        extents[name] = np.array([points.min(axis=0), points.max(axis=0)])
    return extents


@pytest.mark.parametrize("name", ["v3", "v3-long-leg"])
def test_meshes_have_the_same_position_in_both_files(name: str, tmp_path: Path) -> None:
    """Bounds [m] of the drawn meshes per body: MuJoCo's model, and vertices of the URDF's files
    placed by Pinocchio.
    """
    robot = load(name)
    path, _ = pa.pupper.write_variant(name, tmp_path)
    config = pa.Configuration(robot, robot.neutral())
    theirs = mujoco_extent(robot, robot.neutral())
    assert len(theirs) == 13
    for link in ElementTree.parse(path).getroot().iter("link"):
        for visual in link.iter("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            body = link.attrib["name"]
            part = trimesh.load_mesh((path.parent / mesh.attrib["filename"]).resolve())
            scale = np.array(mesh.attrib.get("scale", "1 1 1").split(), dtype=float)
            origin = visual.find("origin")
            assert origin is not None
            place = np.array(origin.attrib["xyz"].split(), dtype=float)
            turn = Rotation.from_euler("xyz", np.array(origin.get("rpy", "0 0 0").split(), float))
            points = turn.apply(part.vertices * scale) + place
            world = config.frame_position(body) + points @ config.frame_rotation(body).T
            extent = np.array([world.min(axis=0), world.max(axis=0)])
            np.testing.assert_allclose(theirs[body], extent, atol=2e-6, err_msg=body)


@pytest.mark.parametrize("base", ["skeleton", "v3"])
def test_heavier_torso_is_marked_by_a_block_without_mass_in_both_files(
    base: str, tmp_path: Path
) -> None:
    """The block has equal place and size in both files and no mass; lighter torsos have no
    block."""
    variant = pa.pupper.VariantSpec(base, 1.0, 1.5, "marked")
    urdf_file, mjcf_file = pa.pupper.write_variant(variant, tmp_path)[:2]
    box = next(
        visual
        for visual in ElementTree.parse(urdf_file).getroot().iter("visual")
        if visual.get("name") == "ballast"
    )
    model = mujoco.MjModel.from_xml_path(str(mjcf_file))
    geom = model.geom("ballast")
    origin, shape = box.find("origin"), box.find("geometry/box")
    assert origin is not None
    assert shape is not None
    place = np.array([float(number) for number in origin.attrib["xyz"].split()])
    size = np.array([float(number) for number in shape.attrib["size"].split()])
    np.testing.assert_allclose(geom.pos, place, atol=1e-12)
    np.testing.assert_allclose(2 * geom.size, size, atol=1e-12)
    assert geom.contype == geom.conaffinity == 0
    original = mujoco.MjModel.from_xml_path(
        str(pa.pupper.write_variant(base_name(base), tmp_path)[1])
    )
    assert "ballast" not in [original.geom(i).name for i in range(original.ngeom)]
    torso = original.body("base_link").mass[0]
    assert model.body("base_link").mass[0] == pytest.approx(1.5 * torso, rel=1e-12)


def base_name(base: str) -> str:
    """Return the name of the variant that equals a base model."""
    return {"skeleton": "original", "v3": "v3"}[base]


@pytest.mark.parametrize("source", BODIES)
def test_scales_do_not_change_hips_and_scale_the_inertia_of_the_torso(source: str) -> None:
    """Legs scaled by 1.7 and torso mass by 2.5: hips are unchanged, the torso's inertia scales."""
    for base in ("skeleton", "v3"):
        start, end = bodies_of(source, base), bodies_of(source, base, 1.7, 2.5)
        hips = [name for name in start if name.endswith(("_1", "_HAA"))]
        assert hips or base == "skeleton"
        for name in hips:
            np.testing.assert_allclose(end[name].inertia, start[name].inertia, rtol=1e-12)
            assert end[name].mass == start[name].mass
            np.testing.assert_allclose(end[name].position, start[name].position, atol=1e-15)
        np.testing.assert_allclose(end["base"].inertia, 2.5 * start["base"].inertia, atol=1e-15)
        np.testing.assert_allclose(end["base"].com, start["base"].com, atol=1e-15)
        assert end["base"].mass == pytest.approx(2.5 * 1.506, rel=1e-12)


@pytest.mark.parametrize("base", ["original", "v3"])
@pytest.mark.parametrize("scale", [0.5, 2.5])
def test_scaled_home_has_the_foot_height_of_the_base_model(base: str, scale: float) -> None:
    """Reference: lowest foot of the unscaled robot in its home configuration [m]."""
    spec = pa.pupper.VariantSpec("v3" if base == "v3" else "skeleton", scale)
    heights = []
    for robot in (load(base), pa.load_variant(spec)):
        feet = pa.Configuration(robot, robot.home).foot_positions().values()
        heights.append(min(foot[2] for foot in feet))
    assert heights[1] == pytest.approx(heights[0], abs=1e-12)


def test_urdf_and_mjcf_of_the_variants_have_the_same_bodies(robot: pa.Robot) -> None:
    """Masses, CoMs and inertias of Pinocchio's model and of MuJoCo's model."""
    assert_same_bodies(pinocchio_bodies(robot), mujoco_bodies(robot), 1e-12)


@pytest.mark.parametrize("source", BODIES)
@pytest.mark.parametrize(
    ("base", "legs", "torso"), [("skeleton", 0.3, 5.0), ("v3", 0.3, 0.2), ("v3", 3.0, 5.0)]
)
def test_scaled_bodies_have_positive_second_moments(
    source: str, base: str, legs: float, torso: float
) -> None:
    """The triangle inequality of the principal moments holds."""
    for name, body in bodies_of(source, base, legs, torso).items():
        assert body.mass > 0
        assert np.linalg.eigvalsh(second_moments(body.inertia)).min() > 0, name


@given(mass=st.floats(0.01, 5), size=st.floats(0.001, 0.2))
def test_capsule_inertia_becomes_that_of_a_sphere_or_a_rod(mass: float, size: float) -> None:
    """Closed forms: 2/5 m r^2 without a cylinder, and m l^2 / 12 across a thin rod."""
    axis = np.array([0.0, 0.6, 0.8])
    sphere = 0.4 * mass * size**2 * np.eye(3)
    found = urdf.compute_capsule_inertia(mass, size, 0.0, axis)
    np.testing.assert_allclose(found, sphere, rtol=1e-12, atol=1e-15)
    rod = mass * size**2 / 12 * (np.eye(3) - np.outer(axis, axis))
    thin = urdf.compute_capsule_inertia(mass, 1e-9 * size, size, axis)
    np.testing.assert_allclose(thin, rod, atol=1e-8 * mass * size**2)


@pytest.mark.parametrize(("radius", "length"), [(0.005, 0.3), (0.05, 0.01), (0.011, 0.11)])
def test_capsule_inertia_equals_that_of_mujoco(radius: float, length: float) -> None:
    """Reference: principal moments of MuJoCo's compiled capsule."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><freejoint/>
        <geom type="capsule" size="{radius!r}" fromto="0 0 0 0 0 {length!r}" mass="0.3"/>
        </body></worldbody></mujoco>"""
    )
    ours = urdf.compute_capsule_inertia(0.3, radius, length, np.array([0, 0, 1.0]))
    np.testing.assert_allclose(sorted(np.diag(ours)), sorted(model.body_inertia[1]), rtol=1e-10)


def test_meshes_are_stretched_with_their_links() -> None:
    """v3-long-leg: thigh and calf are longer along the leg, as thick as in v3, and the foot is
    1.5 times as far below the hip."""
    short, long = (
        mujoco_extent(load(name), load(name).neutral()) for name in ("v3", "v3-long-leg")
    )
    for body in ("base_link", "leg_front_r_1"):
        np.testing.assert_allclose(long[body], short[body], atol=1e-7)
    for body in ("leg_front_r_2", "leg_front_r_3"):
        assert np.ptp(long[body][:, 2]) > 1.2 * np.ptp(short[body][:, 2])
        np.testing.assert_allclose(long[body][:, 1], short[body][:, 1], atol=1e-7)
    reach = [-extent["leg_front_r_3"][0, 2] for extent in (short, long)]
    assert reach[1] / reach[0] == pytest.approx(1.5, abs=0.05)


@pytest.mark.parametrize("scale", [0.5, 1.5, 2.0])
def test_shapes_of_the_skeleton_are_stretched_in_both_files(scale: float) -> None:
    """By hand: capsules of the MJCF and cylinders of the URDF with the scaled length."""
    description = describe_variant(pa.pupper.VariantSpec("skeleton", scale))
    model = description.mjcf.copy().compile()
    links = {
        link.attrib["name"]: link for link in ElementTree.fromstring(description.urdf).iter("link")
    }
    for part, length, radius in (("thigh", 0.08, 0.013), ("calf", 0.11, 0.011)):
        for leg in ("FL", "FR", "RL", "RR"):
            geom = int(model.body(f"{leg}_{part}").geomadr[0])
            half = scale * length / 2
            np.testing.assert_allclose(model.geom_size[geom, :2], [radius, half])
            np.testing.assert_allclose(model.geom_pos[geom], [0, 0, -half], atol=1e-15)
            for kind in ("visual", "collision"):
                cylinder = links[f"{leg}_{part}"].find(f"{kind}/geometry/cylinder")
                assert cylinder is not None
                assert float(cylinder.attrib["length"]) == pytest.approx(scale * length)
                assert float(cylinder.attrib["radius"]) == radius


def test_written_variant_of_any_scale_has_all_digits(tmp_path: Path) -> None:
    spec = pa.pupper.VariantSpec("v3", 1 / 3, np.pi, name="odd")
    paths = pa.pupper.write_variant(spec, tmp_path)
    feet = list(load("v3").contact_frames.values())
    again, ours = pa.load_robot(urdf=paths[0], mjcf=paths[1], feet=feet), pa.load_variant(spec)
    assert again.name == "odd"
    assert_same_bodies(mujoco_bodies(ours), mujoco_bodies(again), 1e-12)
    assert_same_bodies(pinocchio_bodies(again), mujoco_bodies(again), 1e-12)


def test_writing_a_variant_does_not_change_the_base_files(tmp_path: Path) -> None:
    files = [
        path for kind in ("urdf", "mjcf") for path in (ROOT / kind).rglob("*") if path.is_file()
    ]
    before = {path: path.stat().st_mtime_ns for path in files}
    for _ in range(2):  # the second time over its own files
        pa.pupper.write_variant("v3-long-leg", tmp_path)
    assert {path: path.stat().st_mtime_ns for path in files} == before


def test_second_derivation_of_a_base_starts_from_the_unchanged_base() -> None:
    """URDF and MJCF are derived separately: the text of the URDF is immutable."""
    for scale in (1.31, 1.32):
        robot = pa.load_variant(pa.pupper.VariantSpec("v3", scale, scale))
    assert_same_bodies(pinocchio_bodies(robot), mujoco_bodies(robot), 1e-12)


def test_change_of_a_description_does_not_change_the_next_description() -> None:
    first = describe_variant("v3-heavy")
    text, urdf_text = to_xml(first.mjcf), first.urdf
    first.mjcf.bodies[1].mass = 99.0
    assert to_xml(first.mjcf) != text
    second = describe_variant("v3-heavy")
    assert (to_xml(second.mjcf), second.urdf) == (text, urdf_text)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3-heavy"])
def test_written_files_are_read_from_another_folder(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By MuJoCo and yourdfpy, with relative paths; the meshes are beside the models."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    paths = pa.pupper.write_variant(name, "out/models")
    assert paths == (Path(f"out/models/urdf/{name}.urdf"), Path(f"out/models/mjcf/{name}.xml"))
    monkeypatch.chdir(tmp_path)
    urdf_path, mjcf_path = (str(Path("elsewhere") / path) for path in paths)
    mass = load(name).total_mass
    assert mujoco.MjModel.from_xml_path(mjcf_path).body_mass.sum() == pytest.approx(mass)
    scene = yourdfpy.URDF.load(urdf_path)
    masses = [link.inertial.mass for link in scene.robot.links if link.inertial is not None]
    assert sum(masses) == pytest.approx(mass, rel=1e-12)
    shapes = sum(len(link.visuals) for link in scene.robot.links)
    assert len(scene.scene.geometry) == shapes
    written = {path.name for path in (tmp_path / "elsewhere/out/models").rglob("*.stl")}
    expected = {"torso.stl", "hip.stl", "thigh.stl", "calf.stl"} if "v3" in name else set()
    assert written == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3"])
def test_published_files_have_the_bodies_of_the_base_model(name: str) -> None:
    ours = load(name)
    files = ROOT / f"urdf/{BASES[name]}.urdf", ROOT / f"mjcf/{BASES[name]}.xml"
    feet = list(ours.contact_frames.values())
    robot = pa.load_robot(urdf=files[0], mjcf=files[1], feet=feet)
    assert robot.name == BASES[name]
    assert robot.joint_names == ours.joint_names
    assert (robot.base, robot.imu) == ("base_link", "body_imu_site")
    assert_same_bodies(pinocchio_bodies(robot), pinocchio_bodies(ours), 1e-15)
    assert_same_bodies(mujoco_bodies(robot), mujoco_bodies(ours), 1e-15)
