"""What of a submission waits for a person: whatever it lets run without anybody asking for it."""

from __future__ import annotations

from collections.abc import Mapping

from robotkube.errors import DocumentError
from robotkube.registry.catalogue.core.catalogue import (
    PERSON,
    RELEASE_POLICY,
    ReleasePolicy,
    read_application,
    read_release_policy,
)


def approval_reasons(applications: Mapping[str, str], main: Mapping[str, str]) -> tuple[str, ...]:
    """Why a submission of `applications` (path -> text, readable) to a catalogue with the files `main` waits for an
    approval; none when it does not. What is on main already with the same text changes nothing."""
    if _policy(main).initial_for != PERSON:
        return ()
    roles = {path: read_application(text, path).initial_for for path, text in sorted(applications.items())}
    return tuple(
        f"{path} runs by itself on every agent of role {role} (initialFor)"
        for path, role in roles.items()
        if role and main.get(path) != applications[path]
    )


def _policy(main: Mapping[str, str]) -> ReleasePolicy:
    """The release policy on main; one that is missing or cannot be read opens nothing."""
    try:
        return read_release_policy(main.get(RELEASE_POLICY, ""), RELEASE_POLICY)
    except DocumentError:
        return ReleasePolicy("verified", PERSON)
