"""Texts of documents and pages, and terms: each key has both languages and is used."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from string import Formatter

import pytest

from pupper_analysis.base.diagnostics import CHINESE_SHORT_FORM, LANGUAGES, SHORT_FORM, phrase
from pupper_analysis.base.diagnostics.catalogue import LINE_ENTRY_FILES, list_entries
from pupper_analysis.present.document import Name, join_words, text, word
from pupper_analysis.tools.study.measures import METRICS
from tests.base.diagnostics.test_diagnostic import (
    HAN,
    TERMS,
    TEXTS,
    WORDS,
    list_package_texts,
    list_template_names,
    made_calls,
)
from tests.support.repository import ROOT

SYMBOLS = re.compile(r"\{[^}]*\}|\[!?\w+\?|\b(kd|kp|yourdfpy|URDF|MJCF|OK|None)\b")
"""Parts of a text that are equal in both languages."""

FORMS = (*LANGUAGES, SHORT_FORM, CHINESE_SHORT_FORM)
"""Keys of a catalogue entry."""

CHINESE_SYNONYMS = {
    "起始姿态": "初始姿态",
    "位形": "构型",
    "姿势": "姿态",
    "接触形状": "碰撞形状",
    "碰撞外形": "碰撞形状",
    "显示外形": "显示形状",
    "联动": "跟随",
    "连续力矩": "持续力矩",
    "力矩限值": "力矩上限",
    "正向动力学": "正动力学",
    "塌下": "倒塌",
    "倾覆": "翻倒",
    "摔倒": "跌倒",
    "压入": "陷入",
    "蠕变": "蠕动",
    "脚掌": "足底",
    "滚转": "横滚",
    "最差姿态": "最不利姿态",
    "处理步骤": "准备步骤",
    "裕量": "裕度",
    "契约": "约定",
    "测量项": "指标",
    "读法": "解读",
}
"""{Chinese synonym: the term of the Chinese texts for the same concept}."""


WITHOUT_CHINESE_SHORT_FORM = {"walk-speed-line"}
"""Keys of texts with a short English form whose Chinese text is as short."""


@pytest.mark.parametrize("words", [TEXTS, TERMS], ids=["texts", "terms"])
def test_catalogue_entries_have_both_languages(words: dict[str, dict[str, str]]) -> None:
    """Both texts use the same values; Chinese texts contain Chinese characters and punctuation."""
    assert words
    for key, both in words.items():
        assert set(both) - {SHORT_FORM, CHINESE_SHORT_FORM} == set(LANGUAGES), key
        short = re.sub(r"\[!?\w+\?|\]", "", both.get(SHORT_FORM, ""))  # without conditions
        assert len(short) <= len(both["en"]), key
        short = re.sub(r"\[!?\w+\?|\]", "", both.get(CHINESE_SHORT_FORM, ""))
        assert len(short) <= len(both["zh"]), key
        english, chinese = both["en"], both["zh"]
        assert list_template_names(english) == list_template_names(chinese), key
        plain = SYMBOLS.sub("", english)
        assert HAN.search(chinese) or not re.search("[a-z]{4}", plain), key
        assert not HAN.search(english), key
        shown = re.sub(r"\[!?\w+\?", "[", chinese)  # without the names of conditions
        assert not re.search(r"[,;:?!](?=[\u4e00-\u9fff])", shown), f"punctuation of {chinese}"


def test_short_forms_exist_in_both_languages_with_equal_values() -> None:
    """A short answer has equal numbers in both languages, also if a message is too wide."""
    entries = TEXTS | TERMS
    for diagnostics in WORDS.values():
        entries |= diagnostics
    forms = (SHORT_FORM, CHINESE_SHORT_FORM)
    shortened = {key: entry for key, entry in entries.items() if entry.keys() & set(forms)}
    assert len(shortened) > 200
    lacking = {key for key, entry in shortened.items() if not entry.keys() >= set(forms)}
    assert lacking == WITHOUT_CHINESE_SHORT_FORM
    for key in shortened.keys() - lacking:
        english, chinese = (list_template_values(shortened[key][form]) for form in forms)
        assert english == chinese, key


def list_template_values(template: str) -> set[str]:
    """Return the names of the values that a template prints, without words chosen by a number."""
    names = (name for _, name, _, _ in Formatter().parse(template) if name)
    return {name for name in names if "|" not in name}


def test_chinese_texts_name_each_concept_by_one_term() -> None:
    """Chinese catalogues and pages contain no synonym of a term.

    Generated pages repeat texts of the catalogues, also those of an earlier build.
    """
    catalogues = (ROOT / "pupper_analysis").rglob("*.toml")
    pages = [page for page in (ROOT / "docs/zh").rglob("*.md") if "generated" not in page.parts]
    files = [*catalogues, ROOT / "docs/words.toml", *pages]
    contents = {file: file.read_text(encoding="utf-8") for file in files}
    assert any("初始姿态" in content for content in contents.values())
    for file, content in contents.items():
        for synonym, used in CHINESE_SYNONYMS.items():
            assert synonym not in content, f"{file.name}: {synonym} instead of {used}"


@pytest.mark.parametrize(("file", "words"), [("terms.toml", TERMS), ("texts.toml", TEXTS)])
def test_entries_on_one_line_are_found_as_tomllib_reads_them(
    file: str, words: dict[str, dict[str, str]]
) -> None:
    """The catalogue finds entries by a pattern, without parsing the file."""
    assert file in LINE_ENTRY_FILES
    assert set(list_entries(file)) == set(words)
    for key, texts in words.items():
        found = {language: phrase(key, language) for language in FORMS}
        assert {language: text for language, text in found.items() if text} == texts


def test_key_of_a_text_and_of_a_term_has_one_translation() -> None:
    """`phrase` searches the texts first."""
    assert [key for key in TEXTS if TEXTS[key] != TERMS.get(key, TEXTS[key])] == []


@pytest.mark.slow
def test_catalogue_has_no_unused_text() -> None:
    """Reference: all texts in the source code and in the page template."""
    measures = {f"metric-{name.replace('_', '-')}" for name in METRICS}
    left = set(TEXTS) - list_package_texts() - measures
    assert {key for key in left if not key.startswith(tuple(list_key_beginnings()))} == set()


def list_key_beginnings() -> Iterator[str]:
    """Yield the beginnings of keys that end with a value, as in `text(f"walk-quantity-{name}")`."""
    for _, node in made_calls():
        one = node.args[0] if node.args and getattr(node.func, "id", "") == "text" else None
        if isinstance(one, ast.JoinedStr) and isinstance(one.values[0], ast.Constant):
            yield str(one.values[0].value)


def test_text_raises_for_an_unknown_key() -> None:
    with pytest.raises(KeyError):
        text("no-such-text")
    assert word("leg_front_r_1") == Name("leg_front_r_1")


def test_text_keys_are_lower_case_with_hyphens() -> None:
    """Keys differ from the English text, so that a corrected text keeps its translation."""
    assert [key for key in TEXTS if not re.fullmatch("[a-z0-9]+(-[a-z0-9]+)*", key)] == []


def test_values_of_a_text_are_in_its_language() -> None:
    message = text("force-axis", axis=text("roll"))
    assert (message.en, message.zh) == ("force roll", "力 横滚")
    listed = join_words([text("mass"), Name("com {x}")])
    assert (listed.en, listed.zh) == ("mass, com {x}", "质量、com {x}")


@pytest.mark.slow
def test_each_text_of_the_code_exists_and_gets_its_values() -> None:
    """Calls of ``text`` with a literal key, or with one of two."""
    count = 0
    for module, node in made_calls():
        if getattr(node.func, "id", "") != "text" or not node.args:
            continue
        given = {keyword.arg for keyword in node.keywords}
        choices = [node.args[0]]
        while choices:
            one = choices.pop()
            if isinstance(one, ast.IfExp):
                choices += [one.body, one.orelse]
            elif isinstance(one, ast.Constant) and isinstance(one.value, str):
                count += 1
                needed = list_template_names(phrase(one.value, "en"))
                assert None in given or needed <= given, f"{module}:{node.lineno}"
    assert count > 300


@pytest.mark.slow
def test_each_term_of_the_code_is_in_the_catalogue() -> None:
    """Calls of ``Term`` with a literal key, or with one of two; without an entry it is English."""
    keys = set[str]()
    for _, node in made_calls():
        if getattr(node.func, "id", "") != "Term" or not node.args:
            continue
        choices = [node.args[0]]
        while choices:
            one = choices.pop()
            if isinstance(one, ast.IfExp):
                choices += [one.body, one.orelse]
            elif isinstance(one, ast.Constant) and isinstance(one.value, str):
                keys.add(one.value)
    assert len(keys) > 50
    assert keys - set(TERMS) - set(TEXTS) == set()
