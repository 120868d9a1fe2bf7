"""Pushes that the forge refuses before it takes anything: which answers mean that, and what the forge says of them."""

from __future__ import annotations

import re

import httpx

from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities

ASKING_SECONDS_MAX = 5.0
WORDS_CHARACTERS_MAX = 500

_STATUS = re.compile(r"status code: (\d{3})")  # libgit2's words; it keeps nothing else of such an answer
_PREFIX = re.compile(r"^(?:error:\s*)+")
_REFUSING = frozenset({"400", "403", "404", "410", "413", "422"})
_TOLD = {
    "403": "it may not write to this repository, or nobody may, as when it is archived",
    "404": "this repository is not there, or not for it",
}


def refused_status(error: Exception) -> str:
    """The status of an answer by which a forge refuses, whoever asks how often; empty where another attempt may get
    another one."""
    status = _STATUS.search(str(error))
    return status.group(1) if status and status.group(1) in _REFUSING else ""


def refusal_words(status: str, url: str, account: tuple[str, str]) -> str:
    """What a forge that answered a push to `url` with `status` says of it, in its own words where it has any."""
    words = _asked(url, account) or _TOLD.get(status, "")
    return f"it answers account {account[0]} with {status}{f': {words}' if words else ''}"


def in_one_line(words: str) -> str:
    """Words of a forge or its hooks in one line, without control characters and the `error:` that Git puts before each;
    bounded."""
    lines = ("".join(c if c.isprintable() else " " for c in line).strip() for line in words.splitlines())
    return " ".join(filter(None, (_PREFIX.sub("", line) for line in lines)))[:WORDS_CHARACTERS_MAX]


def _asked(url: str, account: tuple[str, str]) -> str:
    """The text with which a push to `url` is refused now: libgit2 does not keep it. Empty when it is a page, or there
    is none."""
    try:
        answer = httpx.get(
            f"{url}/info/refs",
            params={"service": "git-receive-pack"},
            auth=account,
            verify=certificate_authorities(),
            timeout=ASKING_SECONDS_MAX,
        )
    except (httpx.HTTPError, httpx.InvalidURL):
        return ""
    is_text = answer.headers.get("content-type", "").startswith("text/plain")
    return in_one_line(answer.text) if answer.is_client_error and is_text else ""
