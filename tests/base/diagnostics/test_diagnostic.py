"""Diagnostics: messages as codes with values, and the catalogues with their texts in two
languages.
"""

from __future__ import annotations

import ast
import json
import math
import pickle
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

from pupper_analysis.base import errors
from pupper_analysis.base.diagnostics import (
    LANGUAGES,
    Diagnostic,
    Quantity,
    Severity,
    Source,
    Term,
    Vector,
    codes,
    diagnose,
    entry,
    is_term,
    merge_diagnostics,
    term,
)
from pupper_analysis.base.diagnostics.catalogue import word_files
from pupper_analysis.base.diagnostics.templates import fill_template, format_number
from pupper_analysis.base.results import to_json
from tests.support.layers import PACKAGE, trees

WORDS = {
    whose: tomllib.loads(path.read_text(encoding="utf-8")) for whose, path in word_files().items()
}
TEXTS = WORDS.pop("texts") | {
    k: v for section in WORDS.values() for k, v in section.pop("texts", {}).items()
}
TERMS = WORDS.pop("terms") | {
    k: v for section in WORDS.values() for k, v in section.pop("terms", {}).items()
}
MEANINGS = WORDS.pop("meanings") | {
    k: v for section in WORDS.values() for k, v in section.pop("meanings", {}).items()
}
CODES = sorted(codes())
HAN = re.compile("[\u4e00-\u9fff]")


def list_template_names(template: str) -> set[str]:
    """Return the names of all required and optional values of a template."""
    optional = re.findall(r"\[!?(\w+)\?", template)
    holes = [name.split("|")[0] for _, name, _, _ in Formatter().parse(template) if name]
    return {*optional, *holes}


def list_templates(code: str) -> list[str]:
    """Return the templates of a diagnostic's text and short form, in both languages."""
    message = entry(code)
    return [*message.templates.values(), *message.short_templates.values()]


@cache
def made_calls() -> tuple[tuple[str, ast.Call], ...]:
    """All calls in the package, each with its module."""
    return tuple(
        (module, node)
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
    )


