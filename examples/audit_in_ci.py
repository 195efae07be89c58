"""Model files as a CI job: audits the files that the command line names.

One sees each finding as an annotation that GitHub shows beside the line of the file; the exit
status is 1 if one of them is an error. ``pupper-analysis audit FILE --format github`` does the same
from a shell; as a script it can have rules of its own.
"""

import sys

import pupper_analysis as pa

LEVELS = {"error": "error", "warning": "warning", "note": "notice"}
"""{severity: GitHub's word for it}"""


def main(paths: list[str]) -> int:
    """Audits files, and returns the exit status."""
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
