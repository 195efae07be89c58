"""The files of a variant: derived in memory, and written."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.arguments import check_type
from pupper_analysis.errors import ModelError, VariantError
from pupper_analysis.files import whole_file
from pupper_analysis.models import mjcf
from pupper_analysis.models.description import Description
from pupper_analysis.models.places import one_line
from pupper_analysis.pupper import derive_mjcf
from pupper_analysis.pupper.variants import BASES, VariantSpec, model_folder, variant_spec


def describe(variant: str | VariantSpec) -> Description:
    """Derives a variant's URDF from the base URDF and its MJCF from the base MJCF, in memory.

    The two derivations share no code but the numbers of the spec.

    Raises:
        VariantError: If the name is unknown.
        ModelError: If a base file is missing or damaged.
    """
    spec = variant_spec(variant)
    base = BASES[spec.base]
    urdf_source = model_folder("urdf") / base.urdf
    mjcf_source = model_folder("mjcf") / base.mjcf
    urdf_text = urdf_source.read_text()
    scaled = spec.leg_scale != 1.0 or spec.torso_mass_scale != 1.0
    if scaled:
        from pupper_analysis.pupper import derive_urdf  # yourdfpy is slow to import

    mjcf_spec = mjcf.load(mjcf_source)
    if scaled:
        try:
            urdf_text = derive_urdf.derive(urdf_text, spec, source=urdf_source)
            derive_mjcf.derive(mjcf_spec, spec)
            mjcf.compile_spec(mjcf_spec.copy(), mjcf_source)
        except (ArithmeticError, ValueError, ModelError) as error:
            scales = f"{spec.leg_scale:g} and {spec.torso_mass_scale:g}"
            raise VariantError(
                "leg_scale, torso_mass_scale",
                scales,
                f"no robot can be made so ({one_line(error)}); try scales nearer to 1",
            ) from error
    return Description(
        name=spec.name,
        urdf=urdf_text,
        urdf_source=urdf_source,
        mjcf=mjcf_spec,
        mjcf_source=mjcf_source,
        feet={foot: (frame, frame) for foot, frame in base.feet.items()},
    )


def write_variant(variant: str | VariantSpec, folder: str | Path) -> tuple[Path, Path]:
    """Writes a variant's files, with the meshes they use, so that any viewer can open them.

    Args:
        variant: A name or a spec.
        folder: Gets ``urdf/NAME.urdf``, ``mjcf/NAME.xml`` and ``mjcf/meshes/``.

    Returns:
        The paths of the URDF and of the MJCF.

    Raises:
        VariantError: If the name is unknown.
        OutputError: If a file cannot be written.
    """
    description = describe(variant)
    check_type("folder", folder, str | Path)
    folder = Path(folder)
    urdf_path = folder / "urdf" / f"{description.name}.urdf"
    mjcf_path = folder / "mjcf" / f"{description.name}.xml"
    mjcf_text = mjcf.to_xml(description.mjcf)
    meshes = {mesh.file for mesh in description.mjcf.meshes}
    meshdir = description.mjcf.compiler.meshdir
    for mesh in sorted(meshes):
        content = (description.mjcf_source.parent / meshdir / mesh).read_bytes()
        with whole_file(mjcf_path.parent / meshdir / mesh) as file:
            file.write(content)
    for path, text in ((urdf_path, description.urdf), (mjcf_path, mjcf_text)):
        with whole_file(path) as file:
            file.write(text.encode())
    return urdf_path, mjcf_path
