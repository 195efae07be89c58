"""The package as a whole: public names, and the modules that an import loads."""

import os
import subprocess
import sys
from pathlib import Path
from types import MappingProxyType, ModuleType

import pytest

import pupper_analysis as pa
from pupper_analysis.base.exports import make_lazy_exports
from tests.support.names import public, public_modules
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT


def test_each_public_name_equals_the_name_of_its_object() -> None:
    """Exchanged names, or a name of an object of another package, are found."""
    others = {}
    for module in (pa, *public_modules()):
        for name, value in public(module).items():
            assert name in dir(module)
            if callable(value):
                assert value.__name__ == name
                assert value.__module__.startswith(pa.__name__)
                assert value.__doc__, name
                # Whoever imports such a module would put it in the name's place.
                assert not (Path(str(module.__file__)).parent / f"{name}.py").exists(), name
            else:
                others[name] = type(value)
    assert others == {"VARIANTS": MappingProxyType}


def run_python(code: str, folder: Path) -> str:
    """Run Python code in a new process in another folder, with warnings as errors; return the
    printed text.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MUJOCO_GL": ""}
    result = subprocess.run(
        [sys.executable, "-W", "error", "-W", "ignore::DeprecationWarning", "-c", code],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        check=False,
        timeout=PATIENCE,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


LOADED = "import sys; print([m for m in {names} if m in sys.modules])"
HEAVY = (
    *("pxr", "matplotlib", "yourdfpy", "trimesh", "placo", "clarabel", "scipy", "shapely"),
    *("click", "rich", "jinja2"),
)


def test_import_loads_no_engine_and_no_heavy_package(tmp_path: Path) -> None:
    code = "import pupper_analysis; " + LOADED.format(names=(*HEAVY, "mujoco", "pinocchio"))
    assert run_python(code, tmp_path) == "[]"


def test_import_does_not_change_the_import_system(tmp_path: Path) -> None:
    code = (
        "import sys; kept = sys.meta_path[:], sys.path_hooks[:], sys.path[:]; "
        "import pupper_analysis; print(kept == (sys.meta_path, sys.path_hooks, sys.path))"
    )
    assert run_python(code, tmp_path) == "True"


@pytest.mark.slow
def test_diff_imports_no_scipy_and_finds_models_from_any_folder(tmp_path: Path) -> None:
    """The heavy variant has 4.216 kg."""
    loaded = LOADED.format(names=("scipy", "shapely", "trimesh"))
    code = (
        "import pupper_analysis as pa; pa.load_variant('v3'); "
        f"from pupper_analysis.tools.diff import compare; {loaded}; "
        "print(round(pa.load_variant('heavy').total_mass, 9))"
    )
    assert run_python(code, tmp_path).split() == ["[]", "4.216"]


@pytest.mark.slow
def test_loading_a_base_model_needs_no_drawing_and_no_urdf_writer(tmp_path: Path) -> None:
    code = "import pupper_analysis as pa; pa.load_variant('v3'); " + LOADED.format(names=HEAVY)
    assert run_python(code, tmp_path) == "[]"


@pytest.mark.slow
def test_stand_imports_only_the_linear_algebra_of_scipy_and_no_drawing(tmp_path: Path) -> None:
    code = (
        "import pupper_analysis as pa; r = pa.load_variant('v3'); s = pa.solve_stand(r); "
        "pa.gravity_compensation(pa.Configuration(r, s.qpos)); pa.steady_state(r, s); "
        "pa.stance.stance_path; pa.verify_stand(r, s); "
    )
    parts = ("optimize", "interpolate", "integrate", "spatial", "stats")
    names = ("matplotlib", "yourdfpy", "trimesh", *(f"scipy.{part}" for part in parts))
    assert run_python(code + LOADED.format(names=names), tmp_path) == "[]"


@pytest.mark.slow
def test_example_in_the_package_docstring_runs(tmp_path: Path) -> None:
    assert pa.__doc__ is not None
    lines = [line[4:] for line in pa.__doc__.splitlines() if line.startswith("    ")]
    assert len(lines) >= 5
    assert (
        run_python("\n".join([*lines, "print(report.passed, len(torques))"]), tmp_path) == "True 12"
    )


def test_completion_offers_public_names_only() -> None:
    """``dir``, which IPython completes, must not contain ``Any``, ``np`` or
    ``make_lazy_exports``."""
    values = [getattr(pa, name) for name in pa.__all__]
    for module in (pa, *(value for value in values if isinstance(value, ModuleType))):
        names = [name for name in dir(module) if not name.startswith("_")]
        assert names, module.__name__
        for name in names:
            value = getattr(module, name)
            is_module = isinstance(value, ModuleType)
            source = value.__name__ if is_module else getattr(value, "__module__", None)
            assert source is None or source.startswith("pupper_analysis"), name
    assert {"Any", "np", "orjson"}.isdisjoint(dir(pa.results))
    assert "make_lazy_exports" not in dir(pa.stance)


def test_missing_modules_are_not_exported(tmp_path: Path) -> None:
    """The stub lists four modules, of which ``kept`` and the tool ``saw`` exist."""
    for name in ("kept.py", "tools/saw/__init__.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "__init__.pyi").write_text(
        "from . import kept as kept\nfrom . import gone as gone\n"
        "from .tools import saw as saw\nfrom .tools import axe as axe\n"
    )
    assert make_lazy_exports("shed", str(tmp_path / "__init__.py"))[2] == ["kept", "saw"]


def test_unknown_public_name_raises_attribute_error() -> None:
    with pytest.raises(AttributeError, match="Pupper"):
        pa.Pupper  # noqa: B018
    assert not hasattr(pa, "nothing")


def test_robot_loads_if_warnings_are_errors(tmp_path: Path) -> None:
    """Pinocchio 3.8 imports Coal by its deprecated name ``hppfcl``; other warnings stay errors."""
    code = (
        "import warnings, pupper_analysis as pa; warnings.simplefilter('error');"
        "print(pa.load_robot('v3').nu);"
        "warnings.warn('own', DeprecationWarning)"
    )
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MUJOCO_GL": ""},
        check=False,
        timeout=PATIENCE,
    )
    assert result.stdout.strip() == "12", result.stderr
    assert "DeprecationWarning: own" in result.stderr
