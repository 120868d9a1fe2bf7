"""What is said when a certificate does not hold, the server's or one's own: what was refused, and what to do."""

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


def refused_own_certificate(alert: str) -> str:
    """The sentence for the alert, as OpenSSL names it, with which a server ends a handshake; empty when it is not about
    the client's certificate."""
    if "CERTIFICATE_REQUIRED" in alert or "HANDSHAKE_FAILURE" in alert:
        return (
            "the broker asks for a certificate of the account. Its Secret has one where the platform makes them "
            "(tls.accounts), with the key identity: certificate"
        )
    if "CERTIFICATE_EXPIRED" in alert:
        return (
            "the broker says that the account's certificate has expired; see the log of the Deployment certificates, "
            "and compare the clocks"
        )
    if "CERTIFICATE_REVOKED" in alert:
        return "the broker says that the account's certificate is revoked (`robotkube agent list`)"
    if "UNKNOWN_CA" in alert:
        return (
            "the broker does not know the authority of the account's certificate; compare it with ConfigMap "
            "robotkube-ca in the platform's namespace"
        )
    if "CERTIFICATE" in alert:
        return f"the broker does not take the account's certificate ({alert.lower().replace('_', ' ')})"
    return ""
