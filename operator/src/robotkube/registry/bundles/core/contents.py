"""What a bundle holds: a list that stands in the bundle itself, with the digest of everything."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import BUNDLE_VERSION, BUNDLED_VERSION, DIGEST, NAME, REGISTRY_PATH
from robotkube.registry.charts.core.packing import build_tag

FORMAT = 1
CONTENTS_TYPE = "application/vnd.robotkube.bundle.v1+json"
MANIFESTS_TYPE = "application/vnd.robotkube.manifests.v1+yaml"
CONTENTS_BYTES_MAX = 4 << 20
IMAGE, CHART, MANIFESTS, CONTENTS = "image", "chart", "manifests", "contents"
KINDS = (IMAGE, CHART, MANIFESTS)
PLATFORM_CHART = "robotkube"


@dataclass(frozen=True)
class Attached:
    """What is attached to something: the digest of its manifest, its artifact type, and what it is in words."""

    digest: str
    artifact_type: str
    title: str


@dataclass(frozen=True)
class BundleItem:
    """One thing: `digest` is that of its manifest, `size` the bytes of all its parts."""

    kind: str
    name: str
    version: str
    digest: str
    size: int
    attached: tuple[Attached, ...] = ()

    @property
    def repository(self) -> str:
        """Its place below the path to which a bundle is pushed."""
        folder = {CHART: "charts/" if self.name != PLATFORM_CHART else "", MANIFESTS: "manifests/"}.get(self.kind, "")
        return f"{folder}{self.name}"

    @property
    def tag(self) -> str:
        """Its tag there. Only what people name by its version has that alone: a tag that is written again with another
        build makes some registries forget the former one."""
        if self.kind == CONTENTS or self.repository == PLATFORM_CHART:
            return self.version.replace("+", "_")
        return build_tag(self.version, self.digest)


@dataclass(frozen=True)
class BundleContents:
    """Everything in a bundle. `prefix` is what its charts and manifests put before the names of images."""

    version: str
    prefix: str
    items: tuple[BundleItem, ...]

    def of(self, kind: str) -> list[BundleItem]:
        """Items of one kind, by name."""
        return sorted((item for item in self.items if item.kind == kind), key=lambda item: (item.name, item.version))

    def listing(self, digest: str) -> BundleItem:
        """The list itself as an item, with the digest of its manifest."""
        return BundleItem(CONTENTS, "bundle", self.version, digest, 0)

    def references(self) -> dict[str, str]:
        """Image name -> reference by digest, as charts and manifests of the bundle have it."""
        return {item.name: f"{self.prefix}/{item.name}@{item.digest}" for item in self.of(IMAGE)}

    def digests(self) -> Iterator[str]:
        """Digests of all manifests that it names."""
        for item in self.items:
            yield item.digest
            yield from (one.digest for one in item.attached)


def write_contents(contents: BundleContents) -> bytes:
    """The one JSON text of a list."""
    return canonical_json({"format": FORMAT, **asdict(contents)})


def read_contents(data: bytes, where: str) -> BundleContents:
    """The list in `data`; DocumentError when it is none of this form."""
    try:
        document = read_json(data)
        if document["format"] != FORMAT:
            raise DocumentError(
                where, [f"format: {document['format']!r} is not {FORMAT}; use the program of its version"]
            )
        items = tuple(_item(entry, where) for entry in document["items"])
        contents = BundleContents(str(document["version"]), str(document["prefix"]), items)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise DocumentError(where, [f"no list of a bundle's contents: {error or type(error).__name__}"]) from error
    problems = list(_problems(contents))
    if problems:
        raise DocumentError(where, problems)
    return contents


def _problems(contents: BundleContents) -> Iterator[str]:
    """What would make other files, references or commands of a list than those of the things in it."""
    if not BUNDLE_VERSION.fullmatch(contents.version):
        yield f"version: {contents.version[:100]!r} is none: a digit, then letters, digits and ._+-, at most 100"
    if not REGISTRY_PATH.fullmatch(contents.prefix):
        yield f"prefix: {contents.prefix[:100]!r} is not of the form HOST/PATH"
    for item in contents.items:
        if not (NAME.fullmatch(item.name) and BUNDLED_VERSION.fullmatch(item.version)):
            yield f"items: {item.kind} {item.name[:100]!r} {item.version[:100]!r}: no name with a version"
    named = Counter((one.kind, one.name, "" if one.kind == IMAGE else one.version) for one in contents.items)
    yield from (f"items: {kind} {name} stands {count} times" for (kind, name, _), count in named.items() if count > 1)


def _item(entry: Mapping[str, Any], where: str) -> BundleItem:
    attached: Sequence[Mapping[str, Any]] = entry["attached"]
    item = BundleItem(
        str(entry["kind"]),
        str(entry["name"]),
        str(entry["version"]),
        str(entry["digest"]),
        int(entry["size"]),
        tuple(Attached(str(one["digest"]), str(one["artifact_type"]), str(one["title"])) for one in attached),
    )
    wrong = [text for text in (item.digest, *(one.digest for one in item.attached)) if not DIGEST.fullmatch(text)]
    if item.kind not in KINDS or wrong:
        raise DocumentError(where, [f"items: {item.name}: kind {item.kind!r} or a digest is not known here"])
    return item
