"""Main of a deployment repository, in memory, whose releases bring in topics; its forge can be away."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import write_revoked
from robotkube.delivery.deployment.core.releases import Release, chart_of, source_of, write_release, write_source
from robotkube.errors import UnavailableError

DIGEST = "sha256:" + "a" * 64
REGISTRY = "oci://forge.example/verified"
POSE_00, POSE_01 = "/vehicles/vehicle_00/pose", "/vehicles/vehicle_01/pose"


def bridge(namespace: str, *topics: str | Mapping[str, Any], name: str = "mqtt-bridge", agent: str = "") -> Release:
    """A bridge in a namespace that brings in topics; `agent` is what its values say, whatever its namespace is."""
    items = [{"name": topic, "type": "std_msgs/msg/String"} if isinstance(topic, str) else topic for topic in topics]
    values = {"placement": {"agent": agent or namespace}, "bridge": {"in": items, "out": []}}
    return release(namespace, name, values)


def release(namespace: str, name: str, values: Mapping[str, Any], chart: str = "mqtt-bridge") -> Release:
    return Release(namespace, name, chart, "0.2.0", DIGEST, values, plan="20261126-100000-abcdef")


def texts(*releases: Release) -> dict[str, str]:
    """The files of releases, with their sources."""
    sources = [source_of(chart_of(one), REGISTRY) for one in releases]
    return {
        **{one.path: write_release(one) for one in releases},
        **{source.path: write_source(source) for source in sources},
    }


class Main:
    """The port MainHistory. `put` makes a commit that has these releases and no others, revokes these agents (with the
    reason of each), and has these policies besides."""

    def __init__(self, *releases: Release) -> None:
        self.commits: list[Mapping[str, str]] = []
        self.away = False
        self.put(*releases)

    def put(
        self, *releases: Release, revoked: Mapping[str, str] | None = None, policies: Mapping[str, str] | None = None
    ) -> str:
        revoking = {} if revoked is None else {REVOKED_PATH: write_revoked(revoked)}
        return self.put_files({**texts(*releases), **revoking, **(policies or {})})

    def put_files(self, files: Mapping[str, str]) -> str:
        self.commits.append(files)
        return self.tip

    @property
    def tip(self) -> str:
        return f"{len(self.commits):040x}"

    def fetch(self) -> str:
        if self.away:
            raise UnavailableError("the forge does not answer")
        return self.tip

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        return self.commits[int(commit, 16) - 1]

    def irregular(self, commit: str, folders: Sequence[str]) -> Sequence[str]:
        return ()

    def headers(self, since: str, commits_max: int) -> Iterator[tuple[str, str]]:
        return iter(())
