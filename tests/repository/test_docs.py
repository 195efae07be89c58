"""The docs name what is there, and what is generated of them is whole."""

from __future__ import annotations

import ast
import csv
import importlib
import re
import tarfile
import tomllib
import zipfile
from pathlib import Path

import click
import pytest
import yaml

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.tools.audit.audit import CHECKS
from tests.support.names import public, public_modules
from tests.support.repository import ROOT, script
from tests.support.rooms import FLOOR

PACKAGE = ROOT / "pupper_analysis"
PAGES = sorted(
    page
    for page in [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "examples").glob("*.md"),
    ]
    if "generated" not in page.parts
)
DATA = ROOT / "docs" / "data"


def rows(page: str) -> list[list[str]]:
    """The rows of a page's tables, without their headers; a cell may hold an escaped bar."""
    lines = [line for line in (ROOT / page).read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    rules = [index for index, row in enumerate(cells) if set(row) == {"---"}]
    return [row for index, row in enumerate(cells) if not {index, index + 1} & set(rules)]


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for link in re.findall(r"\]\(((?!https?:)[^)#\s]+)[^)]*\)", page.read_text()):
            known = (page.parent / link).exists() or "generated" in Path(link).parts
            assert known, f"{page}: {link}"  # those that are generated, the site's build checks


def test_named_modules_are_there() -> None:
    """Of this package, as a path (``robot/contact.py``, ``stance/sag/``) or with dots."""
    ignored = (ROOT / ".gitignore").read_text()
    for page in PAGES:
        for path in re.findall(r"`([a-z_]+/[a-z_/]*(?:\.py)?)`", page.read_text()):
            room = path.split("/")[0]
            if room in FLOOR:
                assert (PACKAGE / path).exists(), f"{page}: {path}"
            else:  # of the repository, or made by a command of the Makefile
                assert (ROOT / path).exists() or f"{room}/" in ignored, f"{page}: {path}"
        for name in re.findall(r"`pupper_analysis\.([a-z_.]+)`", page.read_text()):
            importlib.import_module(f"pupper_analysis.{name}")


def test_documents_name_sections_that_are_there() -> None:
    """A report gives them as sources: ``page_of("explanation/statics.md", "Which of them")``."""
    named = [
        pair
        for path in PACKAGE.rglob("*.py")
        for pair in re.findall(r'\bpage_of\("([^"]+)",\s*"([^"]+)"\)', path.read_text())
    ]
    assert len(named) > 10
    for name, heading in named:
        headings = re.findall(r"^#+ (.+)$", (ROOT / "docs" / name).read_text(), re.M)
        assert heading in headings, f"docs/{name}: {heading}"


def test_every_command_has_a_guide() -> None:
    guides = ROOT / "docs/how-to"
    texts = [page.read_text() for page in guides.glob("*.md")]
    index = (guides / "index.md").read_text()
    for page in guides.glob("[!i]*.md"):
        assert f"({page.name})" in index, page.name
    for name in cli.COMMANDS:
        assert any(f"\npupper-analysis {name}" in text for text in texts), name


def test_python_of_the_docs_is_python_and_names_what_is_public() -> None:
    for page in PAGES:
        for code in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
            for node in ast.walk(ast.parse(code)):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    assert node.value.id != "pa" or hasattr(pa, node.attr), f"{page}: {node.attr}"


def test_tables_of_data_are_whole_and_described() -> None:
    groups = tomllib.loads((DATA / "tables.toml").read_text())
    described = [name for group in groups.values() for name in group if name != "title"]
    assert {path.stem for path in DATA.glob("*.csv")} == set(described)
    assert len(described) == len(set(described))
    for name in described:
        with (DATA / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
        assert len(rows) > 1, name
        assert {len(row) for row in rows} == {len(header)}, name


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The generated pages of both sites, in ``en`` and ``zh``."""
    folder = tmp_path_factory.mktemp("sites")
    pages = script("docs/pages.py")
    for language in ("en", "zh"):
        pages.write(folder / language, language)
    return folder


def test_the_page_of_robots_counts_its_rows(generated: Path) -> None:
    """Four rows by hand, then the page: at least 80 robots, each with its defect's line or none."""
    rows = [
        {"crosscheck": "AGREE", "stand or hold": "holds", "first defect": "-"},
        {"crosscheck": "3 differences", "stand or hold": "fails", "first defect": "a.urdf:3: mass"},
        {"crosscheck": "-", "stand or hold": "holds", "first defect": "b.xml:4: mesh"},
        {"crosscheck": "-", "stand or hold": "holds, made one", "first defect": "-"},
    ]
    found = script("docs/pages.py").robots_summary(rows)
    assert found.startswith("4 robots, 2 of them with a defect")
    assert "Of 2 pairs of a URDF and an MJCF 1 agree" in found
    assert "3 holds; 1 fails" in found
    page = (generated / "en/reference/generated/tables/robots.md").read_text()
    with (DATA / "robots-of-packages.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert f"{len(table)} robots, " in page
    assert len(table) >= 80
    assert all(re.search(r"\.(urdf|xml):\d+", row["first defect"]) for row in table
               if row["first defect"] != "-" and row["crosscheck"] == "-"
               and not row["audit"].startswith(("OK", "refused")))  # fmt: skip


def test_the_reference_has_all_there_is(generated: Path) -> None:
    english, chinese = (generated / language / "reference/generated" for language in ("en", "zh"))
    rules = (english / "audit-rules.md").read_text()
    assert all(f"| `{rule}` |" in rules for rule in CHECKS)
    assert all(f"| `{rule}` |" in (chinese / "audit-rules.md").read_text() for rule in CHECKS)
    codes = (english / "diagnostics.md").read_text()
    assert "| `servos-added` |" in codes
    assert codes.count("\n| `") == (chinese / "diagnostics.md").read_text().count("\n| `") > 200
    api = "".join(page.read_text() for page in (english / "api").glob("*.md"))
    for module in (pa, *public_modules()):
        missing = [name for name in public(module) if f"{module.__name__}.{name}\n" not in api]
        assert missing == [], module.__name__
    parts = re.split(r"^## ", (english / "commands.md").read_text(), flags=re.M)[1:]
    for name, part in zip(cli.COMMANDS, parts, strict=True):
        assert part.startswith(f"{name}\n")
        for option in cli.find_command(name).params:
            if isinstance(option, click.Option):
                assert f"`{option.opts[0]}" in part, f"{name} {option.opts[0]}"
    tables = "".join(page.read_text() for page in (english / "tables").glob("*.md"))
    assert tables.count("\n## ") == len(list(DATA.glob("*.csv")))


def test_what_is_generated_is_plain_text(generated: Path) -> None:
    pages = script("docs/pages.py")
    assert pages._plain("a_b *c* [d] `e_f` $g") == r"a\_b \*c\* \[d\] `e_f` \$g"
    assert pages._readable("{name!r}[limit? beyond {limit:.2f}], {n|foot|feet}") == (
        "⟨name⟩ beyond ⟨limit⟩, feet"
    )
    assert pages._readable("{given}: write {{values = [1]}}") == "⟨given⟩: write {values = [1]}"
    lines = ["least |f_t| of name_, ``a_``", "code::", "", "    x_ = *y", "so *it*"]
    pages.plain_text(lines)
    assert lines == [
        r"least \|f_t\| of name\_, ``a_``", "code::", "", "    x_ = *y", r"so \*it\*"
    ]  # fmt: skip


def test_modules_named_in_docstrings_are_there() -> None:
    for path in PACKAGE.rglob("*.py"):
        for name in re.findall(r"``pupper_analysis\.([a-z_.]+)``", path.read_text()):
            importlib.import_module(f"pupper_analysis.{name}")


def test_every_room_is_described_in_the_architecture() -> None:
    described = [row[0] for row in rows("docs/explanation/architecture.md") if len(row) == 4]
    assert described == [f"`{room}/`" for room in FLOOR]


def test_every_room_has_an_answer_to_where_a_new_thing_goes() -> None:
    places = " ".join(row[1] for row in rows("docs/explanation/architecture.md") if len(row) == 2)
    asked = {room for room in FLOOR if re.search(rf"`{room}/", places)}
    assert asked == set(FLOOR)


GLOSSARY = [row for row in rows("docs/reference/glossary.md") if len(row) == 3]


@pytest.mark.parametrize(
    ("term", "place"),
    {
        "metric": "tools/push/metrics.py",
        "failure": "diagnose(",
        "friction cone": "statics/cone_program.py",
        "effort": "models/efforts.py",
        "solimp": "robot/contact.py",
        "static stability": "robot/stability.py",
        "armature": "models/conversion.py",
        "rule of the audit": "tools/audit/rules/catalogue.toml",
        "translation": "texts.toml",
        "closed loop": "robot/closure.py",
        "eigenvalue": "robot/stability.py",
    }.items(),
)
def test_a_search_for_the_fields_term_finds_its_place_first(term: str, place: str) -> None:
    table = [row for row in rows("docs/explanation/architecture.md") if len(row) == 2]
    found = next(row for row in table if term in row[0])
    assert place in found[1]
    assert (PACKAGE / place).exists() or "/" not in place


def test_words_of_the_glossary_are_used_in_their_homes() -> None:
    """In docstrings or names, or a module's own, with blanks, hyphens or underscores."""
    for row in GLOSSARY:
        home = re.fullmatch(r"`([a-z_/]+\.py)`", row[2])
        assert home is not None, row[2]
        text = re.sub(r"[\s_\-\"]+", " ", home[1] + (PACKAGE / home[1]).read_text()).lower()
        joined = text.replace(" ", "")
        for word in row[0].lower().split(", "):
            plain = re.sub(r"[\s\-]+", " ", word)
            known = plain in text or plain.replace(" ", "") in joined
            assert known, f"{word!r} is not in {home[1]}"


def test_contributing_names_targets_that_are_there() -> None:
    targets = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.M))
    named = set(re.findall(r"`make ([a-z-]+)", (ROOT / "CONTRIBUTING.md").read_text()))
    assert named <= targets
    assert {"setup", "test", "lint", "types", "docs", "coverage"} <= named


def test_the_workflow_runs_what_ci_runs() -> None:
    """Both call the Makefile's targets.

    The lowest versions and the longest proofs are for the workflow alone; the quick benchmark is
    one of the tests in the other, where ratios of times are measured, too: its last job calls it.
    """
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    script = (ROOT / ".ci" / "run").read_text()
    targets = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.M))
    called = set(re.findall(r"\bmake ((?:[a-z-]+ ?)+)", script))
    ours = {word for words in called for word in words.split()} & targets
    theirs = {
        word for words in re.findall(r"run: make (.+)$", workflow, re.M) for word in words.split()
    } & targets
    assert {"test", "lint", "types", "docs"} <= theirs
    assert theirs == ours - {"setup", "test-slow", "benchmark-ratios"} | {
        "test-lowest",
        "test-longest",
        "benchmark-quick",
    }
    assert ".ci/run" in workflow


