"""`make demo`: from nothing to the scenario's report. Every step is idempotent and says what it found in the cache.

python -m scenarios.demo SCENARIO [--variant manager-killed] [--set vehicles=3] [--until cluster|platform]
    [--cluster KIND]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ci import publish
from ci.cluster import choosing
from ci.cluster.choosing import Choice
from ci.cluster_contract import topology
from ci.cluster_contract.provider import Provider
from ci.errors import SetUpError
from ci.images import preparation
from ci.installation import Installer
from ci.machine import preparing
from ci.steps import Steps
from scenarios import definition
from scenarios.definition import Scenario, ScenarioError
from scenarios.generator import routes
from scenarios.runner import running
from scenarios.runner.platform.access import Access
from scenarios.runner.platform.inspection import ROBOTKUBE
from scenarios.runner.playing import driving, needs

STOPS = ("cluster", "platform", "scenario")
STEPS = {"cluster": 3, "platform": 6, "scenario": 7}


@dataclass(frozen=True)
class Request:
    """What is to be run: scenario folder, overrides of its parameters, cluster, last step; `kept` is the folder of
    evidence for the publication (default: the user's cache); `variant` is a named set of parameters or steps; `values`
    are values of the platform's chart for this cluster; `driving` is for how many minutes the players go on driving
    after the run."""

    scenario: Path
    settings: dict[str, str]
    cluster: Choice
    until: str
    kept: Path | None = None
    variant: str | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    driving: float = 0

    @property
    def described(self) -> str:
        """What one run has in common with another that takes as long."""
        settings = (f"{key}={value}" for key, value in sorted(self.settings.items()))
        return " ".join([self.scenario.name, *([self.variant] if self.variant else []), *settings])

    def settled(self) -> Scenario:
        """The scenario with its parameters; ScenarioError."""
        return definition.load(self.scenario, [f"{key}={value}" for key, value in self.settings.items()], self.variant)


def bring_up(request: Request, steps: Steps) -> Installer:
    """Tool chain, images, cluster, Argo CD, platform, catalogue. Returns the installer of the running cluster.

    Scenario and settings are checked before anything is started; raises ScenarioError or SetUpError.
    """
    settled = request.settled()
    if settled.players:
        routes.duration_seconds(settled.parameters)
    counts = {"vehicles": str(settled.parameters.vehicles)}
    wanted = topology.read(request.scenario / "scenario.yaml", counts)
    with steps.step("tool chain"):
        binaries = preparing.tool_chain()
    with steps.step("images"):
        prepared = preparation.everything()
    provider = choosing.provider(request.cluster, binaries)
    with steps.step("cluster"):
        provider.up(wanted, prepared.images)
    kubeconfig = provider.kubeconfig()
    installer = Installer(binaries, kubeconfig, provider.work(), provider.chart_profile())
    if request.until == "cluster":
        return installer
    with steps.step("Argo CD") as step:
        step.note = installer.argocd(prepared.references())
    with steps.step("platform") as step:
        installer.platform(prepared.references(), wanted, values=request.values, say=step.progress)
        step.progress(where_to_look(installer, provider))
        if machines := provider.machines():
            nodes = publish.find_forge(kubeconfig, publish.PULL_ACCOUNT)
            believed = publish.authorities(kubeconfig) if nodes.url.startswith("https://") else ""
            machines.pull_from(nodes.url, nodes.username, nodes.password, believed)
    with steps.step("catalogue") as step:
        extra = settled.extra_charts
        published = publish.publish(kubeconfig, step.progress, request.kept, extra, provider.reach)
        step.note = published.outcome.verdict
    return installer


def where_to_look(installer: Installer, provider: Provider) -> str:
    """The sentence that says where the fleet is seen."""
    console = installer.console()
    if console is None:
        return f"No console; `{ROBOTKUBE} watch` shows the fleet."
    return f"The console shows the fleet: {provider.way_of_a_person(console).instruction}"


def run(request: Request) -> int:
    """Exit code of the whole: the scenario's when it ran."""
    steps = Steps(STEPS[request.until])
    provider = choosing.provider(request.cluster)
    needs.require_machines(request.settled(), provider)
    installer = bring_up(request, steps)
    if request.until != "scenario":
        print(f"export KUBECONFIG={installer.kubeconfig}")
        return 0
    with steps.step("scenario", of=request.described):
        seconds = dict(steps.seconds)
        code = running.run(request.scenario, provider, request.settings, request.variant, set_up_seconds=seconds)
    print(where_to_look(installer, provider))
    if request.driving:
        driving.drive(Access(provider.kubeconfig(), provider.reach), request.settled(), request.driving, print)
    return code


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="make demo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenario", type=definition.find, help="its folder, or its name below scenarios/")
    parser.add_argument("--variant", help="named set of parameters or steps in scenario.yaml")
    parser.add_argument("--set", action="append", default=[], metavar="PARAMETER=VALUE")
    choosing.add_arguments(parser)
    parser.add_argument("--driving", type=driving.minutes, default=0, metavar="MINUTES", help="the players go on")
    parser.add_argument("--until", choices=STOPS, default="scenario")
    given = parser.parse_args()
    try:
        settings = topology.overrides(given.set)
        cluster = choosing.choice(given)
        wanted = Request(given.scenario, settings, cluster, given.until, variant=given.variant, driving=given.driving)
        return run(wanted)
    except (SetUpError, ScenarioError) as error:
        print(f"error: {error}", file=sys.stderr)
        return getattr(error, "exit_code", 1)
    except KeyboardInterrupt:
        print("interrupted; what was finished is kept, `make down` removes what runs", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
