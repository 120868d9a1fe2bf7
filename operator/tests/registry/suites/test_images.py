"""The images suite over a registry in memory: every check once, all problems at once."""

from __future__ import annotations

import copy
import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.charts.ports import Attachment
from robotkube.registry.evidence.core.statements import Artefact
from robotkube.registry.suites.adapters.kept_layers import KeptLayers
from robotkube.registry.suites.core import image_checks
from robotkube.registry.suites.core.image_checks import Started
from robotkube.registry.suites.loops.images import CONFIGURATION_BYTES_MAX, ImagesSuite
from robotkube.registry.suites.ports.suites import Subject
from tests.stages.registry.made_layers import ELF, SITE, digest_of, hex_of, made_layer

HOST, REPOSITORY = "forge.invalid:3000", "robotkube/ros"
PROGRAM = ["robotkube-bridge"]
SETTINGS: dict[str, Any] = {
    "User": "10001:10001",
    "Entrypoint": PROGRAM,
    "Labels": {"org.opencontainers.image.title": "robotkube ros", "org.opencontainers.image.version": "0.1.0"},
}


LAYER = made_layer({"usr/bin/tool": ELF, f"{SITE}/six-1.16.dist-info/METADATA": b"Name: six\nVersion: 1.16\n"})


def bill_of(digest: str) -> dict[str, Any]:
    """The bill of an image of LAYER."""
    tool = {"type": "file", "name": "/usr/bin/tool", "hashes": [{"alg": "SHA-256", "content": hex_of(ELF)}]}
    return {
        "bomFormat": "CycloneDX",
        "metadata": {"component": {"hashes": [{"alg": "SHA-256", "content": digest.removeprefix("sha256:")}]}},
        "components": [{"name": "six", "purl": "pkg:pypi/six@1.16"}, tool],
    }


class MemoryRegistry:
    """Manifests, blobs and attachments by digest."""

    def __init__(self, kept_layers: Path) -> None:
        self.kept_layers = kept_layers
        self.contents: dict[str, bytes] = {}
        self.attached: dict[str, list[Attachment]] = {}
        self.layers_read: list[str] = []
        self.down = False

    def put(self, document: Any) -> str:
        return self.put_bytes(json.dumps(document).encode())

    def put_bytes(self, data: bytes) -> str:
        self.contents[digest_of(data)] = data
        return digest_of(data)

    def image(
        self,
        bill: bool = True,
        platform: tuple[str, str] = ("linux", "amd64"),
        layers: Sequence[bytes] = (LAYER,),
        **settings: Any,
    ) -> str:
        """An image with SETTINGS, some of them changed; its digest."""
        names = dict(zip(("os", "architecture"), platform, strict=True))
        config = self.put({**names, "config": {**copy.deepcopy(SETTINGS), **settings}})
        described = [{"digest": self.put_bytes(layer)} for layer in layers]
        digest = self.put({"config": {"digest": config, "size": 1}, "layers": described})
        if bill:
            self.attach(digest, bill_of(digest))
        return digest

    def attach(self, digest: str, bill: Any, artifact_type: str = image_checks.BILL_TYPE) -> None:
        data = bill if isinstance(bill, bytes) else json.dumps(bill).encode()
        self.attached.setdefault(digest, []).append(Attachment("sha256:x", artifact_type, data, {}))

    def manifest(self, repository: str, digest: str) -> bytes:
        return self.blob(repository, digest, CONFIGURATION_BYTES_MAX)

    def blob(self, repository: str, digest: str, bytes_max: int) -> bytes:
        if self.down:
            raise UnavailableError("registry: does not answer")
        if repository != REPOSITORY or digest not in self.contents:
            raise InputError(f"registry: {repository} has no {digest}")
        assert len(self.contents[digest]) <= bytes_max
        return self.contents[digest]

    def blob_pieces(self, repository: str, digest: str, bytes_max: int) -> Iterator[bytes]:
        self.layers_read.append(digest)
        return iter([self.blob(repository, digest, bytes_max)])

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        return self.attached.get(subject, [])


@pytest.fixture
def registry(tmp_path: Path) -> MemoryRegistry:
    return MemoryRegistry(tmp_path / "layers")


