"""Registries of the images, as they answer from here. That nodes reach them as well is not said by it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem
from robotkube.delivery.preflight.core.renderings import Object
from robotkube.registry.charts.core.pod_images import pod_images

HUB, HUB_API = "docker.io", "registry-1.docker.io"
HOST = re.compile(r"(?:[^/]*[.:][^/]*|localhost)(?=/)")
CHALLENGE = re.compile(r'(Basic|Bearer)\b(?:.*?\brealm="([^"]*)")?', re.IGNORECASE)
WHY = "nodes that do not get an image do not start its pods"


@dataclass(frozen=True)
class RegistryAnswer:
    """What a registry's /v2/ said: the status, and the challenge of its header WWW-Authenticate; or `refused`, why the
    connection was not made or believed, or `silent`, why nothing is known."""

    status: int = 0
    challenge: str = ""
    refused: str = ""
    silent: str = ""


def hosts(objects: Sequence[Object]) -> tuple[str, ...]:
    """The hosts of the registries that the chart's images are pulled from."""
    return tuple(sorted({host_of(image) for image in pod_images(objects) if image}))


def host_of(image: str) -> str:
    """The host of an image's registry; without one it is Docker's."""
    match = HOST.match(image)
    return match[0] if match else HUB


def registries(reached: Mapping[str, RegistryAnswer]) -> CheckVerdict:
    """Each registry answers as one, by HTTPS; a registry inside of the cluster at its Service's address."""
    problems = [problem for host, answer in reached.items() for problem in _problems(host, answer)]
    silent = [f"{host}: {answer.silent}" for host, answer in reached.items() if answer.silent]
    said = [f"{host}: {_words(answer)}" for host, answer in reached.items() if answer.status]
    return CheckVerdict("; ".join(said) or "no registry answered", problems, "; ".join(silent))


def _problems(host: str, answer: RegistryAnswer) -> Iterator[Problem]:
    where = f"registry {host}"
    if answer.refused:
        fix = "correct `images` in the values, or give the authority of its certificate with --registry-ca FILE"
        yield Problem(f"it is not reached from here: {answer.refused}", where, WHY, fix)
    elif answer.status == 401 and not CHALLENGE.search(answer.challenge):
        what = "it refuses without saying how to sign in (WWW-Authenticate)"
        yield Problem(what, where, WHY, "name a registry in `images` that speaks Basic or Bearer")
    elif answer.status and answer.status not in (200, 401):
        what = f"/v2/ answers {answer.status}, as no OCI registry does"
        yield Problem(what, where, WHY, "correct `images` in the values, or ask who runs the registry")


def _words(answer: RegistryAnswer) -> str:
    challenge = CHALLENGE.search(answer.challenge)
    if answer.status == 401 and challenge:
        realm = f" of {challenge[2].partition('?')[0]}" if challenge[2] else ""
        kind = "an account" if challenge[1].lower() == "basic" else f"a token{realm}"
        return f"answers, and asks for {kind}: nodes need it by imagePullSecrets or their own configuration"
    return f"answers {answer.status}"
