"""The images suite: what the chart would run, read from the OCI registry; nothing is started."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.value_templates import Render as Fill
from robotkube.registry.charts.ports import ImageRegistry
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core import image_checks
from robotkube.registry.suites.core.image_checks import ImageReference, Started
from robotkube.registry.suites.core.pod_security import mapping
from robotkube.registry.suites.core.static_checks import Rendering, check
from robotkube.registry.suites.loops.image_bills import ImageBills
from robotkube.registry.suites.loops.installation import filled_sets
from robotkube.registry.suites.loops.static import AGENT, RELEASE, START_NS
from robotkube.registry.suites.ports.suites import LayerReader, Subject, SuiteNamespace

CONFIGURATION_BYTES_MAX = 1 << 20
IMAGES_MAX = 20
USER_FIX = "end its Dockerfile with USER 10001:10001, behind every RUN that USER 0:0 stands before"


@dataclass(frozen=True)
class Image:
    """An image that is in the OCI registry: `manifests` by digest, one for each platform; `configurations` by
    platform."""

    reference: ImageReference
    manifests: Mapping[str, Mapping[str, Any]]
    configurations: Mapping[str, Mapping[str, Any]]

    @property
    def settings(self) -> list[Mapping[str, Any]]:
        """`config` of every platform's configuration."""
        return [mapping(configuration.get("config")) for configuration in self.configurations.values()]


class ImagesSuite:
    """Suite `images`: `reader` reads layers, `host` is the platform's OCI registry as references name it, `fill` fills
    the test sets."""

    name = "images"
    version = "2"
    needs_namespace = False

    def __init__(self, oci_registry: ImageRegistry, reader: LayerReader, host: str, fill: Fill) -> None:
        self._oci_registry = oci_registry
        self._bills = ImageBills(oci_registry, reader)
        self._host = host
        self._fill = fill

    def run(self, subject: Subject, test_namespace: SuiteNamespace | None = None) -> list[Check]:
        """Every check over every image of the chart. UnavailableError when the OCI registry does not answer."""
        started, problems = self._started(subject)
        references = sorted({*(container.image for container in started), *subject.images.values()})
        problems += [] if references else ["the chart runs no image"]
        problems += [f"{len(references)} images, at most {IMAGES_MAX} are read"] if references[IMAGES_MAX:] else []
        images, missing = self._read(references[:IMAGES_MAX], _platforms(subject))
        return [
            check("renders", problems, "repair the chart or its test values; the static suite says more"),
            check("exist", missing, "push the image to the platform's OCI registry and name it by its digest"),
            check("platform", _platform_problems(images.values(), _platforms(subject)), "build it for these platforms"),
            check("user", _each(images, image_checks.user_problems), USER_FIX),
            check(
                "entry-point",
                _start_problems(started, images),
                "run the program itself (command: [python3, -m, ...]), or end the script with: exec program",
            ),
            check(
                "labels", _each(images, image_checks.label_problems), "write LABEL <label>=<value> in its Dockerfile"
            ),
            check(
                "bill-of-materials",
                [
                    problem
                    for image in images.values()
                    for problem in self._bills.problems(image.reference, image.manifests)
                ],
                "make the bill of this very image and attach it to its digest: robotkube image push DIR|ARCHIVE",
            ),
        ]

    def _started(self, subject: Subject) -> tuple[list[Started], list[str]]:
        """Every container of every test set, and why a set could not be rendered."""
        started = []
        problems = []
        try:
            sets = filled_sets(subject.entry, AGENT, START_NS, self._fill)
        except InputError as error:
            return [], [str(error)]
        for test_set in sets:
            try:
                started += _containers(test_set.name, subject.render(test_set.values, RELEASE))
            except InputError as error:
                problems.append(f"set {test_set.name}: {error}")
        return list(dict.fromkeys(started)), problems

    def _read(self, references: Sequence[str], platforms: Sequence[str]) -> tuple[dict[str, Image], list[str]]:
        images = {}
        missing = []
        for text in references:
            reference = image_checks.read_reference(text)
            if reference is None:
                missing.append(f"{text}: is not named by its digest")
            elif reference.host != self._host:
                missing.append(f"{text}: is not in the platform's OCI registry {self._host}")
            else:
                try:
                    images[text] = self._image(reference, platforms)
                except InputError as error:
                    missing.append(f"{text}: {error}")
        return images, missing

    def _image(self, reference: ImageReference, platforms: Sequence[str]) -> Image:
        document = self._document(reference.repository, reference.digest)
        digests = [reference.digest]
        if "manifests" in document:
            named = [image_checks.manifest_of(document, platform) for platform in platforms]
            digests = list(dict.fromkeys(digest for digest in named if digest))
        manifests = {digest: self._document(reference.repository, digest) for digest in digests}
        configurations = {}
        for digest, manifest in manifests.items():
            configuration = self._configuration(reference.repository, digest, manifest)
            configurations[image_checks.platform_of(configuration)] = configuration
        return Image(reference, manifests, configurations)

    def _document(self, repository: str, digest: str) -> Mapping[str, Any]:
        return _json(self._oci_registry.manifest(repository, digest), f"manifest {digest}")

    def _configuration(self, repository: str, digest: str, manifest: Mapping[str, Any]) -> Mapping[str, Any]:
        described = mapping(manifest.get("config"))
        data = self._oci_registry.blob(repository, str(described.get("digest")), CONFIGURATION_BYTES_MAX)
        return _json(data, f"configuration of {digest}")


def _platforms(subject: Subject) -> list[str]:
    return [
        str(platform) for platform in mapping(subject.entry.get("spec")).get("platforms") or [subject.artefact.platform]
    ]


def _containers(test_set: str, objects: Sequence[Mapping[str, Any]]) -> list[Started]:
    pods = Rendering(test_set, "", RELEASE, "", objects).pods
    return [
        Started(
            place,
            str(container.get("image") or ""),
            tuple(map(str, container.get("command") or ())),
            tuple(map(str, container.get("args") or ())),
        )
        for pod in pods
        for place, container in pod.containers
    ]


def _json(data: bytes, what: str) -> Mapping[str, Any]:
    try:
        document = read_json(data)
    except ValueError as error:
        raise InputError(f"{what}: not readable as JSON: {error}") from error
    if not isinstance(document, Mapping):
        raise InputError(f"{what}: is no mapping")
    return document


def _platform_problems(images: Iterable[Image], platforms: Sequence[str]) -> list[str]:
    return [
        f"{image.reference}: is for {', '.join(sorted(image.configurations)) or 'none'}, the entry has {platform}"
        for image in images
        for platform in platforms
        if platform not in image.configurations
    ]


def _each(images: Mapping[str, Image], problems_of: Any) -> list[str]:
    return [
        problem
        for text, image in images.items()
        for settings in image.settings
        for problem in problems_of(text, settings)
    ]


def _start_problems(started: Sequence[Started], images: Mapping[str, Image]) -> list[str]:
    """Every container, and with its own settings every image that a container's command does not replace."""
    return [
        problem
        for container in started
        for settings in (
            images[container.image].settings if container.image in images else [{}] if container.command else []
        )
        for problem in image_checks.start_problems(container, settings)
    ]