def subject_of(
    reference: str,
    container: Mapping[str, Any] | None = None,
    platforms: Sequence[str] = ("linux/amd64",),
    images: Mapping[str, str] | None = None,
) -> Subject:
    """A chart with one container."""
    sets = [{"name": name, "values": {"placement": {"agent": "{{ agent }}"}}} for name in ("first", "second")]
    entry = {"spec": {"platforms": list(platforms), "suites": {"sets": sets}}}

    def render(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        assert values["placement"]["agent"] == "agent-00"
        one = {"name": "app", "image": reference, "command": PROGRAM, **(container or {})}
        spec = {"template": {"spec": {"containers": [one]}}}
        return [{"kind": "Deployment", "metadata": {"name": release}, "spec": spec}]

    artefact = Artefact("app", "0.1.0", "sha256:" + "1" * 64, "linux/amd64")
    return Subject(artefact, entry, {}, b"", {"ros": reference} if images is None else images, render)


def reference(digest: str) -> str:
    return f"{HOST}/{REPOSITORY}@{digest}"


def problems(registry: MemoryRegistry, subject: Subject) -> dict[str, str]:
    checks = ImagesSuite(registry, KeptLayers(registry.kept_layers), HOST, Jinja2Templates().render).run(subject)
    assert [check.name for check in checks] == [
        "renders",
        "exist",
        "platform",
        "user",
        "entry-point",
        "labels",
        "bill-of-materials",
    ]
    assert all(check.passed or check.fix for check in checks)
    return {check.name: check.found for check in checks if not check.passed}


def test_an_image_in_order_passes(registry: MemoryRegistry) -> None:
    assert problems(registry, subject_of(reference(registry.image()))) == {}


def test_an_image_that_is_not_there(registry: MemoryRegistry) -> None:
    gone = reference("sha256:" + "0" * 64)
    assert problems(registry, subject_of(gone)) == {"exist": f"{gone}: registry: {REPOSITORY} has no sha256:{'0' * 64}"}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"{HOST}/{REPOSITORY}:0.1.0", "is not named by its digest"),
        (f"docker.io/library/python@sha256:{'0' * 64}", f"is not in the platform's OCI registry {HOST}"),
        ("", "is not named by its digest"),
    ],
)
def test_a_reference_that_cannot_be_looked_up(registry: MemoryRegistry, text: str, found: str) -> None:
    assert found in problems(registry, subject_of(text))["exist"]


def test_images_that_no_container_runs_are_looked_at(registry: MemoryRegistry) -> None:
    images = {"ros": reference(registry.image()), "tool": reference("sha256:" + "0" * 64)}
    assert list(problems(registry, subject_of(images["ros"], images=images))) == ["exist"]


def test_a_registry_that_does_not_answer_is_no_finding(registry: MemoryRegistry) -> None:
    subject = subject_of(reference(registry.image()))
    registry.down = True
    with pytest.raises(UnavailableError, match="does not answer"):
        problems(registry, subject)


def test_an_image_for_another_platform(registry: MemoryRegistry) -> None:
    image = reference(registry.image(platform=("linux", "arm64")))
    assert problems(registry, subject_of(image)) == {
        "platform": f"{image}: is for linux/arm64, the entry has linux/amd64"
    }


def test_an_index_is_read_for_every_platform_of_the_entry(registry: MemoryRegistry) -> None:
    names = (("linux", "amd64"), ("linux", "arm64"))
    manifests = [
        {"digest": registry.image(bill=False, platform=name), "platform": {"os": name[0], "architecture": name[1]}}
        for name in names
    ]
    index = registry.put({"manifests": manifests})
    registry.attach(index, bill_of(index))
    assert problems(registry, subject_of(reference(index), platforms=["linux/amd64", "linux/arm64"])) == {}
    wanted = subject_of(reference(index), platforms=["linux/amd64", "linux/riscv64"])
    assert "the entry has linux/riscv64" in problems(registry, wanted)["platform"]


ROOT, A_NAME = "it runs as root", "a name proves nothing: its number may be 0"


@pytest.mark.parametrize(
    ("user", "why"),
    [("", ROOT), ("0", ROOT), ("0:0", ROOT), ("root", ROOT), ("robot", A_NAME), ("10001:users", A_NAME)],
)
def test_a_user_that_may_be_root(registry: MemoryRegistry, user: str, why: str) -> None:
    named = problems(registry, subject_of(reference(registry.image(User=user))))
    assert list(named) == ["user"]
    assert f"user is {user or 'not set'}: {why}" in named["user"]


def test_who_was_root_for_run_is_told_what_stands_at_the_end(registry: MemoryRegistry) -> None:
    subject = subject_of(reference(registry.image(User="0:0")))
    suite = ImagesSuite(registry, KeptLayers(registry.kept_layers), HOST, Jinja2Templates().render)
    [check] = [one for one in suite.run(subject) if one.name == "user"]
    assert check.fix == "end its Dockerfile with USER 10001:10001, behind every RUN that USER 0:0 stands before"


def test_labels_that_are_missing(registry: MemoryRegistry) -> None:
    named = problems(registry, subject_of(reference(registry.image(Labels=None))))
    assert named["labels"].count("is missing") == 2


