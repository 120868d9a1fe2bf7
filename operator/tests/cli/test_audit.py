"""The command `robotkube audit` on a saved folder: data on stdout, talk on stderr, exit codes, the page for people."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pygit2
import pytest

from robotkube.cli.main import main
from robotkube.delivery.audit.adapters.html_page import page
from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH
from robotkube.delivery.deployment.core.policies.initial import PATH
from tests.stages.delivery.audit.audited_platform import (
    BEGAN,
    MINUTE,
    RECORDER,
    SECOND,
    Platform,
    files_of,
    message_of,
    plan_id,
    release,
)
from tests.stages.delivery.audit.manipulations import LATER, break_glass

EVIL = "<script>alert('x')</script>"


@pytest.fixture
def saved(clean: Platform, tmp_path: Path) -> Platform:
    """A copy of the platform, as `--save` leaves it in `folder`/saved."""
    platform = clean.copy(tmp_path / "platform")
    (tmp_path / "saved").mkdir()
    for name, target in (("deployment.git", platform.deployment.folder), ("catalogue.git", platform.catalogue.folder)):
        (tmp_path / "saved" / name).symlink_to(target)
    (tmp_path / "saved" / "oci").symlink_to(platform.folder / "oci")
    return platform


class Line:
    def __init__(self, saved: Platform, capture: pytest.CaptureFixture[str]) -> None:
        self.folder = saved.folder.parent
        self.offline = ("--offline", str(self.folder / "saved"))
        self.keys = ("--keys", str(saved.folder / "keys"))
        self._capture = capture

    def run(self, *words: str) -> tuple[int, str, str]:
        try:
            code = main(["audit", *words])
        except SystemExit as error:
            code = int(str(error.code))
        out, err = self._capture.readouterr()
        return code, out, err


@pytest.fixture
def line(saved: Platform, capsys: pytest.CaptureFixture[str]) -> Line:
    return Line(saved, capsys)


def test_nothing_found_ends_with_0(line: Line) -> None:
    code, out, err = line.run("cloud-0/recorder-a", *line.keys, *line.offline)
    assert code == 0
    assert re.search(r"2026-11-18T11:19:41Z  2026-11-18T11:22:41Z  cloud-0/recorder-a +recorder 0\.1\.0", out)
    assert re.search(r"cloud-0/meeting +#7 of manager, automatic", out)
    assert re.search(r"recorder 0\.1\.0  sha256:[0-9a-f]{64}  install +passed", out)
    assert "findings: 0\n" in out
    assert "Cannot be told from Git: which containers ran" in out
    assert err == "robotkube: deployment repository: 6 commits\nrobotkube: catalogue: 3 commits\n"


def test_the_table_has_events_traces_and_who_asked_by_a_policy(line: Line, saved: Platform) -> None:
    people = ("approval", "ada", "grace")
    saved.merge({PATH: "add: [{application: recording, forRole: cloud}]\n"}, "record\n", LATER, *people)
    made = release(RECORDER, saved.names["evidence of recorder"], "cloud-0", "standing", plan_id(9))
    saved.merge(files_of(made), message_of(made, kinds=("initial",)), LATER + MINUTE)
    path = line.folder / "audit.html"
    code, out, _ = line.run(*line.keys, *line.offline, "--html", str(path))
    assert code == 0
    assert re.search(rf"[0-9a-f]{{12}}  {SECOND.task} +{SECOND.event} +proximity +{SECOND.trace}\n", out)
    assert re.search(r"cloud-0/standing +recorder 0\.1\.0 +sha256:[0-9a-f]{64} +policy recording +-\n", out)
    asked = "recording on every agent of role cloud"
    assert re.search(rf"{asked} +operator-team +grace +2026-11-18T12:06:41Z +deployment [0-9a-f]{{12}} #7\n", out)
    assert "commits without the gate's record" not in out
    text = path.read_text()
    assert f"{asked}<br>" in text
    assert re.search(r"operator-team, approved by grace, pull request #7,\s+deployment", text)
    read(text)


def test_the_table_has_who_signed_what_came_past_the_gate_and_what_became_of_it(line: Line, saved: Platform) -> None:
    break_glass(saved)
    commit = saved.deployment.tip
    path = line.folder / "audit.html"
    _, out, _ = line.run(*line.keys, *line.offline, "--html", str(path))
    assert re.search(rf"{commit[:12]}  break-glass  ada,grace  no\n", out)
    assert re.search(
        r"break-glass</span> signed by ada, grace\s*<br><span class=\"no\">not made good", path.read_text()
    )
    accepted = saved.merge({ACCEPTED_PATH: f"{commit}\n"}, "right\n", LATER + MINUTE, "approval", "ada", "grace")
    _, out, _ = line.run(*line.keys, *line.offline, "--html", str(path))
    assert f"break-glass  ada,grace  accepted by {accepted[:12]}\n" in out
    assert f'<span class="yes">accepted</span> by <code>{accepted[:12]}</code>' in path.read_text()
    read(path.read_text())


def test_findings_end_with_1_and_stand_on_stdout(line: Line, saved: Platform) -> None:
    saved.deployment.commit({"policies/edits.yaml": "edits: respect\n"}, "by hand\n", BEGAN + 60 * MINUTE, "ada")
    code, out, err = line.run(*line.keys, *line.offline)
    assert (code, err.splitlines()[-1]) == (1, "robotkube: 1 finding; what each means: docs/reference/audit.md")
    assert "findings: 1\n* unchecked-commit (deployment, commit " in out
    assert "    the gate signed no record of this commit" in out


def test_json_is_the_document(line: Line, saved: Platform) -> None:
    code, out, _ = line.run(*line.keys, *line.offline, "--output", "json")
    document = json.loads(out)
    assert (code, document["asked"], document["findings"]) == (0, "", [])
    assert document["as_of"]["deployment"] == {"tip": saved.deployment.tip, "commits": 6}


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (["cloud-0/nobody"], 2, "nothing on main has to do with 'cloud-0/nobody'; give a release or task"),
        (["--since", "main"], 2, "--since 'main': must be a commit of 40 hex"),
        (["--save", "elsewhere"], 2, "--offline reads a folder and nothing else: leave out --save and --forge-url"),
        (["--html", "nowhere/at/all.html"], 2, "--html nowhere/at/all.html: No such file or directory"),
    ],
)
def test_wrong_usage_ends_with_2(line: Line, words: list[str], code: int, expected: str) -> None:
    outcome = line.run(*words, *line.keys, *line.offline)
    assert (outcome[0], expected in outcome[2]) == (code, True), outcome[2]


def test_keys_are_asked_for(line: Line) -> None:
    code, _, err = line.run(*line.offline)
    assert (code, "--keys" in err) == (2, True)
    code, _, err = line.run("--keys", str(line.folder / "no-keys"), *line.offline)
    assert (code, "No such file or directory; mount the public keys there" in err) == (2, True)


def test_a_folder_that_is_not_there_ends_with_2(line: Line) -> None:
    code, _, err = line.run(*line.keys, "--offline", str(line.folder / "nothing"))
    assert (code, "no such folder; make it with `robotkube audit --save" in err) == (2, True)


def test_a_forge_that_does_not_answer_ends_with_3(line: Line) -> None:
    password = line.folder / "password"
    password.write_text("word")
    forge = ("--forge-url", "http://127.0.0.1:9", "--password-file", str(password))
    code, _, err = line.run(*line.keys, *forge)
    assert (code, "git http://127.0.0.1:9/robotkube/deployment: fetch:" in err) == (3, True)
    code, _, err = line.run(*line.keys, "--forge-url", "http://127.0.0.1:9")
    assert (code, "--forge-url needs --password-file" in err) == (2, True)


def test_an_index_that_is_none_is_named(line: Line, saved: Platform) -> None:
    saved.index.write_text("{}")
    code, _, err = line.run(*line.keys, *line.offline)
    assert (code, "index.json: no index of an OCI image layout" in err) == (2, True)


def test_words_in_git_do_not_steer_the_terminal_and_can_be_written(line: Line, saved: Platform) -> None:
    main = saved.deployment
    tip = main.git[main.tip]
    tree = b"100644 na\xffme\0" + bytes.fromhex(str(main.git.create_blob(b"x")))
    folder = main.git.write(pygit2.enums.ObjectType.TREE, tree)
    builder = main.git.TreeBuilder(tip.tree)
    builder.insert("releases", folder, pygit2.enums.FileMode.TREE)
    text = f"tree {builder.write()}\nparent {tip.id}\n".encode()
    text += f"author \x1b[2Jx <x@x> {BEGAN + 3600} +0000\ncommitter x <x@x> {BEGAN + 3600} +0000\n\n".encode()
    main.move(str(main.git.write(pygit2.enums.ObjectType.COMMIT, text + b"\x1b[31mcaf\xe9\n")))
    path = line.folder / "audit.html"
    for form in ("table", "json", "yaml"):
        code, out, err = line.run(*line.keys, *line.offline, "--output", form, "--html", str(path))
        assert (code, "\x1b" in out, "\x1b" in err) == (1, False, False)
    read(path.read_text(encoding="utf-8"))


# -- the page --------------------------------------------------------------------------------------------------------


class _Tags(HTMLParser):
    """The tags of a page, and whether they close in order."""

    EMPTY = frozenset({"meta", "br"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.attributes: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        self.attributes |= {name for name, _ in attrs}
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def read(text: str) -> _Tags:
    tags = _Tags()
    tags.feed(text)
    assert tags.open == []
    return tags


def with_findings(platform: Platform) -> Mapping[str, Any]:
    """An audit with a finding that concerns the subject, others that do not, and words that somebody made up."""
    evidence = platform.names["evidence of recorder"]
    made = release(RECORDER, evidence, "cloud-0", "recorder-c", plan_id(6), replace(SECOND, task="cloud-0/third"))
    text = message_of(made).replace("vehicle-00 and", EVIL)
    platform.deployment.commit(files_of(made), text, BEGAN + 60 * MINUTE)
    platform.deployment.commit({"README.md": EVIL}, f"{EVIL}\n", BEGAN + 61 * MINUTE, "ada")
    return platform.audit("cloud-0/recorder-c")


def test_the_page_is_written_beside_the_table(line: Line) -> None:
    path = line.folder / "audit.html"
    code, _, _ = line.run("cloud-0/recorder-a", *line.keys, *line.offline, "--html", str(path))
    text = path.read_text()
    assert (code, "<h1>Audit: cloud-0/recorder-a" in text, "nothing found" in text) == (0, True, True)
    read(text)


def test_the_page_loads_and_runs_nothing_and_escapes_everything(saved: Platform) -> None:
    text = page(with_findings(saved))
    tags = read(text)
    assert not tags.seen & {"script", "link", "img", "iframe", "object", "form", "a"}
    assert not tags.attributes & {"src", "href", "style", "onload", "onclick"}
    assert EVIL not in text
    assert "&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt;" in text
    assert "default-src &#39;none&#39;" in text or "default-src 'none'" in text
    assert "url(" not in text
    assert "@import" not in text


def test_the_page_says_what_concerns_the_subject_and_what_does_not(saved: Platform) -> None:
    text = page(with_findings(saved))
    assert "2 findings" in text
    before, _, after = text.partition("<details>")
    assert (before.count('class="finding"'), after.count('class="finding"')) == (1, 1)
    assert "1 about something else than cloud-0/recorder-c" in after
    assert "prefers-color-scheme:dark" in text