def test_hooks_are_the_projects_own_tools() -> None:
    text = (ROOT / ".pre-commit-config.yaml").read_text()
    assert re.findall(r"repo: (\S+)", text) == ["local"]
    entries = [entry.split()[:2] for entry in re.findall(r"entry: (.+)$", text, re.M)]
    assert {runner for runner, _ in entries} == {".ci/tool"}
    assert {tool for _, tool in entries} == {"ruff", "mypy", "lint-imports"}


def test_a_release_needs_one_version_everywhere(tmp_path: Path) -> None:
    release = script("scripts/check_release.py")
    versions = release.stated()
    assert set(versions.values()) == {pa.__version__}
    release.main(f"v{pa.__version__}")
    with pytest.raises(SystemExit, match=r"CHANGELOG\.md has"):
        release.main("v99.0.0")


def test_on_the_package_index_the_readme_leads_to_its_tag() -> None:
    for_index = script("scripts/check_release.py").for_index
    there = for_index((ROOT / "README.md").read_text(), "https://git.example/us/it", "v1.2.3")
    targets = re.findall(r"\]\(([^)]+)\)", there)
    ours = [target for target in targets if target.startswith("https://git.example/us/it/")]
    assert [target for target in targets if not target.startswith("https://")] == []
    for target in ours:
        kind, tag, path = target.removeprefix("https://git.example/us/it/").split("/", 2)
        assert (kind, tag) == ("raw" if path.endswith(".png") else "blob", "v1.2.3")
        assert (ROOT / path).is_file()
    assert "https://git.example/us/it/raw/v1.2.3/docs/images/variants.png" in ours
    assert "git+" not in there
    assert "pip install pupper-analysis\n" in there
    assert 'pip install "pupper-analysis[live,study]"' in there


