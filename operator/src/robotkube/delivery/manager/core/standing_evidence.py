"""Releases that stay on main although evidence is in doubt: what runs is not removed because a policy, a key, a
statement or an application changed, but it is not changed either."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Composition, Refused
from robotkube.delivery.manager.core.placement.placement import Agent
from robotkube.delivery.tasks.core.task_description import APPLICATION_NOT_VERIFIED, IMAGE_NOT_VERIFIED

EVIDENCE_REASONS = frozenset({"NoVerifiedVersion", "GuaranteeNotMet", APPLICATION_NOT_VERIFIED, IMAGE_NOT_VERIFIED})


def with_doubtful(
    desired: Composition, main: Mapping[str, Release], own: Mapping[str, Release], agents: Sequence[Agent]
) -> dict[str, Release]:
    """The desired releases by path, with those of main that demands use which are refused for want of evidence only.

    What such a demand shares with others stays as main has it until another demand joins or leaves it. `main` are
    main's releases, `own` those of this manager, `agents` all that are declared."""
    doubtful = {k for k, o in desired.outcomes.items() if isinstance(o, Refused) and o.reason in EVIDENCE_REASONS}
    if not doubtful:
        return dict(desired.releases)
    kept = {path: release for path, release in _used(doubtful, main, agents).items() if path in own}
    changed = {
        p: one for p, one in desired.releases.items() if p not in kept or _joined_or_left(kept[p], one, doubtful)
    }
    return {**kept, **changed}


def _used(doubtful: set[str], main: Mapping[str, Release], agents: Sequence[Agent]) -> Mapping[str, Release]:
    """Main's releases of these demands; of the initial configuration everything that no task asks for on its agent."""
    names = {key.split("/")[2] for key in doubtful if key.startswith("initial/")}
    namespaces = {agent.namespace for agent in agents if agent.name in names}
    return {
        path: release
        for path, release in main.items()
        if any(cause.task in doubtful for cause in release.causes)
        or (not release.causes and release.namespace in namespaces)
    }


def _joined_or_left(kept: Release, wanted: Release, doubtful: set[str]) -> bool:
    """Return whether other tasks than doubtful ones use a release now than on main; for what only the initial
    configuration uses, whether it changes at all."""
    if not kept.causes:
        return True
    return {cause.task for cause in kept.causes} - doubtful != {cause.task for cause in wanted.causes}
