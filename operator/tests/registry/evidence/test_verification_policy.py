"""The verification policy: what it may say, and every mistake named at once."""

import pytest

from robotkube.errors import DocumentError
from robotkube.registry.evidence.core.verification_policy import PATH, SuiteRule, read_verification_policy
from tests.stages.registry.signed_evidence import POLICY, POLICY_TEXT

IMAGE = "forge.example:3000/suites/own@sha256:" + "a" * 64
HEAD = "apiVersion: registry.robotkube.io/v1alpha1\nkind: VerificationPolicy\nmetadata: {name: release}\n"
SUITE = "{name: static, version: '1', seconds: 60}"


def policy(suites: str) -> str:
    return f"{HEAD}spec: {{suites: [{suites}]}}\n"


def problems(text: str) -> tuple[str, ...]:
    with pytest.raises(DocumentError) as caught:
        read_verification_policy(text, PATH)
    return caught.value.problems


def test_suites_stay_in_their_order_with_their_limits() -> None:
    assert POLICY.suites[0] == SuiteRule("static", "1", 60)
    assert [rule.name for rule in POLICY.suites] == ["static", "images", "install"]
    assert POLICY.rule("install") == POLICY.suites[2]
    assert POLICY.rule("other") is None


def test_a_suite_of_a_user_names_its_image() -> None:
    own = f"{{name: own, version: '3', seconds: 9, image: '{IMAGE}', command: [run, --all], installs: true}}"
    read = read_verification_policy(policy(own), PATH)
    assert read.suites == (SuiteRule("own", "3", 9, IMAGE, ("run", "--all"), True),)


@pytest.mark.parametrize(
    ("keys", "seconds"), [("", 60), (", soakSeconds: 10", 10), (", soakSeconds: 0", 0), (", soakSeconds: 120", 120)]
)
def test_how_long_a_chart_soaks(keys: str, seconds: int) -> None:
    read = read_verification_policy(policy(f"{{name: install, version: '2', seconds: 240{keys}}}"), PATH)
    assert read.suites == (SuiteRule("install", "2", 240, soak_seconds=seconds, memory_growth_percent=10),)


def test_how_much_a_container_may_grow_meanwhile() -> None:
    read = read_verification_policy(policy("{name: install, version: '2', seconds: 9, memoryGrowthPercent: 25}"), PATH)
    assert read.suites[0].memory_growth_percent == 25


def test_a_run_that_is_short_soaks_for_half_of_it() -> None:
    read = read_verification_policy(policy("{name: install, version: '2', seconds: 75}"), PATH)
    assert read.suites[0].soak_seconds == 37


def test_the_digest_is_that_of_the_meaning() -> None:
    spaced = POLICY_TEXT.replace('version: "1"', "version:  '1'") + "# a comment\n"
    assert spaced != POLICY_TEXT
    assert read_verification_policy(spaced, PATH).digest == POLICY.digest
    longer = read_verification_policy(POLICY_TEXT.replace("seconds: 60", "seconds: 61"), PATH)
    assert longer.digest != POLICY.digest


@pytest.mark.parametrize(
    ("suites", "expected"),
    [
        ("", "spec.suites: must list 1 to 16 suites, not 0"),
        (", ".join(f"{{name: s{n}, version: '1', seconds: 1}}" for n in range(17)), "1 to 16 suites, not 17"),
        (f"{SUITE}, {SUITE}", "spec.suites: name 'static' stands twice"),
        ("{name: summary, version: '1', seconds: 1}", "spec.suites[0].name: 'summary' is taken"),
        ("{name: static, version: 1, seconds: 60}", "spec.suites[0].version: must be text; put it in quotes"),
        ("{name: static, version: '1', seconds: 0}", "spec.suites[0].seconds: must be whole seconds from 1 to 3600"),
        ("{name: static, version: '1', seconds: true}", "spec.suites[0].seconds: must be whole seconds"),
        (f"{{name: static, version: '1', seconds: 6, image: '{IMAGE}'}}", "spec.suites[0].image: static is a suite of"),
        ("{name: own, version: '1', seconds: 60}", "spec.suites[0].image: missing"),
        (
            "{name: own, version: '1', seconds: 60, image: 'own:latest'}",
            "spec.suites[0].image: 'own:latest' must match",
        ),
        ("{name: static, version: '1', seconds: 60, retries: 3}", "spec.suites[0].retries: unknown key; remove it"),
        (f"{{name: {'x' * 41}, version: '1', seconds: 1, image: '{IMAGE}'}}", "spec.suites[0].name: 'xxx"),
        ("text", "spec.suites[0]: must be a mapping"),
        ("{name: static, version: '1', seconds: 60, soakSeconds: 5}", "[0].soakSeconds: only install soaks; remove it"),
        ("{name: static, version: '1', seconds: 60, memoryGrowthPercent: 5}", "only install soaks; remove it"),
        ("{name: install, version: '1', seconds: 60, memoryGrowthPercent: 0}", "must be a whole number from 1 to 100"),
        ("{name: install, version: '1', seconds: 60, soakSeconds: 31}", "from 0 to 30, half of `seconds`"),
        ("{name: install, version: '1', seconds: 60, soakSeconds: true}", "[0].soakSeconds: must be whole seconds"),
    ],
)
def test_a_mistake_is_named_with_its_key(suites: str, expected: str) -> None:
    assert any(expected in problem for problem in problems(policy(suites)))


def test_all_mistakes_are_named_at_once() -> None:
    mistakes = problems("apiVersion: v1\nkind: Policy\nmetadata: {name: UPPER}\nspec: {suites: [{name: own}]}\n")
    keys = ("apiVersion:", "kind:", "metadata.name:", "[0].version: missing", "[0].seconds:", "[0].image: missing")
    assert all(any(key in problem for problem in mistakes) for key in keys)
