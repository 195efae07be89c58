"""The language of a page: its texts are those of the report's catalogue, and so is its Chinese."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.document import Text, Words
from pupper_analysis.present.words import text
from pupper_analysis.tools.live.door import without_folders

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
