"""Selection: the application that answers a demand, and the chart version of each of its services, with reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.manager.core.composition.inputs import Demand, Inputs, Schema
from robotkube.delivery.manager.core.placement.reasons import NAMED_MAX
from robotkube.errors import RefusalError, did_you_mean
from robotkube.foundation.documents.core.defaults import with_defaults
from robotkube.foundation.documents.core.yaml_codec import json_problems
from robotkube.registry.catalogue.core.applications import Application, ChartRequirement, Service
from robotkube.registry.catalogue.core.catalogue import Catalogue, Pin
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement
from robotkube.registry.catalogue.core.versions import LOWEST, Precedence, version_key
from robotkube.registry.charts.core.values_schemas import Validate, deployed, names_value

Chosen = tuple[ChartVersion, tuple[str, ...]]


@dataclass(frozen=True)
class Choice:
    """The application for a demand, its parameters with their defaults, and why it was chosen."""

    application: Application
    parameters: Mapping[str, Any]
    reasons: tuple[str, ...] = ()


class Selector:
    """The selector of one catalogue; `withheld`, `validate` and `schema` are as in Inputs."""

    def __init__(
        self, catalogue: Catalogue, withheld: Mapping[Pin, str], validate: Validate, schema: Schema | None
    ) -> None:
        self.catalogue = catalogue
        self.withheld = dict(withheld)
        self.validate = validate
        self.schema = schema

    def serves(self, inputs: Inputs) -> bool:
        """Return whether it selects for these inputs as for its own."""
        return (
            self.catalogue is inputs.catalogue
            and self.withheld == inputs.withheld
            and self.validate == inputs.validate
            and self.schema == inputs.schema
        )

    def chart(
        self,
        requirement: ChartRequirement,
        more: tuple[GuaranteeRequirement, ...] = (),
        platforms: frozenset[str] = frozenset(),
        pinned: Pin | None = None,
    ) -> Chosen:
        """As Catalogue.select."""
        return self.catalogue.select(requirement, more, platforms, pinned, self.withheld)

    def bridge(self, kind: str) -> tuple[Service, Chosen]:
        """The service that bridges links of a kind, and its chart if nothing else is asked of it; RefusalError when the
        catalogue has not exactly one, or no version of its chart."""
        application = self.catalogue.bridge(kind)
        if len(application.services) != 1:
            raise RefusalError(
                "CompositionFailed", f"bridge application {application.name} must have exactly one service"
            )
        return application.services[0], self.chart(application.services[0].chart)

    def application(self, demand: Demand, kept: str = "") -> Choice:
        """The application that is named, or the best that provides what is asked for: the one that answers the task
        already (`kept`) as long as it can, else the one whose first service has the highest version, then by name."""
        if not demand.provides:
            named = self.catalogue.applications.get(demand.application)
            if named is None:
                known = sorted(self.catalogue.applications)
                instead = f"{did_you_mean(demand.application, known)}it has {', '.join(known) or 'nothing'}"
                raise RefusalError(
                    "UnknownApplication", f"the catalogue has no application {demand.application!r}; {instead}"
                )
            return Choice(named, self._checked(named, demand))
        candidates = [a for _, a in sorted(self.catalogue.applications.items()) if demand.provides in a.provides]
        if not candidates:
            raise RefusalError("UnknownApplication", f"no application of the catalogue provides {demand.provides}")
        return self._best(candidates, demand, kept)

    def _best(self, candidates: Sequence[Application], demand: Demand, kept: str) -> Choice:
        good: list[tuple[Application, Mapping[str, Any], Any]] = []
        refused: list[tuple[str, RefusalError]] = []
        for application in candidates:
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

    def _rank(self, application: Application, demand: Demand) -> Precedence:
        chosen = [self.chart(service.chart, demand.requirements)[0] for service in application.services]
        return version_key(chosen[0].version if chosen else LOWEST)

    def _checked(self, application: Application, demand: Demand) -> Mapping[str, Any]:
        self.catalogue.admit(application)
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
        silent = [str(requirement) for requirement in demand.requirements if requirement.name not in stated]
        if silent:
            has = ", ".join(sorted(stated)[:NAMED_MAX]) or "none"
            raise RefusalError(
                "GuaranteeNotMet",
                f"no service of {application.name} states a guarantee for {', '.join(silent)}; stated are {has}",
            )
        return parameters

    def check_values(self, chart: ChartVersion, values: Mapping[str, Any], key: str) -> None:
        """Check composed values of the release `key`: RefusalError(CompositionFailed) with every problem and its path,
        when no file could carry them, or when they break the chart's schema."""
        problems = json_problems(values, "values")
        if not problems and self.schema is not None:
            problems = self._schema_problems(chart, values, self.schema)
        if problems:
            raise RefusalError("CompositionFailed", f"chart {chart.chart} {chart.version}: {'; '.join(problems)}")

    def knows_guests(self, chart: ChartVersion) -> bool:
        """Return whether releases of a chart can run on the guests of a Node: its published schema, as far as it is at
        hand, has the value."""
        schema = self.schema(chart.chart, chart.version) if self.schema is not None else None
        return schema is None or names_value(schema, "placement", "guest")

    def deployed(self, chart: ChartVersion, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """A release's values laid over the chart's own, as far as its published schema is at hand."""
        schema = self.schema(chart.chart, chart.version) if self.schema is not None else None
        full: Mapping[str, Any] = deployed(schema or {}, values)
        return full

    def _schema_problems(self, chart: ChartVersion, values: Mapping[str, Any], schemas: Schema) -> list[str]:
        schema = schemas(chart.chart, chart.version)
        if schema is not None:
            return list(self.validate(schema, deployed(schema, values), "values"))
        if self.catalogue.assurance == "none":
            return []
        path = f"charts/{chart.chart}/{chart.version}.schema.json"
        return [f"the catalogue has no {path} to check the values by; submit the chart again"]
