"""Documentation: links, commands, tables and generated pages exist and are complete."""

from __future__ import annotations

import ast
import csv
import html
import importlib
import re
import subprocess
import sys
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
from tests.support.layers import LAYERS
from tests.support.names import public, public_modules
from tests.support.repository import ROOT, script

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
    """Return the rows of a page's tables, without their headers; a cell may hold an escaped bar."""
    lines = [line for line in (ROOT / page).read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    rules = [index for index, row in enumerate(cells) if set(row) == {"---"}]
    return [row for index, row in enumerate(cells) if not {index, index + 1} & set(rules)]


def resolve_public_path(path: str) -> object:
    """Return the object of a documented path, reached as a user does: ``pa``, then attributes."""
    package, *names = path.split(".")
    assert package == "pupper_analysis"
    value: object = pa
    for name in names:
        value = getattr(value, name)
    return value


def test_relative_links_of_pages_exist() -> None:
    for page in PAGES:
        for link in re.findall(r"\]\(((?!https?:)[^)#\s]+)[^)]*\)", page.read_text()):
            known = (page.parent / link).exists() or "generated" in Path(link).parts
            assert known, f"{page}: {link}"  # those that are generated, the site's build checks


def test_modules_named_in_pages_exist() -> None:
    """Of this package, as a path (``robot/contact.py``, ``stance/sag/``) or with dots.

    A group of entry points ("the group `pupper_analysis.bridges`") is no module.
    """
    ignored = (ROOT / ".gitignore").read_text()
    for page in PAGES:
        for path in re.findall(r"`([a-z_]+/[a-z_/]*(?:\.py)?)`", page.read_text()):
            folder = path.split("/")[0]
            if folder in LAYERS:
                assert (PACKAGE / path).exists(), f"{page}: {path}"
            else:  # of the repository, or made by a command of the Makefile
                assert (ROOT / path).exists() or f"{folder}/" in ignored, f"{page}: {path}"
        for name in re.findall(r"(?<!group )`pupper_analysis\.([a-z_.]+)`", page.read_text()):
            importlib.import_module(f"pupper_analysis.{name}")


def test_sections_named_by_documents_exist() -> None:
    """A report gives them as sources: ``cite_page("explanation/statics.md", "Choice of")``."""
    named = [
        pair
        for path in PACKAGE.rglob("*.py")
        for pair in re.findall(r'\bcite_page\("([^"]+)",\s*"([^"]+)"\)', path.read_text())
    ]
    assert len(named) > 10
    for name, heading in named:
        headings = re.findall(r"^#+ (.+)$", (ROOT / "docs" / name).read_text(), re.M)
        assert heading in headings, f"docs/{name}: {heading}"


def test_every_command_has_a_guide() -> None:
    guides = ROOT / "docs/how-to"
    texts = [page.read_text() for page in guides.glob("*.md")]
    index = (guides / "index.md").read_text()
    pages = list(guides.glob("[!i]*.md"))
    assert len(pages) >= len(cli.COMMAND_NAMES)
    for page in pages:
        assert f"({page.name})" in index, page.name
    for name in cli.COMMAND_NAMES:
        assert any(f"\npupper-analysis {name}" in text for text in texts), name


@pytest.mark.parametrize("name", cli.COMMAND_NAMES)
def test_the_guide_of_a_command_has_the_sections_of_each_guide(name: str) -> None:
    """Purpose, a command with its output, options, equations and limits, in this order."""
    text = (ROOT / f"docs/how-to/{name}.md").read_text()
    purpose = text.split("\n\n")[1]
    assert re.match(r"`\w+` ", purpose), purpose
    assert text.index("\n```sh\n") < text.index("\n```text\n") < text.index("\n## Options\n")
    assert re.search(rf"^pupper-analysis {name}\b", text[: text.index("\n```text\n")], re.M)
    parts = dict(re.findall(r"^## (.+)\n((?:(?!^## ).*\n?)*)", text, re.M))
    assert "| option | meaning |" in parts["Options"]
    assert re.search(r"^ {4}\S.*(<=|>=|=)", parts["How it works"], re.M), "no equation"
    assert parts["Limits"].strip()
    headings = list(parts)
    assert headings.index("Options") < headings.index("How it works") < headings.index("Limits")


def test_data_tables_are_rectangular_and_described() -> None:
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
    """Return the generated pages of both sites, in ``en`` and ``zh``."""
    folder = tmp_path_factory.mktemp("sites")
    pages = script("docs/pages.py")
    for language in ("en", "zh"):
        pages.write_pages(folder / language, language)
    return folder


@pytest.mark.slow
def test_page_of_robots_states_its_number_of_rows(generated: Path) -> None:
    """At least 80 robots, each with the line of the first defect or none."""
    page = (generated / "en/reference/generated/tables/robots.md").read_text()
    with (DATA / "robots-of-packages.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert f"{len(table)} robots, " in page
    assert len(table) >= 80
    assert all(re.search(r"\.(urdf|xml):\d+", row["first defect"]) for row in table
               if row["first defect"] != "-" and row["crosscheck"] == "-"
               and not row["audit"].startswith(("OK", "refused")))  # fmt: skip


def test_reference_lists_all_rules_codes_names_and_commands(generated: Path) -> None:
    english, chinese = (generated / language / "reference/generated" for language in ("en", "zh"))
    rules = (english / "audit-rules.md").read_text()
    assert all(f"| `{rule}` |" in rules for rule in CHECKS)
    assert all(f"| `{rule}` |" in (chinese / "audit-rules.md").read_text() for rule in CHECKS)
    codes, chinese_codes = (
        "".join(page.read_text() for page in (site / "diagnostics").glob("*.md"))
        for site in (english, chinese)
    )
    assert "| `servos-added` |" in codes
    assert codes.count("\n| `") == chinese_codes.count("\n| `") > 200
    api = "".join(page.read_text() for page in (english / "api").rglob("*.md"))
    documented = set(re.findall(r"^\.\. auto\w+:: (\S+)$", api, re.M))
    for module in (pa, *public_modules()):
        objects = {id(getattr(module, name)) for name in public(module)}
        printed = {id(resolve_public_path(path)) for path in documented}
        assert objects <= printed, module.__name__
    listed = re.findall(r"^\| \[(\w+)\]", (english / "commands.md").read_text(), re.M)
    assert listed == list(cli.COMMAND_NAMES)
    for name in cli.COMMAND_NAMES:
        part = (english / f"commands/{name}.md").read_text()
        assert part.startswith(f"# {name}\n")
        for option in cli.find_command(name).params:
            if isinstance(option, click.Option):
                assert f"`{option.opts[0]}" in part, f"{name} {option.opts[0]}"
    tables = "".join(page.read_text() for page in (english / "tables").glob("*.md"))
    assert tables.count("\n## ") == len(list(DATA.glob("*.csv")))


def test_generated_pages_are_short_and_listed_in_the_index_of_their_folder(generated: Path) -> None:
    """45 000 characters are at most about 30 000 px on a phone (390 px, measured)."""
    for language in ("en", "zh"):
        folder = generated / language / "reference/generated"
        for page in folder.rglob("*.md"):
            assert len(page.read_text()) < 45_000, page
        for index in ("diagnostics", "results"):
            text = (folder / f"{index}.md").read_text()
            for page in (folder / index).glob("*.md"):
                assert f"]({index}/{page.name}" in text
                assert f"\n{index}/{page.stem}\n" in text
    results = (generated / "en/reference/generated/results.md").read_text()
    assert '- <a id="stand"></a>[Stand](results/s.md#stand)' in results
    api = (generated / "en/reference/generated/api/pupper_analysis.md").read_text()
    assert '- <a id="pupper_analysis.Robot"></a>[Robot](pupper_analysis/Robot.md)' in api


def test_a_long_table_is_split_without_a_lost_row() -> None:
    pages = script("docs/pages.py")
    rows = [(str(number), "x" * 5500) for number in range(7)]
    parts = pages.split_rows(rows)
    assert [len(part) for part in parts] == [2, 2, 2, 1]
    assert [row for part in parts for row in part] == rows


def test_types_are_printed_with_short_and_public_names() -> None:
    shorten = script("docs/pages.py").shorten_types
    array = "~numpy.ndarray[tuple[~typing.Any, ...], ~numpy.dtype[~numpy.float64]]"
    assert shorten(f"(x: dict[str, {array}] = <factory>)") == "(x: dict[str, Array] = ...)"
    assert shorten("ndarray[tuple[Any, ...], dtype[bool]] | None") == "BoolArray | None"
    assert shorten("pinocchio.pinocchio_pywrap_default.Model") == "pinocchio.Model"
    assert shorten("~mujoco._structs.MjModel") == "~mujoco.MjModel"
    assert shorten("~numpy.typing.NDArray[np.bool_]") == "BoolArray"
    assert shorten("TypeAliasForwardRef('ArrayLike')") == "ArrayLike"
    assert shorten("pupper_analysis.robot.plane.Contact") == "~pupper_analysis.Contact"
    assert shorten("~pupper_analysis.robot.stability.Stability") == (
        "~pupper_analysis.robot.Stability"
    )
    private = "tuple[~pupper_analysis.models.description.Description, ...]"
    assert shorten(private) == "tuple[Description, ...]"


def check_names(site: Path) -> tuple[int, list[str]]:
    """Run ``docs/check_names.py`` in a new process; return its exit status and what it reports."""
    command = [sys.executable, str(ROOT / "docs/check_names.py"), str(site)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.returncode, done.stderr.splitlines()


def test_documented_names_resolve_in_a_new_process(generated: Path) -> None:
    """Paths of the API pages, and ``pa.NAME`` on all pages, after ``import pupper_analysis``."""
    site = generated / "names"
    for page in [*PAGES, *(generated / "en").rglob("*.md")]:
        root = generated / "en" if generated in page.parents else ROOT
        copy = (site / page.relative_to(root)).with_suffix(".html")
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(html.escape(page.read_text().replace("\\_", "_")))
    (site / "CHANGELOG.html").unlink()  # contains former names
    assert check_names(site) == (0, [])


def test_private_names_of_a_page_are_reported(tmp_path: Path) -> None:
    """``pa.models`` exists only after another name has imported it."""
    (tmp_path / "api").mkdir()
    page = tmp_path / "api/page.html"
    page.write_text(
        "<title>~numpy.x</title><p>pa.Robot pa.stance.Interval pupper_analysis.toml "
        "pa.Robot.name</p>"
    )
    assert check_names(tmp_path) == (0, [])
    faults = (
        "pa.models",
        "pa.robot.plane",
        "pa.stance.task",
        "pupper_analysis.robot.contact.ContactParameters",
        "pa.Robot.nothing",
        "~numpy.",
        "typing.",
        "ndarray[",
        "&lt;factory&gt;",
    )
    for fault in faults:
        page.write_text(f"<p>a <span>{fault}</span></p>")
        status, reported = check_names(tmp_path)
        assert status == 1, fault
        assert reported == [f"api/page.html: {html.unescape(fault)}"]


def test_architecture_page_has_the_current_import_graph() -> None:
    drawing = script("docs/draw_architecture.py")
    assert drawing.read_embedded_facts() == drawing.collect_facts(
        drawing.folder_graph(), drawing.tool_graph()
    ), "draw it again: python docs/draw_architecture.py"


def test_each_package_is_described_on_the_architecture_page() -> None:
    described = [row[0] for row in rows("docs/explanation/architecture.md") if len(row) == 4]
    assert described == [f"`{folder}/`" for folder in LAYERS]


def test_release_check_requires_one_version_in_all_files(tmp_path: Path) -> None:
    release = script("scripts/check_release.py")
    versions = release.read_versions()
    assert set(versions.values()) == {pa.__version__}
    assert pa.__version__.count(".") == 2
    release.main(f"v{pa.__version__}")
    with pytest.raises(SystemExit, match=r"CHANGELOG\.md has"):
        release.main("v99.0.0")


def test_release_check_reports_each_fault_of_a_distribution(tmp_path: Path) -> None:
    """A complete wheel and source distribution have no fault; then one fault is made at a time."""
    release = script("scripts/check_release.py")
    root, dist = tmp_path / "root", tmp_path / "dist"
    for folder in (root / "pupper_analysis", root / "urdf", dist):
        folder.mkdir(parents=True)
    (root / "pyproject.toml").write_text(
        '[project]\nname = "some-robot"\nversion = "1.2.3"\nreadme = "README.md"\n'
        'requires-python = ">=3.11"\nclassifiers = ["Typing :: Typed"]\n'
        "[project.optional-dependencies]\nlive = []\n"
    )
    (root / "README.md").write_text("# Robot\n")
    (root / "pupper_analysis/words.toml").touch()
    (root / "urdf/a.urdf").touch()
    stem = "some_robot-1.2.3"
    names = ("pupper_analysis/words.toml", "pupper_analysis/pupper/urdf/a.urdf")
    metadata = (
        "Metadata-Version: 2.4\nName: some-robot\nVersion: 1.2.3\nRequires-Python: >=3.11\n"
        "Classifier: Typing :: Typed\nProvides-Extra: live\n\n# Robot\n"
    )

    def list_faults(text: str = metadata, files: tuple[str, ...] = names) -> list[str]:
        with zipfile.ZipFile(dist / f"{stem}-py3-none-any.whl", "w") as wheel:
            wheel.writestr(f"{stem}.dist-info/METADATA", text)
            for name in files:
                wheel.writestr(name, "")
        return list(release.list_faults(dist, root))

    with tarfile.open(dist / f"{stem}.tar.gz", "w:gz") as source:
        for name in ("README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "pyproject.toml"):
            source.addfile(tarfile.TarInfo(f"{stem}/{name}"))
    assert list_faults() == ["the source distribution lacks tests"]
    with tarfile.open(dist / f"{stem}.tar.gz", "w:gz") as source:
        for name in (
            *("README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "pyproject.toml"),
            "tests/test_a.py",
        ):
            source.addfile(tarfile.TarInfo(f"{stem}/{name}"))
    assert list_faults() == []
    release.check_distributions(dist, root)
    for name in names:
        rest = tuple(file for file in names if file != name)
        assert list_faults(files=rest) == [f"the wheel lacks {name}"]
    assert list_faults(files=(*names, "tests/a.py")) == ["the wheel has tests/a.py"]
    for old, new, word in (
        ("# Robot", "# Old", "README"),
        (">=3.11", ">=3.10", "Requires-Python"),
        ("Provides-Extra: live\n", "", "Provides-Extra"),
        ("Typed", "Untyped", "Classifier"),
        ("Version: 1.2.3", "Version: 1.2.2", "Version"),
    ):
        (fault,) = list_faults(metadata.replace(old, new))
        assert word in fault
    (dist / "some_robot-1.2.2.tar.gz").touch()
    with pytest.raises(SystemExit, match=r"1\.2\.2"):
        release.check_distributions(dist, root)


def test_generated_pages_escape_markup_and_simplify_templates() -> None:
    """Cases by hand: markup outside of code is escaped; a template shows the names of its values
    and the plural."""
    pages = script("docs/pages.py")
    assert pages._escape_markdown("a_b *c* [d] `e_f` $g") == r"a\_b \*c\* \[d\] `e_f` \$g"
    template = "{name!r}[limit? beyond {limit:.2f}], {n|foot|feet}: write {{values = [1]}}"
    assert pages._simplify_template(template) == (
        "⟨name⟩ [beyond ⟨limit⟩], feet: write {values = [1]}"
    )
    lines = ["least |f_t| of name_, ``a_``", "code::", "", "    x_ = *y", "so *it*"]
    pages.escape_docstring(lines)
    assert lines == [
        r"least \|f_t\| of name\_, ``a_``",
        *("code::", "", "    x_ = *y"),
        r"so \*it\*",
    ]


@pytest.mark.parametrize(
    ("template", "simplified"),
    [
        ("[option?--force][!option?force=True] replaces it", "[--force / force=True] replaces it"),
        ("{robot} [!why?站不住][why?站不住：{why}]", "⟨robot⟩ [站不住 / 站不住：⟨why⟩]"),
        ("其[lower?低 {lower:.3g}][higher?高 {higher}]：", "其[低 ⟨lower⟩ / 高 ⟨higher⟩]："),
        ("turn[share? at {share}][!share?, but not]", "turn [at ⟨share⟩ / , but not]"),
        ("{what}[some? {some}][times? {times:g} times]", "⟨what⟩ [⟨some⟩] [⟨times⟩ times]"),
        ("它[freed?克服后，][joints?，在 {joints}]抖动", "它[克服后，][，在 ⟨joints⟩]抖动"),
        ("down[swing? ({swing})][!swing?]", "down [(⟨swing⟩)]"),
    ],
)
def test_alternative_texts_of_a_template_are_separated(template: str, simplified: str) -> None:
    """Opposite conditions, or texts without a separator between them, exclude each other; other
    optional texts may occur together. Cases by hand."""
    assert script("docs/pages.py")._simplify_template(template) == simplified


def test_no_text_of_a_code_joins_two_alternatives(generated: Path) -> None:
    """Each alternative is in brackets: texts that a case excludes are not read as one sentence."""
    for language in ("en", "zh"):
        page = "".join(
            path.read_text()
            for path in (generated / language / "reference/generated/diagnostics").glob("*.md")
        )
        assert page.count(" / ") > 70, language
        assert "--forceforce=True" not in page
        assert "无法站立无法站立" not in page


def test_links_of_the_released_readme_point_to_its_tag() -> None:
    convert = script("scripts/check_release.py").convert_readme
    there = convert((ROOT / "README.md").read_text(), "https://git.example/us/it", "v1.2.3")
    targets = re.findall(r"\]\(([^)]+)\)", there)
    ours = [target for target in targets if target.startswith("https://git.example/us/it/")]
    assert [target for target in targets if not target.startswith("https://")] == []
    for target in ours:
        kind, tag, path = target.removeprefix("https://git.example/us/it/").split("/", 2)
        assert (kind, tag) == ("raw" if path.endswith(".png") else "blob", "v1.2.3")
        assert (ROOT / path).is_file()
    assert "https://git.example/us/it/raw/v1.2.3/docs/images/variants.png" in ours
    assert "pip install ." not in there
    assert "OWNER" not in there
    assert "pip install pupper-analysis\n" in there
    assert 'pip install "pupper-analysis[live,study]"' in there


def test_workflows_call_existing_make_targets() -> None:
    targets = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.M))
    workflows = list((ROOT / ".github/workflows").glob("*.yml"))
    assert targets
    assert workflows
    for path in workflows:
        text = path.read_text()
        named = {
            word for line in re.findall(r"run: make (.+)$", text, re.M) for word in line.split()
        }
        assert {name for name in named if re.fullmatch(r"[a-z][a-z-]+", name)} <= targets, path.name


def test_readme_names_make_targets_that_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
    named = set(re.findall(r"^make ([a-z-]+)", (ROOT / "README.md").read_text("utf-8"), re.M))
    assert named
    assert named <= targets


def test_contributing_names_make_targets_that_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(), re.M))
    named = set(re.findall(r"`make ([a-z-]+)", (ROOT / "CONTRIBUTING.md").read_text()))
    assert named <= targets
    assert {"setup", "test", "lint", "types", "docs", "coverage"} <= named


def test_commit_hooks_run_the_tools_of_the_project() -> None:
    text = (ROOT / ".pre-commit-config.yaml").read_text()
    assert re.findall(r"repo: (\S+)", text) == ["local"]
    entries = [entry.split()[:2] for entry in re.findall(r"entry: (.+)$", text, re.M)]
    assert {runner for runner, _ in entries} == {".ci/tool"}
    assert {tool for _, tool in entries} == {"ruff", "mypy", "lint-imports"}


def test_issue_form_requires_the_json_of_the_result() -> None:
    forms = {
        path.name: yaml.safe_load(path.read_text())
        for path in (ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml")
    }
    for name, form in forms.items():
        assert name == "config.yml" or {"name", "description", "body"} <= form.keys()
    (asked,) = [
        form_field for form_field in forms["wrong-answer.yml"]["body"] if form_field["id"] == "json"
    ]
    assert "--json" in asked["attributes"]["description"]
    assert asked["validations"]["required"]


def test_python_versions_of_the_classifiers_are_tested_on_both_systems() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    stated = [
        classifier.rpartition(" ")[2]
        for classifier in project["classifiers"]
        if re.search(r":: 3\.\d", classifier)
    ]
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    tested = re.search(r"python-version: \[(.+)\]", workflow)
    systems = re.search(r"os: \[(.+)\]", workflow)
    assert tested is not None
    assert systems is not None
    assert re.findall(r"[\d.]+", tested[1]) == stated
    assert project["requires-python"] == f">={stated[0]}"
    assert [system.strip() for system in systems[1].split(",")] == ["ubuntu-latest", "macos-latest"]


def test_python_code_of_pages_uses_public_names() -> None:
    checked = 0
    for page in PAGES:
        for code in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
            for node in ast.walk(ast.parse(code)):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    assert node.value.id != "pa" or hasattr(pa, node.attr), f"{page}: {node.attr}"
                    checked += node.value.id == "pa"
    assert checked > 20


def test_modules_named_in_docstrings_exist() -> None:
    for path in PACKAGE.rglob("*.py"):
        for name in re.findall(r"``pupper_analysis\.([a-z_.]+)``", path.read_text()):
            importlib.import_module(f"pupper_analysis.{name}")


def test_inline_code_in_docstrings_is_complete() -> None:
    """Code between double backquotes has no space at its ends, and its neighbours are spaces or
    punctuation; else reStructuredText takes the backquotes as text."""
    checked = 0
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                parts = (ast.get_docstring(node) or "").split("``")
                place = f"{path}: {getattr(node, 'name', 'module')}"
                assert len(parts) % 2 == 1, place
                for before, code, after in zip(parts[:-1:2], parts[1::2], parts[2::2], strict=True):
                    assert code, place
                    assert code == code.strip(), f"{place}: {code!r}"
                    assert re.search(r"(^|[\s('\"\[{</:=-])$", before), f"{place}: {code!r}"
                    assert re.match(r"$|[^\w`]", after), f"{place}: {code!r}"
                    checked += 1
    assert checked > 3000


def test_architecture_page_states_the_place_of_new_things() -> None:
    """For each subpackage, and for terms of the field: the first row with the term."""
    table = [row for row in rows("docs/explanation/architecture.md") if len(row) == 2]
    places = " ".join(row[1] for row in table)
    assert {folder for folder in LAYERS if re.search(rf"`{folder}/", places)} == set(LAYERS)
    expected = {
        "metric": "tools/push/metrics.py",
        "failure": "diagnose(",
        "friction cone": "statics/cone_program.py",
        "effort": "models/efforts.py",
        "solimp": "robot/contact.py",
        "static stability": "robot/stability.py",
        "armature": "models/conversion.py",
        "rule of the audit": "tools/audit/rules/catalogue.toml",
        "closed loop": "robot/closure.py",
        "eigenvalue": "robot/stability.py",
    }
    for term, place in expected.items():
        found = next(row for row in table if term in row[0])
        assert place in found[1], term
        assert (PACKAGE / place).exists() or "/" not in place
