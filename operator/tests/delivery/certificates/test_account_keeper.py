"""Certificates by which accounts at the broker are proved, with objects in memory and real certificates; time is the
test's own, and starts at the real one."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from robotkube.delivery.certificates.core.issuance import AccountCertificate, AccountIssuance, Issuance
from robotkube.delivery.certificates.core.register import KEPT_SECONDS, Register, read, written
from robotkube.delivery.certificates.loops.account_keeper import AccountKeeper
from robotkube.delivery.certificates.loops.keeper import CertificateKeeper
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters import issuing
from robotkube.foundation.certificates.core.lives import Pair
from tests.delivery.certificates.test_keeper import BROKER, Objects

DAY = 86_400.0
LIFE = 90 * DAY
OBSERVER = AccountCertificate("observer", "broker-account-observer", "robotkube")
VEHICLE = AccountCertificate("vehicle-00", "broker-account", "vehicle-00")
RESERVED = AccountCertificate("vehicle-01", "broker-account", "vehicle-01", reserved=True)
ISSUANCE = AccountIssuance((OBSERVER, VEHICLE, RESERVED), LIFE, "broker-certificates", "http://rights/accounts")


class AccountObjects(Objects):
    """The port in memory, with accounts' Secrets and the register; `written` says what was put, in its order."""

    def __init__(self) -> None:
        super().__init__()
        self.accounts: dict[str, Pair] = {}
        self.kept_register = (Register(), "")
        self.written: list[str] = []
        self.missing: set[str] = set()
        self.refusing: set[str] = set()

    def of_account(self, account: AccountCertificate) -> Pair | None:
        if account.account in self.missing:
            raise InputError(f"Secret {account.namespace}/{account.secret} is missing")
        return self.accounts.get(account.account)

    def put_of_account(self, account: AccountCertificate, certificate: Pair) -> None:
        self._ask("put_of_account")
        if account.account in self.refusing:
            raise InputError(f"Secret {account.namespace}/{account.secret}: is forbidden")
        self.written.append(account.account)
        self.accounts[account.account] = certificate

    def register(self) -> tuple[Register, str]:
        return self.kept_register

    def put_register(self, register: Register, revocations: str) -> None:
        self._ask("put_register")
        self.written.append("register")
        self.kept_register = (register, revocations)


class Main:
    """Whom main shuts out; None: nobody says it."""

    def __init__(self) -> None:
        self.names: frozenset[str] | None = frozenset({"vehicle-01"})
        self.asked_with: set[str] = set()

    def shut(self, authority: str) -> frozenset[str]:
        self.asked_with.add(authority)
        if self.names is None:
            raise UnavailableError("rights does not answer")
        return self.names


class Stage:
    def __init__(self) -> None:
        self.now = float(int(time.time()))  # certificates have whole seconds
        self.objects = AccountObjects()
        self.main = Main()
        self.authority = issuing.new_authority("ours", self.now)
        self.keeper = self.another()

    def another(self, issuance: AccountIssuance = ISSUANCE) -> AccountKeeper:
        self.keeper = AccountKeeper(self.objects, issuing, issuance, self.main, lambda: self.now)
        return self.keeper

    def keep(self) -> None:
        self.keeper.keep(self.authority)

    def serial(self, account: str) -> int:
        return issuing.describe(self.objects.accounts[account], self.authority).serial

    @property
    def revoked(self) -> frozenset[int]:
        serials = issuing.listed(self.objects.kept_register[1], self.authority)
        assert serials is not None
        return serials


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_everybody_whom_main_lets_in_gets_one_after_it_was_entered(stage: Stage) -> None:
    stage.keep()
    assert stage.objects.written == ["register", "observer", "vehicle-00"]
    life = issuing.describe(stage.objects.accounts["vehicle-00"], stage.authority)
    assert (life.names, life.signed, round(life.end - stage.now)) == (frozenset({"vehicle-00"}), True, LIFE)
    assert stage.revoked == frozenset()
    assert stage.main.asked_with == {stage.authority.certificate}
    stage.keep()
    assert len(stage.objects.written) == 3
    assert (stage.keeper.issued, stage.keeper.problem) == (2, "")


