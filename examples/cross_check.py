"""Compare a URDF with an MJCF, and find the value that differs.

The output shows that the two files of Pupper's skeleton agree. Then the torso is 10 % heavier in
the URDF: the difference is found with file, line and both values, and explains all deviations.
"""

import tempfile
from pathlib import Path

import pupper_analysis as pa


def main() -> None:
    """Compare a URDF with its MJCF, before and after a slip is put into it."""
    with tempfile.TemporaryDirectory() as folder:
        urdf, mjcf = pa.pupper.write_variant("original", folder)
        print("as written: agree =", pa.compare_models(urdf, mjcf).agree)

        heavier = Path(folder) / "heavier.urdf"
        text = urdf.read_text()
        slip = '<mass value="1.506"/>'
        assert text.count(slip) == 1
        heavier.write_text(text.replace(slip, '<mass value="1.6566"/>'))
        found = pa.compare_models(heavier, mjcf)
        print("with a slip: agree =", found.agree)
        for difference in found.differences:
            print(difference.message)
            print(" ", difference.urdf_place, difference.mjcf_place)
        print(f"explained: {found.explained:.0%}")


if __name__ == "__main__":
    main()
