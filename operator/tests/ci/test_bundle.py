"""The platform's chart as a bundle has it: what stands in values.yaml already, and nothing else is changed."""

from __future__ import annotations

import gzip
import io
import tarfile

import pytest
import yaml

from ci import bundle
from ci.bundle.platform_chart import bundled_chart, defaults, with_defaults
from ci.errors import SetUpError
from ci.images.building import NAMES
from ci.images.services import SERVICE_NAMES
from tests.stages.paths import CHARTS

CHART = CHARTS / "robotkube"
REFERENCES = {name: f"registry.example/robotkube/{name}@sha256:{number:064x}" for number, name in enumerate(NAMES, 1)}
KEYS = {"key-1": "-----BEGIN PUBLIC KEY-----\nMCow\n-----END PUBLIC KEY-----\n"}


def test_no_image_of_the_chart_is_left_to_be_looked_up() -> None:
    packed = bundled_chart(CHART, REFERENCES, KEYS)
    with tarfile.open(fileobj=io.BytesIO(gzip.decompress(packed.archive))) as tar:
        values = yaml.safe_load(tar.extractfile("robotkube/values.yaml"))  # type: ignore[arg-type]
    named = {name: reference for name, reference in values["images"].items() if "@sha256:" in reference}
    assert named == {name: REFERENCES[name] for name in named}
    assert set(values["images"]) - set(named) == {"mongo"}, "the database of a bundle is the one that is in it"
    assert values["database"]["kind"] == "ferretdb"
    assert set(values["serviceImages"]) == set(SERVICE_NAMES)
    assert values["evidence"]["trustedKeys"] == KEYS
    everything = {*named.values(), *values["serviceImages"].values(), *values["inspection"]["images"]}
    assert everything == set(REFERENCES.values()), "every image of a bundle may run"


def test_the_same_images_make_the_same_chart() -> None:
    assert bundled_chart(CHART, REFERENCES, KEYS).digest == bundled_chart(CHART, REFERENCES, KEYS).digest


def test_comments_and_all_other_values_stay() -> None:
    text = (CHART / "values.yaml").read_text()
    embedded = yaml.safe_load((CHART / "values-embedded.yaml").read_text())
    written = with_defaults(text, defaults(REFERENCES, KEYS, embedded))
    before, after = text.splitlines(), written.splitlines()
    assert len([line for line in before if line not in after]) <= 14
    assert after[0] == before[0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a:\n  b: 1  # one\n  c: 2\nd: 3\n", "a:\n  b: {x: y}\n  c: 2\nd: 3\n"),
        ("a: {c: 2}   # flow\nd: 3\n", "a: {b: {x: y}, c: 2}\nd: 3\n"),
        ("a:\n  c: 2\nd: 3\n", "a:\n  c: 2\n  b: {x: y}\nd: 3\n"),
        ("a:\n  b:\n  - 1\n  - 2\n  c: 2\n", "a:\n  b: {x: y}\n  c: 2\n"),
    ],
)
def test_a_default_is_written_into_its_line(text: str, expected: str) -> None:
    written = with_defaults(text, {"a": {"b": {"x": "y"}}})
    assert yaml.safe_load(written) == yaml.safe_load(expected)


def test_a_key_that_is_gone_is_named() -> None:
    with pytest.raises(SetUpError, match="no key a"):
        with_defaults("b: 1\n", {"a": {"b": 1}})


def test_evidence_is_that_of_exactly_the_digest() -> None:
    digest = f"sha256:{'ab' * 32}"
    kept = {
        "evidence/app/0.1.0_abababababab/static.json": "static",
        "evidence/app/0.1.0_abababababab/summary.json": "summary",
        "evidence/app/0.1.0_000000000000/static.json": "of another build",
        "evidence/app2/0.1.0_abababababab/static.json": "of another chart",
    }
    assert bundle.kept_envelopes(kept, "app", "0.1.0", digest) == {"static": b"static", "summary": b"summary"}
