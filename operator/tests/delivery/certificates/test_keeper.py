"""Keeping certificates: made once, renewed in time, put right, with objects in memory; time is the test's own. On a
real API server with the rights of the chart: charts/test_certificates.py."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Collection
from dataclasses import replace

import pytest

from robotkube.delivery.certificates.core.issuance import Issuance, ServerCertificate
from robotkube.delivery.certificates.loops.keeper import CertificateKeeper
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.core.lives import Life, Pair
from tests.stages.pauses import Pauses

DAY = 86_400.0
BROKER = ServerCertificate("broker-tls", ("broker",), 90 * DAY)
FORGE = ServerCertificate("forge-tls", ("forge", "127.0.0.1"), 90 * DAY, service="forge")
DATABASE = ServerCertificate("database-tls", ("database",), 30 * DAY)
ISSUANCE = Issuance("robotkube", "tls-authority", "robotkube-ca", ("robotkube", "vehicle-00"), (BROKER,))


class Objects:
    """The port in memory; calls whose name is in `away` fail."""

    def __init__(self) -> None:
        self.kept: Pair | None = None
        self.shown: dict[str, Pair | None] = {}
        self.maps = {"robotkube": "", "vehicle-00": ""}
        self.away: set[str] = set()
        self.found: list[str] = []
        self.order: list[str] = []

    def authority(self) -> Pair | None:
        self._ask("authority")
        return self.kept

    def keep_authority(self, authority: Pair) -> None:
        self._ask("keep_authority")
        self.kept = authority

    def certificate(self, secret: str) -> Pair | None:
        self._ask("certificate")
        return self.shown.get(secret)

    def put_certificate(self, secret: str, certificate: Pair) -> None:
        self._ask("put_certificate")
        self.shown[secret] = certificate

    def addresses(self, service: str) -> list[str]:
        assert service == FORGE.service
        return self.found

    def trusted(self, namespace: str) -> str:
        self._ask("trusted")
        return self.maps[namespace]

    def publish(self, namespace: str, certificate: str) -> None:
        self._ask("publish")
        self.maps[namespace] = certificate

    def _ask(self, name: str) -> None:
        self.order.append(name)
        if name in self.away:
            raise UnavailableError(f"API server: {name}")


class Numbers:
    """The port Issuer: certificates are `<authority>/<number>`, and what they say is kept here."""

    def __init__(self) -> None:
        self.lives: dict[str, Life] = {}
        self._next = itertools.count()

    def new_authority(self, name: str, now: float) -> Pair:
        number = next(self._next)
        return Pair(f"authority {number}", f"key {number}")

    def is_authority(self, pair: Pair) -> bool:
        return "/" not in pair.certificate

    def issue(self, authority: Pair, names: Collection[str], now: float, seconds: float) -> Pair:
        pair = Pair(f"{authority.certificate}/{next(self._next)}", "key")
        self.lives[pair.certificate] = Life(frozenset(names), now, now + seconds, has_key=True, signed=True)
        return pair

    def describe(self, pair: Pair, authority: Pair) -> Life:
        if pair.certificate not in self.lives:
            raise InputError("cannot be read as PEM")
        return replace(self.lives[pair.certificate], signed=pair.certificate.startswith(f"{authority.certificate}/"))


class Stage:
    def __init__(self) -> None:
        self.now = 0.0
        self.objects = Objects()
        self.issuer = Numbers()
        self.keeper = self.another()

    def another(self, issuance: Issuance = ISSUANCE) -> CertificateKeeper:
        self.keeper = CertificateKeeper(self.objects, self.issuer, issuance, lambda: self.now, jitter=lambda: 0.5)
        return self.keeper

    def shown(self, certificate: ServerCertificate = BROKER) -> Pair:
        shown = self.objects.shown[certificate.secret]
        assert shown is not None
        return shown


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_an_empty_platform_gets_an_authority_whom_everybody_trusts_before_the_broker_shows_it(stage: Stage) -> None:
    assert stage.keeper.reasons_not_ready() == ["nothing was looked at yet"]
    stage.keeper.step()
    assert stage.keeper.reasons_not_ready() == []
    assert stage.objects.maps == dict.fromkeys(("robotkube", "vehicle-00"), "authority 0")
    assert stage.shown().certificate == "authority 0/1"
    writes = [name for name in stage.objects.order if name in ("keep_authority", "publish", "put_certificate")]
    assert writes == ["keep_authority", "publish", "publish", "put_certificate"]


def test_another_process_keeps_what_is_there(stage: Stage) -> None:
    stage.keeper.step()
    before = (stage.objects.kept, dict(stage.objects.shown), dict(stage.objects.maps))
    again = stage.another()
    again.step()
    assert (stage.objects.kept, stage.objects.shown, stage.objects.maps) == before
    assert (again.issued, again.published) == (0, 0)


def test_the_brokers_certificate_is_renewed_at_two_thirds_by_the_same_authority(stage: Stage) -> None:
    stage.keeper.step()
    first = stage.shown()
    stage.now = 60 * DAY - 1
    stage.keeper.step()
    assert stage.shown() == first
    stage.now = 60 * DAY
    stage.keeper.step()
    assert stage.shown() != first
    assert stage.objects.maps["vehicle-00"] == "authority 0"
    assert stage.keeper.lives["broker-tls"].end == 150 * DAY


def test_each_server_has_a_certificate_of_its_own_that_is_renewed_when_it_is_due(stage: Stage) -> None:
    keeper = stage.another(replace(ISSUANCE, certificates=(BROKER, DATABASE)))
    keeper.step()
    broker, database = stage.shown(), stage.shown(DATABASE)
    assert broker != database
    assert {secret: life.names for secret, life in keeper.lives.items()} == {
        "broker-tls": {"broker"}, "database-tls": {"database"},
    }  # fmt: skip
    stage.now = 20 * DAY
    keeper.step()
    assert (stage.shown(), keeper.issued) == (broker, 3)
    assert stage.shown(DATABASE) != database
    [expiry, *_] = keeper.metrics()
    assert expiry.values == {("broker-tls",): 90 * DAY, ("database-tls",): 50 * DAY}
    stage.now = 50 * DAY
    stage.objects.away = {"certificate"}
    keeper.step()
    stage.objects.away = set()
    keeper.problem = ""
    assert keeper.reasons_not_ready() == ["the certificate in Secret database-tls has expired"]


def test_a_servers_certificate_follows_the_addresses_of_its_service(stage: Stage) -> None:
    keeper = stage.another(replace(ISSUANCE, certificates=(FORGE,)))
    keeper.step()
    assert keeper.lives["forge-tls"].names == {"forge", "127.0.0.1"}
    stage.objects.found = ["10.96.0.9", "fd00::9", "127.0.0.1"]
    for _ in range(2):
        keeper.step()
    assert keeper.lives["forge-tls"].names == {"forge", "127.0.0.1", "10.96.0.9", "fd00::9"}
    assert keeper.issued == 2


@pytest.mark.parametrize("shown", [None, Pair("garbage", "key")], ids=["lost", "unreadable"])
def test_a_certificate_that_is_lost_or_no_certificate_is_made_anew(stage: Stage, shown: Pair | None) -> None:
    stage.keeper.step()
    stage.objects.shown["broker-tls"] = shown
    stage.keeper.step()
    assert stage.shown().certificate.startswith("authority 0/")


def test_other_names_are_another_certificate(stage: Stage) -> None:
    stage.keeper.step()
    stage.another(replace(ISSUANCE, certificates=(replace(BROKER, names=("broker", "mqtt.example")),))).step()
    assert stage.keeper.lives["broker-tls"].names == {"broker", "mqtt.example"}


def test_what_somebody_else_wrote_into_a_namespace_is_put_right(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.keeper.step()
    stage.objects.maps["vehicle-00"] = "authority of somebody"
    with caplog.at_level(logging.INFO):
        stage.keeper.step()
    assert stage.objects.maps["vehicle-00"] == "authority 0"
    assert "authority published namespace=vehicle-00" in caplog.text


def test_no_key_is_logged(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG):
        stage.keeper.step()
    assert "key" not in caplog.text


def test_a_secret_that_holds_no_authority_is_no_reason_to_make_another_one(stage: Stage) -> None:
    stage.keeper.step()
    stage.objects.kept = Pair("authority 0/1", "key")
    stage.keeper.step()
    [reason] = stage.keeper.reasons_not_ready()
    assert reason.startswith("Secret tls-authority: its certificate signs no others")
    assert stage.objects.kept == Pair("authority 0/1", "key")


@pytest.mark.parametrize(
    "call", ["authority", "keep_authority", "trusted", "publish", "certificate", "put_certificate"]
)
def test_interrupted_anywhere_the_next_look_completes_it(stage: Stage, call: str) -> None:
    stage.objects.away = {call}
    stage.keeper.step()
    assert stage.keeper.reasons_not_ready() == [f"API server: {call}"]
    stage.objects.away = set()
    stage.keeper.step()
    assert stage.keeper.reasons_not_ready() == []
    assert set(stage.objects.maps.values()) == {stage.objects.kept.certificate if stage.objects.kept else ""}


def test_a_problem_is_logged_once(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.objects.away = {"authority"}
    for _ in range(3):
        stage.keeper.step()
    assert caplog.text.count("not all are as they should be") == 1
    assert stage.keeper.failed == 3


def test_failures_are_repeated_after_a_back_off_which_is_never_longer_than_the_usual_time(stage: Stage) -> None:
    stage.objects.away = {"authority"}
    pauses = Pauses(4)
    stage.keeper.run(pauses)
    assert pauses.seconds == [0.5, 1.0, 2.0, 2.0]
    stage.objects.away = set()
    pauses = Pauses(2)
    stage.keeper.run(pauses)
    assert pauses.seconds == [60.0, 60.0]


def test_a_certificate_that_is_over_is_no_state_to_be_ready_in(stage: Stage) -> None:
    stage.keeper.step()
    stage.now = 90 * DAY
    assert stage.keeper.reasons_not_ready() == ["the certificate in Secret broker-tls has expired"]
    values = {series.name: series.values for series in stage.keeper.metrics()}
    assert values["robotkube_certificates_expiry_timestamp_seconds"] == {("broker-tls",): 90 * DAY}
    assert values["robotkube_certificates_issued_total"] == {(): 1.0}
