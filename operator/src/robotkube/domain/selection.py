"""Which application answers a demand, and which chart version each of its services runs: choices with their reasons.

Remembers what it chose: the answers depend on one catalogue only. `Selector`s are thrown away with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.domain.catalogue import Catalogue, Pin
from robotkube.domain.catalogue_applications import Application, ChartRequirement, Service
from robotkube.domain.catalogue_charts import ChartVersion
from robotkube.domain.errors import RefusalError
from robotkube.domain.guarantees import GuaranteeRequirement
from robotkube.domain.placement import NAMED_MAX
from robotkube.domain.tasks import with_defaults
from robotkube.domain.texts import json_problems
from robotkube.domain.values_schemas import Validate, deployed
from robotkube.domain.versions import version_key
from robotkube.domain.worlds import Demand, Schema

CHOICES_KEPT_MAX = 4096

Chosen = tuple[ChartVersion, tuple[str, ...]]


@dataclass(frozen=True)
class Choice:
    """The application for a demand, its parameters with their defaults, and why it was taken."""

    application: Application
    parameters: Mapping[str, Any]
    reasons: tuple[str, ...] = ()


class Selector:
    """Selects from one catalogue; `withheld` as World says it."""

    def __init__(
        self, catalogue: Catalogue, withheld: Mapping[Pin, str], validate: Validate, schema: Schema | None
    ) -> None:
        self.catalogue, self.withheld, self.validate, self.schema = catalogue, dict(withheld), validate, schema
        self._known: dict[Any, Chosen | RefusalError] = {}
        self._bridges: dict[str, tuple[Service, Chosen]] = {}

    def serves(self, catalogue: Catalogue, withheld: Mapping[Pin, str], schema: Schema | None) -> bool:
        """Whether answers given so far hold for these inputs."""
        return self.catalogue is catalogue and self.withheld == withheld and self.schema == schema

    def chart(
        self,
        requirement: ChartRequirement,
        more: tuple[GuaranteeRequirement, ...] = (),
        platforms: frozenset[str] = frozenset(),
        pinned: Pin | None = None,
    ) -> Chosen:
        """As Catalogue.select; the same question is answered once."""
        key = (requirement, more, platforms, pinned)
        if key not in self._known:
            while len(self._known) >= CHOICES_KEPT_MAX:
                self._known.pop(next(iter(self._known)))
            try:
                self._known[key] = self.catalogue.select(requirement, more, platforms, pinned, self.withheld)
            except RefusalError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, RefusalError):
            raise RefusalError(found.reason, found.message)
        return found

    def bridge(self, kind: str) -> tuple[Service, Chosen]:
        """The service that bridges links of a kind, and its chart if nothing else is asked of it; RefusalError when the
        catalogue has not exactly one, or no version of its chart."""
        if kind not in self._bridges:
            application = self.catalogue.bridge(kind)
            if len(application.services) != 1:
                raise RefusalError(
                    "CompositionFailed", f"bridge application {application.name} must have exactly one service"
                )
            self._bridges[kind] = application.services[0], self.chart(application.services[0].chart)
        return self._bridges[kind]

    def application(self, demand: Demand, kept: str = "") -> Choice:
        """The application that is named, or the best that provides what is asked for: the one that answers the task
        already (`kept`) as long as it can, else the one whose first service has the highest version, then by name."""
        if not demand.provides:
            named = self.catalogue.applications.get(demand.application)
            if named is None:
                known = ", ".join(sorted(self.catalogue.applications)) or "nothing"
                raise RefusalError(
                    "UnknownApplication", f"the catalogue has no application {demand.application!r}; it has {known}"
                )
            return Choice(named, self._checked(named, demand))
        found = [a for _, a in sorted(self.catalogue.applications.items()) if demand.provides in a.provides]
        if not found:
            raise RefusalError("UnknownApplication", f"no application of the catalogue provides {demand.provides}")
        return self._best(found, demand, kept)

    def _best(self, found: Sequence[Application], demand: Demand, kept: str) -> Choice:
        good: list[tuple[Application, Mapping[str, Any], Any]] = []
        refused: list[tuple[str, RefusalError]] = []
        for application in found:
            try:
                parameters = self._checked(application, demand)
                good.append((application, parameters, self._rank(application, demand)))
            except RefusalError as error:
                refused.append((application.name, error))
        against = [f"application {name}: {error.reason}: {error.message}" for name, error in refused]
        if not good:
            reasons = {error.reason for _, error in refused}
            reason = "GuaranteeNotMet" if "GuaranteeNotMet" in reasons else refused[0][1].reason
            raise RefusalError(reason, f"{demand.provides}: {'; '.join(against)}")
        chosen, parameters, _ = max(good, key=lambda one: (one[0].name == kept, one[2]))  # the first of equals by name
        better = "answers it already" if chosen.name == kept else "is newer, or first by name"
        others = [f"application {a.name}: possible; {chosen.name} {better}" for a, _, _ in good if a is not chosen]
        return Choice(
            chosen, parameters, (f"application {chosen.name}: taken, it provides {demand.provides}", *others, *against)
        )

    def _rank(self, application: Application, demand: Demand) -> tuple[int, int, int, bool, str]:
        chosen = [self.chart(service.chart, demand.requirements)[0] for service in application.services]
        return version_key(chosen[0].version) if chosen else (0, 0, 0, False, "")

    def _checked(self, application: Application, demand: Demand) -> Mapping[str, Any]:
        parameters = with_defaults(application.parameters, demand.parameters)
        problems = self.validate(application.parameters, parameters, "parameters")
        if problems:
            raise RefusalError("InvalidParameters", "; ".join(problems))
        stated = {
            guarantee.name
            for service in application.services
            for version in self.catalogue.candidates(service.chart)
            for guarantee in version.guarantees
        }
        silent = [str(one) for one in demand.requirements if one.name not in stated]
        if silent:
            has = ", ".join(sorted(stated)[:NAMED_MAX]) or "none"
            raise RefusalError(
                "GuaranteeNotMet",
                f"no service of {application.name} states a guarantee for {', '.join(silent)}; stated are {has}",
            )
        return parameters

    def check_values(self, chart: ChartVersion, values: Mapping[str, Any]) -> None:
        """RefusalError(CompositionFailed) when composed values could not be carried by a file, or break the chart's
        schema: every problem with its path in the values."""
        problems = json_problems(values, "values")
        if not problems and self.schema is not None:
            problems = self._schema_problems(chart, values, self.schema)
        if problems:
            raise RefusalError("CompositionFailed", f"chart {chart.chart} {chart.version}: {'; '.join(problems)}")

    def _schema_problems(self, chart: ChartVersion, values: Mapping[str, Any], schemas: Schema) -> list[str]:
        schema = schemas(chart.chart, chart.version)
        if schema is not None:
            return list(self.validate(schema, deployed(schema, values), "values"))
        if self.catalogue.assurance == "none":
            return []
        path = f"charts/{chart.chart}/{chart.version}.schema.json"
        return [f"the catalogue has no {path} to check the values by; submit the chart again"]
