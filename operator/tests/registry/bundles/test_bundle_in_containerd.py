"""A bundle's images in a container runtime, without a registry: known by the references that the charts have."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from ci.cluster.embedded.nodes import containerd
from ci.images import preparation
from robotkube.cli.main import main
from robotkube.registry.bundles.adapters.layouts import Bundle, read_bundle
from robotkube.registry.bundles.adapters.making import BundleMaker
from robotkube.registry.images.adapters import bills
from tests.stages import waiting
from tests.stages.programs import folder, program
from tests.stages.registry.made_bundles import PREFIX, VERSION

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]

NAMES = ("pause", "ferretdb")  # small ones
END_SECONDS_MAX = 30


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    path = tmp_path_factory.mktemp("bundle") / "robotkube.tar"
    maker = BundleMaker(VERSION, PREFIX)
    for image in preparation.everything().images:
        if image.name in NAMES:
            maker.add_image(image.name, image.archive, image.archive.with_name(bills.FILE), image.ground)
    maker.write(path)
    return read_bundle(path)


@pytest.fixture
def socket(tmp_path: Path) -> Iterator[Path]:
    """A containerd without anything in it; layers are mounted where nobody else sees it."""
    state = tmp_path / "state"
    state.mkdir()
    settings = containerd.ContainerdSettings(
        tmp_path / "root", state, "none", Path(program("runc")), state, state / "certs.d"
    )
    (state / "containerd.toml").write_text(settings.toml())
    command = ["unshare", "--mount", "--propagation", "private", program("containerd")]
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen([*command, "--config", str(state / "containerd.toml")], stdout=log, stderr=log)
        try:
            path = state / "containerd.sock"
            version = [program("ctr"), "--address", str(path), "version"]
            waiting.until(
                lambda: path.exists() and subprocess.run(version, capture_output=True, check=False).returncode == 0,
                "containerd",
                seconds=60,
                state=lambda: (tmp_path / "log").read_text()[-1000:],
            )
            yield path
        finally:
            process.terminate()
            process.wait(END_SECONDS_MAX)


def test_images_are_known_by_the_references_of_the_charts(
    bundle: Bundle, socket: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", f"{folder()}:/usr/sbin:/usr/bin:/sbin:/bin")
    assert main(["bundle", "load", str(bundle.path), "--containerd", str(socket)]) == 0
    ctr = [program("ctr"), "--address", str(socket), "--namespace", "k8s.io", "images", "list"]
    listed = subprocess.run(ctr, capture_output=True, text=True, timeout=60, check=True).stdout
    known = {line.split()[0]: line.split()[2] for line in listed.splitlines()[1:]}
    for name, reference in bundle.contents.references().items():
        assert known[reference] == reference.rpartition("@")[2], name
