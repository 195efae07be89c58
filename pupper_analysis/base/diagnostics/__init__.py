"""Diagnostics: facts as data, with a code, a subject, values with units, and sources.

A diagnostic is created by ``diagnose`` with a code of the catalogue. The texts, in English and
Simplified Chinese, are in ``catalogue/*.toml``, and in the ``words.toml`` of tools and formats.
"""

from pupper_analysis.base.diagnostics.catalogue import CHINESE_SHORT_FORM as CHINESE_SHORT_FORM
from pupper_analysis.base.diagnostics.catalogue import LANGUAGES as LANGUAGES
from pupper_analysis.base.diagnostics.catalogue import SHORT_FORM as SHORT_FORM
from pupper_analysis.base.diagnostics.catalogue import Entry as Entry
from pupper_analysis.base.diagnostics.catalogue import codes as codes
from pupper_analysis.base.diagnostics.catalogue import entry as entry
from pupper_analysis.base.diagnostics.catalogue import is_term as is_term
from pupper_analysis.base.diagnostics.catalogue import meaning as meaning
from pupper_analysis.base.diagnostics.catalogue import phrase as phrase
from pupper_analysis.base.diagnostics.catalogue import term as term
from pupper_analysis.base.diagnostics.diagnostic import Diagnostic as Diagnostic
from pupper_analysis.base.diagnostics.diagnostic import Group as Group
from pupper_analysis.base.diagnostics.diagnostic import Severity as Severity
from pupper_analysis.base.diagnostics.diagnostic import Source as Source
from pupper_analysis.base.diagnostics.diagnostic import Subject as Subject
from pupper_analysis.base.diagnostics.diagnostic import Value as Value
from pupper_analysis.base.diagnostics.diagnostic import contains_error as contains_error
from pupper_analysis.base.diagnostics.diagnostic import diagnose as diagnose
from pupper_analysis.base.diagnostics.diagnostic import merge_diagnostics as merge_diagnostics
from pupper_analysis.base.diagnostics.templates import UNLIMITED as UNLIMITED
from pupper_analysis.base.diagnostics.templates import Phrase as Phrase
from pupper_analysis.base.diagnostics.templates import Quantity as Quantity
from pupper_analysis.base.diagnostics.templates import Term as Term
from pupper_analysis.base.diagnostics.templates import Vector as Vector
from pupper_analysis.base.diagnostics.templates import describe_bound as describe_bound
from pupper_analysis.base.diagnostics.templates import describe_effort as describe_effort
from pupper_analysis.base.diagnostics.templates import fill_template as fill_template
from pupper_analysis.base.diagnostics.templates import format_number as format_number
from pupper_analysis.base.diagnostics.templates import format_pair as format_pair
