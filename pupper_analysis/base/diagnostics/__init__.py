"""Facts as data: what was found, about what, with which numbers, from where; and their words.

Whoever finds something makes a ``Diagnostic`` by ``diagnose``, with a code of the catalogue. Words,
in English and in Simplified Chinese, are in ``catalogue/*.toml`` and nowhere else.
"""

from pupper_analysis.base.diagnostics.catalogue import (
    LANGUAGES,
    Entry,
    codes,
    entry,
    is_term,
    meaning,
    phrase,
    term,
)
from pupper_analysis.base.diagnostics.diagnostic import (
    Diagnostic,
    Group,
    Quantity,
    Severity,
    Source,
    Subject,
    Term,
    Value,
    Vector,
    diagnose,
    merge_diagnostics,
)
from pupper_analysis.base.diagnostics.templates import (
    UNLIMITED,
    Phrase,
    describe_bound,
    fill_template,
)

__all__ = [
    "LANGUAGES",
    "UNLIMITED",
    "Diagnostic",
    "Entry",
    "Group",
    "Phrase",
    "Quantity",
    "Severity",
    "Source",
    "Subject",
    "Term",
    "Value",
    "Vector",
    "codes",
    "describe_bound",
    "diagnose",
    "entry",
    "fill_template",
    "is_term",
    "meaning",
    "merge_diagnostics",
    "phrase",
    "term",
]
