"""The Chinese site: the same settings as the English one, of ``docs/conf.py``."""

from __future__ import annotations

import logging
import runpy
from pathlib import Path

import jieba

globals().update(runpy.run_path(str(Path(__file__).resolve().parents[1] / "conf.py")))

language = "zh_CN"
exclude_patterns: list[str] = []
jieba.setLogLevel(logging.WARNING)  # it tells that it loads its dictionary
templates_path = ["_templates", "../_templates"]
locale_dirs = ["locale"]
html_context = {"other_language": ("English", "../index.html")}
