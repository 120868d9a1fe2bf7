"""The gate's key: made once, whatever interrupts it, by who cannot read it. On a real API server with the rights of the
chart: charts/test_gate_key.py."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import pytest

from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from robotkube.registry.evidence.adapters.key_pairs import new_key_pair, read_key_pair
from robotkube.registry.evidence.core.key_pairs import KeyPair
from robotkube.setup.gate_key import read_configuration
from robotkube.setup.loops.gate_key import Provided, file_name, provide_key
from tests.stages.registry.signed_evidence import Signing, artefact

SETTINGS = """\
log_level: info
secret: {namespace: robotkube-gate, name: gate-key}
public_keys: {namespaces: [robotkube-gate, robotkube], name: gate-public-key}
former_key: /var/run/secrets/robotkube/former/key.pem
"""
GATE, PLATFORM = "robotkube-gate", "robotkube"


class Objects:
    """The port in memory; the call `fails_at` is never answered, before or after it was carried out."""

    def __init__(self) -> None:
        self.secret = ""
        self.maps: dict[str, dict[str, str]] = {GATE: {}, PLATFORM: {}}
        self.writes = 0
        self.fails_at = 0
        self.late = False
        self.stolen = ""

    def has_key(self) -> bool:
        return bool(self.secret)

    def public_keys(self) -> Mapping[str, Mapping[str, str]]:
        return {place: dict(keys) for place, keys in self.maps.items()}

    def publish(self, namespace: str, keys: Mapping[str, str]) -> None:
        self._before()
        self.maps[namespace].update(keys)
        self._after()

    def withdraw(self, namespace: str, name: str) -> None:
        self._before()
        self.maps[namespace].pop(name, None)
        self._after()

    def keep(self, private_key: str) -> bool:
        self._before()
        self.secret, made = (self.secret or self.stolen or private_key), not (self.secret or self.stolen)
        self._after()
        return made

    def _before(self) -> None:
        self.writes += 1
        if self.writes == self.fails_at and not self.late:
            raise UnavailableError("no answer")

    def _after(self) -> None:
        if self.writes == self.fails_at and self.late:
            raise UnavailableError("no answer")

    def signs_for(self, folder: Path) -> dict[str, bool]:
        """Namespace -> whether what the key in the Secret signs is believed with the keys that are published there."""
        (folder / "key").write_text(self.secret)
        believed = {}
        for place, keys in self.maps.items():
            trusted = folder / place
            trusted.mkdir(exist_ok=True)
            for name, pem in keys.items():
                (trusted / name).write_text(pem)
            envelopes = Signing(KeyFile(folder / "key")).sign(artefact()).values()
            try:
                believed[place] = all(TrustedKeys(trusted).verify(envelope) for envelope in envelopes)
            except InputError:
                believed[place] = False
        return believed


def test_a_key_is_made_and_believed_wherever_somebody_verifies(tmp_path: Path) -> None:
    objects = Objects()
    assert provide_key(objects, None, new_key_pair) == Provided("made", 1)
    assert objects.signs_for(tmp_path) == {GATE: True, PLATFORM: True}


def test_running_again_changes_nothing() -> None:
    objects = Objects()
    provide_key(objects, None, new_key_pair)
    secret = objects.secret
    maps = objects.public_keys()
    writes = objects.writes
    assert provide_key(objects, None, new_key_pair) == Provided("kept", 1)
    assert (objects.secret, objects.public_keys(), objects.writes) == (secret, maps, writes)


@pytest.mark.parametrize("late", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("call", [1, 2, 3])
def test_interrupted_at_any_point_and_run_again_the_key_that_stays_is_believed(
    call: int, late: bool, tmp_path: Path
) -> None:
    objects = Objects()
    objects.fails_at, objects.late = call, late
    with pytest.raises(UnavailableError):
        provide_key(objects, None, new_key_pair)
    if objects.secret:
        assert objects.signs_for(tmp_path) == {GATE: True, PLATFORM: True}
    objects.fails_at = 0
    provide_key(objects, None, new_key_pair)
    assert objects.signs_for(tmp_path) == {GATE: True, PLATFORM: True}


def test_the_key_of_an_older_installation_moves(tmp_path: Path) -> None:
    objects = Objects()
    former = new_key_pair()
    assert provide_key(objects, former, new_key_pair) == Provided("moved", 1)
    assert objects.secret == former.private
    assert objects.signs_for(tmp_path) == {GATE: True, PLATFORM: True}


@pytest.mark.parametrize("same", [True, False])
def test_what_is_left_where_the_gate_was_is_said(same: bool, caplog: pytest.LogCaptureFixture) -> None:
    objects = Objects()
    former = new_key_pair()
    provide_key(objects, former if same else None, new_key_pair)
    kept = objects.secret
    with caplog.at_level(logging.WARNING):
        assert provide_key(objects, former, new_key_pair) == Provided("kept", 1)
    assert objects.secret == kept
    words = "the same key stands where the gate was before: remove it there" if same else "it signs nothing"
    assert words in caplog.text
    assert former.key_id in caplog.text


def test_a_key_that_somebody_else_makes_meanwhile_stays_and_ours_is_not_believed(tmp_path: Path) -> None:
    objects = Objects()
    theirs = new_key_pair()
    objects.maps[GATE][file_name(theirs)] = objects.maps[PLATFORM][file_name(theirs)] = theirs.public
    objects.stolen = theirs.private
    assert provide_key(objects, None, new_key_pair) == Provided("kept", 1)
    assert objects.secret == theirs.private
    assert {name for keys in objects.maps.values() for name in keys} == {file_name(theirs)}


@pytest.mark.parametrize("lost", [GATE, PLATFORM])
def test_a_namespace_that_lost_its_public_keys_gets_them_from_the_other(lost: str, tmp_path: Path) -> None:
    objects = Objects()
    provide_key(objects, None, new_key_pair)
    objects.maps[lost] = {}
    assert provide_key(objects, None, new_key_pair) == Provided("kept", 1)
    assert objects.signs_for(tmp_path) == {GATE: True, PLATFORM: True}


def test_a_key_whose_public_half_nobody_knows_is_said_and_kept() -> None:
    objects = Objects()
    objects.secret = new_key_pair().private
    with pytest.raises(InputError, match=r"no ConfigMap .*robotkube-gate, robotkube.* says whose signatures count"):
        provide_key(objects, None, new_key_pair)


def test_after_a_new_key_what_the_old_one_signed_counts() -> None:
    """Its Secret was removed by hand."""
    objects = Objects()
    provide_key(objects, None, new_key_pair)
    objects.secret = ""
    assert provide_key(objects, None, new_key_pair) == Provided("made", 2)


def test_key_pairs_of_files(tmp_path: Path) -> None:
    pair = new_key_pair()
    assert pair.private not in repr(pair)
    path = tmp_path / "key.pem"
    assert read_key_pair(path) is None
    path.write_text(pair.private)
    assert read_key_pair(path) == pair
    assert isinstance(pair, KeyPair)
    assert KeyFile(path).key_id == pair.key_id
    assert KeyFile(path).public_key == pair.public
    path.write_text("no key")
    with pytest.raises(InputError, match="no PEM private key"):
        read_key_pair(path)


def test_settings_name_every_problem(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(SETTINGS)
    settings = read_settings(path, read_configuration)
    assert (settings.namespace, settings.secret, settings.public_keys) == (GATE, "gate-key", "gate-public-key")
    assert settings.namespaces == (GATE, PLATFORM)
    path.write_text(SETTINGS.replace("[robotkube-gate, robotkube]", "[]").replace("info", "loud"))
    with pytest.raises(DocumentError) as refusal:
        read_settings(path, read_configuration)
    assert "public_keys.namespaces: must name who verifies" in str(refusal.value)
    assert "log_level" in str(refusal.value)
