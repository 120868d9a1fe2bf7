"""Values of tls that do not fit each other, and how the chart refuses them."""

from __future__ import annotations

from typing import Any

EXTERNAL = {"kind": "external", "external": {"host": "mqtt.example", "port": 8883}}
AUTHORITY = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"
PROCESSES = dict.fromkeys(("gate", "manager", "rights", "suite-runner"), "mine")
PROVIDED = {"secret": "mine", "database": "mine", "forge": "mine", "processes": PROCESSES}


def provided_but(name: str) -> dict[str, Any]:
    """A Secret of one's own for each server but this."""
    return {key: value for key, value in PROVIDED.items() if key != name}


TLS_REFUSALS: dict[str, tuple[dict[str, Any], str]] = {
    "certificates made for a broker of somebody else": (
        {"broker": EXTERNAL},
        "tls.mode is made, but broker.kind is external: its owner has its certificate. Set tls.mode: provided with the",
    ),
    "a second listener of somebody else's broker": (
        {"broker": EXTERNAL, "tls": {"mode": "off", "plain": True}},
        "tls.plain is true, but broker.kind is external: its listeners are its owner's. Leave it out;",
    ),
    "nobody to trust": (
        {"tls": {"mode": "provided", "provided": PROVIDED}},
        "tls.mode is provided, but tls.authorities is empty: nobody could verify the broker. Put the PEM",
    ),
    "nobody to trust an Issuer": (
        {"tls": {"mode": "cert-manager", "issuer": {"name": "ours", "kind": "ClusterIssuer"}}},
        "tls.mode is cert-manager, but tls.authorities is empty",
    ),
    "an authority that is a private key": (
        {
            "tls": {
                "mode": "provided",
                "provided": PROVIDED,
                "authorities": f"{AUTHORITY}-----BEGIN PRIVATE KEY-----",
            }
        },
        "tls.authorities: holds a private key; it would stand in ConfigMaps that every agent reads.",
    ),
    "an authority that is no PEM": (
        {"tls": {"mode": "provided", "provided": PROVIDED, "authorities": "ours"}},
        "tls.authorities: must be PEM that begins with -----BEGIN CERTIFICATE-----",
    ),
    "authorities that nobody asks for": (
        {"tls": {"authorities": AUTHORITY}},
        "tls.authorities is given, but tls.mode is made: nobody would trust them. Set the mode to provided or",
    ),
    "a provided certificate without a Secret": (
        {"tls": {"mode": "provided", "provided": provided_but("secret"), "authorities": AUTHORITY}},
        "tls.mode is provided, but tls.provided.secret is empty. Name the Secret",
    ),
    "a Secret that nobody mounts": (
        {"tls": {"provided": {"secret": "mine"}}},
        "tls.provided.secret is given, but tls.mode is made. Set the mode to provided, or leave the Secret out.",
    ),
    "a provided certificate of the broker alone": (
        {"tls": {"mode": "provided", "provided": provided_but("database"), "authorities": AUTHORITY}},
        "tls.mode is provided, but tls.provided.database is empty. Name the Secret in the platform's namespace that",
    ),
    "a Secret of the database that nobody mounts": (
        {"tls": {"provided": {"database": "mine"}}},
        "tls.provided.database is given, but tls.mode is made and database.kind mongo: nobody mounts it. Leave it out",
    ),
    "a provided certificate of all but the forge": (
        {"tls": {"mode": "provided", "provided": provided_but("forge"), "authorities": AUTHORITY}},
        "tls.mode is provided, but tls.provided.forge is empty. Name the Secret in the platform's namespace that has",
    ),
    "a Secret of the forge that nobody mounts": (
        {"tls": {"provided": {"forge": "mine"}}},
        "tls.provided.forge is given, but tls.mode is made, forge.kind gitea and forge.tls true: nobody mounts it.",
    ),
    "a provided certificate of all but one process": (
        {
            "tls": {
                "mode": "provided",
                "processes": True,
                "provided": {**PROVIDED, "processes": {name: "mine" for name in PROCESSES if name != "gate"}},
                "authorities": AUTHORITY,
            }
        },
        "tls.processes is true, but tls.provided.processes names no Secret for gate. Name the one in namespace "
        "robotkube-gate that has its tls.crt and tls.key, for the name gate.robotkube-gate.svc.cluster.local; "
        "or set tls.processes: false",
    ),
    "a Secret of a process that nobody mounts": (
        {"tls": {"processes": True, "provided": {"processes": {"gate": "mine"}}}},
        "tls.provided.processes names a Secret for gate, but tls.mode is made and tls.processes true: nobody mounts",
    ),
    "a Secret of a process that does not serve": (
        {
            "tls": {
                "mode": "provided",
                "processes": True,
                "provided": {**PROVIDED, "processes": {**PROCESSES, "inspector": "mine"}},
                "authorities": AUTHORITY,
            }
        },
        "tls.provided.processes names a Secret for inspector, which is no process that serves here. Name some of",
    ),
    "an Issuer that does not sign where the gate is": (
        {"tls": {"mode": "cert-manager", "processes": True, "authorities": AUTHORITY, "issuer": {"name": "ours"}}},
        "tls.processes is true, but tls.issuer.kind is Issuer, which signs in the platform's namespace alone, and the "
        "gate stands in robotkube-gate. Name a ClusterIssuer, or set tls.processes: false.",
    ),
    "names of a forge without a certificate": (
        {"forge": {"tls": False, "names": ["git.example"]}},
        "forge.names is given, but the forge has no certificate here: tls.mode is",
    ),
    "TLS of somebody else's database that is here": (
        {"database": {"external": {"tls": True}}},
        "database.external.tls is true, but database.kind is mongo. Leave it out: tls.mode says",
    ),
    "TLS of a database that nobody could verify": (
        {"database": {"kind": "external", "external": {"host": "mongo.example", "tls": True}}},
        "database.external.tls is true, but tls.authorities is empty: nobody could verify the database. Set",
    ),
    "an Issuer without a name": (
        {"tls": {"mode": "cert-manager", "authorities": AUTHORITY, "issuer": {"kind": "ClusterIssuer"}}},
        "tls.mode is cert-manager, but tls.issuer.name is empty. Name the Issuer",
    ),
    "an Issuer that nobody asks": (
        {"tls": {"issuer": {"name": "ours"}}},
        "tls.issuer.name is given, but tls.mode is made. Set the mode to cert-manager, or leave the name out.",
    ),
}