@cache
def list_package_texts() -> frozenset[str]:
    """Return all string literals of the package's code and of its page template."""
    page = files("pupper_analysis.present.html").joinpath("templates/page.html").read_text("utf-8")
    return frozenset(page.split('"')) | frozenset(
        node.value
        for tree in trees().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def find_diagnose_calls() -> Iterator[tuple[str, str, set[str] | None]]:
    """Yield (module:line, code, names of the given values) of each call of ``diagnose``.

    The names are None if the call takes ``**values``. The code must be a literal or a choice of
    literals; it is an argument of ``change_of``, ``check_floating`` and ``check_base_is_free``.
    """
    for module, node in made_calls():
        made = getattr(node.func, "id", None)
        is_refusal = getattr(node.func, "attr", None) == "check_floating" and bool(node.args)
        if made in ("change_of", "check_base_is_free") or is_refusal:
            argument = node.args[made == "check_base_is_free"]
            for code in literals(argument, f"{module}:{node.lineno}", trees()[module]):
                yield f"{module}:{node.lineno}", code, None
        if made != "diagnose" or ast.unparse(node).startswith("diagnose(code, subject=subject"):
            continue
        named = {word.arg for word in node.keywords if word.arg}
        if "subject" in named:
            named.add("name")
        given = None if any(word.arg is None for word in node.keywords) else named
        for code in literals(node.args[0], f"{module}:{node.lineno}", trees()[module]):
            yield f"{module}:{node.lineno}", code, given


def pair_assignment(node: ast.Assign) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Yield target and value of an assignment; of a tuple, each pair."""
    for target in node.targets:
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            yield from zip(target.elts, node.value.elts, strict=True)
        else:
            yield target, node.value


def literals(node: ast.expr, where: str, tree: ast.Module) -> Iterator[str]:
    if isinstance(node, ast.IfExp):
        yield from literals(node.body, where, tree)
        yield from literals(node.orelse, where, tree)
    elif isinstance(node, ast.Name):  # assigned in an earlier line, or default of an argument
        for definition in ast.walk(tree):
            if isinstance(definition, ast.FunctionDef):
                names = [argument.arg for argument in definition.args.args]
                for name, default in zip(names[::-1], definition.args.defaults[::-1], strict=False):
                    if name == node.id and isinstance(default, ast.Constant) and default.value:
                        yield str(default.value)
            for target, value in (
                pair_assignment(definition) if isinstance(definition, ast.Assign) else ()
            ):
                if ast.unparse(target) == node.id:
                    yield from literals(value, where, tree)
    elif isinstance(node, ast.Subscript):  # value of a table in the same module
        (table,) = (
            assignment.value
            for assignment in tree.body
            if isinstance(assignment, ast.Assign)
            and ast.unparse(assignment.targets[0]) == ast.unparse(node.value)
        )
        yield from ast.literal_eval(table).values()
    else:
        assert isinstance(node, ast.Constant), f"{where}: a code is a literal"
        yield str(node.value)


@pytest.mark.slow
def test_catalogue_equals_tomllib_and_each_code_is_in_one_file() -> None:
    """Reference: the catalogue files, read by `tomllib`."""
    found = []
    for read in WORDS.values():
        found += list(read)
        for code, stated in read.items():
            assert set(stated) <= {"severity", "group", "short", "short_zh", *LANGUAGES}, code
            short_forms = {"en": stated.get("short", ""), "zh": stated.get("short_zh", "")}
            assert dict(entry(code).short_templates) == short_forms
            assert dict(entry(code).templates) == {
                language: stated[language] for language in LANGUAGES
            }
    assert sorted(found) == CODES


@pytest.mark.slow
def test_each_code_has_a_message_in_both_languages() -> None:
    """Both templates use the same values, and the Chinese text contains Chinese characters if the
    English text contains words.
    """
    assert CODES
    for code in CODES:
        message = entry(code)
        assert message.severity in list(Severity), code
        assert message.group in ("wrong", "assumed", "found"), code
        assert list_template_names(message.templates["en"]) == list_template_names(
            message.templates["zh"]
        ), code
        assert len(message.short_templates["en"]) <= len(message.templates["en"]), code
        chinese = re.sub(r"\[!?\w+\?|\]", "", message.short_templates["zh"])  # without conditions
        assert len(chinese) <= len(message.templates["zh"]), code
        words = re.sub(r"\{[^}]*\}|\[!?\w+\?", "", message.templates["en"])
        if re.search("[a-z]{4}", words) and "pip install" not in words:
            assert HAN.search(message.templates["zh"]), code


def test_short_form_contains_the_short_forms_of_inner_diagnostics_in_its_language() -> None:
    inner = diagnose("triangle-inequality", share=Quantity(0.9, "1"))
    message = diagnose("error-at", where="a.urdf", what=inner)
    assert message.short == "a.urdf: inertia violates the triangle inequality by 90 %"
    assert message.short_zh == "a.urdf：惯量违反三角不等式，相差 90 %"
    without = diagnose("problem", problem="text")
    assert (without.short_zh, without.get_short_form("zh")) == ("", without.text("zh"))


@pytest.mark.slow
def test_catalogue_contains_exactly_the_codes_in_use() -> None:
    """Reference: all calls in the package's syntax trees."""
    used = {code for _, code, _ in find_diagnose_calls()}
    assert used - set(CODES) == set()
    assert set(CODES) - used == set()


@pytest.mark.slow
def test_every_template_gets_its_values() -> None:
    """Reference: keyword arguments of each `diagnose` call in the syntax trees."""
    lacking = {
        f"{where} {code}": missing
        for where, code, given in find_diagnose_calls()
        if given is not None
        and (missing := list_template_names("".join(list_templates(code))) - given)
    }
    assert lacking == {}


SENTENCE = re.compile("[a-z]+ [a-z]+ [a-z]+")


@pytest.mark.slow
def test_errors_contain_diagnostics_instead_of_sentences() -> None:
    """Reference: the syntax tree.

    No error of the package is constructed from a literal sentence.
    """
    made = {name for name, one in vars(errors).items() if name.endswith("Error")}
    found, kinds = set(), set()
    for module, node in made_calls():
        name = getattr(node.func, "id", None)
        if name == "UnknownNameError":
            kinds |= {arg.value for arg in node.args[1:2] if isinstance(arg, ast.Constant)}
        elif name in made:
            words = [constant.value for given in node.args for constant in ast.walk(given)
                     if isinstance(constant, ast.Constant)]  # fmt: skip
            if any(map(SENTENCE.search, map(str, words))):
                found.add(module)
    assert found == set()
    assert all(map(is_term, kinds - {None})), kinds


# --- templates


@pytest.mark.parametrize(
    ("template", "values", "english"),
    [
        ("{mass}", {"mass": Quantity(1.5, "kg")}, "1.5 kg"),
        ("{mass:g:.0f}", {"mass": Quantity(1.5, "kg")}, "1500 g"),
        ("{gap:mm:.1f}", {"gap": Quantity(0.01234, "m")}, "12.3 mm"),
        ("{turn:deg:.1f}", {"turn": Quantity(np.pi / 6, "rad")}, "30.0 deg"),
        ("{turn:.1f}", {"turn": Quantity(np.pi / 6, "rad")}, "30.0 deg"),
        ("{turn::.1f}", {"turn": Quantity(np.pi / 6, "rad")}, "30.0"),
        ("{turn:stated:.2f}", {"turn": Quantity(np.pi / 6, "rad")}, "0.52 rad"),
        ("{at:read:.3g}", {"at": Quantity(np.pi / 6, "rad")}, "30 deg"),
        ("{at:read:.3g}", {"at": Quantity(0.02, "m")}, "20 mm"),
        ("{at:read:.3g}", {"at": Quantity(0.02, "rad or m")}, "0.02 rad or m"),
        ("{x:mm:.3g} or {x:deg:.3g}", {"x": Quantity(0.01, "rad or m")}, "10 mm or 0.573 deg"),
        ("{share:%:.0f}", {"share": Quantity(0.25, "1")}, "25 %"),
        (
            "{mass:g} {time:g}",
            {"mass": Quantity(2, "kg"), "time": Quantity(0.5, "s")},
            "2000 g 0.5 s",
        ),
        ("{share:.2f}", {"share": Quantity(0.25, "1")}, "0.25"),
        ("{x:.2f} {x}", {"x": 2 / 3}, "0.67 0.6666666666666666"),
        ("{name!r}", {"name": "a b"}, "'a b'"),
        ("{n} {n|foot|feet}", {"n": 1}, "1 foot"),
        ("{n} {n|foot|feet}", {"n": 3}, "3 feet"),
        ("{all|foot|feet} {all}", {"all": ("FR", "FL")}, "feet FR, FL"),
        ("{all:2}", {"all": ("a", "b", "c", "d")}, "a, b and 2 more"),
        ("{all:2}", {"all": ("a", "b", "c")}, "a, b, c"),
        (
            "{all:;1}",
            {"all": (diagnose("fell-over"),) * 3},
            "the robot fell over; 2 more failures",
        ),
        (
            "{all:;1}",
            {"all": (diagnose("fell-over"), diagnose("no-effect"), diagnose("no-effect"))},
            "the robot fell over; 2 more findings",
        ),
        ("{all:;2|mm:.0f}", {"all": (Quantity(0.001, "m"), Quantity(0.002, "m"))}, "1 mm; 2 mm"),
        ("{all!r:or}", {"all": ("a", "b")}, "'a' or 'b'"),
        ("{all:,or}", {"all": ("a", "b", "c")}, "a, or b, or c"),
        ("it[limit? ends at {limit}].", {"limit": Quantity(2, "m")}, "it ends at 2 m."),
        ("it[limit? ends at {limit}].", {"limit": None}, "it."),
        ("it[limit? ends][!limit? goes on].", {"limit": ()}, "it goes on."),
        ("{name}", {"name": "{mass} [limit? x]"}, "{mass} [limit? x]"),
        ("{one:.3g} {two:.3g}", {"one": 2.0, "two": 2.0}, "2 2"),
        ("{one:.3g} {two:.3g}", {"one": 2.0, "two": 2.00001}, "2 2.00001"),
        ("{old:g} {new:g}", {"old": 1e-3, "new": 1.0000005e-3}, "0.001 0.0010000005"),
        (
            "{one} or {two:stated:.3g}",
            {"one": Quantity(0.5, "m"), "two": Quantity(0.50000001, "m")},
            "0.5 m or 0.50000001 m",
        ),
        (
            "{urdf:mm:.3g} {mjcf:mm:.3g}",
            {"urdf": Quantity(0.5, "m"), "mjcf": Quantity(0.50000001, "m")},
            "500 mm 500.00001 mm",
        ),
        (
            "{one} {two}",
            {"one": Vector((1.0, 2.0), "kg"), "two": Vector((1.0, 2.00000004), "kg")},
            "(1, 2) kg (1, 2.00000004) kg",
        ),
        ("{one:.3g} {two:.3g}", {"one": math.nan, "two": math.nan}, "nan nan"),
    ],
)
def test_templates_are_filled_with_values(
    template: str, values: dict[str, object], english: str
) -> None:
    assert fill_template(template, values, "en") == english


# --- diagnostics


def message() -> Diagnostic:
    return diagnose(
        "foot-misses-target",
        subject=("foot", "FL"),
        gap=Quantity(np.float64(0.002), "m"),
        sources=Source("a.urdf", 7, "joint/limit", "effort"),
    )


def test_a_diagnostic_survives_pickling_and_can_be_compared() -> None:
    assert pickle.loads(pickle.dumps(message())) == message()
    assert len({message(), message()}) == 1
    other = diagnose("foot-misses-target", subject=("foot", "FR"), gap=Quantity(0.002, "m"))
    assert other != message()
    with pytest.raises(TypeError, match="cannot be changed"):
        message().values["gap"] = 3  # type: ignore[index]


def test_json_of_a_diagnostic_has_code_values_units_sources_and_words() -> None:
    (shown,) = json.loads(to_json({"notes": [message()]}))["notes"]
    source = {"file": "a.urdf", "line": 7, "element": "joint/limit", "attribute": "effort"}
    assert shown == {
        **{"code": "foot-misses-target", "severity": "error", "message": "FL by 2 mm"},
        "subject": {"kind": "foot", "name": "FL"},
        "values": {"gap": {"value": 0.002, "unit": "m"}},
        "sources": [source],
    }


def test_unknown_code_raises() -> None:
    with pytest.raises(KeyError):
        diagnose("no-such-code")  # the test of codes in use reads the package, not the tests


def test_arrays_become_tuples_and_unsupported_values_raise() -> None:
    assert diagnose("problem", problem=np.array([1, 2])).values["problem"] == (1, 2)
    assert diagnose("problem", problem=Path("a/b")).values["problem"] == "a/b"
    with pytest.raises(TypeError):
        diagnose("problem", problem=object())


def test_terms_are_translated_and_unknown_terms_are_kept() -> None:
    assert term("joint", "zh") == "关节"
    assert term("no such term", "zh") == "no such term"


def test_diagnostic_within_another_has_the_same_language() -> None:
    inner = diagnose("name-unknown", kind=Term("joint"), unknown="knee", known=("hip", "foot"))
    assert inner.text("en") == "no joint 'knee'; there are: hip, foot"
    assert inner.text("zh") == "没有关节 'knee'；现有：hip、foot"
    outer = diagnose("argument-not-valid", field="feet", problem=inner)
    assert outer.text("zh") == "feet：没有关节 'knee'；现有：hip、foot"


def test_merged_diagnostics_are_sorted_by_severity_without_repetitions() -> None:
    near, wrong = diagnose("try-another-height"), diagnose("joint-at-limit", subject=("joint", "a"))
    lesser = diagnose("problem", problem="less", severity=Severity.WARNING)
    worst = diagnose("problem", problem="worst")
    assert merge_diagnostics([near, lesser, wrong, worst, near]) == (worst, lesser, near, wrong)


def test_inertia_difference_is_stated_in_both_languages() -> None:
    entry = diagnose(
        "inertia-entry-differs",
        entry="ixx",
        one=Quantity(0.018, "kg m^2"),
        two=Quantity(0.016, "kg m^2"),
        guess=diagnose("relative-change", change=Quantity(-0.0739, "1")),
        first=Term("the URDF"),
        second=Term("the MJCF"),
    )
    found = diagnose("inertia-differs", subject=("body", "base"), entries=[entry, entry])
    english = "ixx 0.018 kg m^2 in the URDF, 0.016 kg m^2 in the MJCF (-7.39 %)"
    assert str(found) == f"link base: inertia about the com: {english}; {english}"
    chinese = "ixx 在 URDF 中为 0.018 kg m^2，在 MJCF 中为 0.016 kg m^2（-7.39 %）"
    assert found.text("zh") == f"连杆 base：关于质心的惯量：{chinese}；{chinese}"


def test_error_names_its_file_and_contains_its_diagnostic() -> None:
    problem = diagnose("feet-miss-targets", feet=("FL",))
    error = errors.ModelError("a.urdf", problem)
    assert str(error) == "a.urdf: the feet miss their targets: FL"
    assert error.problem == "the feet miss their targets: FL"
    assert error.diagnostic.text("zh") == "a.urdf：各足未到达目标：FL"
    again = pickle.loads(pickle.dumps(error))
    assert again.diagnostic == error.diagnostic
    assert str(again) == str(error)


def test_package_never_searches_its_own_messages() -> None:
    """A program must decide by codes and values, not by the text of a note or an error."""
    reads = re.compile(
        r"""["'] (?:not )?in (?:note|sentence|str\(error\)|error\.problem)\b"""
        r"""|\b(?:note|sentence|message|problem)\.(?:startswith|endswith|partition)\("""
    )
    found = {path for path in PACKAGE.rglob("*.py") if reads.search(path.read_text("utf-8"))}
    assert found == set()


@pytest.mark.parametrize(
    ("value", "spec", "expected"),
    [
        (-0.0, ".1f", "0.0"),
        (-0.04, ".1f", "0.0"),
        (-0.04, "+.1f", "+0.0"),
        (-1e-5, ".0%", "0 %"),
        (-0.0, "g", "0"),
        (-0.0, ".1e", "0.0e+00"),
        (-0.06, ".1f", "-0.1"),
        (-1e-30, "g", "-1e-30"),
    ],
)
def test_number_that_is_rounded_to_zero_has_no_minus(
    value: float, spec: str, expected: str
) -> None:
    assert format_number(value, spec) == expected


@pytest.mark.parametrize(
    ("value", "spec", "expected"),
    [
        (0.0556, ".1%", "5.6 %"),
        (0.16, ".0%", "16 %"),
        (0.039, ".2g%", "3.9 %"),
        (2e7, ".2g%", "2000000000 %"),
        (9.9e8, ".2g%", "99000000000 %"),
        (2e9, ".2g%", "2e+11 %"),
        (2e-8, ".2g%", "0.000002 %"),
    ],
)
def test_percentages_have_a_space_before_the_sign(value: float, spec: str, expected: str) -> None:
    """Reference: ISO 80000-1, 7.1.4: a space precedes the percent sign, in every format."""
    assert format_number(value, spec) == expected
