"""USD files that are unreadable or unsafe are refused in one line with their name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

from pxr import Usd

from pupper_analysis.base.errors import MissingPackageError, ModelError
from pupper_analysis.models.loading import read_model
from pupper_analysis.tools.usd import prim_limits
from pupper_analysis.tools.usd.file import MAX_DEPTH, read_usd
from tests.tools.usd import written as usd

HEAD = "#usda 1.0\n"
BODY = 'def Xform "b" ( prepend apiSchemas = ["PhysicsRigidBodyAPI"] )\n{\n}\n'


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("broken.usda", b'#usda 1.0\ndef Xform "a"\n{\n junk\n', "usd-not-valid"),
        ("old.usdc", b"PXR-USDC" + b"\x07" * 90, "usd-not-valid"),
        ("cut.usdz", b"PK\x03\x04" + b"\x07" * 90, "usd-not-valid"),
        ("none.usd", b"", "file-is-empty"),
        ("xml.usd", b"<robot/>", "usd-not-valid"),
        ("lfs.usd", b"version https://git-lfs.github.com/spec/v1\noid", "model-is-lfs-pointer"),
        ("world.usda", b'#usda 1.0\ndef Xform "a"\n{\n}\n', "usd-without-bodies"),
    ],
)
def test_invalid_usd_is_refused_in_one_line_without_output(
    name: str, content: bytes, code: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(ModelError, match=name) as refused:
        read_usd(file)
    assert refused.value.diagnostic.values["problem"].code == code
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")  # USD's own warnings are not written


def test_missing_file_and_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.usda", tmp_path):
        with pytest.raises(ModelError):
            read_usd(path)


def test_nesting_that_crashes_usd_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "deep.usda"
    depth = MAX_DEPTH + 1
    file.write_text(HEAD + 'def "a"\n{\n' * depth + "}\n" * depth)
    with pytest.raises(ModelError, match="nested"):
        read_usd(file)
    file.write_text(HEAD + BODY + f'def "c" ( doc = "{"{" * depth}" )\n{{\n}}\n')
    assert read_usd(file).bodies == {"b": "/b"}


def nest_references(levels: int, *, instanceable: bool = False) -> str:
    """Return a layer in which each class refers twice to the class before: 2^levels prims."""
    flag = "instanceable = true" if instanceable else ""
    text = HEAD + BODY + 'class "n0"\n{\n}\n'
    for level in range(levels):
        child = f"( references = </n{level}>\n {flag} )\n{{\n}}\n"
        text += f'class "n{level + 1}"\n{{\ndef "a" {child}def "b" {child}}}\n'
    return text + f'def "c" ( references = </n{levels}> )\n{{\n}}\n'


@pytest.mark.parametrize("instanceable", [False, True])
def test_nested_references_are_refused_before_usd_composes_the_prims(
    tmp_path: Path, instanceable: bool
) -> None:
    """2^30 prims in 3 kB; USD needs 34 s for 2^15 of them."""
    file = tmp_path / "nested.usda"
    file.write_text(nest_references(30, instanceable=instanceable))
    with pytest.raises(ModelError, match="more than 100000 prims"):
        read_usd(file)


def test_nested_external_layers_are_refused_before_usd_composes_the_prims(tmp_path: Path) -> None:
    """Ten layers, each with ten references to the next layer: 10^10 prims."""
    for level in range(10):
        reference = f"( references = @./{level + 1}.usda@ )"
        prims = "".join(f'def "p{number}" {reference}\n{{\n}}\n' for number in range(10))
        text = f'#usda 1.0\n( defaultPrim = "r" )\ndef "r"\n{{\n{prims}}}\n'
        (tmp_path / f"{level}.usda").write_text(text)
    (tmp_path / "10.usda").write_text('#usda 1.0\n( defaultPrim = "b" )\n' + BODY)
    with pytest.raises(ModelError, match="more than 100000 prims"):
        read_usd(tmp_path / "0.usda")


def test_prims_of_references_payloads_variants_and_sublayers_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference is the number of prims of USD's own stage, with its pseudo-root."""
    inner = 'def "r"\n{\ndef "x"\n{\n}\ndef "y"\n{\n}\n}\n'
    (tmp_path / "inner.usda").write_text('#usda 1.0\n( defaultPrim = "r" )\n' + inner)
    (tmp_path / "below.usda").write_text('#usda 1.0\ndef "below"\n{\n}\n')
    file = tmp_path / "outer.usda"
    variants = 'variants = { string s = "v" }\n prepend variantSets = "s"'
    file.write_text(
        "#usda 1.0\n( subLayers = [@./below.usda@] )\n"
        + BODY
        + 'def "one" ( references = @./inner.usda@ )\n{\n}\n'
        + 'def "two" ( payload = @./inner.usda@</r> )\n{\n}\n'
        + 'def "three" ( inherits = </one> )\n{\n}\n'
        + f'def "four" ( {variants} )\n{{\n'
        + 'variantSet "s" = {\n"v" {\ndef "z"\n{\n}\n}\n}\n}\n'
    )
    stage = read_usd(file).stage
    prims = sum(1 for _ in Usd.PrimRange.AllPrims(stage.GetPseudoRoot()))
    assert prims == 14
    monkeypatch.setattr(prim_limits, "MAX_PRIMS", prims - 1)
    with pytest.raises(ModelError, match="prims"):
        read_usd(file)


