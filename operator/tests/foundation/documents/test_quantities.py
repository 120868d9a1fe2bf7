"""Quantities of Kubernetes: what is one, of which form, and what it stands for."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from robotkube.foundation.documents.core.quantities import CPU, MEMORY, quantity, quantity_of_form, written


@pytest.mark.parametrize(
    ("value", "amount"),
    [
        (2, "2"),
        (0.5, "0.5"),
        ("30m", "0.03"),
        ("1.5", "1.5"),
        ("1k", "1000"),
        ("2G", "2000000000"),
        ("64Mi", str(64 * 2**20)),
        ("1Ti", str(2**40)),
    ],
)
def test_what_a_quantity_stands_for(value: Any, amount: str) -> None:
    assert quantity(value) == Decimal(amount)


@pytest.mark.parametrize("value", [None, True, "", "much", "-1", "1 Mi", "1KB", "1.", "٣", [], {}])
def test_what_is_none(value: Any) -> None:
    assert quantity(value) is None


@pytest.mark.parametrize(
    ("value", "form", "amount"),
    [
        ("500m", CPU, "0.5"),
        (1, CPU, "1"),
        ("0.25", CPU, "0.25"),
        ("2Gi", CPU, None),
        ("1k", CPU, None),
        ("0.5m", CPU, None),
        ("2Gi", MEMORY, str(2**31)),
        ("2G", MEMORY, None),
        ("1.5Gi", MEMORY, None),
        (2**31, MEMORY, None),
    ],
)
def test_people_write_fewer_forms_than_kubernetes_takes(value: Any, form: Any, amount: str | None) -> None:
    assert quantity_of_form(value, form) == (None if amount is None else Decimal(amount))


def test_amounts_are_written_as_charts_do() -> None:
    assert (written(Decimal("0.03"), "cpu"), written(Decimal(64 * 2**20), "memory")) == ("30m", "64Mi")
