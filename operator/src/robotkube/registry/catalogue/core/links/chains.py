"""Chains of services: the names that a new application of several services may have, and its document.

Each service has a chart of its own, `<application>-<service>`, and hands what it makes to the next one on a topic of
the application: the first reads the parameter `input`, the last writes `output`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from robotkube.foundation.documents.core.patterns import (
    NEW_CHART_NAME,
    NEW_SERVICE_NAME,
    ROS_TOPIC,
    ROS_TOPIC_CHARACTERS_MAX,
)

SERVICES_MAX = 8
TOPIC_PATTERN = f"^{ROS_TOPIC.pattern}$"


def chart_name(application: str, service: str) -> str:
    """The name of a service's chart."""
    return f"{application}-{service}"


def ros_word(name: str) -> str:
    """A name as a part of ROS names, which have no hyphens."""
    return name.replace("-", "_")


def service_problems(application: str, services: Sequence[str]) -> list[str]:
    """Everything that is wrong with the names of the services, each with its fix."""
    problems = []
    if not 1 <= len(services) <= SERVICES_MAX:
        problems.append(f"{len(services)} services; give 1 to {SERVICES_MAX}, separated by commas")
    for service in dict.fromkeys(services):
        if services.count(service) > 1:
            problems.append(f"service {service!r} stands twice; give each a name of its own")
        if not NEW_SERVICE_NAME.fullmatch(service):
            problems.append(f"service {service!r}: use lower-case letters, digits and single hyphens, a letter first")
        elif not NEW_CHART_NAME.fullmatch(chart_name(application, service)):
            problems.append(f"service {service!r}: its chart would be named {chart_name(application, service)!r}, "
                            "which may have 30 characters; shorten one of the names")  # fmt: skip
    return problems


def chain_document(application: str, services: Sequence[str], provides: str) -> str:
    """The application's document: its services, one behind the other."""
    return f"""apiVersion: registry.robotkube.io/v1alpha1
kind: Application
metadata:
  name: {application}
spec:
  description: "Hands texts on from service to service: {", ".join(services)}"
  provides: [{provides}]
  parameters:
    type: object
    additionalProperties: false
    properties:
      input:
        description: full name of the topic that the first service reads
        type: string
        pattern: "{TOPIC_PATTERN}"
        maxLength: {ROS_TOPIC_CHARACTERS_MAX}
        default: /{ros_word(application)}/in
      output:
        description: full name of the topic that the last service writes
        type: string
        pattern: "{TOPIC_PATTERN}"
        maxLength: {ROS_TOPIC_CHARACTERS_MAX}
        default: /{ros_word(application)}/out
  services:
{"".join(_service(application, services, index) for index in range(len(services)))}{_links(services)}"""


def _service(application: str, services: Sequence[str], index: int) -> str:
    chart = chart_name(application, services[index])
    made = [f"/{ros_word(application)}/{ros_word(service)}" for service in services[:-1]]
    heard = ['"{{ parameters.input }}"', *made][index]
    said = [*made, '"{{ parameters.output }}"'][index]
    return f"""  - name: {services[index]}
    release: {chart}
    chart: {{name: {chart}, version: ">=0.1.0 <0.2.0"}}
    placement: {{role: cloud}}
    values:
      relay:
        input: {heard}
        output: {said}
"""


def _links(services: Sequence[str]) -> str:
    links = [f"  - {{kind: ros, from: {{service: {a}}}, to: {{service: {b}}}}}\n" for a, b in pairwise(services)]
    return "".join(["  links:\n", *links]) if links else ""
