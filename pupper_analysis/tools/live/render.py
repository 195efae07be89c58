"""Documents as panels of a page: small, in one language, and no name becomes part of the HTML."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import singledispatch
from html import escape

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.document import (
    Cell,
    Column,
    Document,
    Lines,
    Number,
    Table,
    Text,
    Words,
)
from pupper_analysis.present.formats import escape_control
from pupper_analysis.present.words import text
from pupper_analysis.tools.live.door import without_folders
from pupper_analysis.tools.live.scene import (
    BEYOND,
    SCALE,
    colour_of,
    to_css,
)

# The language of a page: its texts are those of the report's catalogue, and so is its Chinese.

NAMES = {"en": "English", "zh": "中文"}
"""{language: what it calls itself}."""


@dataclass(frozen=True)
class Language:
    """Says texts in one language.

    Attributes:
        code: ``"en"`` or ``"zh"``.
    """

    code: str = "en"

    def __post_init__(self) -> None:
        if self.code not in NAMES:
            raise ConfigurationError("language", diagnose("language-unknown", language=self.code))

    def __call__(self, key: str, **values: object) -> str:
        """Returns a text of the page.

        Args:
            key: The catalogue's.
            **values: What stands in its braces.

        Raises:
            KeyError: If the catalogue lacks it.
        """
        return self._of(text(key, **values))

    def sentence(self, told: Diagnostic) -> str:
        """Returns what a diagnostic says."""
        return told.with_names(without_folders).text(self.code)

    def either(self, choices: Iterable[str]) -> str:
        """Returns choices with the word for *or* between them."""
        return self("or").join(choices)

    def words(self, words: Words) -> str:
        """Returns words of a document."""
        return without_folders(self._of(words) if isinstance(words, Text) else words.text)

    def _of(self, words: Text) -> str:
        return words.zh if self.code == "zh" else words.en

    @property
    def other(self) -> Language:
        """The other one."""
        return Language("en" if self.code == "zh" else "zh")

    @property
    def name(self) -> str:
        """What it calls itself."""
        return NAMES[self.code]


STYLE = """<style>
.pa{font:13px/1.45 system-ui,sans-serif;padding:0 .9em .6em;overflow-wrap:anywhere}
.pa table{border-collapse:collapse;width:100%;margin:.35em 0 .7em}
.pa td,.pa th{overflow-wrap:break-word;padding:.1em .35em .1em 0;text-align:left}
.pa td,.pa th{font-weight:400;vertical-align:top}
.pa th{opacity:.72}
.pa th.n{text-align:right}
.pa td:not(:first-child){white-space:nowrap}
.pa td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.pa h4{margin:.7em 0 .1em;font-size:13px;font-weight:650}
.pa .good,.pa .bad,.pa .wait{border-left:4px solid;padding:.25em .6em;margin:.4em 0}
.pa .good{border-color:#1e8c46}.pa .bad{border-color:#c81e28}.pa .wait{border-color:#e0a020}
.pa .bar{display:inline-block;height:.62em;border-radius:2px;vertical-align:baseline}
.pa .scale{display:flex;height:.6em;border-radius:2px;margin:.2em 0 0}
</style>"""

PHONE = """<style>
.pa-page{display:none}
@media (max-width:36em){
.mantine-Paper-root:has(.pa-page){width:100% !important;max-height:55% !important}
.mantine-Paper-root:has(.pa-page) [style*="width: 20em"]{width:100% !important}
div:has(>.mantine-Paper-root .pa-page):not(:has([style*="display: none"] .pa-page))>div:has(canvas)
{height:45% !important}
.pa-page{display:block}
}
</style><div class="pa-page"></div>"""
"""Where viser has a sheet over the scene, as wide as a hand, the scene ends where it begins."""


_BOXES = {"good": "good", "bad": "bad", "warn": "wait"}
"""{emphasis: the class of a box}."""


def render_panel(document: Document, say: Language) -> str:
    """Returns a document: whose it is, its verdict and the reasons, and its blocks."""
    parts = [_headed(document.title, say), render_verdict(document, say)]
    parts += [_block(block, say) for block in document.blocks]
    return join_parts(*parts)


def render_brief(document: Document, say: Language) -> str:
    """Returns a document's verdict alone, for a screen that has no room for more."""
    return f'<div class="pa-page">{join_parts(render_verdict(document, say))}</div>'


def render_verdict(document: Document, say: Language) -> str:
    """Returns a document's verdict with its reasons, in one remark; nothing where it has none."""
    if document.passed is None:
        return ""
    told = (*document.failures, *document.told)
    if not told and document.verdict is not None:
        told = (document.verdict,)
    return _box(document.mark, "; ".join(say.words(one) for one in told))


def join_parts(*parts: str) -> str:
    """Returns parts as one piece of a page."""
    return f'{STYLE}<div class="pa">{"".join(parts)}</div>'


def render_waiting(words: Words, say: Language) -> str:
    """Returns that something is under way."""
    return join_parts(_box("warn", say.words(words)))


def render_hint(words: Words, say: Language) -> str:
    """Returns a hint where there is no result."""
    return join_parts(f"<div>{_said(say.words(words))}</div>")


def _headed(words: Words, say: Language) -> str:
    told = say.words(words)
    return f"<h4>{_said(told)}</h4>" if told else ""


def _said(told: str) -> str:
    """Returns a text as it is shown: nothing in it acts."""
    return escape(escape_control(told))


def _box(mark: str, told: str) -> str:
    return f'<div class="{_BOXES[mark]}">{_said(told)}</div>'


@singledispatch
def _block(_: object, __: Language) -> str:
    """Returns a block; plots and views are left out, as they are drawn beside the panels."""
    return ""


@_block.register
def _lines(block: Lines, say: Language) -> str:
    title = "" if block.title is None else _headed(block.title, say)
    told = [say.words(one) for one in block.lines]
    if block.mark:
        return title + "".join(_box(block.mark, one) for one in told)
    return title + "".join(f"<div>{_said(one)}</div>" for one in told)


@_block.register
def _table(block: Table, say: Language) -> str:
    """Returns a table; its header is shown where it tells units."""
    rows = []
    if any(column.unit for column in block.columns):
        heads = [say.words(one.name) + _unit(one) for one in block.columns]
        kinds = ["" if one.left else ' class="n"' for one in block.columns]
        cells = (f"<th{kind}>{_said(head)}</th>" for kind, head in zip(kinds, heads, strict=True))
        rows.append(f"<tr>{''.join(cells)}</tr>")
    rows += [f"<tr>{''.join(_cell(one, say) for one in row)}</tr>" for row in block.rows]
    barred = any(isinstance(cell, Number) and cell.share is not None
                 for row in block.rows for cell in row)  # fmt: skip
    kind = ' class="barred"' if barred else ""
    table = f"{_headed(block.title, say)}<table{kind}>{''.join(rows)}</table>"
    return table + (_scale(say) if barred else "")


def _unit(column: Column) -> str:
    """Returns a column's unit in parentheses, in one piece; nothing where it has none."""
    unit = column.unit.replace(" ", "\N{NO-BREAK SPACE}")
    return f" ({unit})" if unit not in ("", "1") else ""


def _cell(cell: Cell, say: Language) -> str:
    if not isinstance(cell, Number):
        return f"<td>{_said(say.words(cell))}</td>"
    number = f'<td class="n">{_said(cell.text)}</td>'
    if cell.share is None:
        return number
    width, colour = 3.0 * cell.share, to_css(colour_of(cell.value / 100))  # a share is in percent
    bar = f'<span class="bar" style="width:{width:.2f}em;background:{colour}"></span>'
    return f'{number}<td style="width:3.1em">{bar}</td>'


def _scale(say: Language) -> str:
    """Returns which colour is which part of a limit."""
    stops = ",".join(f"{to_css(colour)} {100 * share:.0f}%" for share, colour in SCALE)
    return (
        f'<div class="scale" style="background:linear-gradient(90deg,{stops})"></div>'
        '<div style="display:flex;justify-content:space-between"><span>0</span>'
        f'<span>50 %</span><span>100 % <b style="color:{to_css(BEYOND)}">'
        f"■ {_said(say.words(text('above')))}</b></span></div>"
    )
