"""The ports that one manager works with, together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robotkube.delivery.manager.core.broken_links import BrokenLinks
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.foundation.forge.ports.pull_requests import Forge
from robotkube.foundation.forge.ports.repositories import DeploymentRepository, Proposals
from robotkube.foundation.kubernetes.ports import Leadership


@dataclass(frozen=True)
class ManagerPorts:
    """The ports of one manager; `name` is its own, which is its account at the forge; `broken_links` are those that
    bridges report."""

    tasks: TaskStore
    cluster: Cluster
    deployment: DeploymentRepository
    proposals: Proposals
    forge: Forge
    leadership: Leadership
    name: str = "manager"
    broken_links: Callable[[], BrokenLinks] = dict
