"""Audit model files in CI.

The output shows each finding as an annotation, which GitHub displays at the line of the file. The
exit status is 1 if an audit fails. ``pupper-analysis audit FILE --format github`` prints
annotations from a shell; a script can have rules of its own.
"""

import sys

import pupper_analysis as pa

LEVELS = {"error": "error", "warning": "warning", "note": "notice"}
"""{severity: level of the annotation}."""


def main(paths: list[str]) -> int:
    """Audit the files and return the exit status."""
    passed = True
    for path in paths:
        audit = pa.audit_model(path)
        for found in audit.findings:
            place = f"file={found.file},line={found.line or 1}"
            print(f"::{LEVELS[found.severity]} {place}::{found.message} [{found.rule}]")
        print(f"{path}: {'passed' if audit.passed else 'FAILED'}, {len(audit.rules_run)} rules")
        passed = passed and audit.passed
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