@pytest.mark.parametrize(
    "words",
    [
        ["sh", "-c", "python3 node.py; echo ended"],
        ["/bin/sh", "-ec", "cd /app && python3 node.py"],
        ["bash", "-l", "-c", "exec python3 a.py & wait"],
        ["/usr/bin/env", "LANG=C", "sh", "-c", "python3 node.py"],
        ["busybox", "ash", "-c", "# exec\npython3 node.py"],
        ["sh", "-c"],
        ["sh", "-c", "exec sleep 1 &"],
        ["sh", "-c", "exec python3 a.py | tee log"],
        ["sh", "-c", "if true; then exec a; fi"],
        ["sh", "-c", "exec 'unfinished"],
        ["sh", "-c", "exec"],
    ],
)
def test_a_shell_as_the_first_process(registry: MemoryRegistry, words: list[str]) -> None:
    for container, image in (
        ({"command": words}, registry.image()),
        ({"command": words[:1], "args": words[1:]}, registry.image()),
        ({"command": None}, registry.image(Entrypoint=words)),
        ({"command": None, "args": words[1:]}, registry.image(Entrypoint=words[:1], Cmd=["other"])),
    ):
        named = problems(registry, subject_of(reference(image), container))
        assert "a shell is PID 1 and passes no SIGTERM on" in named["entry-point"]


@pytest.mark.parametrize(
    "words",
    [
        ["sh", "-c", "cd /app && exec python3 node.py"],
        ["sh", "-c", "set -e\nprepare\nexec python3 node.py\n"],
        ["sh", "-c", "a || b; exec python3 -c 'x; y' 2>&1"],
        ["/usr/bin/tini", "--", "sh", "-c", "python3 node.py"],
        ["sh", "/entrypoint.sh", "-c", "x"],
        ["python3", "-c", "import time; time.sleep(1)"],
    ],
)
def test_what_gets_its_signals(words: list[str]) -> None:
    assert list(image_checks.start_problems(Started("app", "image", tuple(words), ()), {})) == []


def test_a_command_replaces_what_the_image_starts(registry: MemoryRegistry) -> None:
    image = registry.image(Entrypoint=["sh", "-c"], Cmd=["python3 node.py"])
    assert problems(registry, subject_of(reference(image))) == {}


def test_nothing_to_run(registry: MemoryRegistry) -> None:
    image = reference(registry.image(Entrypoint=None, Cmd=None))
    assert "says what to run" in problems(registry, subject_of(image, {"command": None}))["entry-point"]


def test_an_image_without_a_bill(registry: MemoryRegistry) -> None:
    digest = registry.image(bill=False)
    registry.attach(digest, b"{}", artifact_type="application/vnd.in-toto+json")
    named = problems(registry, subject_of(reference(digest)))
    assert named == {
        "bill-of-materials": f"{reference(digest)}: no software bill of materials is attached to this digest"
    }


@pytest.mark.parametrize(
    ("bill", "found"),
    [
        (b"\xff", "is not readable as JSON"),
        (b"[" * 100_000, "is not readable as JSON"),
        ({**bill_of("sha256:" + "2" * 64)}, "describes another image"),
        ({"bomFormat": "SPDX"}, "bomFormat is 'SPDX', not CycloneDX"),
        ([1], "bomFormat is None"),
    ],
)
def test_a_bill_that_says_nothing_about_the_image(registry: MemoryRegistry, bill: Any, found: str) -> None:
    digest = registry.image(bill=False)
    registry.attach(digest, bill)
    assert found in problems(registry, subject_of(reference(digest)))["bill-of-materials"]
    registry.attach(digest, bill_of(digest))
    assert problems(registry, subject_of(reference(digest))) == {}


def bill_found(registry: MemoryRegistry, digest: str) -> str:
    return problems(registry, subject_of(reference(digest))).get("bill-of-materials", "")


def test_a_file_that_is_added_to_the_image_is_missed_in_the_bill(registry: MemoryRegistry) -> None:
    digest = registry.image(bill=False, layers=[LAYER, made_layer({"usr/bin/added": ELF})])
    registry.attach(digest, bill_of(digest))
    assert "the attached bill lacks 1 ELF file of the image: /usr/bin/added" in bill_found(registry, digest)


def test_a_file_that_is_removed_from_the_image_is_one_too_many_in_the_bill(registry: MemoryRegistry) -> None:
    digest = registry.image(bill=False, layers=[LAYER, gzip.compress(made_layer({"usr/bin/.wh.tool": b""}))])
    registry.attach(digest, bill_of(digest))
    assert "names 1 file that the image does not have: /usr/bin/tool" in bill_found(registry, digest)


