"""What is said when a server's certificate does not hold: what was refused, and what to do."""

from __future__ import annotations

NOT_YET, EXPIRED = 9, 10
UNKNOWN_AUTHORITY = frozenset([2, 18, 19, 20, 21])  # of OpenSSL's X509_V_ERR_*, as all here
OTHER_NAME = frozenset([62, 64])


def refused_certificate(code: int, words: str, name: str, authorities: str) -> str:
    """The sentence for OpenSSL's verification error `code`, which it puts into `words`; `name` was asked for, with the
    authorities of a file."""
    if code == EXPIRED:
        return (
            "its certificate has expired; have it renewed (tls.mode made: see the log of the Deployment certificates), "
            "and compare the clocks"
        )
    if code == NOT_YET:
        return "its certificate is not valid yet; compare the clocks"
    if code in UNKNOWN_AUTHORITY:
        return (
            f"its certificate is of an authority that {authorities} does not have; compare that file with ConfigMap "
            "robotkube-ca in the platform's namespace, and with the server's certificate"
        )
    if code in OTHER_NAME:
        return (
            f"its certificate is not for the name {name}; connect by one that it has, or add this one to tls.names (of "
            "the forge: forge.names)"
        )
    return f"its certificate does not hold: {words}"