def test_a_reference_to_a_prim_above_ends(tmp_path: Path) -> None:
    """USD ignores such a reference with a warning."""
    file = tmp_path / "endless.usda"
    file.write_text(HEAD + BODY + 'def "a"\n{\ndef "c" ( references = </a> )\n{\n}\n}\n')
    assert read_usd(file).bodies == {"b": "/b"}


def test_missing_usd_references_are_reported_and_not_fetched(tmp_path: Path) -> None:
    file = tmp_path / "a.usda"
    away = 'def "w" ( references = @https://example.com/x.usd@ )\n{\n}\n'
    file.write_text(HEAD + BODY + 'def "v" ( payload = @./none.usda@ )\n{\n}\n' + away)
    (note,) = read_usd(file).notes
    assert note.code == "usd-files-missing"
    assert {Path(name).name for name in note.values["files"]} == {"x.usd", "none.usda"}


def test_references_payloads_variants_and_instances_are_read(tmp_path: Path) -> None:
    usd.write(tmp_path, name="robot.usda")
    text = (
        HEAD
        + """( metersPerUnit = 0.01
  kilogramsPerUnit = 0.001
  upAxis = "Y" )
def Xform "w"
{
    def Xform "one" (
        instanceable = true
        payload = @./robot.usda@
        variants = { string size = "big" }
        prepend variantSets = "size"
    )
    {
        variantSet "size" = {
            "big" {
                over "base"
                {
                    float physics:mass = 3000
                }
            }
        }
    }
}
"""
    )
    file = tmp_path / "scene.usda"
    file.write_text(text)
    found = read_usd(file)
    assert found.bodies["thigh"] == "/w/one/base/thigh"
    assert found.joints["hip"] == "/w/one/joints/hip"
    assert str(found.place("joint", "hip")) == "scene.usda:</w/one/joints/hip>"


def test_equal_prim_names_are_distinguished_by_path(tmp_path: Path) -> None:
    file = tmp_path / "two.usda"
    two = "".join(f'def Xform "{name}"\n{{\n{BODY}}}\n' for name in ("left", "right"))
    file.write_text(HEAD + two)
    assert read_usd(file).bodies == {"left/b": "/left/b", "right/b": "/right/b"}


def test_usd_is_refused_by_commands_that_need_xml(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="format USD"):
        read_model(usd.write(tmp_path))


def test_missing_library_is_named_by_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(MissingPackageError, match=r"pupper-analysis\[usd\]"):
        read_usd(usd.write(tmp_path))


def test_changed_file_is_read_again(tmp_path: Path) -> None:
    """USD keeps open layers in memory."""
    first = read_usd(usd.write(tmp_path))
    second = read_usd(usd.write(tmp_path, ('def Xform "rod"', 'def Xform "stick"')))
    assert "stick" in second.bodies
    assert "rod" in first.bodies