def test_the_bill_of_another_image_with_this_digest_written_into_it(registry: MemoryRegistry) -> None:
    digest = registry.image(bill=False)
    foreign = bill_of(digest) | {"components": [{"name": "libc6", "purl": "pkg:deb/debian/libc6@2.36"}]}
    registry.attach(digest, foreign)
    bill = bill_found(registry, digest)
    assert "lacks 1 Python package of the image: six 1.16" in bill
    assert "lacks 1 ELF file of the image: /usr/bin/tool" in bill
    assert "names 1 Debian package that the image does not have: libc6 2.36" in bill
    registry.attach(digest, bill_of(digest))
    assert bill_found(registry, digest) == ""


def test_an_image_without_packages_needs_no_package_in_its_bill(registry: MemoryRegistry) -> None:
    digest = registry.image(bill=False, layers=[made_layer({"usr/bin/tool": ELF})])
    registry.attach(digest, bill_of(digest) | {"components": bill_of(digest)["components"][1:]})
    assert bill_found(registry, digest) == ""


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        ([b"no tar"], "not readable as a layer"),
        ([LAYER] * 129, "129 layers; at most 128 are read"),
        ([made_layer({"x": ("hardlink", "none")})], "/x: is a hard link to /none, which is not there"),
    ],
)
def test_an_image_that_cannot_be_read(registry: MemoryRegistry, layers: list[bytes], words: str) -> None:
    digest = registry.image(bill=False, layers=layers)
    registry.attach(digest, bill_of(digest))
    assert f"cannot be compared with its bill: {words}" in bill_found(registry, digest)


def test_layers_are_read_once_and_only_for_a_bill_that_says_it_is_of_this_image(registry: MemoryRegistry) -> None:
    first = registry.image()
    second = registry.image(layers=[LAYER, made_layer({"etc/more": b""})])
    for _ in range(3):
        assert bill_found(registry, first) == bill_found(registry, second) == ""
    assert len(registry.layers_read) == 2
    other = registry.image(bill=False, layers=[made_layer({"etc/other": b""})])
    registry.attach(other, bill_of(first))
    assert "describes another image" in bill_found(registry, other)
    assert len(registry.layers_read) == 2


def test_each_platform_of_an_index_needs_a_bill_that_lists_it(registry: MemoryRegistry) -> None:
    names = (("linux", "amd64"), ("linux", "arm64"))
    layers = (LAYER, made_layer({"usr/bin/arm": ELF}))
    digests = [registry.image(bill=False, platform=one, layers=[two]) for one, two in zip(names, layers, strict=True)]
    index = registry.put(
        {
            "manifests": [
                {"digest": digest, "platform": {"os": one, "architecture": two}}
                for digest, (one, two) in zip(digests, names, strict=True)
            ]
        }
    )
    registry.attach(index, bill_of(index))
    subject = subject_of(reference(index), platforms=["linux/amd64", "linux/arm64"])
    assert f"{reference(digests[1])}: the attached bill lacks" in problems(registry, subject)["bill-of-materials"]
    arm = bill_of(digests[1])
    arm["components"] = [{**arm["components"][1], "name": "/usr/bin/arm"}]
    registry.attach(digests[1], arm)
    assert problems(registry, subject) == {}


@pytest.mark.parametrize("document", [[], "text", {"config": 1}, {"manifests": 3}, {"manifests": [{"platform": 1}]}])
def test_manifests_of_the_wrong_form_are_findings(registry: MemoryRegistry, document: Any) -> None:
    named = problems(registry, subject_of(reference(registry.put(document))))
    assert named.keys() & {"exist", "platform"}


def test_a_chart_that_cannot_be_rendered_is_a_finding(registry: MemoryRegistry) -> None:
    subject = subject_of(reference(registry.image()))
    without_sets = Subject(subject.artefact, {"spec": {}}, {}, b"", subject.images, subject.render)
    assert "the entry has no test values" in problems(registry, without_sets)["renders"]

    def refuse(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        raise InputError("Error: values don't meet the specifications")

    broken = Subject(subject.artefact, subject.entry, {}, b"", {}, refuse)
    problem = problems(registry, broken)["renders"]
    assert "set first: Error: values don't meet" in problem
    assert "the chart runs no image" in problem


def test_references_by_digest() -> None:
    read = image_checks.read_reference(f"{HOST}/a/b-c/d@sha256:{'0' * 64}")
    assert read is not None
    assert (read.host, read.repository, str(read)) == (HOST, "a/b-c/d", f"{HOST}/a/b-c/d@sha256:{'0' * 64}")
    for text in ("ros", f"{HOST}/a@sha256:{'0' * 63}", f"{HOST}/A@sha256:{'0' * 64}", f"{HOST}/../a@sha256:{'0' * 64}"):
        assert image_checks.read_reference(text) is None
