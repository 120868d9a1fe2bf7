"""Chart versions of the test's catalogue repository, with real evidence signed by one key of the tests.

published_chart("mqtt-bridge", "0.1.0", digest)     files: entry, values schema, envelopes of all suites, summary
trusted_keys(), signing(artefact)                   what gate and manager trust; the key itself, for wrong evidence
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import yaml

from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import Artefact
from tests.stages.paths import REPOSITORY
from tests.stages.registry.signed_evidence import PLATFORM, POLICY_TEXT, Signing, entry, published, seeded_key

CHARTS, REGISTRY = REPOSITORY / "charts" / "apps", REPOSITORY / "registry"
PUBLIC_KEYS = Path(__file__).parent / "trusted_keys"
SEED, OTHER_SEED = 1, 2


def key_folder() -> Path:
    """A folder of public keys, as it is mounted in gate and manager: the one of `gate_key()`."""
    return PUBLIC_KEYS


@cache
def gate_key(seed: int = SEED) -> KeyFile:
    """The gate's key, which is in no file; with OTHER_SEED one that nobody trusts."""
    return seeded_key(seed)


def trusted_keys() -> TrustedKeys:
    """What gate and manager trust."""
    return TrustedKeys(key_folder())


def artefact(chart: str, version: str, digest: str) -> Artefact:
    """A chart version as evidence names it."""
    return Artefact(chart, version, digest, PLATFORM)


def signing(about: Artefact, seed: int = SEED) -> Signing:
    """Signs with the trusted key what belongs to a chart of this project."""
    return Signing(gate_key(seed), schema="".join(schema_file(about.chart, about.version).values()))


def schema_file(chart: str, version: str, charts: Path = CHARTS) -> dict[str, str]:
    """The values schema of a chart of the folder `charts`, with its values as default, as the gate publishes it."""
    schema = json.loads((charts / chart / "values.schema.json").read_text())
    schema["default"] = yaml.safe_load((charts / chart / "values.yaml").read_text())
    return {f"charts/{chart}/{version}.schema.json": json.dumps(schema, indent=1, sort_keys=True) + "\n"}


def published_chart(
    chart: str, version: str, digest: str, images: Sequence[str] = (), charts: Path = CHARTS
) -> dict[str, str]:
    """Everything the gate publishes of a chart version of the folder `charts` that passed, with these images."""
    schema = "".join(schema_file(chart, version, charts).values())
    return published(gate_key(), artefact(chart, version, digest), schema=schema, images=images)


def unproved_chart(chart: str, version: str, digest: str, state: str = "verified") -> dict[str, str]:
    """An entry with that state and without evidence, as somebody could edit it."""
    return {**entry(artefact(chart, version, digest), state), **schema_file(chart, version)}


def policies() -> dict[str, str]:
    """The policies of a catalogue that asks for evidence."""
    return {"policies/release.yaml": "assurance: verified\n", "policies/verification.yaml": POLICY_TEXT}


def applications() -> dict[str, str]:
    """The applications of this project."""
    return {str(path.relative_to(REGISTRY)): path.read_text() for path in REGISTRY.glob("applications/*.yaml")}
