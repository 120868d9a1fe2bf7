"""What registries say to a question for their API, from here; no account is shown to them."""

from __future__ import annotations

from pathlib import Path

import httpx

from robotkube.delivery.preflight.core.findings import without_accounts
from robotkube.delivery.preflight.core.registries import HUB, HUB_API, RegistryAnswer
from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities

SECONDS_MAX = 4.0
API_HEADER, API = "Docker-Distribution-Api-Version", "registry/2.0"
NOT_REACHED = RegistryAnswer(silent="its name is the cluster's own, and its Service's address is not reached from here")


class RegistryQuestions:
    """Asks registries by HTTPS, and believes the usual authorities and that of the file `authority`; InputError when it
    has none."""

    def __init__(self, authority: Path | None = None) -> None:
        try:
            self._context = certificate_authorities(trust_env=False, more=authority)
        except InputError as error:
            raise InputError(f"{authority}: no certificate of an authority as PEM") from error

    def ask(self, host: str) -> RegistryAnswer:
        """What the registry at a host says."""
        try:
            return _read(self._get(f"https://{HUB_API if host == HUB else host}/v2/"))
        except httpx.TimeoutException:
            return RegistryAnswer(silent=f"timed out: no answer within {SECONDS_MAX:g} s")
        except httpx.HTTPError as error:
            return RegistryAnswer(refused=str(error) or type(error).__name__)

    def ask_service(self, address: str) -> RegistryAnswer:
        """What a registry inside of the cluster says at its Service's address and port, by HTTP. Outside of the cluster
        the address is another's, or nobody's, so what does not call itself a registry says nothing."""
        try:
            answer = self._get(f"http://{address}/v2/")
        except (httpx.HTTPError, httpx.InvalidURL):
            return NOT_REACHED
        return _read(answer) if answer.headers.get(API_HEADER) == API else NOT_REACHED

    def _get(self, url: str) -> httpx.Response:
        return httpx.get(url, verify=self._context, timeout=SECONDS_MAX, trust_env=False, follow_redirects=False)


def _read(answer: httpx.Response) -> RegistryAnswer:
    return RegistryAnswer(answer.status_code, without_accounts(answer.headers.get("WWW-Authenticate", "")))
