"""What is done to a cable for its conditions, as text; that the kernel means the same, `test_emulation` shows."""

from __future__ import annotations

import itertools

import pytest

from ci.cluster.embedded.emulation import emulating, rules
from ci.cluster.embedded.emulation.delays import STEP_SECONDS, DelayedQueue, VaryingDelay
from ci.cluster.embedded.emulation.rules import Wiring
from ci.cluster.embedded.network.addresses import PLANS, plan_of
from ci.cluster_contract.network_conditions import NetworkConditions
from ci.cluster_contract.topology import NODES_MAX

MOBILE = NetworkConditions(up_mbit=50, round_trip_ms=50, jitter_ms=15, loss_percent=0.01)
NARROW = NetworkConditions(up_mbit=20, down_mbit=100)
RELAYED, PLAIN = (Wiring(plan_of("demo"), 2, relayed) for relayed in (True, False))


def test_a_rate_is_a_token_bucket_with_a_queue_of_a_second() -> None:
    words = rules.shaping("eth0", 20, NARROW, netem=False)
    assert " ".join(words) == "qdisc replace dev eth0 root handle 1: tbf rate 20mbit burst 32768 limit 2500000"
    assert rules.shaping("eth0", None, MOBILE, netem=False) == []


def test_where_the_kernel_has_netem_it_delays_and_keeps_the_order() -> None:
    """It keeps the order of packets only together with a rate, so it always has one."""
    words = " ".join(rules.shaping("eth0", 50, MOBILE, netem=True))
    assert words.endswith("netem limit 10000 delay 25ms 7.5ms rate 50mbit")
    assert " ".join(rules.shaping("rk-demo-2", None, MOBILE, netem=True)).endswith("rate 10000mbit")
    assert rules.relayed(MOBILE, netem=False)
    assert not rules.relayed(MOBILE, netem=True)
    assert not rules.relayed(NARROW, netem=False)


def test_a_relay_stands_between_the_cable_and_the_bridge() -> None:
    assert [*rules.prepared(RELAYED)] == [
        "link add rk-demo-e2 type veth peer name rk-demo-f2",
        "link set rk-demo-e2 gso_max_segs 1 up",
        "link set rk-demo-f2 up",
        "link set rk-demo-2 gso_max_segs 1",
    ]
    assert [*rules.switched(RELAYED)] == ["link set rk-demo-2 nomaster", "link set rk-demo-f2 master rk-demo"]
    assert [*rules.restored(RELAYED)] == [
        "link del rk-demo-e2",
        "link set rk-demo-2 master rk-demo",
        "link set rk-demo-2 gso_max_segs 65535",
    ]


def test_without_a_delay_the_cable_stays_in_the_bridge() -> None:
    assert [*rules.prepared(PLAIN)] == ["link set rk-demo-2 gso_max_segs 1"]
    assert [*rules.switched(PLAIN)] == []
    assert [*rules.restored(PLAIN)] == ["link set rk-demo-2 gso_max_segs 65535"]


def test_losses_and_holes_are_judged_where_packets_come_in() -> None:
    relayed, plain = rules.machine_rules(RELAYED, MOBILE), rules.machine_rules(PLAIN, NARROW)
    assert 'hook ingress device "rk-demo-f2"' in relayed
    assert "numgen random mod 1000000 < 100 counter name lost drop" in relayed
    assert 'devices = { "rk-demo-2", "rk-demo-e2" } priority 0; policy drop;' in relayed
    assert 'hook ingress device "rk-demo-2"' in plain
    assert "numgen" not in plain
    assert "policy drop" not in plain
    assert "counter name in_holes drop" in plain
    assert 'hook ingress device "eth0"' in rules.node_rules(MOBILE)


def test_a_hole_ends_by_itself() -> None:
    assert rules.hole("rk-demo-2", "rk-demo-f2", 5) == (
        'add element netdev rk-demo-2 holes { "rk-demo-f2" timeout 5000ms }\n'
    )


