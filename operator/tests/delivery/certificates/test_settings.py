"""The key `accounts` of the settings, as people and charts write it, and what is said of mistakes."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.certificates.core.issuance import AccountCertificate
from robotkube.delivery.certificates.settings import read_configuration
from robotkube.foundation.documents.core.reader import Reader

VEHICLE = {"account": "vehicle-00", "secret": "broker-account", "namespace": "vehicle-00"}
ACCOUNTS = {
    "register": "broker-certificates",
    "shut": "https://rights.robotkube.svc:8080/accounts",
    "life_seconds": 7_776_000,
    "of": [VEHICLE],
}


def document(**accounts: Any) -> dict[str, Any]:
    return {
        "listen": {"address": "0.0.0.0", "port": 8081},  # noqa: S104
        "log_level": "info",
        "namespace": "robotkube",
        "authority": {"secret": "tls-authority"},
        "certificates": [{"secret": "broker-tls", "names": ["broker"], "life_seconds": 7_776_000}],
        "trusted": {"config_map": "robotkube-ca", "namespaces": ["robotkube"]},
        "accounts": {**ACCOUNTS, **accounts},
    }


def test_accounts_are_read_with_what_is_special_of_them() -> None:
    reserved = {**VEHICLE, "account": "vehicle-01", "namespace": "vehicle-01", "reserved": True, "number": 2}
    reader = Reader("config.yaml")
    accounts = read_configuration(reader, document(of=[VEHICLE, reserved])).issuance.accounts
    assert reader.problems == []
    assert accounts is not None
    assert accounts.certificates == (
        AccountCertificate("vehicle-00", "broker-account", "vehicle-00"),
        AccountCertificate("vehicle-01", "broker-account", "vehicle-01", 2, reserved=True),
    )
    assert (accounts.seconds, accounts.register) == (7_776_000.0, "broker-certificates")


@pytest.mark.parametrize(
    ("accounts", "said"),
    [
        ({"of": [VEHICLE, VEHICLE]}, "accounts.of: names an account twice"),
        ({"of": [{**VEHICLE, "number": -1}]}, "accounts.of[0].number: must be a whole number from 0 on"),
        ({"of": [{**VEHICLE, "number": True}]}, "accounts.of[0].number: must be a whole number from 0 on"),
        ({"of": [{**VEHICLE, "reserved": "no"}]}, "accounts.of[0].reserved: must be true or false"),
        ({"of": [{**VEHICLE, "account": "Vehicle 00"}]}, "accounts.of[0].account"),
        ({"of": ["vehicle-00"]}, "accounts.of[0]"),
        ({"life_seconds": 1}, "accounts.life_seconds: must be a whole number"),
        ({"shut": "rights"}, "accounts.shut"),
        ({"ofs": []}, "ofs"),
    ],
)
def test_a_mistake_is_named(accounts: dict[str, Any], said: str) -> None:
    reader = Reader("config.yaml")
    read_configuration(reader, document(**accounts))
    assert any(said in problem for problem in reader.problems), reader.problems
