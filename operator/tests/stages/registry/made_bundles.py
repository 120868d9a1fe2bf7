"""A small bundle: two images that share a layer, one of them cut from the other, charts with and without evidence."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

from robotkube.registry.bundles.adapters.layouts import Bundle, read_bundle
from robotkube.registry.bundles.adapters.making import BundleMaker
from robotkube.registry.charts.core.packing import PackedChart, pack_chart
from tests.stages.registry.made_archives import write_archive

VERSION, PREFIX = "0.1.0", "forge.robotkube.svc.cluster.local:3000/robotkube"
SHARED = b"a layer that both have" * 1000
EVIDENCE = {"static": b'{"payload":"static"}', "summary": b'{"payload":"summary"}'}


def chart(name: str, version: str = "0.2.0") -> PackedChart:
    """A chart without templates."""
    metadata = {"apiVersion": "v2", "name": name, "version": version}
    return pack_chart(name, metadata, {"Chart.yaml": json.dumps(metadata).encode()})


def without(archive: Path, layer: bytes) -> None:
    """Take a layer out of an archive, as those of images that are cut from another lack what that has."""
    from tests.stages.registry.made_layers import digest_of

    left_out = "blobs/" + digest_of(layer).replace(":", "/")
    part = archive.with_suffix(".part")
    with tarfile.open(archive) as source, tarfile.open(part, "w") as target:
        for member in source:
            if member.name != left_out:
                target.addfile(member, source.extractfile(member))
    part.replace(archive)


def made(folder: Path, name: str = "robotkube-0.1.0.tar") -> Bundle:
    """The bundle, in a folder."""
    ground, cut, bill = folder / "platform.tar", folder / "gate.tar", folder / "bill.json"
    write_archive(ground, [SHARED, b"platform"])
    write_archive(cut, [SHARED, b"gate"])
    without(cut, SHARED)
    bill.write_bytes(b'{"bomFormat":"CycloneDX"}')
    maker = BundleMaker(VERSION, PREFIX)
    maker.add_image("platform", ground, bill)
    maker.add_image("gate", cut, bill, ground)
    maker.add_chart(chart("mqtt-bridge"), EVIDENCE)
    maker.add_chart(chart("bag-player"), {})
    maker.add_chart(chart("robotkube", VERSION), {})
    maker.add_manifests("argocd", "3.5.7", f"image: {PREFIX}/argocd@sha256:{'0' * 64}\n")
    maker.write(folder / name)
    return read_bundle(folder / name)
