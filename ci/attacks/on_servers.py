"""Attacks on forge, registry, gate and Argo CD themselves, which need no release (`ci.attacks`)."""

from __future__ import annotations

from ci.attacks.cells import Attack, Refused, Unseen
from ci.attacks.shared_cells import (
    ARGOCD,
    INSPECTION,
    NO_DEMAND,
    NOT_ON_MAIN,
    NOT_PROPOSED,
    NOTHING_RUNS,
    NOTHING_TO_JUDGE,
    OTHER_CHART,
    PACKAGE_RIGHTS,
    POLICIES,
    RESERVED,
)

ON_SERVERS = (
    Attack(
        "notes-pushed",
        "The gate's notes (records, outcomes) are pushed by force",
        NO_DEMAND,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        NOTHING_RUNS,
        RESERVED,
    ),
    Attack(
        "staged-tag-overwritten",
        "A publisher overwrites the tag of what is being tried",
        NOT_ON_MAIN,
        Refused(
            "has no digest …; submit it again",
            "registry/publication/test_publication_on_forge.py::"
            "test_a_publisher_who_writes_a_tag_again_changes_nothing_that_is_tried",
        ),
        OTHER_CHART,
        NOTHING_RUNS,
    ),
    Attack(
        "platform-image-pushed",
        "A publisher pushes or deletes an image in the organisation of the platform's",
        NO_DEMAND,
        NOT_PROPOSED,
        Refused(
            "image … may not run in namespace …: only images that the platform was installed with run in its "
            "namespaces, by digest",
            f"{POLICIES}::test_the_platform_runs_its_own_images",
        ),
        Refused(
            "container … of pod … runs image …, which is not listed for this namespace",
            f"{INSPECTION}::test_an_image_that_was_pushed_to_the_platforms_organisation",
        ),
        Refused("401 Unauthorized: reqPackageAccess", f"{PACKAGE_RIGHTS}::test_writing", "the OCI registry"),
    ),
    Attack(
        "key-read",
        "An account of Argo CD reads the signing key",
        NO_DEMAND,
        NOT_PROPOSED,
        Unseen("policies judge what is written; who may read is a matter of rights"),
        NOTHING_RUNS,
        Refused(
            'secrets "gate-key" is forbidden: User "system:serviceaccount:argocd:…" cannot get resource "secrets"',
            "charts/test_rights.py::test_argo_cd_is_refused_the_key_of_the_gate",
            "the cluster's rights (embedded cluster)",
        ),
    ),
    Attack(
        "repo-server-asked",
        "The repo-server is asked to fetch an internal address",
        NO_DEMAND,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        NOTHING_RUNS,
        Refused(
            "TLSV13_ALERT_CERTIFICATE_REQUIRED",
            f"{ARGOCD}::test_the_repo_server_answers_who_shows_the_certificate_and_nobody_else",
            "the repo-server (embedded cluster)",
        ),
    ),
    Attack(
        "hook-unsigned",
        "An unsigned hook of a forge that is not used, in GitLab's form",
        NO_DEMAND,
        NOT_PROPOSED,
        NOTHING_TO_JUDGE,
        NOTHING_RUNS,
        Refused("Webhook processing failed", f"{ARGOCD}::test_an_unsigned_hook_of_no_forge_is_taken", "Argo CD"),
    ),
    Attack(
        "slow-connections",
        "Sixty slow connections to the gate",
        NO_DEMAND,
        Refused(
            "connections refused count=… last_source=…",
            "foundation/runtime/test_slow_clients.py::test_refusals_are_logged_once_in_a_while",
            "its log",
        ),
        NOTHING_TO_JUDGE,
        NOTHING_RUNS,
    ),
    Attack(
        "deep-json",
        "A request to the gate nests JSON 100,000 deep",
        NO_DEMAND,
        Refused(
            "the body is not readable as JSON",
            "delivery/gate/test_requests.py::test_what_is_deep_or_no_json_is_refused_with_words",
        ),
        NOTHING_TO_JUDGE,
        NOTHING_RUNS,
    ),
)  # fmt: skip
