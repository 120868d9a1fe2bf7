"""`python -m scenarios.runner run SCENARIO --cluster demo [--variant small] [--set key=value]...`: one run and its
report.

Exit code 0 when every expectation holds, 1 when one does not or the run broke off, 2 on bad usage, 3 without a cluster.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ci.errors import SetUpError
from scenarios import definition
from scenarios.definition import ScenarioError
from scenarios.runner import running


def main(arguments: list[str] | None = None) -> int:
    """Parses the command line and runs."""
    parser = argparse.ArgumentParser(prog="python -m scenarios.runner", description="Runs a scenario on a platform.")
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("run", help="one run on a cluster that is up, with the platform installed")
    command.add_argument("scenario", type=definition.find, help="its folder, or its name below scenarios/")
    command.add_argument("--cluster", default="demo", help="name of the cluster")
    command.add_argument("--variant", help="named set of parameters or steps in scenario.yaml")
    command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="overrides a parameter")
    command.add_argument("--reports", type=Path, default=running.REPORTS, help="folder of the reports")
    given = parser.parse_args(arguments)
    try:
        settings = dict(pair(text) for text in given.set)
        return running.run(given.scenario, given.cluster, settings, given.variant, reports=given.reports)
    except ScenarioError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted; the platform keeps running", file=sys.stderr)
        return 130


def pair(text: str) -> tuple[str, str]:
    """Splits `key=value`."""
    key, sign, value = text.partition("=")
    if not key or not sign:
        raise ScenarioError(f"--set {text}: must have the form key=value, such as vehicles=3")
    return key, value


if __name__ == "__main__":
    sys.exit(main())
