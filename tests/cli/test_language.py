"""Answers in Chinese: option ``--language``, its environment variable, and texts without English.

References: the numbers of the English answer, and the width of a terminal in cells.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len

from pupper_analysis import cli
from pupper_analysis.cli.shared import LANGUAGE_OPTION, LANGUAGE_VARIABLE
from pupper_analysis.present import terminal
from pupper_analysis.present.document import MAX_ANSWER_WIDTH, Document, Name, Report, Text
from tests.cli.test_answers import COMMANDS
from tests.support.commands import Answer, answer
from tests.support.every_command import share_robots
from tests.support.printing import printed
from tests.support.shared_rollouts import share_rollouts

ENGLISH_SENTENCE = re.compile(r"(?<![\w./=\"'-])[a-z]{2,}(?:,? [a-z]{2,}){2,}(?![\w./=-])")
"""Three or more words of at least two lower-case letters, which no name and no path contains."""

NUMBER = re.compile(r"(?<![A-Za-z_\d.])[-+±]?\d+(?:\.\d+)?(?:e[-+]\d+)?")
"""Number that is no part of a name, such as the 3 of ``leg_back_r_3``."""

QUANTITY = re.compile(
    rf"{NUMBER.pattern} (N m s/rad|N m/rad|N m|N s|kg|mm/min|mrad/min|mm|%)(?![A-Za-z])"
)
"""Number with a unit that is spelt equally in both languages."""


def list_sentences(lines: str) -> str:
    """Return the lines without next commands, which contain the words that the user typed."""
    return "\n".join(line for line in lines.splitlines() if "pupper-analysis " not in line)


def check_chinese(lines: str) -> None:
    """Check that lines contain Chinese characters, and no English sentence."""
    text = list_sentences(lines)
    assert re.search("[\u4e00-\u9fff]", text), text
    assert ENGLISH_SENTENCE.findall(text) == [], text


@pytest.fixture(scope="module", autouse=True)
def simulate_once() -> Iterator[None]:
    """Prepare each robot and simulate each rollout once for all commands and both languages."""
    with share_robots(), share_rollouts():
        yield


@pytest.mark.parametrize("name", cli.COMMAND_NAMES)
def test_each_command_has_the_same_option_for_the_language(name: str) -> None:
    options = [param for param in cli.find_command(name).params if param.name == "language"]
    assert len(options) == 1
    assert options[0] is LANGUAGE_OPTION


def test_stand_prints_the_numbers_of_the_english_answer_in_chinese() -> None:
    english, chinese = answer("stand", "v3", "-v"), answer("stand", "v3", "-v", "--language", "zh")
    assert english.returncode == chinese.returncode == 0
    check_chinese(chinese.stdout)
    head, *_ = chinese.stdout.splitlines()
    assert head.startswith("保持稳定 v3：")
    assert QUANTITY.findall(head) == ["N m", "%"]
    texts = [list_sentences(found.stdout) for found in (english, chinese)]
    # Sentences come before the tables, whose layout depends on the widths of the headers.
    sentences = [text.partition("\n\n")[0].splitlines() for text in texts]
    assert len(sentences[0]) == len(sentences[1]) > 5
    for lines in zip(*sentences, strict=True):
        first, second = ([match[0] for match in QUANTITY.finditer(line)] for line in lines)
        assert sorted(first) == sorted(second), lines
    counts = [Counter(NUMBER.findall(text)) for text in texts]
    assert counts[0] == counts[1]


def test_short_answer_is_cut_at_the_end_of_a_chinese_clause() -> None:
    """A message without a short form is cut. Reference: the full message."""
    message = f"{'第一句' * 10}；{'第二句' * 10}"
    document = Document(Name("kind"), Name("v3"), (), findings=(Text("", message),))
    (line,) = printed(document, everything=False, width=200, language="zh").splitlines()
    assert line == f"v3：{'第一句' * 10} …"
    assert cell_len(line) <= MAX_ANSWER_WIDTH


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("convert", "v3", "-o", "new.xml"),
        ("diff", "v3", "v3-heavy"),
        ("workspace", "v3"),
        ("payload", "v3"),
    ],
    ids=lambda words: words[0],
)
def test_short_chinese_answer_has_the_numbers_of_the_english_answer(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    """Reference: the English answer. Chinese texts without short form lost numbers."""
    heads = []
    for language in ("en", "zh"):
        lines = answer(*words, "--language", language, "--force", folder=tmp_path).stdout
        heads.append(list_sentences(lines).splitlines()[:2])
        assert all(cell_len(line) <= MAX_ANSWER_WIDTH for line in heads[-1])
    english, chinese = (Counter(NUMBER.findall("\n".join(head))) for head in heads)
    assert english - chinese == Counter()


def test_environment_variable_sets_the_language_and_the_option_has_priority(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("LANG", "zh_CN.UTF-8")  # the locale has no effect
    monkeypatch.delenv(LANGUAGE_VARIABLE, raising=False)
    english = answer("audit", "v3")
    assert english.stdout.startswith("OK ")
    monkeypatch.setenv(LANGUAGE_VARIABLE, "zh")
    assert answer("audit", "v3").stdout.startswith("正常 ")
    option = answer("audit", "v3", "--language", "en")
    assert list_sentences(option.stdout) == list_sentences(english.stdout)


@pytest.mark.parametrize("words", [("--language", "fr"), ()])
def test_other_languages_are_refused_with_the_valid_values(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, "en" if words else "fr")
    refused = answer("stand", "v3", *words)
    assert refused.returncode == 2
    assert refused.stdout == ""
    assert "'fr' is not one of 'en', 'zh'" in refused.stderr
    assert LANGUAGE_VARIABLE in refused.stderr


def test_json_and_markdown_do_not_depend_on_the_language() -> None:
    for words in (("--format", "markdown"), ("--json", "-")):
        texts = [
            answer("crosscheck", "v3", *words, "--language", language).stdout
            for language in ("en", "zh")
        ]
        # The provenance contains the command line and the date.
        plain = [re.sub(r"language.{0,6}(en|zh)|\d\d:\d\d:\d\d", "", text) for text in texts]
        assert plain[0] == plain[1]
        assert len(plain[0]) > 1000


@pytest.mark.parametrize(
    ("words", "refusal", "proposal"),
    [
        (("stand", "v3", "--height", "1m"), "站姿不可达", "stand v3 --language zh --height"),
        (("stand", "v3", "--kp", "leg_frnt_r_1=5"), "leg_frnt_r_1", "--kp leg_front_r_1=5"),
        (("stand", "absent.urdf"), "没有这个文件", ""),
        (("crosscheck", "v3", "--map", "a"), "的格式不是 URDF=MJCF（例如 lf_haa=FL_hip）", ""),
        (("stand", "v3", "--contact", "FR=wall"), "（例如 wall:0.4m）", ""),
        (("live", "v3", "--drop", "--no-browser"), "只用于 --policy、网页；", ""),
    ],
)
def test_refusals_are_chinese(words: tuple[str, ...], refusal: str, proposal: str) -> None:
    refused = answer(*words, "--language", "zh")
    assert refused.returncode == 2
    assert refused.stderr.startswith("错误：")
    assert refusal in refused.stderr
    check_chinese(refused.stderr)
    assert ("  下一步：pupper-analysis " in refused.stderr) == bool(proposal)
    assert proposal in refused.stderr


@pytest.mark.slow
def test_all_answers_have_the_english_numbers_and_no_english_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command runs once in Chinese; its report is printed in full in both languages."""
    reports: list[Report] = []
    print_report = terminal.print_report

    def record_report(out: terminal.SafeConsole, report: Report, **options: Any) -> None:
        reports.append(report)
        print_report(out, report, **options)

    monkeypatch.setattr(terminal, "print_report", record_report)
    monkeypatch.setenv(LANGUAGE_VARIABLE, "zh")
    (tmp_path / "study.toml").write_text(
        'robot = "v3"\nmeasure = ["peak_utilisation"]\n[vary]\npayload = [0.0, 0.1]\n'
    )
    words = {"robot": "v3", "pair": "v3", "new": "new.xml", "edited": "v3-heavy"}
    for line in COMMANDS:
        typed = line.format(**words)
        found: Answer = answer(*shlex.split(typed), folder=tmp_path)
        assert found.returncode in (0, 1) or found.stderr.startswith("错误："), (typed, found)
        lines = found.stdout or found.stderr
        check_chinese(lines)
        assert cell_len(lines.splitlines()[0]) <= MAX_ANSWER_WIDTH, typed
    assert len(reports) > 15
    for report in reports:
        english, chinese = (printed(report, language=language) for language in ("en", "zh"))
        check_chinese(chinese)
        numbers = [Counter(NUMBER.findall(text)) for text in (english, chinese)]
        assert numbers[0] == numbers[1], report.title
