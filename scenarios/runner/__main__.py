"""`python -m scenarios.runner run SCENARIO [--cluster KIND] [--variant small] [--set key=value]...`: one run and its
report; `drive SCENARIO --minutes 30` lets its players go round without a report, and `--minutes 0` stand.

Exit code 0 when every expectation holds, 1 when one does not or the run broke off, 2 on bad usage, 3 without a cluster.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from ci.cluster import choosing
from ci.cluster_contract.provider import Provider
from ci.errors import SetUpError
from scenarios import definition
from scenarios.definition import ScenarioError
from scenarios.runner import running
from scenarios.runner.platform.access import Access
from scenarios.runner.playing import driving
from scenarios.runner.waiting import RunError


def main(arguments: list[str] | None = None) -> int:
    """Parses the command line and runs."""
    parser = argparse.ArgumentParser(prog="python -m scenarios.runner", description="Runs a scenario on a platform.")
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("run", help="one run on a cluster that is up, with the platform installed")
    add_scenario(command)
    command.add_argument("--reports", type=Path, default=running.REPORTS, help="folder of the reports")
    command.set_defaults(act=run)
    command = commands.add_parser("drive", help="its players go round, or stand, on a cluster where it has run before")
    add_scenario(command)
    command.add_argument("--minutes", type=driving.minutes, required=True, help="for how long; 0: they stand")
    command.set_defaults(act=drive)
    given = parser.parse_args(arguments)
    try:
        return int(given.act(given, dict(pair(text) for text in given.set)))
    except (ScenarioError, RunError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted; the platform keeps running", file=sys.stderr)
        return 130


def add_scenario(command: argparse.ArgumentParser) -> None:
    """Adds what names a scenario and its cluster."""
    command.add_argument("scenario", type=definition.find, help="its folder, or its name below scenarios/")
    choosing.add_arguments(command)
    command.add_argument("--variant", help="named set of parameters or steps in scenario.yaml")
    command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="overrides a parameter")


def run(given: argparse.Namespace, settings: Mapping[str, str]) -> int:
    """One run; its exit code."""
    return running.run(given.scenario, provider_of(given), settings, given.variant, reports=given.reports)


def drive(given: argparse.Namespace, settings: Mapping[str, str]) -> int:
    """Lets the players go round, or stand."""
    scenario = definition.load(given.scenario, [f"{key}={text}" for key, text in settings.items()], given.variant)
    provider = provider_of(given)
    access = Access(provider.kubeconfig(), provider.reach)
    driving.drive(access, scenario, given.minutes, print)
    return 0


def provider_of(given: argparse.Namespace) -> Provider:
    """The cluster that is named; InputError."""
    return choosing.provider(choosing.choice(given))


def pair(text: str) -> tuple[str, str]:
    """Splits `key=value`."""
    key, sign, value = text.partition("=")
    if not key or not sign:
        raise ScenarioError(f"--set {text}: must have the form key=value, such as vehicles=3")
    return key, value


if __name__ == "__main__":
    sys.exit(main())