def _wheel(folder: Path, metadata: str, names: list[str]) -> None:
    with zipfile.ZipFile(folder / "some_robot-1.2.3-py3-none-any.whl", "w") as wheel:
        wheel.writestr("some_robot-1.2.3.dist-info/METADATA", metadata)
        for name in names:
            wheel.writestr(name, "")


def test_distributions_are_checked_before_they_are_published(tmp_path: Path) -> None:
    """A project of its own: sound, then without a file, with an old README, of another Python."""
    check = script("scripts/check_release.py")
    root, dist = tmp_path / "root", tmp_path / "dist"
    for folder in (root / "pupper_analysis", root / "urdf", root / "mjcf", dist):
        folder.mkdir(parents=True)
    (root / "pyproject.toml").write_text(
        '[project]\nname = "some-robot"\nversion = "1.2.3"\nreadme = "README.md"\n'
        'requires-python = ">=3.11"\nclassifiers = ["Typing :: Typed"]\n'
        "[project.optional-dependencies]\nlive = []\n"
    )
    (root / "README.md").write_text("# Robot\n")
    (root / "pupper_analysis/words.toml").touch()
    (root / "urdf/a.urdf").touch()
    names = ["pupper_analysis/words.toml", "pupper_analysis/pupper/urdf/a.urdf"]
    sound = (
        "Metadata-Version: 2.4\nName: some-robot\nVersion: 1.2.3\nRequires-Python: >=3.11\n"
        "Classifier: Typing :: Typed\nProvides-Extra: live\n\n# Robot\n"
    )
    with tarfile.open(dist / "some_robot-1.2.3.tar.gz", "w:gz") as source:
        for name in (
            "README.md",
            "LICENSE",
            "CHANGELOG.md",
            "CITATION.cff",
            "tests",
            "pyproject.toml",
        ):
            source.addfile(tarfile.TarInfo(f"some_robot-1.2.3/{name}"))
    _wheel(dist, sound, names)
    assert list(check.faults(dist, root)) == []
    _wheel(dist, sound, names[1:])
    assert list(check.faults(dist, root)) == ["the wheel lacks pupper_analysis/words.toml"]
    for old, new, word in (
        ("# Robot", "# Old", "README"),
        (">=3.11", ">=3.10", "Requires-Python"),
        ("Provides-Extra: live\n", "", "Provides-Extra"),
        ("Typed", "Untyped", "Classifier"),
    ):
        _wheel(dist, sound.replace(old, new), names)
        (found,) = check.faults(dist, root)
        assert word in found
    _wheel(dist, sound, names)
    (dist / "some_robot-1.2.2.tar.gz").touch()
    with pytest.raises(SystemExit, match=r"1\.2\.2"):
        check.check_distributions(dist, root)


