"""`helm template` of a chart that is not trusted yet: bounded in time, memory and output, without network, with an
empty home and an empty environment; see helm_sandbox.py, as which the program is started.

Only what a chart's own files say is rendered: a schema that refers to anything outside itself is refused, since helm
would read that file or ask that address.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.yaml_codec import read_mappings

PROGRAM = "/usr/local/bin/helm"  # where the platform's image has it
PROGRAM_VARIABLE = "ROBOTKUBE_HELM"  # of the environment: another place
LACKING = f"there is no program helm; install it, or name it in {PROGRAM_VARIABLE}"
SECONDS_MAX = 20.0  # of a processor
CLOCK_SECONDS_MAX = 120.0  # on a machine that has other work
MEMORY_BYTES_MAX = 512 * 1024 * 1024
OUTPUT_BYTES_MAX = 2 * 1024 * 1024
FILES_MAX = 1_000
FILES_BYTES_MAX = 8 * 1024 * 1024
MESSAGE_CHARACTERS_MAX = 2_000
SCHEMA_FILE = "values.schema.json"
SCHEMA_DEPTH_MAX = 64
REFERENCES = ("$ref", "$dynamicRef", "$recursiveRef")
DIALECTS = "json-schema.org/"
REFUSED = "helm template: "  # begins what helm says of a chart that it does not render
NOT_STARTED = 126  # the exit code of helm_sandbox.py
SANDBOX = Path(__file__).with_name("helm_sandbox.py")


def find_helm() -> str:
    """The program helm: the one that is named, that of the platform's image, or one on the PATH; empty without."""
    named = os.environ.get(PROGRAM_VARIABLE)
    candidates = [named] if named else [PROGRAM, shutil.which("helm")]
    return next(
        (str(Path(candidate).resolve()) for candidate in candidates if candidate and Path(candidate).is_file()), ""
    )


class HelmProgram:
    """The port ChartProgram on the program at `path`; `work` is a folder for what one rendering needs. One that takes
    more than `seconds` of a processor is refused; UnavailableError when it has not ended in `clock_seconds`, which the
    chart may not be to blame for."""

    def __init__(
        self, path: str, work: Path, seconds: float = SECONDS_MAX, clock_seconds: float = CLOCK_SECONDS_MAX
    ) -> None:
        self._path = path
        self._work = work
        self._seconds = seconds
        self._clock_seconds = clock_seconds

    def render(
        self, files: Mapping[str, bytes], values: Mapping[str, Any], release: str, namespace: str
    ) -> list[dict[str, Any]]:
        """The objects of the chart."""
        _refuse(files)
        with tempfile.TemporaryDirectory(dir=self._work) as folder:
            place = Path(folder)
            _write(files, place / "chart")
            (place / "values.json").write_text(json.dumps(values))
            (place / "home").mkdir()
            text = self._run(place, release, namespace)
        return read_mappings(text, f"objects of {release}", OUTPUT_BYTES_MAX)

    def _run(self, place: Path, release: str, namespace: str) -> str:
        bounds = [str(bound) for bound in (math.ceil(self._seconds), MEMORY_BYTES_MAX, OUTPUT_BYTES_MAX)]
        command = [sys.executable, "-I", "-S", str(SANDBOX), *bounds, self._path, "template", release]
        command += [str(place / "chart"), "--namespace", namespace, "--values", str(place / "values.json")]
        with (place / "objects").open("wb") as objects, (place / "errors").open("wb") as errors:
            try:
                done = subprocess.run(
                    [*command, "--include-crds"], stdin=subprocess.DEVNULL, stdout=objects, stderr=errors,
                    env={"HOME": str(place / "home"), "PATH": ""}, cwd=place, timeout=self._clock_seconds, check=False,
                )  # fmt: skip
            except subprocess.TimeoutExpired as error:
                raise UnavailableError(
                    f"a chart could not be rendered within {self._clock_seconds:g} s; try again later"
                ) from error
        if done.returncode == NOT_STARTED:
            raise UnavailableError(_words(place, done.returncode))
        if (place / "objects").stat().st_size >= OUTPUT_BYTES_MAX:
            raise InputError(f"the chart renders to more than {OUTPUT_BYTES_MAX} bytes; make fewer or smaller objects")
        if done.returncode != 0:
            raise InputError(f"{REFUSED}{_words(place, done.returncode)}")
        return (place / "objects").read_text(encoding="utf-8", errors="replace")


def _words(place: Path, code: int) -> str:
    text = (place / "errors").read_bytes()[:OUTPUT_BYTES_MAX].decode("utf-8", "replace")
    text = (
        text.replace(f"{place}/", "").strip()
        or f"ended with {code} (memory or time was not enough); make its templates simpler"
    )
    return text if len(text) <= MESSAGE_CHARACTERS_MAX else text[:MESSAGE_CHARACTERS_MAX] + " ..."


def _write(files: Mapping[str, bytes], folder: Path) -> None:
    folder.mkdir()
    for path, data in files.items():
        place = folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)


def _refuse(files: Mapping[str, bytes]) -> None:
    """InputError for files that helm must not see."""
    if len(files) > FILES_MAX or sum(map(len, files.values())) > FILES_BYTES_MAX:
        raise InputError(f"the chart has more than {FILES_MAX} files or {FILES_BYTES_MAX} bytes")
    for path, data in files.items():
        pure = PurePosixPath(path)
        if pure.is_absolute() or ".." in pure.parts or "\0" in path or not path:
            raise InputError(f"{path!r}: not a path inside a chart")
        if pure.name == SCHEMA_FILE:
            _refuse_references(path, data)


def _refuse_references(path: str, data: bytes) -> None:
    try:
        document = read_json(data)
    except ValueError as error:
        raise InputError(f"{path}: no JSON: {error}") from error
    for key, value in _references(document, 0):
        if key == "$schema" and DIALECTS in value:
            continue
        if key == "$schema" or not value.startswith("#"):
            raise InputError(f"{path}: {key} {value!r} leads outside the file; write the schema out in the file")


def _references(value: Any, depth: int) -> Iterator[tuple[str, str]]:
    if depth > SCHEMA_DEPTH_MAX:
        raise InputError(f"{SCHEMA_FILE}: nested deeper than {SCHEMA_DEPTH_MAX}")
    if isinstance(value, dict):
        for key, inner in value.items():
            if key in (*REFERENCES, "$schema") and isinstance(inner, str):
                yield key, inner
            yield from _references(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            yield from _references(inner, depth + 1)
