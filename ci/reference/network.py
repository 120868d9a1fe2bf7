"""The tables of docs/reference/network.md, from the platform chart's table of who may reach whom."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from ci.docs import markdown
from ci.folders import PROJECT

TABLE = PROJECT / "charts" / "robotkube" / "files" / "network.yaml"
PAGE = PROJECT / "docs" / "reference" / "network.md"
BEGIN, END = "<!-- written by `make reference`: begin -->", "<!-- end -->"
NAMESPACES = {
    "platform": "the platform's",
    "gate": "the gate's",
    "argocd": "Argo CD's",
    "agents": "each agent's",
    "recording": "each recording agent's",
    "test": "each test namespace",
    "probe": "`<namespace of the release>-probe`",
}
AT = {
    "name-service": "UDP and TCP, `networkPolicies.dns.ports`",
    "api-server": "TCP, `networkPolicies.apiServer.ports`",
    "kubelets": "TCP, `networkPolicies.kubelets.ports`",
    "collector": "TCP, the port in `traces.endpoint`",
    "multicast": "UDP, every port of 239.255.0.1",
    "same": "every port and protocol",
}


def read_table() -> Mapping[str, Any]:
    """The table as the chart reads it."""
    table: Mapping[str, Any] = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return table


def page(text: str) -> str:
    """The page with its tables anew. ValueError without both marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{PAGE.name} needs both marks: {BEGIN} and {END}")
    return markdown.wrapped("\n".join([f"{before}{begin}", *_tables(read_table()), f"{end}{after}"]))


def _tables(table: Mapping[str, Any]) -> Iterator[str]:
    yield from ("| name | namespace | pods |", "| --- | --- | --- |")
    for name, party in table["parties"].items():
        yield f"| `{name}` | {NAMESPACES[party['namespaces']]} | {party['what']} |"
    yield from ("", "| who | reaches | at | because |", "| --- | --- | --- | --- |")
    for edge in table["edges"]:
        who = ", ".join(f"`{name}`" for name in edge["from"])
        where = f" (with {edge['with']})" if "with" in edge else ""
        yield f"| {who} | `{edge['to']}` | {_at(edge)} | {edge['reason']}{where} |"


def _at(edge: Mapping[str, Any]) -> str:
    if "port" not in edge:
        return AT[edge["to"]]
    plain = f"; in clear text {edge['plain']}" if "plain" in edge else ""
    return f"TCP {edge['port']}{plain}"


def write() -> Path:
    """Write the tables anew; the page."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return PAGE
