"""What runs in the processes of `ForkedSuites` in tests: importable there, hence a module of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.registry.suites.core.requests import SuiteProgress, progress_document, read_request
from robotkube.testing.suites import passed


def run(payload: bytes, namespace: str) -> bytes:
    """Does what the first word of the rule's command says."""
    request = read_request(json.loads(payload))
    word, *more = request.rule.command
    if word == "hang":
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        Path(more[0]).write_text(f"{os.getpid()} {child.pid}")
        time.sleep(600)
    if word == "crash":
        os._exit(7)
    if word == "raise":
        raise ValueError("odd")
    if word == "memory":
        return bytes(2 * 1024**3)
    if word == "flood":
        return bytes(8 * 1024 * 1024)
    if word == "nothing":
        return canonical_json(progress_document(SuiteProgress("running")))
    return canonical_json(progress_document(SuiteProgress("finished", passed(request))))
