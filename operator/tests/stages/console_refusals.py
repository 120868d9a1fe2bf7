"""What the platform's chart refuses of `console`: values, and the words of the message; others are those of
profiles/official.yaml."""

from __future__ import annotations

from typing import Any


def by_forge(pages: str = "https://git.example", **changes: Any) -> dict[str, Any]:
    """Signing in by the chart's own forge, whose pages people see there."""
    sign_in = {"forge": True, "issuer": "", "clientId": "", "groups": [], **changes}
    return {"console": {"links": {"forge": pages}, "signIn": sign_in}}


CONSOLE_REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "half of signing in": (
        {"console": {"signIn": {"issuer": ""}}},
        "console.signIn has clientId, url, groups, but nobody can sign in: console.signIn.issuer is empty. Name the",
    ),
    "clients of a console that answers forwards alone": (
        {
            "console": {"signIn": {"issuer": "", "clientId": "", "url": "", "groups": []}},
            "networkPolicies": {"clients": {"console": [{"ipBlock": {"cidr": "192.0.2.10/32"}}]}},
        },
        "networkPolicies.clients.console names who reaches the console, but it answers forwards alone.",
    ),
    "a provider without a client": (
        {"console": {"signIn": {"clientId": ""}}},
        "console.signIn: issuer needs clientId (of the client at the provider), url",
    ),
    "writers without signing in": (
        {
            "console": {
                "anybodyReads": True,
                "signIn": {"issuer": "", "writers": [{"group": "robotkube", "namespaces": ["cloud-0"]}]},
            }
        },
        "console.signIn.writers names groups, but console.signIn.issuer is empty: without signing in nobody writes.",
    ),
    "writers in the name of nobody": (
        {"console": {"signIn": {"writers": [{"group": "robotkube", "namespaces": ["argocd"]}]}}},
        "console.signIn.writers: group robotkube may ask in namespace argocd, which is no agent's. Name agents (",
    ),
    "writers who do not read": (
        {"console": {"signIn": {"writers": [{"group": "others", "namespaces": ["cloud-0"]}]}}},
        "console.signIn.writers: group others is not in console.signIn.groups, so its members may not even read.",
    ),
    "signing in, and everybody": (
        {"console": {"anybodyReads": True}},
        "console.anybodyReads is true, but console.signIn.issuer is set. Take one of the two out.",
    ),
    "the chart's own forge, and another provider": (
        by_forge(issuer="https://accounts.example"),
        "console.signIn.forge is true, but issuer, clientId or secret is set, which are of another provider.",
    ),
    "the chart's own forge, and everybody": (
        {"console": {**by_forge()["console"], "anybodyReads": True}},
        "console.anybodyReads is true, but console.signIn.forge is, too. Take one of the two out.",
    ),
    "the chart's own forge where there is none": (
        {**by_forge(), "forge": {"kind": "external", "external": {"url": "https://git.example"}}},
        "console.signIn.forge is true, but forge.kind is external: the chart cannot register a client there.",
    ),
    "a forge whose pages nobody knows": (
        by_forge(pages=""),
        "console.signIn.forge is true, but console.signIn.url or console.links.forge is empty: browsers go from the",
    ),
    "a forge under the console's name": (
        by_forge(pages="https://Console.example:3000"),
        "console.signIn.url and console.links.forge have the same host name, console.example: a browser would show",
    ),
    "a forge below a path": (
        by_forge(pages="https://git.example/forge"),
        "console.links.forge is https://git.example/forge: the forge's pages lead to each other from the top",
    ),
    "a forge whose cookies no browser sends": (
        by_forge(pages="http://git.example"),
        "console.links.forge is http://git.example, but the forge speaks HTTPS, and browsers send its cookies by TLS",
    ),
    "writers of the forge who do not read": (
        by_forge(writers=[{"group": "robotkube", "namespaces": ["cloud-0"]}]),
        "console.signIn.writers: group robotkube is not in console.signIn.groups, so its members may not even read.",
    ),
}
