"""A plan's source files are exactly those that the releases need, whatever stands on main."""

from __future__ import annotations

from collections.abc import Mapping

from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.releases import Release, Source, Tree, source_of, write_source
from robotkube.delivery.manager.core.composition.composer import Composition
from robotkube.delivery.manager.core.plans import Change, make_plan
from robotkube.registry.catalogue.core.catalogue import Catalogue

CHARTS = "oci://forge.example/verified"

releases = st.builds(
    Release,
    st.sampled_from("ab"),
    st.sampled_from(["r1", "r2", "r3"]),
    st.sampled_from(["c", "d"]),
    st.just("0.1.0"),
    st.sampled_from([f"sha256:{digit * 64}" for digit in "01"]),
    st.just({}),
)
by_path = st.lists(releases, max_size=5).map(lambda drawn: {release.path: release for release in drawn})
urls = st.sampled_from([CHARTS, "oci://elsewhere.example/verified"])
others = st.lists(st.tuples(releases, urls), max_size=3)


def source(release: Release, url: str) -> Source:
    return Source(release.namespace, release.chart, release.digest, f"{url}/{release.chart}")


def needed(releases: Mapping[str, Release]) -> dict[str, str]:
    sources = [source_of((r.namespace, r.chart, r.digest), CHARTS) for r in releases.values()]
    return {one.path: write_source(one) for one in sources}


@given(by_path, others, by_path, st.sets(st.sampled_from(["releases/a/r1.yaml", "releases/b/r2.yaml"])))
def test_sources_are_exactly_those_that_are_needed(
    present: dict[str, Release], beside: list[tuple[Release, str]], more: dict[str, Release], leaving: set[str]
) -> None:
    there = [source(release, url) for release, url in [*zip(present.values(), [CHARTS] * 9, strict=False), *beside]]
    tree = Tree(present, {one.path: one for one in there})
    after = {path: release for path, release in {**present, **more}.items() if path not in leaving}
    paths = [path for path in {**present, **more} if present.get(path) != after.get(path)]
    changes = tuple(Change(path, present.get(path), after.get(path)) for path in paths)
    for _ in range(2):  # the second time with what the tree remembers
        plan = make_plan(changes, tree, Composition({}, {}), {}, Catalogue(), CHARTS, "b" * 40, "20261121-100000")
        main = {path: write_source(one) for path, one in tree.sources.items()}
        written = {path: text for path, text in plan.files.items() if path.startswith("sources/")}
        main |= {path: text for path, text in written.items() if text is not None}
        left = {path: text for path, text in main.items() if written.get(path, text) is not None}
        assert left == needed(after)
