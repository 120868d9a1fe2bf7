"""Charts as gate and suites use them: the OCI registry, with charts by digest and what is attached to them, and
programs that render them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.registry.charts.core.packing import PulledChart
from robotkube.registry.charts.core.references import ChartReference


@dataclass(frozen=True)
class Attachment:
    """Something attached to a manifest: `digest` is that of the artefact's own manifest, `data` its one layer."""

    digest: str
    artifact_type: str
    data: bytes
    annotations: Mapping[str, str]


class PulledCharts(Protocol):
    """A source of charts by their digest."""

    def pull_chart(self, repository: str, digest: str) -> PulledChart:
        """The chart of that digest, unpacked in memory within fixed bounds."""
        ...


class ChartRegistry(PulledCharts, Protocol):
    """One OCI registry. `repository` is `<organisation>/<chart>`, digests are `sha256:<hex>`.

    UnavailableError: the OCI registry does not answer; a caller may try again. InputError: what was asked for is not
    there, is not what its digest says, is beyond a bound, or the account may not do this.
    """

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        """The digest of the manifest that a tag or digest names; None if there is none."""
        ...

    def attach(
        self, repository: str, subject: str, artifact_type: str, data: bytes, annotations: Mapping[str, str]
    ) -> str:
        """Attach `data` to the manifest `subject`; the digest of the artefact. The same again changes nothing.

        The list of attachments is changed under the lock the client was made with: two at once keep both."""
        ...

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        """Everything attached to `subject`, in the order of attaching; empty when there is nothing."""
        ...

    def copy_chart(self, source: str, target: str, digest: str, tag: str, attachments: Collection[str]) -> None:
        """Copy the chart `digest` from repository `source` to `target` under `tag`, with the named attachments (digests
        of artefacts that are attached at `source`) and no others; the chart's tag is written last.

        The same again changes nothing. InputError when `tag` is there with another digest (a tag is never overwritten)
        or when a named attachment is not attached."""
        ...

    def copy_image(self, source: str, target: str, digest: str, artifact_type: str) -> None:
        """Copy the image `digest` from repository `source` to `target`, with what of `artifact_type` is attached to it.
        The same again changes nothing. InputError when `source` does not have it."""
        ...

    def remove_image(self, repository: str, digest: str) -> None:
        """Remove the image `digest` with all that is attached to it; one that is not there is success. Of an index the
        images stay, which other indexes may have."""
        ...


class ImageRegistry(Protocol):
    """Container images as the images suite reads them; errors as those of ChartRegistry."""

    def manifest(self, repository: str, digest: str) -> bytes:
        """The image manifest or index of that digest."""
        ...

    def blob(self, repository: str, digest: str, bytes_max: int) -> bytes:
        """A blob of at most `bytes_max` bytes."""
        ...

    def blob_pieces(self, repository: str, digest: str, bytes_max: int) -> Iterator[bytes]:
        """A blob of at most `bytes_max` bytes, piece by piece; its end is only reached when the digest is right."""
        ...

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        """Everything attached to the manifest `subject`; empty when there is nothing."""
        ...


class ChartProgram(Protocol):
    """A renderer of charts that are not trusted yet."""

    def render(
        self, files: Mapping[str, bytes], values: Mapping[str, Any], release: str, namespace: str
    ) -> list[dict[str, Any]]:
        """The objects of the chart in `files`, without network, bounded in time and size. InputError with the program's
        words when the chart cannot be rendered, UnavailableError when the program cannot be run."""
        ...


class RenderedObjects(Protocol):
    """What a release is made of."""

    def __call__(
        self, chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
    ) -> Sequence[Mapping[str, Any]]:
        """All objects of the release, deployed by `plan`. InputError when its chart cannot be rendered with these
        values, UnavailableError when that cannot be tried now."""
        ...


class RenderedImages(Protocol):
    """What a release's pods would run."""

    def __call__(
        self, chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
    ) -> Sequence[str]:
        """References of all images of the release, deployed by `plan`, sorted. InputError when its chart cannot be
        rendered with these values, UnavailableError when that cannot be tried now."""
        ...
