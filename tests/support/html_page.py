"""Reader of a report: elements, tables, and whether the HTML is well-formed."""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser

from lxml import etree
from lxml import html as lxml_html

VOID_TAGS = frozenset(("meta", "link", "input", "br", "img", "hr"))
"""Elements without an end tag."""


class StrictParser(HTMLParser):
    """HTML parser that raises an error where browsers would silently repair."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), (tag, names)
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID_TAGS:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, tag
        assert self.open[-1] == tag, (tag, self.open[-5:], self.getpos())
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)


@dataclass
class Page:
    """Report that has been parsed.

    Attributes:
        text: Text of the file.
        strict: Result of the strict parser.
        root: Tree of the elements.
    """

    text: str
    strict: StrictParser = field(init=False)
    root: etree._Element = field(init=False)

    def __post_init__(self) -> None:
        self.strict = StrictParser()
        self.strict.feed(self.text)
        self.strict.close()
        assert self.strict.open == []
        self.root = lxml_html.document_fromstring(self.text.encode(), base_url=None)

    def tables(self) -> dict[str, list[dict[str, str]]]:
        """Return {title: [{header with unit: cell} per row]}, in English; of tables with the same
        title the first.
        """
        found: dict[str, list[dict[str, str]]] = {}
        for title, rows in self.list_tables():
            found.setdefault(title, rows)
        return found

    def list_tables(self) -> list[tuple[str, list[dict[str, str]]]]:
        """Return (title, [{header with unit: cell} per row]) of each table, in English."""
        found = []
        for figure in self.root.iter("figure"):
            if figure.get("class") != "table":
                continue
            headers = [read_text(header) for header in figure.findall(".//thead//th")]
            rows = [
                dict(zip(headers, (read_text(cell) for cell in row), strict=True))
                for row in figure.findall(".//tbody/tr")
            ]
            found.append((read_text(figure.find("figcaption")), rows))
        return found

    def shown(self) -> str:
        """Return the displayed English text, without scripts."""
        return read_text(self.root.find("body"))


def read_text(element: etree._Element, language: str = "en") -> str:
    """Return the text of an element in one language."""
    other = "zh" if language == "en" else "en"

    def walk(node: etree._Element) -> str:
        if node.tag in ("script", "style") or other in (node.get("class") or "").split():
            return ""
        return (node.text or "") + "".join(walk(child) + (child.tail or "") for child in node)

    return " ".join(walk(element).split())
