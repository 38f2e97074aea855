"""`assistax doctor`."""

import sys

from assistax.cli.common import Json, print_json, print_table


def doctor(*, json: Json = False) -> None:
    """Say what is installed, which engine is used and why; step and render for two seconds.

    Args:
      json: print JSON.
    """
    from assistax.diagnostics.doctor import diagnose

    report = diagnose()
    if json:
        print_json(report)
    else:
        print_table(report)
    if "FAILED" in report["self_test"] + report["rendering"]:
        sys.exit(1)
