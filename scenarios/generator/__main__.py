"""`python -m scenarios.generator SCENARIO [--variant V] [--set k=v]... [--check]`: makes a scenario's bags and says
where they are."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from scenarios import definition
from scenarios.generator import bags, checking


def main(arguments: list[str] | None = None) -> int:
    """Exit code 0 when the bags exist (and, with --check, are sound), 1 when something is wrong with them, 2 on bad
    usage."""
    parser = argparse.ArgumentParser(prog="python -m scenarios.generator", description="Makes the bags of a scenario.")
    parser.add_argument("scenario", type=Path, help="folder of the scenario")
    parser.add_argument("--variant", help="named set of parameters in scenario.yaml")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="overrides a parameter")
    parser.add_argument("--check", action="store_true", help="reads every bag and checks it")
    given = parser.parse_args(arguments)
    try:
        scenario = definition.load(given.scenario, given.set, given.variant)
        made = bags.make_bags(scenario, progress=lambda text: print(text, file=sys.stderr))
        for agent, folder in made.items():
            if given.check:
                checking.check_bag(folder, scenario, agent)
            print(folder)
    except definition.ScenarioError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
