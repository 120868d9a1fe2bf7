"""The bill of an image that was built elsewhere is one that the suite `images` takes."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.registry.images.adapters.own_images import describe_image
from robotkube.registry.suites.adapters.image_layers import read_layer
from robotkube.registry.suites.core.bill_comparison import differences
from robotkube.registry.suites.core.image_checks import bill_problems
from robotkube.registry.suites.core.image_contents import contents_of
from tests.stages.registry.made_archives import write_archive
from tests.stages.registry.made_layers import COMPRESSIONS, ELF, FILES, Content, made_layer

pytestmark = pytest.mark.processes

UPPER: dict[str, Content] = {"usr/bin/.wh.same-tool": b"", "lib/libnew.so": ELF, "bin": ("symlink", "usr/bin")}


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_bill_of_compressed_layers_lists_what_is_in_them(tmp_path: Path, compression: str) -> None:
    plain = [made_layer(FILES), made_layer(UPPER)]
    digest = write_archive(tmp_path / "own.tar", [COMPRESSIONS[compression](layer) for layer in plain])
    described = describe_image(tmp_path / "own.tar", "own")
    assert (described.digest, described.bill) == (digest, tmp_path / "own.tar.bill.json")
    data = described.bill.read_bytes()
    image = contents_of(read_layer(iter([layer])) for layer in plain)
    assert image.elf.keys() == {"/usr/bin/tool", "/usr/lib/libx.so.1", "/usr/lib/libnew.so"}
    assert list(bill_problems(data, digest)) == []
    assert list(differences(json.loads(data), image)) == []
    assert json.loads(data)["metadata"]["component"]["name"] == "own"


def test_an_index_of_several_manifests_is_refused_with_the_way_out(tmp_path: Path) -> None:
    digest = write_archive(tmp_path / "own.tar", [])
    with tarfile.open(tmp_path / "own.tar") as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    files["blobs/" + digest.replace(":", "/")] = b'{"manifests": []}'
    with tarfile.open(tmp_path / "own.tar", "w") as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    with pytest.raises(InputError, match="an index of several manifests; write one image: docker buildx build --prov"):
        describe_image(tmp_path / "own.tar", "own")
    with pytest.raises(InputError, match=r"missing\.tar: no OCI layout archive"):
        describe_image(tmp_path / "missing.tar", "own")