def test_it_tells_until_when_each_holds_and_when_it_is_renewed(stage: Stage) -> None:
    assert stage.keeper.as_json() is None, "nobody has looked yet"
    stage.objects.missing = {"observer"}
    with pytest.raises(InputError):
        stage.keep()
    told = stage.keeper.as_json()
    assert told is not None
    assert [(one["account"], one["namespace"], one["life"] is None) for one in told] == [
        ("observer", "robotkube", True),
        ("vehicle-00", "vehicle-00", False),
        ("vehicle-01", "vehicle-01", True),
    ]
    life = told[1]["life"]
    assert round(life["end"] - stage.now) == LIFE
    assert life["renewal"] == pytest.approx(life["begin"] + (life["end"] - life["begin"]) * 2 / 3)
    stage.main.names = frozenset({"vehicle-00", "vehicle-01"})
    with pytest.raises(InputError):
        stage.keep()
    assert [one["life"] for one in stage.keeper.as_json() or ()] == [None] * 3, "what is revoked holds no more"


def test_the_page_says_what_the_last_look_met(stage: Stage) -> None:
    issuance = Issuance("robotkube", "tls-authority", "robotkube-ca", ("robotkube",), (BROKER,), ISSUANCE)
    keeper = CertificateKeeper(stage.objects, issuing, issuance, lambda: stage.now, stage.keeper)
    assert keeper.accounts_page() == {"problem": "nothing was looked at yet", "accounts": None}
    keeper.step()
    page = keeper.accounts_page()
    assert (page["problem"], len(page["accounts"])) == ("", 3)
    stage.main.names = None
    keeper.step()
    assert "nobody says which accounts main shuts out" in keeper.accounts_page()["problem"]
    without = CertificateKeeper(stage.objects, issuing, replace(issuance, accounts=None), lambda: stage.now)
    without.step()
    assert without.accounts_page() == {"problem": "", "accounts": None}


def test_one_that_is_not_in_the_register_never_stands_in_a_secret(stage: Stage) -> None:
    stage.objects.away = {"put_register"}
    with pytest.raises(UnavailableError):
        stage.keep()
    assert stage.objects.accounts == {}


def test_they_are_renewed_at_two_thirds_and_the_one_before_stays_good(stage: Stage) -> None:
    stage.keep()
    first = stage.serial("vehicle-00")
    stage.now += LIFE * 2 / 3 - 600
    stage.keep()
    assert stage.serial("vehicle-00") == first
    stage.now += 700
    stage.keep()
    assert stage.serial("vehicle-00") != first
    assert stage.revoked == frozenset()
    stage.now += LIFE + KEPT_SECONDS
    stage.keep()
    assert stage.objects.kept_register[0].entry(first) is None


def test_whom_main_shuts_out_has_all_of_its_certificates_revoked_and_gets_no_other(stage: Stage) -> None:
    """Also those that were replaced already, and for good: let in again it has another one."""
    stage.keep()
    first = stage.serial("vehicle-00")
    stage.now += LIFE * 0.7
    stage.keep()
    second = stage.serial("vehicle-00")
    stage.main.names = frozenset({"vehicle-00", "vehicle-01"})
    assert stage.keeper.has_news()
    stage.keep()
    assert not stage.keeper.has_news()
    assert stage.revoked == {first, second}
    assert stage.serial("vehicle-00") == second
    stage.keep()
    assert stage.keeper.revoked == 2
    stage.main.names = frozenset({"vehicle-01"})
    stage.keep()
    assert stage.serial("vehicle-00") not in {first, second}
    assert stage.revoked == {first, second}


