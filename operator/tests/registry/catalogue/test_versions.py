"""Order of versions by Semantic Versioning 2.0.0, item 11, and ranges of them."""

import itertools
import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from semver import Version

from robotkube.foundation.documents.core.patterns import VERSION
from robotkube.registry.catalogue.core.versions import in_range, is_range, version_key
from tests.stages.paths import REGISTRY

SCHEMAS = REGISTRY / "schemas"
# the specification's own examples, and numbers whose texts sort otherwise
ORDERED = (
    "0.9.10",
    "0.10.0",
    "1.0.0-0",
    "1.0.0-9",
    "1.0.0-10",
    "1.0.0-alpha",
    "1.0.0-alpha.1",
    "1.0.0-alpha.beta",
    "1.0.0-beta",
    "1.0.0-beta.2",
    "1.0.0-beta.11",
    "1.0.0-rc.9",
    "1.0.0-rc.10",
    "1.0.0",
    "2.0.0",
    "2.1.0",
    "2.1.1",
    "10.0.0",
)
NONE = ("", "1", "1.0", "01.0.0", "1.00.0", "1.0.0-", "1.0.0-rc.", "1.0.0-rc..1", "1.0.0-rc.01", "1.0.0-٣", "v1.0.0")
PRE = "-" + "1" * 64

identifiers = st.one_of(
    st.integers(0, 10**9).map(str),
    st.from_regex(r"[0-9A-Za-z-]{1,6}", fullmatch=True).filter(lambda text: not re.fullmatch(r"0[0-9]+", text)),
)
numbers = st.sampled_from([0, 9, 10])
releases = st.builds("{}.{}.{}".format, numbers, numbers, numbers)
candidates = st.builds("{}-{}".format, releases, st.lists(identifiers, min_size=1, max_size=3).map(".".join))
versions = st.one_of(releases, candidates)


def test_versions_sort_by_precedence() -> None:
    for order in (ORDERED, ORDERED[::-1]):
        assert sorted(order, key=version_key) == list(ORDERED)
    assert all(version_key(low) < version_key(high) for low, high in itertools.combinations(ORDERED, 2))


@given(versions, versions)
def test_the_order_is_the_librarys(one: str, other: str) -> None:
    expected = Version.parse(one).compare(other)
    assert (version_key(one) > version_key(other)) - (version_key(one) < version_key(other)) == expected


@given(versions)
def test_every_version_that_files_may_name_has_a_place(version: str) -> None:
    assert VERSION.fullmatch(version)
    assert version_key(version)


@pytest.mark.parametrize("text", [*NONE, "1.0.0+build", f"1.0.0{PRE}1"])
def test_what_is_no_version_is_none_for_files_and_ranges(text: str) -> None:
    assert not VERSION.fullmatch(text)
    assert not is_range(f">={text}")


@pytest.mark.parametrize("text", NONE)
def test_what_is_no_version_has_no_place(text: str) -> None:
    with pytest.raises(ValueError, match="is not valid SemVer"):
        version_key(text)


@pytest.mark.parametrize(
    ("version", "requirement", "expected"),
    [
        ("1.0.0-rc.10", ">1.0.0-rc.9", True),
        ("1.0.0-rc.9", ">=1.0.0-rc.10", False),
        ("1.0.0-rc.10", ">=1.0.0-rc.2 <1.0.0", True),
        ("1.0.0", "<=1.0.0-rc.10", False),
        ("1.0.0", "", True),
        ("1.0.0", "1.0.0", False),
    ],
)
def test_ranges_take_that_order(version: str, requirement: str, expected: bool) -> None:
    assert in_range(version, requirement) is expected


@pytest.mark.parametrize("text", [*ORDERED, *NONE, f"1.0.0{PRE}", f"1.0.0{PRE}1"])
def test_schemas_take_the_same_versions(text: str) -> None:
    chart = json.loads((SCHEMAS / "chart-version.json").read_text())
    application = json.loads((SCHEMAS / "application.json").read_text())
    pattern = chart["$defs"]["version"]["pattern"]
    assert bool(re.search(pattern, text)) is bool(VERSION.fullmatch(text))
    [ranges] = set(_patterns(application, "(>=|<=|>|<|=)"))
    for wanted in (f">={text}", f">0.0.0 <={text}"):
        assert bool(re.search(ranges, wanted)) is is_range(wanted)


def _patterns(value: object, part: str) -> list[str]:
    if isinstance(value, dict):
        own = [value["pattern"]] if part in str(value.get("pattern", "")) else []
        return own + [pattern for inner in value.values() for pattern in _patterns(inner, part)]
    return [pattern for inner in value for pattern in _patterns(inner, part)] if isinstance(value, list) else []