def test_where_each_condition_acts_is_said() -> None:
    assert [*rules.acting(RELAYED, MOBILE, False, "vehicle-00")] == [
        "rate up: tbf at eth0 of node vehicle-00",
        "delay: relay of packets between rk-demo-2 and rk-demo-e2, half in each direction",
        "loss: nftables at rk-demo-f2 (up) and eth0 of node vehicle-00 (down)",
        "holes and counters: nftables at rk-demo-f2 (up) and eth0 of node vehicle-00 (down)",
    ]
    assert "delay: netem at eth0 of node v and rk-demo-2, half in each direction" in {
        *rules.acting(PLAIN, MOBILE, True, "v")
    }
    assert "rate down: tbf at rk-demo-2" in {*rules.acting(PLAIN, NARROW, False, "v")}


@pytest.mark.parametrize("name", sorted(PLANS))
def test_names_of_links_fit_the_kernels_bound_and_are_removed_with_the_clusters(name: str) -> None:
    wiring = Wiring(plan_of(name), NODES_MAX - 1, True)
    assert all(len(cable) <= 15 for cable in (wiring.relay_end, wiring.port))
    assert all(cable.startswith(f"{plan_of(name).bridge}-") for cable in (wiring.relay_end, wiring.port, wiring.table))


@pytest.mark.parametrize(
    ("lacking", "conditions", "words"),
    [
        (
            {"tbf", "netem"},
            NARROW,
            "no tbf, so the cable of v cannot have its rate: load the module sch_tbf, or leave up",
        ),
        (
            {"numgen"},
            MOBILE,
            "no numgen of nftables, so the cable of v cannot have its loss: load the module nft_numgen",
        ),
        ({"tbf"}, NARROW, "no tbf"),
    ],
)
def test_what_the_kernel_cannot_do_is_said(lacking: set[str], conditions: NetworkConditions, words: str) -> None:
    [problem] = emulating.problems({"v": conditions}, lambda what: what not in lacking)
    assert words in problem


def test_what_is_not_asked_needs_nothing() -> None:
    assert emulating.problems({"v": NetworkConditions(round_trip_ms=50)}, lambda _: False) == []
    assert emulating.problems({"v": MOBILE}, lambda what: what != "tbf") == []  # netem has a rate of its own
    assert emulating.problems({"v": MOBILE}, lambda what: what != "netem") == []


def numbers(*given: float) -> itertools.cycle[float]:
    return itertools.cycle(given)


def test_a_delay_moves_evenly_between_random_values() -> None:
    random = numbers(0.0, 0.0, 1.0, 0.5)
    delay = VaryingDelay(0.025, 0.0075, lambda: next(random))
    assert delay.at(10.0) == pytest.approx(0.0175)
    assert delay.at(10.0 + STEP_SECONDS / 2) == pytest.approx((0.0175 + 0.0325) / 2)
    assert delay.at(10.0 + STEP_SECONDS) == pytest.approx(0.0325)
    assert delay.at(10.0 + 1.5 * STEP_SECONDS) == pytest.approx((0.0325 + 0.025) / 2)


def test_packets_keep_their_order_whatever_the_delay_does() -> None:
    random = numbers(1.0, 0.0)
    queue = DelayedQueue(VaryingDelay(0.5, 0.5, lambda: next(random)), 1000)
    for number in range(50):
        queue.put(bytes([number]), number / 100)
    sent = [queue.due(2.0) for _ in range(50)]
    assert sent == [bytes([number]) for number in range(50)]
    assert (queue.due(2.0), queue.next_due, queue.dropped) == (None, None, 0)


def test_nothing_leaves_before_it_is_due_and_what_finds_no_place_is_counted() -> None:
    queue = DelayedQueue(VaryingDelay(0.05, 0.0, lambda: 0.5), 2)
    for data in (b"a", b"b", b"c"):
        queue.put(data, 1.0)
    assert queue.due(1.049) is None
    assert queue.next_due == pytest.approx(1.05)
    assert (queue.due(1.051), queue.due(1.051), queue.due(1.051)) == (b"a", b"b", None)
    assert queue.dropped == 1