def test_while_nobody_says_who_is_shut_the_revoked_and_the_reserved_get_nothing(stage: Stage) -> None:
    """And everybody else does: `rights` itself needs a certificate before it can say anything."""
    stage.main.names = None
    stage.keep()
    assert sorted(stage.objects.accounts) == ["observer", "vehicle-00"]
    assert stage.keeper.problem == "nobody says which accounts main shuts out: rights does not answer"
    assert not stage.keeper.has_news()
    stage.main.names = frozenset({"vehicle-00"})
    assert stage.keeper.has_news()
    stage.keep()
    assert stage.keeper.problem == ""
    assert "vehicle-01" in stage.objects.accounts
    gone = stage.serial("vehicle-00")
    stage.main.names = None
    stage.another().keep(stage.authority)
    assert stage.serial("vehicle-00") == gone
    assert stage.revoked == {gone}


def test_another_number_makes_another_one_and_revokes_those_before(stage: Stage) -> None:
    stage.keep()
    first = stage.serial("vehicle-00")
    changed = replace(ISSUANCE, certificates=(OBSERVER, replace(VEHICLE, number=1), RESERVED))
    stage.another(changed).keep(stage.authority)
    assert stage.serial("vehicle-00") != first
    assert stage.revoked == {first}


def test_an_account_that_is_there_no_more_has_its_certificates_revoked(stage: Stage) -> None:
    stage.keep()
    gone = stage.serial("vehicle-00")
    stage.another(replace(ISSUANCE, certificates=(OBSERVER,))).keep(stage.authority)
    assert stage.revoked == {gone}


def test_a_register_that_was_lost_knows_what_stands_in_secrets_again(stage: Stage) -> None:
    stage.keep()
    stage.objects.kept_register = (Register(), "")
    stage.keep()
    entry = stage.objects.kept_register[0].entry(stage.serial("vehicle-00"))
    assert entry is not None
    assert entry.account == "vehicle-00"


def test_a_list_that_somebody_emptied_or_another_authority_signed_is_made_again(stage: Stage) -> None:
    stage.keep()
    stage.main.names = frozenset({"vehicle-00"})
    stage.keep()
    register, right = stage.objects.kept_register
    other = issuing.revocation_list(issuing.new_authority("other", stage.now), {}, stage.now)
    emptied = issuing.revocation_list(stage.authority, {}, stage.now)
    for text in ("", "nonsense", other, emptied):
        stage.objects.kept_register = (register, text)
        stage.keep()
        assert stage.revoked == issuing.listed(right, stage.authority)


def test_another_authority_makes_others(stage: Stage) -> None:
    stage.keep()
    stage.authority = issuing.new_authority("next", stage.now)
    stage.keep()
    assert issuing.describe(stage.objects.accounts["observer"], stage.authority).signed


def test_what_cannot_be_read_is_replaced(stage: Stage) -> None:
    stage.keep()
    stage.objects.accounts["observer"] = Pair("no certificate", "no key")
    stage.keep()
    assert stage.serial("observer")


def test_a_register_is_read_as_it_was_written_and_a_broken_one_is_not_taken_for_an_empty_one(stage: Stage) -> None:
    stage.keep()
    register = stage.objects.kept_register[0]
    assert read(written(register)) == register
    assert read("") == Register()
    for text in ("{", "[]", '{"issued": [{"account": "a"}]}', '{"issued": [{"serial": "x"}]}', '{"issued": 3}'):
        with pytest.raises(InputError, match=r"register\.json cannot be read"):
            read(text)


def test_the_keeper_is_ready_when_accounts_have_theirs_and_says_why_not(stage: Stage) -> None:
    issuance = Issuance("robotkube", "tls-authority", "robotkube-ca", ("robotkube",), (BROKER,), ISSUANCE)
    keeper = CertificateKeeper(stage.objects, issuing, issuance, lambda: stage.now, stage.keeper)
    stage.main.names = None
    keeper.step()
    assert keeper.reasons_not_ready() == ["nobody says which accounts main shuts out: rights does not answer"]
    stage.main.names = frozenset()
    keeper.step()
    assert keeper.reasons_not_ready() == []
    stage.now += LIFE + 1
    assert "the certificate of account vehicle-00 has expired" in keeper.reasons_not_ready()
    named = {series.name: series for series in keeper.metrics()}
    expiry = named["robotkube_certificates_expiry_timestamp_seconds"]
    of_accounts = {"robotkube/broker-account-observer", "vehicle-00/broker-account", "vehicle-01/broker-account"}
    assert {labels[0] for labels in expiry.values} == {"broker-tls", *of_accounts}
    stage.main.names = frozenset({"vehicle-00"})
    keeper.step()
    assert "vehicle-00" not in stage.keeper.lives
    assert named["robotkube_certificates_issued_total"].values[()] == 4


