"""Check whether a tag may be released: project, package, citation and changelog have its version.

    python scripts/check_release.py v0.2.0
    python scripts/check_release.py --dist dist
    python scripts/check_release.py --index https://github.com/WHO/pupper_analysis v0.2.0

``--dist`` checks that a wheel and a source distribution are complete, and that their metadata agree
with pyproject.toml. ``--index`` rewrites the README for the package index: links and pictures point
to the tag, and the installation uses the package's name.
"""

from __future__ import annotations

import re
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
from email.parser import Parser
from pathlib import Path
from typing import Any

PROJECT_FOLDER = Path(__file__).resolve().parents[1]
"""Root folder of this project."""


def read_versions(root: Path = PROJECT_FOLDER) -> dict[str, str]:
    """Return {file: version}; for the changelog the topmost release; "none" if not found."""
    text = {
        name: (root / name).read_text(encoding="utf-8")
        for name in (
            "pyproject.toml",
            "pupper_analysis/__init__.py",
            "CITATION.cff",
            "CHANGELOG.md",
        )
    }
    patterns = {
        "pupper_analysis/__init__.py": r'^__version__ = "(.+)"$',
        "CITATION.cff": r"^version: (.+)$",
        "CHANGELOG.md": r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$",
    }
    versions = {"pyproject.toml": str(tomllib.loads(text["pyproject.toml"])["project"]["version"])}
    for name, pattern in patterns.items():
        found = re.search(pattern, text[name], re.MULTILINE)
        versions[name] = found[1] if found else "none"
    return versions


def main(tag: str, root: Path = PROJECT_FOLDER) -> None:
    """End with status 1 and print the differences if a file has another version than the tag."""
    other = {name: version for name, version in read_versions(root).items() if f"v{version}" != tag}
    if other:
        message = ", ".join(f"{name} has {version}" for name, version in other.items())
        raise SystemExit(f"{tag}: {message}")
    print(f"{tag} may be released")


def list_faults(folder: Path, root: Path = PROJECT_FOLDER) -> Iterator[str]:
    """Yield the faults of the distributions in a folder."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stem = f"{project['name'].replace('-', '_')}-{project['version']}"
    wheels, sources = sorted(folder.glob("*.whl")), sorted(folder.glob("*.tar.gz"))
    expected = [f"{stem}-py3-none-any.whl", f"{stem}.tar.gz"]
    found = [path.name for path in (*wheels, *sources)]
    if found != expected:
        yield f"there are {found}, not {expected}"
        return
    with zipfile.ZipFile(wheels[0]) as wheel:
        names = set(wheel.namelist())
        metadata = wheel.read(f"{stem}.dist-info/METADATA").decode()
    yield from (f"METADATA: {one}" for one in _list_metadata_faults(metadata, project, root))
    package = root / "pupper_analysis"
    ours = [
        path.relative_to(root).as_posix()
        for pattern in ("*.py", "*.pyi", "*.toml", "*.js", "*.css", "py.typed")
        for path in package.rglob(pattern)
        if "__pycache__" not in path.parts
    ]
    ours += [
        f"pupper_analysis/pupper/{path.relative_to(root).as_posix()}"
        for folder in ("urdf", "mjcf")
        for path in (root / folder).rglob("*")
        if path.is_file()
    ]
    yield from (f"the wheel lacks {name}" for name in ours if name not in names)
    yield from (f"the wheel has {name}" for name in names if name.startswith("tests/"))
    with tarfile.open(sources[0]) as source:
        inside = set(source.getnames())
    for name in ("README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "pyproject.toml", "tests"):
        if not any(one.startswith(f"{stem}/{name}") for one in inside):
            yield f"the source distribution lacks {name}"


def _list_metadata_faults(text: str, project: dict[str, Any], root: Path) -> Iterator[str]:
    """Yield the metadata that differ from pyproject.toml or the README.

    Args:
        text: Metadata of the wheel.
        project: Table ``[project]`` of pyproject.toml.
        root: Root folder of the project.
    """
    stated = Parser().parsestr(text)
    readme = (root / project["readme"]).read_text(encoding="utf-8")
    for key, expected in {
        "Version": [project["version"]],
        "Requires-Python": [project["requires-python"]],
        "Classifier": project["classifiers"],
        "Provides-Extra": list(project["optional-dependencies"]),
    }.items():
        if sorted(stated.get_all(key, [])) != sorted(expected):
            yield f"{key} is {stated.get_all(key)}, not {expected}"
    if stated.get_payload().strip() != readme.strip():
        yield "the description is not the README"


def check_distributions(folder: Path, root: Path = PROJECT_FOLDER) -> None:
    """End with status 1, and print the faults, unless the distributions may be published."""
    found = list(list_faults(folder, root))
    if found:
        raise SystemExit("\n".join(found))
    print(f"{folder}: wheel and source distribution have what they must")


def convert_readme(readme: str, repository: str, tag: str) -> str:
    """Convert the README for the package index: absolute links to a tag, installation by name.

    Args:
        readme: Text of the README.
        repository: Address of the repository.
        tag: Name of the tag.
    """
    where = {"!": f"{repository}/raw/{tag}/", "": f"{repository}/blob/{tag}/"}
    linked = re.sub(
        r"(!?)(\[[^\]]*\]\()(?!https?:|#)", lambda link: link[0] + where[link[1]], readme
    )
    installed = re.sub(
        r"pip install \.(?: +#.*)?$", "pip install pupper-analysis", linked, flags=re.M
    )
    installed = installed.replace("there. In a clone of this repository:", "there.")
    return re.sub(r'pip install "\.(\[[^\]]*\])"', r'pip install "pupper-analysis\1"', installed)


if __name__ == "__main__":
    if sys.argv[1] == "--dist":
        check_distributions(Path(sys.argv[2]))
    elif sys.argv[1] == "--index":
        page = PROJECT_FOLDER / "README.md"
        page.write_text(convert_readme(page.read_text(encoding="utf-8"), *sys.argv[2:4]), "utf-8")
    else:
        main(sys.argv[1])
