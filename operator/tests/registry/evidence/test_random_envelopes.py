"""Envelopes made by chance: each is refused in words, nothing crashes, nothing hangs."""

from __future__ import annotations

import base64
import json
import random
import string
import time
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.evidence.adapters.dsse import ENVELOPE_BYTES_MAX
from tests.stages.registry.signed_evidence import (
    POLICY,
    Signing,
    artefact,
    catalogue,
    entry,
    published,
    signing_key,
    trusting,
)

SECONDS_MAX = 2.0  # of the processor, for one of them: none goes on for ever
TEXT_CHARACTERS_MAX = 1000
APP = artefact()


class Chance:
    """Draws envelopes from a fixed seed out of a good one and of one by another key."""

    def __init__(self, seed: int, good: bytes, foreign: bytes) -> None:
        self.random = random.Random(seed)  # noqa: S311 - the same cases every time
        self.good, self.foreign = good, foreign

    def some(self, count: int) -> bytes:
        return self.random.randbytes(count)

    def value(self, depth: int = 0) -> Any:
        """Any JSON value."""
        kinds = 6 if depth > 4 else 8
        kind = self.random.randrange(kinds)
        if kind == 6:
            return [self.value(depth + 1) for _ in range(self.random.randrange(4))]
        if kind == 7:
            names = ("payload", "payloadType", "signatures", "keyid", "sig", "_type", "subject", "predicate", "x")
            return {self.random.choice(names): self.value(depth + 1) for _ in range(self.random.randrange(5))}
        text = "".join(self.random.choices(string.printable + "äπ\ud800\0", k=self.random.randrange(20)))
        return (None, True, self.random.randrange(-(10**30), 10**30), self.random.random() * 1e308, text, "")[kind]

    def truncated(self) -> bytes:
        return self.good[: self.random.randrange(len(self.good))]

    def huge(self) -> bytes:
        return self.good + b" " * self.random.randrange(ENVELOPE_BYTES_MAX, 4 * ENVELOPE_BYTES_MAX)

    def wrong_types(self) -> bytes:
        document = json.loads(self.good)
        target = self.random.choice([document, document["signatures"][0]])
        target[self.random.choice(sorted(target))] = self.value()
        return json.dumps(document, sort_keys=True, separators=(",", ":")).encode()

    def any_json(self) -> bytes:
        return json.dumps(self.value(), sort_keys=True, separators=(",", ":")).encode()

    def deep(self) -> bytes:
        levels = self.random.randrange(10, 60_000)
        opening, closing = self.random.choice([(b"[", b"]"), (b'{"payload":', b"}")])
        return (opening * levels + b"1" + closing * levels)[: self.random.choice([levels, 10**6])]

    def not_utf8(self) -> bytes:
        place = self.random.randrange(len(self.good))
        return self.good[:place] + self.some(self.random.randrange(1, 9)) + self.good[place:]

    def noise(self) -> bytes:
        return self.some(self.random.randrange(300))

    def edited_after_signing(self) -> bytes:
        document = json.loads(self.good)
        payload = bytearray(base64.b64decode(document["payload"]))
        payload[self.random.randrange(len(payload))] ^= 1 << self.random.randrange(8)
        document["payload"] = base64.b64encode(payload).decode()
        return canonical_json(document)

    def edited_signature(self) -> bytes:
        document = json.loads(self.good)
        signature = bytearray(base64.b64decode(document["signatures"][0]["sig"]))
        signature[self.random.randrange(len(signature))] ^= 1 << self.random.randrange(8)
        document["signatures"][0]["sig"] = base64.b64encode(signature).decode()
        return canonical_json(document)

    def other_key(self) -> bytes:
        if self.random.random() < 0.5:
            return self.foreign
        document = json.loads(self.foreign)
        document["signatures"][0]["keyid"] = json.loads(self.good)["signatures"][0]["keyid"]
        return canonical_json(document)

    def swapped_subject(self) -> bytes:
        document = json.loads(self.good)
        statement = json.loads(base64.b64decode(document["payload"]))
        statement["subject"][0]["digest"]["sha256"] = self.some(32).hex()
        document["payload"] = base64.b64encode(canonical_json(statement)).decode()
        return canonical_json(document)

    def draw(self) -> bytes:
        kinds = (
            *(self.truncated, self.huge, self.wrong_types, self.any_json, self.deep, self.not_utf8, self.noise),
            *(self.edited_after_signing, self.edited_signature, self.other_key, self.swapped_subject),
        )
        return self.random.choice(kinds)()


@pytest.mark.parametrize("count", [200, pytest.param(1000, marks=pytest.mark.thorough)])
def test_random_envelopes_are_refused_in_words_and_make_only_their_own_version_doubtful(
    tmp_path: Path, count: int
) -> None:
    key, other = signing_key(tmp_path / "gate", 1), signing_key(tmp_path / "other", 2)
    trusted = trusting(tmp_path / "keys", key)
    reader = EvidenceReader(trusted)
    good = dict(Signing(key).sign(APP))
    chance = Chance(count, good["static"], Signing(other).sign(APP)["static"])
    neighbour = published(key, artefact("neighbour"))
    own = entry(APP, evidence=sha256(good["summary"]))
    for number in range(count):
        data = chance.draw()
        began = time.thread_time()
        with pytest.raises(InputError) as caught:
            trusted.verify(data)
        assert 0 < len(str(caught.value)) < TEXT_CHARACTERS_MAX, number
        suite = chance.random.choice([*(rule.name for rule in POLICY.suites), "summary"])
        files = {f"{APP.folder}/{name}.json": text.decode() for name, text in good.items()}
        files[f"{APP.folder}/{suite}.json"] = data.decode("utf-8", "replace")
        evidence = reader.read(catalogue(own, neighbour, files))
        app, beside = evidence.version("app", "0.1.0"), evidence.version("neighbour", "0.1.0")
        assert app
        assert beside
        assert (app.assured, beside.assured, evidence.problems) == (False, True, ()), number
        assert suite in app.evidence_problem
        assert time.thread_time() - began < SECONDS_MAX, f"case {number}: {data[:100]!r}"