def test_servers_are_renewed_while_a_fleets_accounts_take_long(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each account takes a sixth of a certificate's life, and the server's is due a day after the look began."""
    issuance = Issuance("robotkube", "tls-authority", "robotkube-ca", ("robotkube",), (BROKER,), ISSUANCE)
    keeper = CertificateKeeper(stage.objects, issuing, issuance, lambda: stage.now, stage.keeper)
    keeper.step()
    stage.objects.accounts.clear()
    stage.now += 2 / 3 * BROKER.seconds - DAY
    put = stage.objects.put_of_account

    def slowly(account: AccountCertificate, certificate: Pair) -> None:
        put(account, certificate)
        stage.now += 1 / 6 * BROKER.seconds

    monkeypatch.setattr(stage.objects, "put_of_account", slowly)
    before = keeper.issued
    keeper.step()
    assert stage.objects.written[-2:] == ["observer", "vehicle-00"]
    assert keeper.issued == before + 1


def test_between_two_looks_main_is_asked_and_a_word_of_it_is_followed_at_once(stage: Stage) -> None:
    """The usual pause is a minute; the test ends it by saying whom main shuts out, and then by stopping."""
    issuance = Issuance("robotkube", "tls-authority", "robotkube-ca", ("robotkube",), (BROKER,), ISSUANCE)
    keeper = CertificateKeeper(stage.objects, issuing, issuance, lambda: stage.now, stage.keeper)

    class Stopping:
        """Stops at the third wait between looks; at the second one main has shut out another agent."""

        def __init__(self) -> None:
            self.waited: list[float] = []

        def wait(self, seconds: float) -> bool:
            if not seconds:
                return len(self.waited) >= 3
            self.waited.append(seconds)
            if len(self.waited) == 2:
                stage.main.names = frozenset({"vehicle-00", "vehicle-01"})
            return len(self.waited) >= 3

    stopping = Stopping()
    keeper.run(stopping)  # type: ignore[arg-type]
    assert [round(seconds) for seconds in stopping.waited] == [5, 5, 5]
    assert stage.objects.kept is not None
    stage.authority = stage.objects.kept
    assert stage.revoked == {stage.serial("vehicle-00")}


def test_an_account_whose_secret_is_away_keeps_no_other_from_its_certificate(stage: Stage) -> None:
    stage.objects.missing = {"observer"}
    with pytest.raises(InputError, match="broker-account-observer is missing"):
        stage.keep()
    assert sorted(stage.objects.accounts) == ["vehicle-00"]
    stage.objects.missing = set()
    stage.keep()
    assert sorted(stage.objects.accounts) == ["observer", "vehicle-00"]


def test_what_cannot_be_put_is_not_made_anew_at_each_look(stage: Stage) -> None:
    """The register would grow with every attempt, until nobody could write it."""
    stage.objects.refusing = {"observer"}
    for _ in range(5):
        with pytest.raises(InputError, match="is forbidden"):
            stage.keep()
    assert [one.account for one in stage.objects.kept_register[0].issued] == ["observer", "vehicle-00"]
    [first] = [one for one in stage.objects.kept_register[0].issued if one.account == "observer"]
    stage.objects.refusing = set()
    stage.keep()
    assert stage.serial("observer") == first.serial
    stage.objects.refusing = {"vehicle-00"}
    stage.now += LIFE
    with pytest.raises(InputError):
        stage.keep()
    stage.main.names = frozenset({"vehicle-00"})  # what waits for it is revoked as well, and is never put
    stage.keep()
    stage.main.names = frozenset()
    stage.objects.refusing = set()
    stage.keep()
    assert stage.serial("vehicle-00") not in stage.revoked
