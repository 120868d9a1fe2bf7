"""A small image for tests of the cluster: one static program in an OCI layout archive, as image builds deliver it."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import tarfile
from pathlib import Path
from typing import Any

BUILD_TIMEOUT_SECONDS = 300
REPOSITORY = "forge.robotkube.svc.cluster.local:3000/robotkube"

# Without arguments: sleep until told to end, as a pause image does.
# Otherwise: serve PORT | get URL | write FILE | read FILE.
PROGRAM = """
package main

import (
	"context"
	"fmt"
	"io"
	"net/http"
	"os"
	"os/signal"
	"syscall"
	"time"
)

func fail(err error) {
	if err != nil {
		fmt.Println(err)
		os.Exit(1)
	}
}

func main() {
	stop, cancel := signal.NotifyContext(context.Background(), syscall.SIGTERM, syscall.SIGINT)
	defer cancel()
	if len(os.Args) < 3 {
		<-stop.Done()
		return
	}
	what := os.Args[2]
	switch os.Args[1] {
	case "serve":
		host, _ := os.Hostname()
		name := http.HandlerFunc(func(w http.ResponseWriter, _ *http.Request) { fmt.Fprintln(w, host) })
		go http.ListenAndServe(":"+what, name)
		<-stop.Done()
	case "get":
		answer, err := (&http.Client{Timeout: 3 * time.Second}).Get(what)
		fail(err)
		body, _ := io.ReadAll(answer.Body)
		fmt.Print(string(body))
	case "write":
		fail(os.WriteFile(what, []byte("written\\n"), 0o600))
	case "read":
		content, err := os.ReadFile(what)
		fail(err)
		fmt.Print(string(content))
	}
}
"""


def build(folder: Path, names: tuple[str, ...] = ("pause", "probe")) -> Path:
    """Write one archive per name and the lock file images.json, whose path is returned."""
    source = folder / "source"
    source.mkdir(parents=True)
    (source / "go.mod").write_text("module probe\n\ngo 1.21\n", encoding="utf-8")
    (source / "main.go").write_text(PROGRAM, encoding="utf-8")
    command = ["go", "build", "-trimpath", "-ldflags", "-s -w", "-o", "probe", "."]
    environment = ["env", "CGO_ENABLED=0"]
    subprocess.run([*environment, *command], cwd=source, check=True, timeout=BUILD_TIMEOUT_SECONDS)
    lock = {}
    for name in names:
        digest = archive(folder / f"{name}.tar", (source / "probe").read_bytes(), name)
        lock[name] = {"reference": f"{REPOSITORY}/{name}@{digest}", "archive": f"{name}.tar"}
    (folder / "images.json").write_text(json.dumps(lock), encoding="utf-8")
    return folder / "images.json"


def archive(target: Path, program: bytes, comment: str) -> str:
    """An OCI layout with one layer that holds /probe; returns the manifest's digest."""
    layer = _tar({"probe": program})
    config = {
        "architecture": "amd64",
        "os": "linux",
        "config": {"Entrypoint": ["/probe"], "User": "65532:65532", "Labels": {"comment": comment}},
        "rootfs": {"type": "layers", "diff_ids": [_digest(layer)]},
    }
    blobs = [layer, json.dumps(config).encode()]
    manifest = {
        "schemaVersion": 2,
        "mediaType": "application/vnd.oci.image.manifest.v1+json",
        "config": _descriptor("application/vnd.oci.image.config.v1+json", blobs[1]),
        "layers": [_descriptor("application/vnd.oci.image.layer.v1.tar", layer)],
    }
    blobs.append(json.dumps(manifest).encode())
    index = {"schemaVersion": 2, "manifests": [_descriptor(str(manifest["mediaType"]), blobs[2])]}
    files = {f"blobs/sha256/{_digest(blob).removeprefix('sha256:')}": blob for blob in blobs}
    files |= {"oci-layout": b'{"imageLayoutVersion": "1.0.0"}', "index.json": json.dumps(index).encode()}
    target.write_bytes(_tar(files))
    return _digest(blobs[2])


def _descriptor(media_type: str, blob: bytes) -> dict[str, Any]:
    return {"mediaType": media_type, "digest": _digest(blob), "size": len(blob)}


def _digest(blob: bytes) -> str:
    return "sha256:" + hashlib.sha256(blob).hexdigest()


def _tar(files: dict[str, bytes]) -> bytes:
    output = io.BytesIO()
    with tarfile.open(fileobj=output, mode="w") as bundle:
        for name, content in sorted(files.items()):
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            entry.mode = 0o755
            bundle.addfile(entry, io.BytesIO(content))
    return output.getvalue()