def test_pythons_of_the_classifiers_are_tested_on_both_systems() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    stated = [
        one.rpartition(" ")[2] for one in project["classifiers"] if re.search(r":: 3\.\d", one)
    ]
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    tested = re.search(r"python-version: \[(.+)\]", workflow)
    systems = re.search(r"os: \[(.+)\]", workflow)
    assert tested is not None
    assert systems is not None
    assert re.findall(r"[\d.]+", tested[1]) == stated
    assert project["requires-python"] == f">={stated[0]}"
    assert [one.strip() for one in systems[1].split(",")] == ["ubuntu-latest", "macos-latest"]


def test_issues_ask_for_the_result_as_data() -> None:
    for path in (ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"):
        form = yaml.safe_load(path.read_text())
        if path.name != "config.yml":
            assert {"name", "description", "body"} <= form.keys()
    wrong = yaml.safe_load((ROOT / ".github/ISSUE_TEMPLATE/wrong-answer.yml").read_text())
    (asked,) = [one for one in wrong["body"] if one["id"] == "json"]
    assert "--json" in asked["attributes"]["description"]
    assert asked["validations"]["required"]


def test_workflows_call_targets_that_are_there() -> None:
    targets = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.M))
    for path in (ROOT / ".github/workflows").glob("*.yml"):
        text = path.read_text()
        named = {
            word for line in re.findall(r"run: make (.+)$", text, re.M) for word in line.split()
        }
        assert {name for name in named if re.fullmatch(r"[a-z][a-z-]+", name)} <= targets, path.name
        for action in re.findall(r"uses: (\S+)", text):  # what runs is what was looked at
            pinned = action == "./" or re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", action)
            assert pinned, f"{path.name}: {action}"
